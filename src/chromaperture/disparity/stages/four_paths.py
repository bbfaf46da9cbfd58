"""Semi-global matching along rows and columns, in plain NumPy: the oracle of ``cpu/four_paths.py``.

Correlations become log-likelihoods; the four axis-parallel paths aggregate them and choose the layer.
"""

from __future__ import annotations

import numpy as np

from chromaperture.disparity.labels import LabelMap
from chromaperture.disparity.stages.correlation import cells_of, correlate
from chromaperture.disparity.stages.paths import PathPenalties, path_costs
from chromaperture.disparity.views import Views
from chromaperture.disparity.winner import PathWinner
from chromaperture.stage_config import CorrelationConfig, FourPathsConfig

LEAST_DETERMINANT = 1e-5  # of the correlations, whose logarithm is the log-likelihood: 5.8 nats at most
NAT_PARTS = 4096  # to which log-likelihoods are rounded: 15 bits, a power of two, so that sums of them are exact
POSTERIOR_POWER = 8  # (1 - x / 8)^8 replaces exp(-x): within 0.04 of it, and 0 beyond x = 8


def four_path_winner(
    views: Views,
    layers_px: np.ndarray,
    label_map: LabelMap,
    *,
    correlation: CorrelationConfig,
    paths: FourPathsConfig,
    labels_px: np.ndarray | None = None,
) -> PathWinner:
    """Correlate the views and find the best label of every pixel along four paths.

    Parameters
    ----------
    views : Views
        (h, w).
    layers_px : (D,) float, px
        Disparities that are scored.
    label_map : LabelMap
        Of every score, or `IDENTITY`: (h, w), or (ceil(h / 2), ceil(w / 2)) for cells of 2 px.
    correlation : CorrelationConfig
    paths : FourPathsConfig
    labels_px : (N,) float, px
        To choose among, from `labels.labels_between`; the layers when absent.
    """
    score = correlate(views, layers_px, config=correlation)
    labels_px = layers_px if labels_px is None else labels_px
    if not (label_map.is_identity and len(labels_px) == len(layers_px)):
        score = scores_at_labels(score, layers_px, labels_px, label_map)
    guide, mask = views.guide, views.mask
    if correlation.cell_px == 2:
        guide, mask = cells_of(guide), cells_of(mask)
    likelihood = log_likelihood(score, view_count=views.pictures.shape[2]) * mask[..., None]
    penalties = PathPenalties(paths.jump_penalty, paths.jump_penalty, paths.edge_range, paths.edge_floor)
    cost = path_costs(likelihood, guide, penalties, paths=4, parts=path_parts(paths.jump_penalty))
    layer = cost.argmin(axis=2)
    inside = np.clip(layer, 1, len(labels_px) - 2)
    before, at, after = (np.take_along_axis(likelihood, (inside + o)[..., None], axis=2)[..., 0] for o in (-1, 0, 1))
    return PathWinner(layer, before, at, after, _posterior_sigma(cost, layer, labels_px, paths))


def path_parts(jump: float) -> float:
    """Return the parts of a nat to which path costs are rounded: three of them, each below ``jump``, fit 16 bits."""
    return 32000 / (3 * jump)


def log_likelihood(score: np.ndarray, *, view_count: int) -> np.ndarray:
    """Log-likelihood against uncorrelated views, nats: -ln(1 - s^2) / 2 of two views, -ln(1 - s) of three.

    Rounded to 1 / `NAT_PARTS`.
    """
    clipped = np.clip(score, 0, 1)
    determinant = 1 - clipped**2 if view_count == 2 else (1 - clipped) ** 2
    nats = -0.5 * np.log(np.maximum(determinant, LEAST_DETERMINANT))
    return np.asarray(np.round(NAT_PARTS * nats) / NAT_PARTS)


def scores_at_labels(
    score: np.ndarray, layers_px: np.ndarray, labels_px: np.ndarray, label_map: LabelMap
) -> np.ndarray:
    """Interpolate scores at the labels of a map, by Catmull and Rom's cubics through four layers.

    Straight lines would cut off the peaks between the layers, by more the farther from them, and bias a frame of even
    depth to the layers as a whole.

    Parameters
    ----------
    score : (H, W, D) float
    layers_px : (D,) float, px
    labels_px : (N,) float, px
    label_map : LabelMap

    Returns
    -------
    (H, W, N) float32; 0, no evidence, beyond the layers
    """
    count = len(layers_px)
    disparity = label_map.offset_px[..., None] + label_map.scale[..., None] * labels_px
    disparity = np.broadcast_to(disparity, (*score.shape[:2], len(labels_px)))
    place = (disparity - layers_px[0]) / (layers_px[1] - layers_px[0])
    low = np.clip(np.floor(place).astype(np.intp), 0, count - 2)
    t = place - low
    taps = [np.take_along_axis(score, np.clip(low + i, 0, count - 1), axis=2) for i in (-1, 0, 1, 2)]
    third = 3 * (taps[1] - taps[2]) + taps[3] - taps[0]
    second = 2 * taps[0] - 5 * taps[1] + 4 * taps[2] - taps[3]
    value = taps[1] + t / 2 * (taps[2] - taps[0] + t * (second + t * third))
    return np.where((t >= 0) & (t <= 1), value, 0).astype(np.float32)


def _posterior_sigma(cost: np.ndarray, layer: np.ndarray, layers_px: np.ndarray, paths: FourPathsConfig) -> np.ndarray:
    """Root mean square distance of the layers from the best, weighted by how little more they cost; (H, W) px."""
    excess = (cost - cost.min(axis=2, keepdims=True)) / (POSTERIOR_POWER * paths.temperature)
    weight = np.maximum(1 - excess, 0) ** POSTERIOR_POWER
    away = (layers_px - layers_px[layer][..., None]) ** 2
    return np.sqrt((weight * away).sum(axis=2) / weight.sum(axis=2)).astype(np.float32)

"""Semi-global matching along rows and columns, in plain NumPy: the oracle of ``compiled/four_paths.py``.

Correlations become log-likelihoods; the four axis-parallel paths aggregate them and choose the layer. A pixel
of cost c(d), what has come to it along its path included, sends ``m(d) = min(c(d), min c + e jump) - min c`` to the
next one, with the guide's edge weight e between the two. Rows are walked first. Columns take a share of what has come
along the rows for evidence: they then know what a whole row says of its pixels, where paths that know nothing of each
other draw streaks across weak texture. With all of it every pixel has the exact minimum over a tree, its column and all
rows that branch off (Bleyer, Gelautz); with none of it this is semi-global matching (Hirschmueller).

References
----------
M. Bleyer, M. Gelautz: Simple but effective tree structures for dynamic programming-based stereo matching. VISAPP 2008.
H. Hirschmueller: Stereo processing by semiglobal matching and mutual information. TPAMI 30, 2008.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from chromaperture.matching.labels import LabelMap, PathWinner
from chromaperture.matching.readable.correlation import cells_of, correlate
from chromaperture.matching.readable.paths import lagrange_weights
from chromaperture.matching.views import Views
from chromaperture.settings.stages import CorrelationConfig, FourPathsConfig

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
    cost = summed_costs(-likelihood, guide, paths, parts=path_parts(paths.jump_penalty))
    layer = cost.argmin(axis=2)
    inside = np.clip(layer, 1, len(labels_px) - 2)
    far_before, before, at, after, far_after = (
        np.take_along_axis(likelihood, np.clip(inside + o, 0, len(labels_px) - 1)[..., None], axis=2)[..., 0]
        for o in (-2, -1, 0, 1, 2)
    )
    sigma_px = _posterior_sigma(cost, layer, labels_px, paths)
    return PathWinner(layer, before, at, after, sigma_px, far_before, far_after)


def path_parts(jump: float) -> float:
    """Return the parts of a nat to which path costs are rounded: two of them, each below ``jump``, fit 16 bits."""
    return 32000 / (2 * jump)


def summed_costs(
    own: np.ndarray, guide: np.ndarray, paths: FourPathsConfig, *, parts: float | None = None
) -> np.ndarray:
    """Sum a pixel's own costs and those that come along its row and its column.

    ``own`` (H, W, N) float, nats; ``guide`` (H, W) float, in units of ``guide_range``; ``parts``: of a nat, to which
    what comes along is rounded as all executions keep it, but for what comes up the columns. Returns (H, W, N) float64:
    lower is better.
    """
    along_row = _arriving(own, guide, paths, axis=1, parts=parts)
    along_column = _arriving(own + paths.row_share * along_row, guide, paths, axis=0, parts=parts)
    return own + along_row + along_column


def _arriving(
    own: np.ndarray, guide: np.ndarray, paths: FourPathsConfig, *, axis: int, parts: float | None
) -> np.ndarray:
    """Sum the costs that come to every pixel from both ends of its line; (H, W, N) float64."""
    own, guide = np.moveaxis(own, axis, 0).astype(np.float64), np.moveaxis(guide, axis, 0)
    links = paths.edge_floor + (1 - paths.edge_floor) * np.exp(-np.abs(np.diff(guide, axis=0)) / paths.edge_range)
    total = np.zeros(own.shape)
    for order in (range(len(own)), range(len(own) - 1, -1, -1)):
        coming = np.zeros(own.shape[1:])
        for before, here in pairwise(order):
            cost = own[before] + coming
            least = cost.min(axis=-1, keepdims=True)
            jump = paths.jump_penalty * links[min(before, here)][:, None]
            coming = np.minimum(cost, least + jump) - least
            up_a_column = axis == 0 and before > here
            total[here] += coming if parts is None or up_a_column else np.round(parts * coming) / parts
    return np.moveaxis(total, 0, axis)


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
    """Interpolate scores at the labels of a map, by polynomials through six layers.

    Beyond both ends scores continue on the parabola through the three outermost layers. Where the outermost was
    repeated instead, flat walls within a px of the range's end were drawn by 0.04 to 0.11 px, so by less than 0.01 px
    (docs/decisions.md, *Ends of the range*).

    Whatever cuts off the peaks between the layers draws flat surfaces to them: cubics through four layers by 0.013 px,
    these by no more than scores of the labels themselves, 0.008 px (`benchmarks/locking.py`).

    ``score`` (H, W, D) float; ``layers_px`` (D,) float, px; ``labels_px`` (N,) float, px. Returns (H, W, N) float32; 0,
    no evidence, beyond the layers.
    """
    count = len(layers_px)
    disparity = label_map.offset_px[..., None] + label_map.scale[..., None] * labels_px
    disparity = np.broadcast_to(disparity, (*score.shape[:2], len(labels_px)))
    place = (disparity - layers_px[0]) / (layers_px[1] - layers_px[0])
    low = np.clip(np.floor(place).astype(np.intp), 0, count - 2)
    t = place - low
    wide = continued(score)
    taps = [np.take_along_axis(wide, low + i, axis=2) for i in range(6)]
    value = sum(weight * tap for weight, tap in zip(lagrange_weights(t), taps, strict=True))
    return np.where((t >= 0) & (t <= 1), value, 0).astype(np.float32)


def continued(score: np.ndarray) -> np.ndarray:
    """Continue scores (..., D) by two layers at either end, on the parabola through the three outermost."""
    for _ in range(2):
        before = 3 * (score[..., :1] - score[..., 1:2]) + score[..., 2:3]
        after = 3 * (score[..., -1:] - score[..., -2:-1]) + score[..., -3:-2]
        score = np.concatenate([before, score, after], axis=-1)
    return score


def _posterior_sigma(cost: np.ndarray, layer: np.ndarray, layers_px: np.ndarray, paths: FourPathsConfig) -> np.ndarray:
    """Root mean square distance of the layers from the best, weighted by how little more they cost; (H, W) px."""
    excess = (cost - cost.min(axis=2, keepdims=True)) / (POSTERIOR_POWER * paths.temperature)
    weight = np.maximum(1 - excess, 0) ** POSTERIOR_POWER
    away = (layers_px - layers_px[layer][..., None]) ** 2
    return np.sqrt((weight * away).sum(axis=2) / weight.sum(axis=2)).astype(np.float32)

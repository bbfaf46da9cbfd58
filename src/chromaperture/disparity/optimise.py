"""Quality "accurate": one global optimisation of the volume instead of a filter and a winner.

Scores of several colour spaces become log-likelihoods, which add; semi-global matching and total
variation find the surface; how far a layer of nearly the same cost lies from it gives the error bar.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import ModuleType
from typing import Literal

import cv2
import numpy as np

from chromaperture.config import MatcherConfig, OptimiserConfig
from chromaperture.disparity.between_layers import between_layers
from chromaperture.disparity.semiglobal import LayerField, even_field
from chromaperture.disparity.views import MatchInputs
from chromaperture.disparity.winner import Winner, parabola_winner
from chromaperture.errors import InputError

Backend = Literal["numba", "reference"]
ScoreVolume = Callable[[MatchInputs, MatcherConfig], np.ndarray]
EDGE_REACH_PX = 8  # two sigmas of the accurate window
MAX_CORRELATION = 0.999  # squared, for two views: a perfect score must not outvote the whole neighbourhood


def match(
    inputs: Sequence[MatchInputs],
    config: MatcherConfig,
    optimiser: OptimiserConfig,
    *,
    score_volume: ScoreVolume,
    fields: Sequence[LayerField] | None = None,
    backend: Backend = "numba",
) -> Winner:
    """Match one capture in one or several colour spaces at once.

    Parameters
    ----------
    inputs : sequence of MatchInputs
        One for each colour space, all with the same layers; the guide is the first one's. Without fields
        their ``directions`` must share one scale of disparity, see `relative_scale`.
    config : MatcherConfig
        A smaller window than for a local winner serves best: a decay of .70. Noise debiasing is left out.
    optimiser : OptimiserConfig
    score_volume : callable
        ``reference.score_volume`` or its fast twin.
    fields : sequence of LayerField, optional
        One for each colour space of a camera, see `semiglobal.layer_field`: surfaces of equal depth
        become smooth instead of surfaces of equal disparity, and the colour spaces come to one scale.
    backend : {"numba", "reference"}

    Returns
    -------
    Winner
        As `optimise_volume`; disparities of the first colour space.
    """
    implementation = solver(backend)
    raw = replace(config, noise_debiasing=False)
    first = inputs[0]
    layers = with_halves(first.layers_px)
    likelihood = np.zeros((*first.mask.shape, len(layers)), np.float32)
    for i, one in enumerate(inputs):
        view_count = one.views.shape[2]
        evidence = log_likelihood(score_volume(one, raw), view_count=view_count)
        field = even_field(*one.mask.shape) if fields is None else fields[i]
        factors = view_count - 1  # see `log_likelihood`: three views square theirs
        likelihood += implementation.at_labels(evidence, one.layers_px, layers, field, factors=factors)
    likelihood *= first.mask[..., None] / len(inputs)
    winner = optimise_volume(likelihood, first.guide, layers, config=optimiser, backend=backend)
    return winner if fields is None else at_pixels(winner, fields[0])


def with_halves(layers_px: np.ndarray) -> np.ndarray:
    """Put a layer between every two; (2 D - 1,) float64, px."""
    return np.linspace(layers_px[0], layers_px[-1], 2 * len(layers_px) - 1)


def at_pixels(winner: Winner, field: LayerField) -> Winner:
    """Turn a winner among labels into one among the disparities of every pixel."""
    disparity = field.offset_px + field.scale * winner.disparity_px
    spread = None if winner.spread_px is None else field.scale * winner.spread_px
    return Winner(disparity, winner.peak, winner.curvature / field.scale**2, spread)


def relative_scale(
    disparity_px: np.ndarray, likelihood: np.ndarray, layers_px: np.ndarray, *, candidates: np.ndarray
) -> float:
    """Find by which factor the disparities of a second colour space differ from a known map.

    Leaking film brings the views of plain sensor channels closer together than unmixed ones, by less than
    their centroids because blurred copies do not merge: measure it, on captures that reach far from focus.

    Parameters
    ----------
    disparity_px : (H, W) float, px
        In the first colour space; NaN unknown.
    likelihood : (H, W, D) float
        Of the second.
    layers_px : (D,) float, px
    candidates : (N,) float

    Returns
    -------
    float
        The candidate at whose multiple of the map the second space finds the most evidence; multiply the
        ``directions`` of the second space by it.
    """
    known = np.isfinite(disparity_px)
    volume = likelihood[known]
    evidence = []
    for factor in candidates:
        place = (factor * disparity_px[known] - layers_px[0]) / (layers_px[1] - layers_px[0])
        layer = np.clip(np.floor(place).astype(np.intp), 0, len(layers_px) - 2)
        share = np.clip(place - layer, 0, 1)
        below = np.take_along_axis(volume, layer[:, None], axis=1)[:, 0]
        above = np.take_along_axis(volume, layer[:, None] + 1, axis=1)[:, 0]
        evidence.append(float(((1 - share) * below + share * above).sum()))
    return float(candidates[int(np.argmax(evidence))])


def log_likelihood(score: np.ndarray, *, view_count: int) -> np.ndarray:
    """Log-likelihood of every layer against uncorrelated views, nats a pixel.

    Gaussian views whose correlation matrix has the determinant D earn -(1/2) ln D a pixel: D = 1 - rho^2
    for two views, the square of one minus the score for three. An anti-correlation is no evidence. Score without noise
    debiasing: noise must lower the correlation here, or noise alone would look certain.

    Parameters
    ----------
    score : (H, W, D) float
    view_count : {2, 3}

    Returns
    -------
    (H, W, D) float32, >= 0
    """
    explained = np.clip(score, 0, 1, dtype=np.float32)
    explained = explained**2 if view_count == 2 else 1 - (1 - explained) ** 2
    return -0.5 * np.log1p(-np.minimum(explained, np.float32(MAX_CORRELATION)))


def optimise_volume(
    likelihood: np.ndarray,
    guide: np.ndarray,
    layers_px: np.ndarray,
    *,
    config: OptimiserConfig,
    backend: Backend = "numba",
) -> Winner:
    """Find the surface that explains the whole volume.

    Parameters
    ----------
    likelihood : (H, W, D) float, nats a pixel
        From `log_likelihood`; for several colour spaces the mean, which keeps the penalties' scale.
    guide : (H, W) float
        Centre view, in units of the bilateral range.
    layers_px : (D,) float, px
    config : OptimiserConfig
    backend : {"numba", "reference"}

    Returns
    -------
    Winner
        With ``spread_px``; the disparity is NaN within half a layer of an end of the range.

    Raises
    ------
    InputError
        Shapes do not fit together.
    """
    if likelihood.ndim != 3 or likelihood.shape[:2] != guide.shape or likelihood.shape[2] != len(layers_px):
        raise InputError(
            f"a volume of shape {likelihood.shape} does not fit a guide of shape {guide.shape} and "
            f"{len(layers_px)} layers"
        )
    step = float(layers_px[1] - layers_px[0])
    implementation = solver(backend)
    likelihood = np.ascontiguousarray(likelihood, np.float32)
    cost = implementation.aggregate(likelihood, guide, step, config=config)
    paths = parabola_winner(cost, layers_px, lower_is_better=True)
    start = np.where(np.isfinite(paths.disparity_px), paths.disparity_px, layers_px[cost.argmin(axis=2)])
    start = between_layers(start, likelihood, layers_px, sigma_px=config.pooling_px)
    disparity = implementation.coupled_variation(start, likelihood, guide, layers_px, config=config)
    spread = implementation.spread(disparity, cost, layers_px, temperature=config.temperature * config.paths)
    spread = np.hypot(spread, local_range(disparity, EDGE_REACH_PX))

    layer = np.rint((disparity - layers_px[0]) / step).astype(np.intp)
    explained = -np.expm1(-2 * np.take_along_axis(likelihood, layer[..., None], axis=2)[..., 0])
    inside = (disparity > layers_px[0] + step / 2) & (disparity < layers_px[-1] - step / 2)
    return Winner(
        np.where(inside, disparity, np.nan).astype(np.float32), np.sqrt(explained), paths.curvature, spread
    )


def local_range(disparity_px: np.ndarray, reach_px: int) -> np.ndarray:
    """Give what the disparity varies by in a square around each pixel; (H, W) float32, px.

    Next to a depth edge windows see both sides, and a pixel given to the wrong one is wrong by all of it, however
    sharp its posterior.
    """
    square = np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)
    surface = np.asarray(disparity_px, np.float32)
    return np.asarray(cv2.dilate(surface, square) - cv2.erode(surface, square))


def solver(name: Backend) -> ModuleType:
    """Give the module that implements the optimiser."""
    if name == "reference":
        from chromaperture.disparity import semiglobal

        return semiglobal
    from chromaperture.disparity import semiglobal_kernels  # compiling starts here, not at import

    return semiglobal_kernels

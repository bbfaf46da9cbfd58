"""Quality "accurate": one global optimisation of the volume instead of a filter and a winner.

Scores of several colour spaces become log-likelihoods, which add; semi-global matching and total
variation find the surface; how far a layer of nearly the same cost lies from it gives the error bar.
"""

from __future__ import annotations

from types import ModuleType
from typing import Literal

import numpy as np

from chromaperture.config import OptimiserConfig
from chromaperture.disparity.subpixel import Winner, parabola_winner
from chromaperture.errors import InputError

Backend = Literal["numba", "reference"]
MAX_CORRELATION = 0.999  # squared, for two views: a perfect score must not outvote the whole neighbourhood


def log_likelihood(score: np.ndarray, *, view_count: int) -> np.ndarray:
    """Log-likelihood of every layer against uncorrelated views, nats a pixel.

    Gaussian views whose correlation matrix has the determinant D earn -(1/2) ln D a pixel: D = 1 - rho^2
    for two views, one minus the score for three. An anti-correlation is no evidence. Score without noise
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
    if view_count == 2:
        explained *= explained
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
    solver = _backend(backend)
    likelihood = np.ascontiguousarray(likelihood, np.float32)
    cost = solver.aggregate(likelihood, guide, step, config=config)
    paths = parabola_winner(-cost, layers_px)
    start = np.where(np.isfinite(paths.disparity_px), paths.disparity_px, layers_px[cost.argmin(axis=2)])
    disparity = solver.coupled_variation(start, likelihood, guide, layers_px, config=config)
    spread = solver.spread(disparity, cost, layers_px, temperature=config.temperature * config.paths)

    layer = np.rint((disparity - layers_px[0]) / step).astype(np.intp)
    explained = -np.expm1(-2 * np.take_along_axis(likelihood, layer[..., None], axis=2)[..., 0])
    inside = (disparity > layers_px[0] + step / 2) & (disparity < layers_px[-1] - step / 2)
    return Winner(
        np.where(inside, disparity, np.nan).astype(np.float32), np.sqrt(explained), paths.curvature, spread
    )


def _backend(name: Backend) -> ModuleType:
    if name == "reference":
        from chromaperture.disparity import semiglobal

        return semiglobal
    from chromaperture.disparity import semiglobal_kernels  # compiling starts here, not at import

    return semiglobal_kernels

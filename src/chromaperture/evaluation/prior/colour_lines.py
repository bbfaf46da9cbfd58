"""The colour-line measure of the paper's [4]: where channels are aligned, their colours lie on a line."""

from __future__ import annotations

import numpy as np

from chromaperture.disparity.accurate import optimised_surface
from chromaperture.disparity.execution import execution_named
from chromaperture.evaluation.prior.shifts import best_layer, box, sampled, spline
from chromaperture.stage_config import SurfaceConfig

_PATHS = SurfaceConfig(slope_penalty=1.0, jump_penalty=1.0, coupling_rounds=0)
_LOG_SPAN = 16.0  # nats: below exp(-16) a window is a perfect line, and noise tells which is more so


def colour_line_measure(
    image: np.ndarray, directions: np.ndarray, layers_px: np.ndarray, *, side_px: int = 15
) -> np.ndarray:
    """Product of the eigenvalues of the local colour covariance over the product of its diagonal.

    With eigenvalues l_i and channel variances s_c^2, L = l_0 l_1 l_2 / (s_r^2 s_g^2 s_b^2) in [0, 1]: 0 for colours on
    a line or plane, 1 for channels that have nothing to do with each other. The product is the determinant.

    Parameters
    ----------
    image : (H, W, 3) float
    directions : (3, 2) float
        Displacement (x, y) of R, G, B per px of disparity.
    layers_px : (D,) float
    side_px : int

    Returns
    -------
    (D, H, W) float64
    """
    measure = np.empty((len(layers_px), *image.shape[:2]))
    planes = [spline(image[..., c]) for c in range(3)]
    for i, d in enumerate(layers_px):
        r, g, b = (sampled(p, d * u, d * v).astype(np.float64) for p, (u, v) in zip(planes, directions, strict=True))
        mr, mg, mb = box(r, side_px), box(g, side_px), box(b, side_px)
        rr, gg, bb = box(r * r, side_px) - mr * mr, box(g * g, side_px) - mg * mg, box(b * b, side_px) - mb * mb
        rg, rb, gb = box(r * g, side_px) - mr * mg, box(r * b, side_px) - mr * mb, box(g * b, side_px) - mg * mb
        rr, gg, bb = (np.maximum(s, 1e-10) for s in (rr, gg, bb))
        determinant = rr * (gg * bb - gb**2) - rg * (rg * bb - gb * rb) + rb * (rg * gb - gg * rb)
        measure[i] = np.clip(determinant / (rr * gg * bb), 0, 1)
    return measure


def colour_lines(
    image: np.ndarray,
    directions: np.ndarray,
    layers_px: np.ndarray,
    *,
    side_px: int = 15,
    optimised: bool = True,
) -> np.ndarray:
    """Match by colour lines, every pixel alone or with a global optimisation.

    The original solves a Markov field by graph cuts; here semi-global paths take their place, over the same measure.

    Parameters
    ----------
    image, directions, layers_px, side_px
        As in `colour_line_measure`.
    optimised : bool

    Returns
    -------
    (H, W) float64, px; NaN at the ends of the range
    """
    measure = colour_line_measure(image, directions, layers_px, side_px=side_px)
    if not optimised:
        return best_layer(-measure, layers_px)
    likelihood = -np.log(np.maximum(measure, np.exp(-_LOG_SPAN)))
    guide = np.ascontiguousarray(image.mean(axis=2) / (0.06 * max(float(np.percentile(image, 99)), 1e-6)), np.float32)
    volume = np.ascontiguousarray(np.moveaxis(likelihood, 0, 2), np.float32)
    found = optimised_surface(volume, guide, layers_px, config=_PATHS, run=execution_named("numba"))
    return np.asarray(found.disparity_px, float)

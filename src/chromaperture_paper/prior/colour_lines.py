"""The colour-line measure of the paper's [4]: colours of aligned channels lie on a line."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.accurate import path_surface
from chromaperture.matching.execution import execution_named
from chromaperture.settings.methods import AccurateConfig
from chromaperture.settings.stages import SurfaceConfig
from chromaperture_paper.prior.shifts import best_layer, box, sampled, spline

_PATHS = AccurateConfig(surface=SurfaceConfig(slope_penalty=1.0, jump_penalty=1.0))  # penalties chosen by hand
_LOG_SPAN = 16.0  # nats; a smaller measure, below exp(-16), depends on noise; chosen by hand
_GUIDE_STEP = 0.06  # unit of the guide's steps, of the bright level (99th percentile); chosen by hand


def colour_line_measure(image: np.ndarray, directions: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
    """Return the determinant of the local colour covariance over the product of its diagonal.

    With eigenvalues l_i and channel variances s_c^2, L = l_0 l_1 l_2 / (s_r^2 s_g^2 s_b^2) in [0, 1]: 0 for colours on
    a line or plane, 1 for uncorrelated channels.

    ``image`` (H, W, 3) float; ``directions`` (3, 2) float: displacement (x, y) of R, G, B per px of disparity;
    ``layers_px`` (D,) float. Returns (D, H, W) float64.
    """
    measure = np.empty((len(layers_px), *image.shape[:2]))
    planes = [spline(image[..., c]) for c in range(3)]
    for i, d in enumerate(layers_px):
        r, g, b = (sampled(p, d * u, d * v).astype(np.float64) for p, (u, v) in zip(planes, directions, strict=True))
        mr, mg, mb = box(r), box(g), box(b)
        rr, gg, bb = box(r * r) - mr * mr, box(g * g) - mg * mg, box(b * b) - mb * mb
        rg, rb, gb = box(r * g) - mr * mg, box(r * b) - mr * mb, box(g * b) - mg * mb
        rr, gg, bb = (np.maximum(s, 1e-10) for s in (rr, gg, bb))
        determinant = rr * (gg * bb - gb**2) - rg * (rg * bb - gb * rb) + rb * (rg * gb - gg * rb)
        measure[i] = np.clip(determinant / (rr * gg * bb), 0, 1)
    return measure


def colour_lines(
    image: np.ndarray, directions: np.ndarray, layers_px: np.ndarray, *, optimised: bool = True
) -> np.ndarray:
    """Match by `colour_line_measure`, pixel by pixel or with a global optimisation.

    The original optimises a Markov random field by graph cuts; here semi-global paths replace them.

    Returns (H, W) float64, px; NaN at the ends of the range.
    """
    measure = colour_line_measure(image, directions, layers_px)
    if not optimised:
        return best_layer(-measure, layers_px)
    likelihood = -np.log(np.maximum(measure, np.exp(-_LOG_SPAN)))
    bright = max(float(np.percentile(image, 99)), 1e-6)
    guide = np.ascontiguousarray(image.mean(axis=2) / (_GUIDE_STEP * bright), np.float32)
    volume = np.ascontiguousarray(np.moveaxis(likelihood, 0, 2), np.float32)
    found = path_surface(volume, guide, layers_px, config=_PATHS, run=execution_named("numba")).label_px
    half = (layers_px[1] - layers_px[0]) / 2
    inside = (found > layers_px[0] + half) & (found < layers_px[-1] - half)
    return np.where(inside, found.astype(float), np.nan)

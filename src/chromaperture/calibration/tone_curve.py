"""Is decoded light proportional to exposure? Two photographs of the same scene at two exposures tell.

Where values are u = L^q of the light L, the ratio of two exposures k apart is k^q at every level; a curve that was
decoded wrongly in another way has another q at each level, and vignetting shows many levels in one picture. Constant
ratios are no proof: q needs the exposures, which a camera states to some 5 %, so that q is known to 0.05 / ln k.

What a wrong q costs, once a camera is calibrated with it: the views of a film are separated by the ratios of white
sheets, which become the power q of what they are. That displaces all edges by the same share of their disparity, and
calibration takes it up. What is left depends on contrast, because the profile of an edge through the pupil bends with
it: `disparity_error` is its largest value between faint edges and black print on white paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.color.unmixing import mixing_matrix, unmixing_rows
from chromaperture.optics.aperture import design_named, made_of
from chromaperture.optics.psf import pupil_samples
from chromaperture.system.errors import InputError
from chromaperture.system.robust import MAD_TO_SIGMA

LEAST_RATIO = 1.4  # of two exposures: half a stop; less, and q is known to 0.15 at best; chosen by hand
_BLOCKS = 24  # along the shorter side of a picture, whose means are compared; chosen by hand
_DARKEST = 0.01  # of full scale: below, 8 bits of sRGB have fewer than 25 counts; chosen by hand
_FEWEST, _BINS = 12, 8  # blocks of a bin of levels; bins; chosen by hand
_CONTRASTS = (1.001, 1.5, 2.0, 4.0, 8.0, 23.0)  # of edges; the last is black print, 0.04, on paper of 0.92
_CELLS, _PLACES = 96, 1201  # across the pupil, and along an edge's profile; finer ones change 1e-4


@dataclass(frozen=True)
class ToneCurve:
    """The local exponent q of decoded values by their level; (N,) float64 each.

    Attributes
    ----------
    level : (N,)
        Geometric mean of the values of both exposures, of full scale.
    exponent : (N,)
        Logarithm of the ratio of the values over that of the exposures; 1 where decoded light is linear.
    scatter : float
        Of single blocks about the exponent of their level: large where the scene or the light changed.
    """

    level: np.ndarray
    exponent: np.ndarray
    scatter: float

    @property
    def error(self) -> float:
        """Root mean square of exponent - 1 over the levels."""
        return float(np.sqrt(np.mean((self.exponent - 1) ** 2)))


def measure_tone(shorter: np.ndarray, longer: np.ndarray, exposure_ratio: float) -> ToneCurve:
    """Measure the exponent of decoded values.

    Parameters
    ----------
    shorter, longer : (H, W, 3) float, linear as decoded
        The same scene, the second exposed longer.
    exposure_ratio : float
        Of the longer exposure to the shorter one.

    Returns
    -------
    ToneCurve

    Raises
    ------
    InputError
        Other sizes, exposures that hardly differ, or too little that is neither dark nor saturated in both.
    """
    if shorter.shape != longer.shape:
        raise InputError("the two exposures have different sizes; take both with the same settings")
    if not exposure_ratio >= LEAST_RATIO:
        raise InputError(
            f"the exposures differ by a factor of {exposure_ratio:.2f} only; take one at half or a quarter of the other"
        )
    low, high = _blocks(shorter), _blocks(longer)
    usable = (low > _DARKEST) & np.isfinite(high) & (high > 0)
    if usable.sum() < _FEWEST:
        raise InputError("too little of the picture is neither dark nor too bright in both exposures; expose less, or "
                         "light the sheet more")  # fmt: skip
    logs = np.log(high[usable] / low[usable]) / np.log(exposure_ratio)
    level = np.sqrt(high[usable] * low[usable])
    edges = np.geomspace(level.min(), level.max() * (1 + 1e-9), _BINS + 1)
    bins = np.clip(np.searchsorted(edges, level, side="right") - 1, 0, _BINS - 1)
    filled = [i for i in range(_BINS) if (bins == i).sum() >= _FEWEST]
    if not filled:
        filled, bins = [0], np.zeros_like(bins)
    exponent = np.array([np.median(logs[bins == i]) for i in filled])
    middle = np.array([np.exp(np.log(level[bins == i]).mean()) for i in filled])
    residual = logs - np.interp(np.log(level), np.log(middle), exponent)
    return ToneCurve(middle, exponent, float(MAD_TO_SIGMA * np.median(np.abs(residual))))


def _blocks(image: np.ndarray) -> np.ndarray:
    """Return the means of square blocks in each channel, NaN where a pixel is saturated; (N, 3) float64."""
    side = max(min(image.shape[:2]) // _BLOCKS, 1)
    rows, columns = image.shape[0] // side, image.shape[1] // side
    parts = np.asarray(image[: rows * side, : columns * side], float).reshape(rows, side, columns, side, 3)
    means = parts.mean(axis=(1, 3))
    means[parts.max(axis=(1, 3)) >= SATURATION] = np.nan
    return np.asarray(means.reshape(-1, 3))


def disparity_error(design: str, exponent_error: float) -> float:
    """Return the relative error of disparities that calibration with the same wrong exponent leaves.

    Parameters
    ----------
    design : str
        Of usual film.
    exponent_error : float
        `ToneCurve.error`; 0 to 1.

    Returns
    -------
    float
        Largest difference of an edge's disparity to that of faint edges, relative to it, over contrasts, both
        directions of the edge, and both signs of the exponent's error.
    """
    if not 0 <= exponent_error < 1:
        raise InputError(f"the error of the tone curve's exponent must lie between 0 and 1, got {exponent_error:g}")
    return 0.0 if exponent_error == 0 else max(_spread(design, 1 + s * exponent_error) for s in (1, -1))


@lru_cache(maxsize=64)
def _spread(design: str, exponent: float) -> float:
    disparity = np.array([edge_disparity(design, exponent, m, s) for m in _CONTRASTS for s in (1, -1)])
    faint = disparity[:2].mean()
    return float(np.abs(disparity / faint - 1).max())


def edge_disparity(design: str, exponent: float, contrast: float, direction: int) -> float:
    """Return the half disparity of an edge whose light is decoded to the power of an exponent, in pupil radii.

    The edge is seen by each channel through its part of the pupil, the views are separated with what white sheets
    show at the same exponent, and each edge stands at the mean of its slope.

    Parameters
    ----------
    design : str
        Of usual film.
    exponent : float
    contrast : float
        Of the bright side to the dark one.
    direction : {1, -1}
        Bright after or before the edge.
    """
    aperture = made_of(design_named(design), "real")
    points, light = pupil_samples(aperture, _CELLS)
    colors = np.array([aperture.filter_named(name).transmission for name in aperture.views])
    rows = unmixing_rows(mixing_matrix(colors**exponent), len(aperture.views))
    linear = light @ unmixing_rows(mixing_matrix(colors), len(aperture.views)).T
    centres = points.T @ (linear / linear.sum(axis=0))
    axis = centres[:, 0] - centres[:, -1]
    order = np.argsort(points @ axis)
    at, passed = (points @ axis)[order] / np.hypot(*axis), light[order]
    places = np.linspace(-1.1, 1.1, _PLACES)
    white = passed.sum(axis=0)
    summed = np.cumsum(passed, axis=0) / np.maximum(white, 1e-12)
    seen = np.stack([np.interp(places, at, summed[:, k], left=0.0, right=1.0) for k in range(3)], axis=1)
    seen = seen if direction > 0 else 1 - seen
    profile = ((1 + (contrast - 1) * seen) / contrast * white / white.max()) ** exponent @ rows.T
    slope = np.diff(profile, axis=0)
    middle = (places[1:] + places[:-1]) / 2
    stands = (middle[:, None] * slope).sum(axis=0) / slope.sum(axis=0)
    return float(stands[0] - stands[-1]) / 2

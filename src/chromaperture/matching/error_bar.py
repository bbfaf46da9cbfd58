"""From the shape of a score's peak or of a posterior to an error bar and a confidence (``docs/equations.md``)."""

from __future__ import annotations

import math

import cv2
import numpy as np

from chromaperture.color.image import DARK
from chromaperture.matching.labels import Surface, Winner
from chromaperture.settings.methods import PaperConfig

LIGHT_WINDOW_PX = 8  # side of the squares whose mean light is looked at: a matching window, two sigmas of 4 px
CONFIDENCE_SCALE_PX = 0.25  # standard deviation at which confidence has fallen to 1/e; chosen by hand
MAX_SIGMA_PX = 4.0  # a quarter of the default search range: beyond, nothing is known of the layer
_BEYOND_PX = 1e6  # takes the place of unknown disparities, which are neither the least nor the greatest
# White noise behind a Gaussian of variance s^2 has the autocorrelation exp(-r^2 / 4 s^2), whose integral is 4 pi s^2;
# that of its square, which counts for correlations, is half of it. The factor 0.8 * 0.57 = 0.46 was chosen by hand;
# tests/depth/test_confidence.py holds the error bar against known errors.
_NOISE_AREA = 0.8 * 4 * math.pi, 0.57


def peak_sigma(winner: Winner, config: PaperConfig, view_count: int, signal_fraction: np.ndarray) -> np.ndarray:
    """Return the standard deviation of a local best layer, px; NaN where the disparity is unknown.

    Gaussian signals of correlation determinant D have the log-likelihood -(N/2) ln D, so the variance is
    ``2 / (N (ln D)'')``: for two views ``(1 - rho^2) / (N rho kappa)``, for three, with the
    score S = 1 - sqrt(D), ``(1 - S) / (N kappa)``. These are correlations of the views as they are, noise included.

    ``config``: ``sigma_scale`` widens the bar; ``view_count``: 2 or 3; ``signal_fraction`` (H, W) float32: texture's
    fraction of the views' variance where the scores were debiased: the factor by which the noise would have lowered the
    correlations. 1 where they were not. Returns (H, W) float32, px.
    """
    samples = independent_samples(config)
    peak = np.clip(winner.peak, 1e-3, 1 - 1e-6)  # a peak of 0 or 1 would make the variance infinite or 0
    curvature = np.maximum(winner.curvature, 1e-9) * signal_fraction
    if view_count == 2:
        raw = peak * signal_fraction
        variance = (1 - raw**2) / (samples * raw * curvature)
    else:
        # sqrt(D) of three views alike but for their noise: eigenvalues 1 + 2 w, 1 - w, 1 - w for the fraction w.
        noise = (1 - signal_fraction) * np.sqrt(1 + 2 * signal_fraction)
        variance = (1 - peak + noise) / (samples * curvature)
    return _limited(config.sigma_scale * np.sqrt(variance), winner.disparity_px)


def surface_sigma(surface: Surface, *, floor_px: float = 0.0) -> np.ndarray:
    """Return the standard deviation of a surface: that of its posterior and a floor, in quadrature; (H, W) px."""
    return _limited(np.hypot(surface.sigma_px, np.float32(floor_px)), surface.disparity_px)


def _limited(sigma_px: np.ndarray, disparity_px: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(disparity_px), np.minimum(sigma_px, MAX_SIGMA_PX), np.nan).astype(np.float32)


def sigma_of_range(layers_px: np.ndarray) -> float:
    """Return the standard deviation of a uniform distribution over the range of the layers, px.

    A disparity that is known no better than this is unknown: its evidence says no more than the search range does.
    """
    return float(layers_px[-1] - layers_px[0]) / math.sqrt(12)


def effective_samples(decay: float) -> float:
    """Return the number of independent samples in the exponential window, both axes together."""
    return ((1 + decay) ** 3 / ((1 - decay) * (1 + decay**2))) ** 2


def independent_samples(config: PaperConfig) -> float:
    """Return the number of independent noise samples in the window, of views that are smoothed twice.

    Before matching, and where they are read between pixels.
    """
    variance_px2 = config.views.presmooth_sigma_px**2 + config.correlation.sampling_variance_px2
    area, fraction = _NOISE_AREA
    px_a_sample = max(1.0, area * variance_px2 * fraction)
    return effective_samples(config.correlation.window_decay) / px_a_sample


def confidence(sigma_px: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Return the confidence in [0, 1]: 1 for a sharp, high peak; 0 where unknown; (H, W) float32."""
    value = np.exp(-sigma_px / CONFIDENCE_SCALE_PX) * np.clip(peak, 0, 1)
    return np.nan_to_num(value, nan=0.0).astype(np.float32)


def local_range(disparity_px: np.ndarray, reach_px: int) -> np.ndarray:
    """Return the range of the known disparities in a square around each pixel; (H, W) float32, px; 0 without any.

    Next to a depth edge windows see both sides, and a pixel given to the wrong one is wrong by all of it, however
    narrow its posterior.
    """
    square = np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)
    low = high = np.asarray(disparity_px, np.float32)
    unknown = np.isnan(low)
    if unknown.any():
        low, high = (np.where(unknown, np.float32(beyond), low) for beyond in (_BEYOND_PX, -_BEYOND_PX))
    return np.asarray(np.maximum(cv2.dilate(high, square) - cv2.erode(low, square), 0))


def pooled_sigma(sigma_px: np.ndarray, reach_px: float) -> np.ndarray:
    """Return the root of the mean variance in a Gaussian window; (H, W) float32, px.

    Paths write their own pattern into the posterior's width, streaks along which the evidence is the same.

    ``sigma_px`` (H, W) float, px; ``reach_px``: sigma of the window.
    """
    variance = np.square(sigma_px, dtype=np.float32)
    return np.sqrt(cv2.GaussianBlur(variance, (0, 0), reach_px, borderType=cv2.BORDER_REFLECT_101))


def without_two_views(image: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return where fewer than two of the matched channels hold light; (H, W) bool.

    A red surface under halves of cyan and yellow is seen by one half only. There is nothing to compare, and what
    noise agrees on, or neighbours suggest, is no measurement.

    ``image`` (H, W, 3) float32, linear RGB, 1.0 = white level; ``rows`` (K, 3) float: weights of R, G, B in the views:
    a channel is matched where one of them is not 0.
    """
    height, width = image.shape[:2]
    side = LIGHT_WINDOW_PX
    small = max(1, width // side), max(1, height // side)
    # Four pixels of a square are enough: read noise of 4 in 5000 electrons leaves their mean to a fifth of the limit.
    first_row, first_column = min(side // 4, height - 1), min(side // 4, width - 1)
    sparse = np.ascontiguousarray(image[first_row :: side // 2, first_column :: side // 2], np.float32)
    mean = cv2.resize(sparse, small, interpolation=cv2.INTER_AREA)
    dark = mean[..., np.any(rows, axis=0)] < DARK  # what is not finite is not known to be dark
    lacking = (~dark).sum(axis=2) < 2
    if not lacking.any():
        return np.zeros((height, width), bool)
    return np.asarray(cv2.resize(lacking.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0)


def without_pixels(usable: np.ndarray) -> np.ndarray:
    """Return where the matching window holds no usable pixel; (H, W) bool."""
    side = LIGHT_WINDOW_PX + 1
    return np.asarray(cv2.dilate(usable, np.ones((side, side), np.uint8)) == 0)


def widened(sigma_px: np.ndarray, unmeasured: np.ndarray, range_sigma_px: float | np.ndarray) -> np.ndarray:
    """Return error bars that are at least that of the search range where nothing was measured; (H, W) float32, px.

    The depth is kept: as that of neighbours it is often right.
    """
    if not unmeasured.any():
        return sigma_px
    least = np.minimum(range_sigma_px, MAX_SIGMA_PX)
    return np.where(unmeasured, np.maximum(sigma_px, least), sigma_px).astype(np.float32)  # NaN stays NaN

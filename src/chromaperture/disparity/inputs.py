"""What the matcher sees: smoothed zero-mean views, a guide, noise maps; the same for every implementation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from chromaperture.color.unmixing import unmix
from chromaperture.config import MatcherConfig
from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture, channel_transmission

SATURATION = 0.995


@dataclass(frozen=True)
class MatchInputs:
    """Arrays of one capture, ready to be matched.

    Attributes
    ----------
    views : (H, W, K) float32
        Views through the K filters, zero mean, pre-smoothed.
    directions : (K, 2) float64
        Displacement (x, y) of each view per px of disparity.
    layers_px : (D,) float64, px
        Disparities that are tried, equally spaced.
    guide : (H, W) float32
        Centre-view picture for the bilateral filter, in units of ``bilateral_range``.
    mask : (H, W) float32
        1 where the capture is usable, 0 where it is saturated or not finite.
    noise_variance : (H, W, K) float32
        Noise variance of the smoothed views; all zero when unknown.
    noise_covariance : (H, W, P) float32
        Noise covariance of the P pairs of views (0,1), (0,2), (1,2), before any shift.
    noise_overlap : (D, P) float32
        Share of that covariance left when a layer's shift has moved the two views apart.
    """

    views: np.ndarray
    directions: np.ndarray
    layers_px: np.ndarray
    guide: np.ndarray
    mask: np.ndarray
    noise_variance: np.ndarray
    noise_covariance: np.ndarray
    noise_overlap: np.ndarray


def view_pairs(view_count: int) -> list[tuple[int, int]]:
    """Give the pairs of views in the order of ``noise_covariance``."""
    return list(combinations(range(view_count), 2))


def guide_weights(aperture: Aperture) -> np.ndarray:
    """Weights of R, G, B whose sum is seen through a pupil centred on the axis; (3,) float64.

    The green of complementary halves sees the whole pupil; designs without such a channel take the mean.
    """
    full = channel_transmission(aperture) > 0.95
    return full / full.sum() if full.any() else np.full(3, 1 / 3)


def smooth(image: np.ndarray, sigma_px: float) -> np.ndarray:
    """Gaussian with replicated borders; sigma 0 returns the image as it is."""
    if sigma_px == 0:
        return image
    radius = math.ceil(4 * sigma_px)
    size = (2 * radius + 1, 2 * radius + 1)
    return cv2.GaussianBlur(image, size, sigma_px, borderType=cv2.BORDER_REPLICATE).reshape(image.shape)


def prepare(
    image: np.ndarray,
    *,
    directions: np.ndarray,
    unmixing: np.ndarray,
    guide_rgb: np.ndarray,
    noise_variance: np.ndarray,
    config: MatcherConfig,
) -> MatchInputs:
    """Change the colour space, smooth, and collect what the matcher needs.

    Parameters
    ----------
    image : (H, W, 3) float32, linear RGB, 1.0 = white level
    directions : (K, 2) float
    unmixing : (K, 3) float
    guide_rgb : (3,) float
    noise_variance : (H, W, 3) float32
        Noise variance of the sensor channels.
    config : MatcherConfig

    Returns
    -------
    MatchInputs

    Raises
    ------
    InputError
        A view is constant, so there is nothing to match.
    """
    finite = np.isfinite(image).all(axis=2)
    mask = finite & (image.max(axis=2) < SATURATION)
    if not mask.any():
        raise InputError(
            "no usable pixel: the whole image is saturated or not finite; lower the exposure, or check "
            "--black-level and --white-level"
        )
    image = np.where(finite[..., None], image, np.float32(np.mean(image[mask])))

    views = unmix(image, unmixing)
    views -= views.mean(axis=(0, 1), dtype=np.float64).astype(np.float32)
    views = smooth(views, config.presmooth_sigma_px)
    flat = views.std(axis=(0, 1)) < 1e-6
    if flat.any():
        raise InputError(
            "the image is constant in at least one view of the aperture: nothing to match. A lens cap, an even wall, "
            "a grey-scale file and a wrong aperture design look like this"
        )

    pairs = view_pairs(len(unmixing))
    rows = np.asarray(unmixing, np.float32)
    white_noise_left, overlap = _noise_autocorrelation(config, directions, pairs)
    variance = (noise_variance @ (rows**2).T) * white_noise_left
    covariance = noise_variance @ np.stack([rows[k] * rows[m] for k, m in pairs], -1) * white_noise_left

    guide = smooth(np.ascontiguousarray(image @ np.asarray(guide_rgb, np.float32)), 1.0)
    scale = max(float(np.percentile(guide, 99) - np.percentile(guide, 1)), 1e-6) * config.bilateral_range
    return MatchInputs(
        views=views,
        directions=np.asarray(directions, float),
        layers_px=config.layers_px,
        guide=(guide / np.float32(scale)).astype(np.float32),
        mask=mask.astype(np.float32),
        noise_variance=np.ascontiguousarray(variance, np.float32),
        noise_covariance=np.ascontiguousarray(covariance, np.float32),
        noise_overlap=overlap.astype(np.float32),
    )


def _noise_autocorrelation(
    config: MatcherConfig, directions: np.ndarray, pairs: list[tuple[int, int]]
) -> tuple[np.float32, np.ndarray]:
    """Give the variance white noise keeps after the pre-smoothing, and its decay with the views' separation.

    White noise behind a Gaussian of sigma p has the autocorrelation exp(-r^2 / 4 p^2) and the variance 1 / (4 pi p^2).
    """
    p = max(config.presmooth_sigma_px, 0.3)  # below, the pixel itself is the smoother
    left = min(1.0, 1 / (4 * math.pi * p**2))
    apart = np.array([np.linalg.norm(directions[k] - directions[m]) for k, m in pairs])
    return np.float32(left), np.exp(-((np.abs(config.layers_px)[:, None] * apart) ** 2) / (4 * p**2))

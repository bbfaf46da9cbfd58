"""How much of a window's evidence is a pixel's own: a blank wall beside a printed box must not take the box's depth.

A correlation window beside an edge sees the edge, and the blur of the layers spreads its detail farther still, so the
evidence of blank pixels is that of their neighbours, or agreement of noise. It counts as far as the pixel has detail
of its own, above the noise::

    w = min(1, E_own / E_window) * max(0, 1 - N / E_window)^2

E is the power of the detail that is correlated: in a narrow window, and in that of the correlation; N is the noise's.
Small correlations earn nats by their square, so noise lowers them by the square of the signal's share.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from chromaperture.settings.stages import CrossFilterConfig

OWN_SIGMA_PX = 1.5  # of the narrow window: 2.7 times narrower than that of the correlation; chosen by hand
_LEAST_POWER = np.float32(1e-14)  # against division by 0


def own_detail(
    image: np.ndarray, noise_variance: np.ndarray | None, channels: tuple[int, ...], config: CrossFilterConfig
) -> np.ndarray:
    """Return the share of its window's evidence that is a pixel's own; (H, W) float32 in [0, 1].

    ``image`` (H, W, 3) float32, linear RGB, finite; ``noise_variance`` (H, W, 3) float: without it nothing is taken off
    for noise; ``channels``: that are correlated.
    """
    fine = min(low for low, _ in config.bands_px)
    coarse = max(high for _, high in config.bands_px)
    power = np.zeros(image.shape[:2], np.float32)
    for k in channels:
        channel = np.ascontiguousarray(image[..., k], np.float32)
        detail = _smooth(channel, fine) - _smooth(channel, coarse)
        power += detail * detail / np.float32(len(channels))
    window = _smooth(power, config.window_sigma_px) + _LEAST_POWER
    own = np.minimum(1, _smooth(power, OWN_SIGMA_PX) / window)
    if noise_variance is None:
        return np.asarray(own, np.float32)
    mean = np.nan_to_num(np.asarray(noise_variance, np.float32)[..., list(channels)].mean(axis=2), posinf=0, neginf=0)
    noise = _smooth(mean, config.window_sigma_px) * np.float32(_power_of_noise(fine, coarse))
    signal = np.maximum(0, 1 - noise / window)
    return np.asarray(own * signal**2, np.float32)


def _power_of_noise(fine_px: float, coarse_px: float) -> float:
    """Share of the power of white noise that the difference of two Gaussians passes."""
    return (fine_px**-2 + coarse_px**-2 - 4 / (fine_px**2 + coarse_px**2)) / (4 * math.pi)


def _smooth(picture: np.ndarray, sigma_px: float) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT_101))

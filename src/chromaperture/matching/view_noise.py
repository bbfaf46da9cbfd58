"""The noise of views that are mixed from the sensor's channels and smoothed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

_LEAST_PRESMOOTH_PX = 0.3  # below, the pixel's own area smooths the noise


@dataclass(frozen=True)
class ViewNoise:
    """Noise of the smoothed views."""

    variance: np.ndarray  # (H, W, K) float32: of the views. Even noise is a broadcast array
    covariance: np.ndarray  # (H, W, P) float32: of the P pairs of views (0,1), (0,2), (1,2), before any shift
    presmooth_sigma_px: float  # of the Gaussian that correlates the noise of neighbours

    def sampled(self, variance_px2: float) -> ViewNoise:
        """Return the noise of views that are read by a kernel of this variance, px^2."""
        before = max(self.presmooth_sigma_px, _LEAST_PRESMOOTH_PX) ** 2
        left = np.float32(before / (before + variance_px2))  # as in `noise_of_views`: by the width's square
        sigma_px = math.sqrt(self.presmooth_sigma_px**2 + variance_px2)
        return ViewNoise(_scaled(self.variance, left), _scaled(self.covariance, left), sigma_px)

    def overlap(self, layers_px: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return the fraction of the covariance that is left when layers have moved the views apart; (D, P) float32.

        White noise behind a Gaussian of sigma p has the autocorrelation exp(-r^2 / 4 p^2).
        """
        p = max(self.presmooth_sigma_px, _LEAST_PRESMOOTH_PX)
        apart = np.array([np.linalg.norm(directions[k] - directions[m]) for k, m in view_pairs(len(directions))])
        return np.exp(-((np.abs(layers_px)[:, None] * apart) ** 2) / (4 * p**2)).astype(np.float32)


def view_pairs(view_count: int) -> list[tuple[int, int]]:
    """Return the pairs of views in the order of ``ViewNoise.covariance``."""
    return list(combinations(range(view_count), 2))


def noise_of_views(noise_variance: np.ndarray, rows: np.ndarray, *, presmooth_sigma_px: float) -> ViewNoise:
    """Return the noise of mixed and smoothed views.

    ``noise_variance`` (H, W, 3) float32: of the sensor's channels; ``rows`` (K, 3) float: weights of R, G, B in the
    views; ``presmooth_sigma_px``: of the Gaussian before matching.
    """
    rows = np.asarray(rows)
    products = np.stack([rows[k] * rows[m] for k, m in view_pairs(len(rows))])
    p = max(presmooth_sigma_px, _LEAST_PRESMOOTH_PX)
    left = np.float32(min(1.0, 1 / (4 * math.pi * p**2)))  # of the variance of white noise behind the Gaussian
    variance, covariance = (_scaled(_mixed_noise(noise_variance, w), left) for w in (rows**2, products))
    return ViewNoise(variance, covariance, presmooth_sigma_px)


def is_even(maps: np.ndarray) -> bool:
    """Return whether maps (H, W, N) hold one value a channel, by construction (`numpy.broadcast_to`)."""
    return maps.strides[0] == 0 and maps.strides[1] == 0


def _mixed_noise(variance: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Noise of weighted sums of the channels, (H, W, N) float32; even noise stays even."""
    weights = np.asarray(weights, np.float32)
    if is_even(variance):
        return np.broadcast_to((weights @ variance[0, 0]).astype(np.float32), (*variance.shape[:2], len(weights)))
    return cv2.transform(np.ascontiguousarray(variance, np.float32), weights).reshape(*variance.shape[:2], -1)


def _scaled(maps: np.ndarray, factor: np.float32) -> np.ndarray:
    if is_even(maps):
        return np.broadcast_to(maps[0, 0] * factor, maps.shape)
    return maps * factor

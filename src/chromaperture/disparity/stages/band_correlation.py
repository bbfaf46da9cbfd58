"""Correlation of two pictures in windows, in one band of frequencies: NumPy and OpenCV, the oracle of the compiled one.

The band is a difference of two smoothed pictures. Windows are Gaussian, around every second sample: the sums over them
have nothing finer.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

LEAST_POWER = np.float32(1e-12)  # of both pictures; even areas have none
_HALVING_SIGMA = 1.0  # samples, of the window of `cv2.pyrDown`
_LEAST_REST = 0.004  # samples squared; windows of less than one sample add no more


def rest_of_window(sigma: float) -> float:
    """Sigma of the window that follows the halving, in halved samples; ``sigma`` is the whole one's, in samples."""
    return math.sqrt(max(sigma**2 - _HALVING_SIGMA**2, _LEAST_REST)) / 2


def band_correlation(fine: np.ndarray, coarse: np.ndarray, *, sigma: float) -> np.ndarray:
    """Correlate both pictures of a pair in one band.

    Parameters
    ----------
    fine, coarse : (H, W, 2) float32
        Both pictures, smoothed little and much.
    sigma : float, samples
        Of the window.

    Returns
    -------
    (ceil(H / 2), ceil(W / 2)) float32 in [-1, 1]
    """
    p, q = cv2.split(fine - coarse)
    rest = rest_of_window(sigma)
    cross, power_p, power_q = (
        cv2.GaussianBlur(
            cv2.pyrDown(product, borderType=cv2.BORDER_REFLECT_101), (0, 0), rest, borderType=cv2.BORDER_REFLECT_101
        )
        for product in (p * q, p * p, q * q)
    )
    return np.asarray(cross / np.sqrt(power_p * power_q + LEAST_POWER))

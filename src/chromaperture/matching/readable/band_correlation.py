"""Correlation of two pictures in windows, in one band of frequencies: NumPy and OpenCV, the oracle of the compiled one.

The band is a difference of two smoothed pictures. Windows are Gaussian, around every second sample: the sums over them
have nothing finer.

Wide blur spreads the detail of an edge over its flat surroundings, in P and Q alike, and where the edge runs along the
baseline both agree there at every depth. A surface that is blurred so much has its detail spread out in the photograph
already. So agreement counts as far as the detail is a window's own::

    r' = r / (max(1, E_P / (g E_a)) max(1, E_Q / (g E_b)))

with the powers of P and Q in the window, those of the views in focus, as the photograph has them, and an allowed growth
g: powers in windows scatter by themselves.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

# Added to the product of both powers, (white level)^4, so that even areas have no correlation. It must be far below
# that of weak texture: filters of a wide blur leave less of it, and a floor as large would draw it to the layers in
# focus. docs/decisions.md, *Weak texture of all pairs*, compares four.
LEAST_POWER = np.float32(1e-14)
LEAST_SEEN = np.float32(1e-12)  # against division by 0, far below noise: a millionth of the white level
_HALVING_SIGMA = 1.0  # samples, of the window of `cv2.pyrDown`
_LEAST_REST = 0.004  # samples squared; windows of less than one sample add no more


def rest_of_window(sigma: float) -> float:
    """Sigma of the window that follows the halving, in halved samples; ``sigma`` is the whole one's, in samples."""
    return math.sqrt(max(sigma**2 - _HALVING_SIGMA**2, _LEAST_REST)) / 2


def band_correlation(
    fine: np.ndarray, coarse: np.ndarray, *, sigma: float, seen: np.ndarray | None = None, allowed_growth: float = 1.0
) -> np.ndarray:
    """Correlate both pictures of a pair in one band.

    Parameters
    ----------
    fine, coarse : (H, W, 2) float32
        Both pictures, smoothed little and much.
    sigma : float, samples
        Of the window.
    seen : (ceil(H / 2), ceil(W / 2), 2) float32, optional
        `band_powers` of the views in focus; without, nothing is taken off.
    allowed_growth : float
        g.

    Returns
    -------
    (ceil(H / 2), ceil(W / 2)) float32 in [-1, 1]
    """
    cross, *powers = _windows(fine, coarse, sigma)
    correlation = cross / np.sqrt(powers[0] * powers[1] + LEAST_POWER)
    if seen is not None:
        for power, own in zip(powers, cv2.split(seen), strict=True):
            correlation /= np.maximum(1, power / (np.float32(allowed_growth) * (own + LEAST_SEEN)))
    return np.asarray(correlation)


def band_powers(fine: np.ndarray, coarse: np.ndarray, *, sigma: float) -> np.ndarray:
    """Return the powers of both pictures in the windows of `band_correlation`; (ceil(H / 2), ceil(W / 2), 2)."""
    return np.stack(_windows(fine, coarse, sigma)[1:], axis=-1)


def _windows(fine: np.ndarray, coarse: np.ndarray, sigma: float) -> list[np.ndarray]:
    """P Q, P P and Q Q of the band, averaged in windows."""
    p, q = cv2.split(fine - coarse)
    rest = rest_of_window(sigma)
    return [
        cv2.GaussianBlur(
            cv2.pyrDown(product, borderType=cv2.BORDER_REFLECT_101), (0, 0), rest, borderType=cv2.BORDER_REFLECT_101
        )
        for product in (p * q, p * p, q * q)
    ]

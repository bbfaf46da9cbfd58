# mypy: disallow-untyped-defs=False
"""Correlation of two pictures in one band, compiled; ``readable/band_correlation.py`` explains what is computed."""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.matching.compiled.paths import FAST
from chromaperture.matching.readable.band_correlation import LEAST_POWER, LEAST_SEEN, rest_of_window
from chromaperture.system.compilation import compiled, inlined

_TAPS = 5  # 1 4 6 4 1, the window of `cv2.pyrDown`
_ANY_POWER = np.empty((0, 0, 2), np.float32)  # as powers of views in focus: nothing is taken off


def band_correlation(
    fine: np.ndarray, coarse: np.ndarray, *, sigma: float, seen: np.ndarray | None = None, allowed_growth: float = 1.0
) -> np.ndarray:
    """Correlate both pictures of a pair in one band, as `readable.band_correlation`."""
    windows = _windows(fine, coarse, sigma)
    out = np.empty(windows.shape[:2], np.float32)
    _normalised(windows, _ANY_POWER if seen is None else seen, np.float32(allowed_growth), out)
    return out


def band_powers(fine: np.ndarray, coarse: np.ndarray, *, sigma: float) -> np.ndarray:
    """Return the powers of both pictures in the windows of `band_correlation`, as `readable.band_powers`."""
    return np.ascontiguousarray(_windows(fine, coarse, sigma)[..., 1:])


def _windows(fine: np.ndarray, coarse: np.ndarray, sigma: float) -> np.ndarray:
    """P Q, P P and Q Q of the band, averaged in windows; (h, w, 3)."""
    height, width = fine.shape[:2]
    halved = np.empty((-(-height // 2), -(-width // 2), 3), np.float32)
    _halved_products(fine, coarse, halved)
    return np.asarray(cv2.GaussianBlur(halved, (0, 0), rest_of_window(sigma), borderType=cv2.BORDER_REFLECT_101))


@inlined(fastmath=FAST)
def _mirrored(i, count):
    """Continue indices beyond both ends; the last one at an end is not repeated."""
    while i < 0 or i >= count:
        if count == 1:
            return 0
        i = -i if i < 0 else 2 * count - 2 - i
    return i


@compiled(fastmath=FAST, error_model="numpy")
def _halved_products(fine, coarse, out):
    """P Q, P P and Q Q of the band in windows around every second sample; (h, w, 3)."""
    height, width = fine.shape[:2]
    ring = np.empty((_TAPS, 3, width), np.float32)  # products of the last rows
    line = np.empty((3, width + _TAPS - 1), np.float32)
    four, six, part = np.float32(4), np.float32(6), np.float32(1 / 256)
    filled = -3
    for y in range(out.shape[0]):
        for row in range(max(filled + 1, 2 * y - 2), 2 * y + 3):
            here, less, products = fine[_mirrored(row, height)], coarse[_mirrored(row, height)], ring[row % _TAPS]
            for x in range(width):
                p, q = here[x, 0] - less[x, 0], here[x, 1] - less[x, 1]
                products[0, x] = p * q
                products[1, x] = p * p
                products[2, x] = q * q
        filled = 2 * y + 2
        for k in range(3):
            a, b, c = ring[(2 * y - 2) % _TAPS, k], ring[(2 * y - 1) % _TAPS, k], ring[2 * y % _TAPS, k]
            d, e, sums = ring[(2 * y + 1) % _TAPS, k], ring[(2 * y + 2) % _TAPS, k], line[k]
            inside = sums[2 : 2 + width]
            for x in range(width):
                inside[x] = part * (a[x] + e[x] + four * (b[x] + d[x]) + six * c[x])
            for x in (-2, -1, width, width + 1):
                sums[x + 2] = inside[_mirrored(x, width)]
            for x in range(out.shape[1]):
                i = 2 * x
                out[y, x, k] = sums[i] + sums[i + 4] + four * (sums[i + 1] + sums[i + 3]) + six * sums[i + 2]


@compiled(fastmath=FAST, error_model="numpy")
def _normalised(windows, seen, allowed_growth, out):
    one = np.float32(1)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            here = windows[y, x]
            found = here[0] / np.sqrt(here[1] * here[2] + LEAST_POWER)
            if len(seen):
                of_p = here[1] / (allowed_growth * (seen[y, x, 0] + LEAST_SEEN))
                of_q = here[2] / (allowed_growth * (seen[y, x, 1] + LEAST_SEEN))
                found /= max(one, of_p) * max(one, of_q)
            out[y, x] = found

"""Cubic interpolation along rows, for the usual aperture whose channels move sideways only."""

from __future__ import annotations

import numba
import numpy as np

_A = np.float32(-0.75)  # slope of the cubic at 1, OpenCV's: both ways of shifting give the same picture


def shift_along_rows(image: np.ndarray, displacement_px: np.ndarray, channel: int, out: np.ndarray) -> None:
    """Sample a channel at x + displacement by cubics; fills a channel of ``out``, edges repeated.

    Parameters
    ----------
    image : (H, W, C) float32
    displacement_px : (H, W) float32, finite
    channel : int
    out : (H, W, C) float32
    """
    _shift(image, np.ascontiguousarray(displacement_px), channel, out)


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
def _shift(image, displacement, k, out):  # type: ignore[no-untyped-def]
    height, width = displacement.shape
    one, two, three, right = np.float32(1), np.float32(2), np.float32(3), np.float32(width + 4)
    for y in numba.prange(height):
        for x in range(width):
            at = np.float32(x) + displacement[y, x]
            at = min(max(at, np.float32(-4)), right) + np.float32(8)  # farther out the edge is read as well
            first = np.int32(at)  # towards zero is down there
            t = at - np.float32(first)
            first -= np.int32(8)
            # The cubic at distances 1 + t, t, 1 - t and 2 - t; together they are 1.
            u = one - t
            w0, w3 = _A * t * u * u, _A * u * t * t
            w1 = ((_A + two) * t - (_A + three)) * t * t + one
            w2 = one - w0 - w1 - w3
            if 1 <= first < width - 2:
                out[y, x, k] = (
                    w0 * image[y, first - 1, k] + w1 * image[y, first, k]
                    + w2 * image[y, first + 1, k] + w3 * image[y, first + 2, k]
                )  # fmt: skip
            else:
                total = np.float32(0)
                for n, w in enumerate((w0, w1, w2, w3)):
                    total += w * image[y, min(max(first - 1 + n, 0), width - 1), k]
                out[y, x, k] = total

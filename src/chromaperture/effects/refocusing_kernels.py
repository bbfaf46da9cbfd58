"""The passes of `refocus` over all pixels, fused; the method is explained there."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, inline="always")
def _share(radius, below, center, above):  # type: ignore[no-untyped-def]
    """Share of a layer in a pixel, linear to the neighbouring layers' radii."""
    if radius <= below or radius >= above:
        return np.float32(0)
    if radius < center:
        return (radius - below) / (center - below)
    return (above - radius) / (above - center)


@numba.njit(cache=True, parallel=True)
def layer_bounds(new, behind_new, hidden, below, above):  # type: ignore[no-untyped-def]
    """First and last column of a layer in every row; (H, 2) int64, first > last where the row holds none of it."""
    height, width = new.shape
    out = np.empty((height, 2), np.int64)
    for y in numba.prange(height):
        first, last = width, -1
        for x in range(width):
            inside = below < new[y, x] < above or (hidden[y, x] and below < behind_new[y, x] < above)
            if inside:
                first = min(first, x)
                last = x
        out[y, 0], out[y, 1] = first, last
    return out


@numba.njit(cache=True, parallel=True)
def layer_planes(color, new, behind, behind_new, hidden, nodes, box):  # type: ignore[no-untyped-def]
    """Light and coverage of a layer inside a box of rows and columns; (h, w, 4) float32."""
    top, bottom, left, right = box
    below, center, above = nodes
    out = np.zeros((bottom - top, right - left, 4), np.float32)
    for y in numba.prange(top, bottom):
        for x in range(left, right):
            a = _share(new[y, x], below, center, above)
            b = _share(behind_new[y, x], below, center, above) if hidden[y, x] else np.float32(0)
            if a == 0 and b == 0:
                continue
            for c in range(3):
                out[y - top, x - left, c] = a * color[y, x, c] + b * behind[y, x, c]
            out[y - top, x - left, 3] = a + b
    return out


@numba.njit(cache=True, parallel=True)
def add_layer(total, before, blurred, top, left):  # type: ignore[no-untyped-def]
    """Add a blurred layer where nothing that stands clear before it hides it, in place; total holds light and cover."""
    for y in numba.prange(blurred.shape[0]):
        for x in range(blurred.shape[1]):
            seen = min(max(np.float32(1) - before[y + top, x + left], np.float32(0)), np.float32(1))
            for c in range(4):
                total[y + top, x + left, c] += seen * blurred[y, x, c]


@numba.njit(cache=True, parallel=True)
def normalised(total):  # type: ignore[no-untyped-def]
    """Light over cover; (H, W, 3) float32, not negative."""
    height, width = total.shape[:2]
    out = np.empty((height, width, 3), np.float32)
    for y in numba.prange(height):
        for x in range(width):
            gain = np.float32(1) / max(total[y, x, 3], np.float32(1e-3))
            for c in range(3):
                out[y, x, c] = max(total[y, x, c] * gain, np.float32(0))
    return out

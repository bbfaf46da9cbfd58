"""Rasterising a point-spread function, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def splat(places, weights, out):  # type: ignore[no-untyped-def]
    """Add points to the four pixels around them, wrapping; the tent this adds is the same in all channels."""
    n = out.shape[0]
    for j in range(len(weights)):
        x, y = np.floor(places[j, 0]), np.floor(places[j, 1])
        tx, ty = places[j, 0] - x, places[j, 1] - y
        x0, y0 = int(x) % n, int(y) % n
        x1, y1 = (x0 + 1) % n, (y0 + 1) % n
        out[y0, x0] += weights[j] * (1 - tx) * (1 - ty)
        out[y0, x1] += weights[j] * tx * (1 - ty)
        out[y1, x0] += weights[j] * (1 - tx) * ty
        out[y1, x1] += weights[j] * tx * ty

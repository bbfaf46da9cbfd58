"""Rasterising a point-spread function, compiled; the same in NumPy is `chromaperture.optics.lens_blur.splat`."""

from __future__ import annotations

import numpy as np

from chromaperture.compilation import compiled


@compiled()
def splat(points_px, weights, out):  # type: ignore[no-untyped-def]
    """Add weighted points to the four pixels around them, with periodic borders."""
    n = out.shape[0]
    for j in range(len(weights)):
        x, y = np.floor(points_px[j, 0]), np.floor(points_px[j, 1])
        tx, ty = points_px[j, 0] - x, points_px[j, 1] - y
        x0, y0 = int(x) % n, int(y) % n
        x1, y1 = (x0 + 1) % n, (y0 + 1) % n
        out[y0, x0] += weights[j] * (1 - tx) * (1 - ty)
        out[y0, x1] += weights[j] * tx * (1 - ty)
        out[y1, x0] += weights[j] * (1 - tx) * ty
        out[y1, x1] += weights[j] * tx * ty

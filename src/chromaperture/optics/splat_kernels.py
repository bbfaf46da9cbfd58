"""Transforms of point-spread functions, compiled; the same in NumPy is `chromaperture.optics.lens_blur`.

Two pictures are transformed at once, as the real and the imaginary part of one: the first is the even (Hermitian) part
of the result, the second the odd one. OpenCV does that three times as fast as SciPy does both (160 x 160 px).
"""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.compilation import compiled


def point_transforms(points_px: np.ndarray, weights: np.ndarray, size: int, samples: int) -> np.ndarray:
    """Fourier transform of weighted points, as `lens_blur.point_transforms`; (C, n, n // 2 + 1) complex64."""
    out = np.zeros((len(points_px), samples, samples // 2 + 1), np.complex64)
    for first in range(0, len(points_px), 2):
        pictures = np.zeros((size, size, 2), np.float32)
        for i, (points, weight) in enumerate(zip(points_px[first : first + 2], weights[first:], strict=False)):
            splat(points, weight, pictures[..., i])
        split_transform(cv2.dft(pictures).view(np.complex64)[..., 0], out[first : first + 2])
    return out


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


@compiled(fastmath={"contract", "arcp", "nsz"})
def split_transform(both, out):  # type: ignore[no-untyped-def]
    """Split the transform (n, n) of one or two real pictures into their own, (1 or 2, m, m // 2 + 1)."""
    n, samples, half = both.shape[0], out.shape[1], np.float32(0.5)
    columns = samples // 2 + 1 if samples == n else (samples + 1) // 2
    for row in range(samples):
        y = row if 2 * row < samples else n - samples + row
        if samples < n and 2 * row == samples:
            continue
        mirrored = n - y if y > 0 else 0
        for x in range(columns):
            a, b = both[y, x], both[mirrored, n - x if x > 0 else 0]
            out[0, row, x] = complex(half * (a.real + b.real), half * (a.imag - b.imag))
        if len(out) > 1:
            for x in range(columns):
                a, b = both[y, x], both[mirrored, n - x if x > 0 else 0]
                out[1, row, x] = complex(half * (a.imag + b.imag), half * (b.real - a.real))

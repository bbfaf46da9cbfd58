"""Transforms of point-spread functions, compiled; the same in NumPy is `chromaperture.optics.lens_blur`.

A narrow one is a small square of pixels, and its transform two products of matrices, rows and then columns, at the
frequencies that are kept, even and odd parts apart: for 20 px in a tile of 240 three times as fast as the fast
transform. Wider ones go through OpenCV's fast transform, two pictures at once as the real and the imaginary part of
one, whose even (Hermitian) part is the first's.
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np

from chromaperture.system.compilation import compiled, inlined

# Direct transforms take reach * kept^2 steps, fast ones size^2 times a logarithm: both are as fast where the former is
# 3 to 5 times size^2 (size 96 and 240, kept 49, 80 and 121).
MOST_PRODUCTS = 3
_FAST: set[str] = {"contract", "arcp", "nsz", "reassoc", "nnan"}


def point_transforms(
    points_px: np.ndarray, weights: np.ndarray, size: int, samples: int, *, out: np.ndarray | None = None
) -> np.ndarray:
    """Fourier transform of weighted points, as `lens_blur.point_transforms`; (C, n, n // 2 + 1) complex64."""
    kept = samples // 2 + 1 if samples == size else (samples + 1) // 2
    most = MOST_PRODUCTS * size**2 // kept**2
    reach = max(1, math.ceil(max(float(points_px.max(initial=0)), -float(points_px.min(initial=0)))))
    if out is None:
        out = np.empty((len(points_px), samples, samples // 2 + 1), np.complex64)
    out[:, kept : samples - kept + 1], out[:, :, kept:] = 0, 0  # the highest frequency, where others are left out
    if reach > most or 2 * reach + 1 > size:
        _fast_transforms(points_px, weights, size, out)
    else:
        direct_transforms(points_px, weights, reach, *_waves(size, kept, most + 1), out.view(np.float32))
    return out


@lru_cache(maxsize=4)
def _waves(size: int, kept: int, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Cosine and sine of every frequency at so many px from the middle; (reach + 1, kept) float32 each."""
    angle = 2 * np.pi / size * np.outer(np.arange(reach + 1), np.arange(kept))
    return np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)


def _fast_transforms(points_px: np.ndarray, weights: np.ndarray, size: int, out: np.ndarray) -> None:
    for first in range(0, len(points_px), 2):
        pictures = np.zeros((size, size, 2), np.float32)
        for i, (points, weight) in enumerate(zip(points_px[first : first + 2], weights[first:], strict=False)):
            splat(points, weight, pictures[..., i])
        split_transform(cv2.dft(pictures).view(np.complex64)[..., 0], out[first : first + 2])


@compiled()
def splat(points_px, weights, out):  # type: ignore[no-untyped-def]
    """Add weighted points to the four pixels around them, with periodic borders."""
    n = out.shape[0]
    for j in range(len(weights)):
        x, y = np.floor(points_px[j, 0]), np.floor(points_px[j, 1])
        tx, ty = points_px[j, 0] - x, points_px[j, 1] - y
        x0, y0 = int(x) % n, int(y) % n
        x1, y1 = x0 + 1 if x0 < n - 1 else 0, y0 + 1 if y0 < n - 1 else 0
        out[y0, x0] += weights[j] * (1 - tx) * (1 - ty)
        out[y0, x1] += weights[j] * tx * (1 - ty)
        out[y1, x0] += weights[j] * (1 - tx) * ty
        out[y1, x1] += weights[j] * tx * ty


@inlined()
def _splat_near(points_px, weights, reach, out):  # type: ignore[no-untyped-def]
    """As `splat`, for points at most ``reach`` px from the middle of a picture without periodic borders."""
    width, pixels = out.shape[1], out.reshape(-1)
    for j in range(len(weights)):
        if weights[j] == 0:
            continue
        px, py = points_px[j, 0] + reach, points_px[j, 1] + reach
        x, y = int(px), int(py)
        tx, ty, weight = np.float32(px - x), np.float32(py - y), np.float32(weights[j])
        here = np.uint64(y * width + x)  # indices that are not negative are not checked
        below, one = here + np.uint64(width), np.uint64(1)
        right = weight * tx
        left = weight - right
        pixels[here] += left - left * ty
        pixels[here + one] += right - right * ty
        pixels[below] += left * ty
        pixels[below + one] += right * ty


@compiled(fastmath=_FAST)
def direct_transforms(points_px, weights, reach, cosines, sines, out):  # type: ignore[no-untyped-def]
    """Transform points at most ``reach`` px from (0, 0); ``out`` is (C, n, n // 2 + 1) complex, as pairs of floats."""
    kept = cosines.shape[1]
    side = 2 * reach + 1
    picture = np.empty((side + 1, side + 1), np.float32)  # a point at the far end adds nothing to the last line
    lines, parts = np.empty((side, 2 * kept), np.float32), np.zeros((2, reach + reach % 2 + 1, 2 * kept), np.float32)
    for c in range(len(out)):
        picture[:] = 0
        _splat_near(points_px[c], weights[c], reach, picture)
        for y in range(side):
            _row_transform(picture[y, :side], cosines, sines, lines[y, :kept], lines[y, kept:])
        for f in range(2 * kept):  # element by element: assigning a row to a row takes Numba 2 s to compile
            parts[0, 0, f] = lines[reach, f]
        for r in range(1, reach + 1):
            below, above, even, odd = lines[reach + r], lines[reach - r], parts[0, r], parts[1, r]
            for f in range(2 * kept):
                even[f] = below[f] + above[f]
                odd[f] = below[f] - above[f]
        _column_transforms(parts[0], parts[1], cosines, sines, out[c])


@inlined(fastmath=_FAST)
def _row_transform(row, cosines, sines, real, imaginary):  # type: ignore[no-untyped-def]
    """Transform of a row about its middle."""
    reach, kept = len(row) // 2, len(real)
    real[:], imaginary[:] = row[reach], 0
    for r in range(1, reach, 2):  # two at a time: what is added to is loaded half as often
        even, odd = row[reach + r] + row[reach - r], row[reach + r] - row[reach - r]
        even2, odd2 = row[reach + r + 1] + row[reach - r - 1], row[reach + r + 1] - row[reach - r - 1]
        c, c2, s, s2 = cosines[r], cosines[r + 1], sines[r], sines[r + 1]
        for f in range(kept):
            real[f] += even * c[f] + even2 * c2[f]
        for f in range(kept):
            imaginary[f] -= odd * s[f] + odd2 * s2[f]
    if reach % 2 == 1:
        even, odd = row[2 * reach] + row[0], row[2 * reach] - row[0]
        c, s = cosines[reach], sines[reach]
        for f in range(kept):
            real[f] += even * c[f]
            imaginary[f] -= odd * s[f]


@inlined(fastmath=_FAST)
def _column_transforms(even, odd, cosines, sines, out):  # type: ignore[no-untyped-def]
    """Transform columns, of each frequency and its negative at once; rows of ``even`` hold real parts, then others."""
    kept, samples = cosines.shape[1], out.shape[0]
    sums = np.empty((4, 2 * kept), np.float32)
    for row in range(0, kept, 2):  # two frequencies and four px at a time: less is loaded for as many products
        second = min(row + 1, kept - 1)
        _weighted_sums(even, cosines, row, second, sums[0], sums[1])
        _weighted_sums(odd, sines, row, second, sums[2], sums[3])
        _put_rows(sums[0], sums[2], row, samples, out)
        if second > row:
            _put_rows(sums[1], sums[3], second, samples, out)


@inlined(fastmath=_FAST)
def _weighted_sums(rows, waves, first, second, one, other):  # type: ignore[no-untyped-def]
    """Add up an odd number of rows, three or more: the middle one, and the others by two waves."""
    middle, e, e2 = rows[0], rows[1], rows[2]
    c, c2, d, d2 = waves[1, first], waves[2, first], waves[1, second], waves[2, second]
    r = 3
    if len(rows) % 4 == 3:
        for f in range(len(one)):
            one[f] = middle[f] + c * e[f] + c2 * e2[f]
            other[f] = middle[f] + d * e[f] + d2 * e2[f]
    else:
        e3, e4, c3, c4, d3, d4 = rows[3], rows[4], waves[3, first], waves[4, first], waves[3, second], waves[4, second]
        for f in range(len(one)):
            one[f] = middle[f] + c * e[f] + c2 * e2[f] + c3 * e3[f] + c4 * e4[f]
            other[f] = middle[f] + d * e[f] + d2 * e2[f] + d3 * e3[f] + d4 * e4[f]
        r = 5
    while r < len(rows):
        c, c2, c3, c4 = waves[r, first], waves[r + 1, first], waves[r + 2, first], waves[r + 3, first]
        d, d2, d3, d4 = waves[r, second], waves[r + 1, second], waves[r + 2, second], waves[r + 3, second]
        e, e2, e3, e4 = rows[r], rows[r + 1], rows[r + 2], rows[r + 3]
        for f in range(len(one)):
            one[f] += c * e[f] + c2 * e2[f] + c3 * e3[f] + c4 * e4[f]
            other[f] += d * e[f] + d2 * e2[f] + d3 * e3[f] + d4 * e4[f]
        r += 4


@inlined(fastmath=_FAST)
def _put_rows(a, b, row, samples, out):  # type: ignore[no-untyped-def]
    """Put A - i B in a row, and A + i B in that of the negative frequency."""
    kept, here = len(a) // 2, out[row]
    for f in range(kept):
        here[2 * f] = a[f] + b[kept + f]
        here[2 * f + 1] = a[kept + f] - b[f]
    if 0 < row < samples - row:
        mirrored = out[samples - row]
        for f in range(kept):
            mirrored[2 * f] = a[f] - b[kept + f]
            mirrored[2 * f + 1] = a[kept + f] + b[f]


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

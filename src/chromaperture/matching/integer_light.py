"""Light in whole units: what is computed of it is exact, so that every execution finds the same bits.

A float32 holds whole numbers up to 2^24. Sums of whole numbers times whole numbers stay below that here, so that
neither the order of a sum nor a fused multiply-add changes a bit; what grows too long is rounded to whole numbers
again (docs/gpu.md, *Agreement*).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

# Of a px of the halved picture, to which displacements are rounded: weights between four pixels are then whole parts of
# 1024, so that sums of light are exact. OpenCV's remap has the same parts.
MOVE_PARTS = 32


class PixelMaps(NamedTuple):
    """Where a view of the halved picture is sampled, as `cv2.remap` takes it."""

    pixels: np.ndarray  # (h, w, 2) int16: column and row of the upper left of four pixels
    parts: np.ndarray  # (h, w) uint16: parts of the way to the next row, times `MOVE_PARTS`, and to the next column


def halved_moves(table_px: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the displacement of every view by the lens at every pixel of the halved picture; (K, h, w, 2) int16.

    Views move along their directions in the pupil with the disparity. A lens adds to that: lateral colour moves a
    channel over the frame, and vignetting and axial colour move its centroid. Pairs of three channels then agree at
    disparities of their own, up to 0.4 px apart (docs/decisions.md, *Channels where the lens moves them*).

    ``table_px`` (rows, columns, K, 2) float, px of the full picture: at places evenly spaced over the frame, the first
    and last on its border pixels; linear between them; ``size`` (int, int): H, W of the full picture. Returns (K, h, w,
    2) int16: (x, y) in parts of a px of the halved picture, `MOVE_PARTS` a px.
    """
    table = np.asarray(table_px, float)
    return _halved_moves(table.tobytes(), table.shape, *size)


def pixel_maps(table_px: np.ndarray, size: tuple[int, int]) -> list[PixelMaps]:
    """Return where every view of the halved picture is sampled; parameters as those of `halved_moves`."""
    table = np.asarray(table_px, float)
    return _pixel_maps(table.tobytes(), table.shape, *size)


def moved(view: np.ndarray, maps: PixelMaps) -> np.ndarray:
    """Sample a halved view (h, w) float32 between four pixels each, the picture continued by its border."""
    return np.asarray(cv2.remap(view, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


@lru_cache(maxsize=2)  # tens of milliseconds, for every picture of a camera alike
def _halved_moves(table: bytes, shape: tuple[int, ...], height: int, width: int) -> np.ndarray:
    values = np.frombuffer(table).reshape(shape)
    rows, columns = (_weights(n, count) for n, count in zip((height, width), shape[:2], strict=True))
    parts = np.einsum("yr,rckd,xc->kyxd", rows, MOVE_PARTS / 2 * values, columns, optimize=True)
    return np.rint(parts).astype(np.int16)


@lru_cache(maxsize=2)
def _pixel_maps(table: bytes, shape: tuple[int, ...], height: int, width: int) -> list[PixelMaps]:
    moves = _halved_moves(table, shape, height, width).astype(np.int32)
    moves[..., 0] += MOVE_PARTS * np.arange(moves.shape[2])
    moves[..., 1] += MOVE_PARTS * np.arange(moves.shape[1])[:, None]
    pixels, parts = (moves // MOVE_PARTS).astype(np.int16), (moves % MOVE_PARTS).astype(np.uint16)
    return [
        PixelMaps(np.ascontiguousarray(at), np.ascontiguousarray(MOVE_PARTS * part[..., 1] + part[..., 0]))
        for at, part in zip(pixels, parts, strict=True)
    ]


def _weights(full: int, count: int) -> np.ndarray:
    """Return the weights of a side's places in every second pixel; (ceil(full / 2), count)."""
    place = np.arange(0, full, 2) * ((count - 1) / max(full - 1, 1))
    return np.asarray(np.maximum(1 - np.abs(place[:, None] - np.arange(count)), 0))


# The mean light is 2^11 to 2^12 units: a unit of a well exposed picture is 1e-4 of the white level, and rounding adds
# 3e-5 of noise. docs/decisions.md compares.
LIGHT_BITS = 11
LEAST_EXPONENT = -60  # of the mean light: a black picture
# Of a strip of rows that stays in the cache between two passes. Halving and smoothing two views of 1280 px on one
# thread takes 4.4 ms with 32 rows, 4.1 with 128, 4.2 with all; each call makes another thread wait for the
# interpreter's lock.
_STRIP_BYTES = 1 << 19
_ALONE = np.ones(1, np.float32)  # a filter that changes nothing
TAP_PARTS = 1024  # weights of a filter are so many parts: 14 bits of light times them fill 24


def light_unit(mean: float) -> float:
    """Return the unit of a picture: the power of two that is 2^-11 to 2^-12 of its mean light."""
    exponent = math.frexp(np.float32(mean))[1] - 1 if mean > 0 else LEAST_EXPONENT
    return 2.0 ** (max(exponent, LEAST_EXPONENT) - LIGHT_BITS)


def in_whole_units(values: np.ndarray, unit: float, *, less: float = 0.0, out: np.ndarray | None = None) -> np.ndarray:
    """Round to multiples of ``unit``, a power of two, halves to even ones; float32.

    Adding a number whose last bit is the unit rounds; exact below 2^22 units.

    ``values`` (H, ...) float32; ``less``: is subtracted; an even number of units, so that halves are rounded the same
    way with it or without.
    """
    rounder = 1.5 * 2**23 * unit
    out = np.empty(values.shape, np.float32) if out is None else out
    rows = _strip_rows(values)
    for first in range(0, len(values), rows):
        part = np.s_[first : first + rows]
        np.add(values[part], np.float32(rounder - less), out=out[part])
        np.subtract(out[part], np.float32(rounder), out=out[part])
    return out


def _strip_rows(values: np.ndarray) -> int:
    return max(8, _STRIP_BYTES * len(values) // max(values.nbytes, 1))


def whole_taps(taps: Sequence[float] | np.ndarray) -> np.ndarray:
    """Round the weights of a filter to parts of `TAP_PARTS` whose sum is 1; float64."""
    parts = np.round(TAP_PARTS * np.asarray(taps, float))
    parts[np.argmax(parts)] += TAP_PARTS - parts.sum()
    return parts / TAP_PARTS


def halved_whole(view: np.ndarray, unit: float) -> np.ndarray:
    """Halve a picture by `cv2.pyrDown` in whole units of light, strip by strip; exact while it is below 2^16 units."""
    height, width = ((n + 1) // 2 for n in view.shape)
    out = np.empty((height, width), np.float32)
    rows = _strip_rows(out)
    for first in range(0, height, rows):
        last, above = min(first + rows, height), max(2 * first - 2, 0)  # a row comes of five
        part = in_whole_units(view[above : 2 * last + 1], unit)
        out[first:last] = cv2.pyrDown(part)[first - above // 2 :][: last - first]
    return out


def smooth_whole(
    view: np.ndarray, sigma_px: float, unit: float, *, out: np.ndarray, maps: PixelMaps | None = None
) -> None:
    """As `views.smooth`, without the mean, in whole units of light; exact while light is below 2^14 of them.

    With ``maps`` the view is sampled there first.
    """
    in_whole_units(view, unit, less=even_mean(view, unit), out=out)
    if maps is not None:
        in_whole_units(moved(out, maps), unit, out=out)
    taps = smoothing_taps(sigma_px).astype(np.float32)
    for taps_x, taps_y in ((taps, _ALONE), (_ALONE, taps)) if len(taps) > 1 else ():
        cv2.sepFilter2D(out, -1, taps_x, taps_y, dst=out, borderType=cv2.BORDER_REPLICATE)
        in_whole_units(out, unit, out=out)


def smoothing_taps(sigma_px: float) -> np.ndarray:
    """Return the whole weights of `views.smooth`; float64."""
    if sigma_px == 0:
        return _ALONE.astype(float)
    size = 2 * math.ceil(4 * sigma_px) + 1
    taps = whole_taps(cv2.getGaussianKernel(size, sigma_px, cv2.CV_64F)[:, 0])
    reach = len(taps) // 2 - int(np.flatnonzero(taps)[0])
    return taps[len(taps) // 2 - reach : len(taps) // 2 + reach + 1]


def even_mean(view: np.ndarray, unit: float, mask: np.ndarray | None = None) -> float:
    """Return the mean, rounded to an even number of units."""
    return 2 * unit * round(cv2.mean(view, mask)[0] / (2 * unit))


def plane_variance(plane: np.ndarray) -> float:
    """Return the variance of a plane (H, W) float32 with a small mean."""
    return max(cv2.norm(plane, cv2.NORM_L2SQR) / plane.size - cv2.mean(plane)[0] ** 2, 0.0)


# By which compiled kernels and shaders take logarithms, since both must round alike: Chebyshev interpolation of
# ln(1.5 + t), |t| <= 1/2, highest power first; good to 4e-8.
LOGARITHM: tuple[float, ...] = tuple(
    np.polynomial.chebyshev.Chebyshev.interpolate(lambda t: np.log(1.5 + t), 8, domain=[-0.5, 0.5])
    .convert(kind=np.polynomial.Polynomial)
    .coef[::-1]
    .tolist()
)

"""Light in whole units: what is computed of it is exact, so that every execution finds the same bits.

A float32 holds whole numbers up to 2^24. Sums of whole numbers times whole numbers stay below that here, so that
neither the order of a sum nor a fused multiply-add changes a bit; what grows too long is rounded to whole numbers
again. Before that 1.4 % of the scores in 16 bits differed between two executions (docs/gpu.md, *Agreement*).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from chromaperture.matching.moved_views import PixelMaps, moved

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

"""Light in whole units: what is computed of it is exact, so that every execution finds the same bits.

A float32 holds whole numbers up to 2^24. Sums of whole numbers times whole numbers stay below that here, so that neither
the order of a sum nor a fused multiply-add changes a bit; what grows too long is rounded to whole numbers again. Before
that 1.4 % of the scores in 16 bits differed between two executions, and a third of the depths of the open aperture by
more than 0.1 % (docs/gpu.md, *Agreement*).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

# The mean light is 2^11 to 2^12 units: a unit of a well exposed picture is 1e-4 of the white level, and rounding adds
# 3e-5 of noise. docs/measurements.md compares.
LIGHT_BITS = 11
LEAST_EXPONENT = -60  # of the mean light: a black picture
TAP_PARTS = 1024  # weights of a filter are so many parts: 14 bits of light times them fill 24


def light_unit(mean: float) -> float:
    """Return the unit of a picture: the power of two that is 2^-11 to 2^-12 of its mean light."""
    exponent = math.frexp(np.float32(mean))[1] - 1 if mean > 0 else LEAST_EXPONENT
    return 2.0 ** (max(exponent, LEAST_EXPONENT) - LIGHT_BITS)


def in_whole_units(
    values: np.ndarray, unit: float, *, less: float = 0.0, out: np.ndarray | None = None
) -> np.ndarray:
    """Round to multiples of ``unit``, a power of two, halves to even ones; float32.

    Adding a number whose last bit is the unit rounds; exact below 2^22 units.

    Parameters
    ----------
    values : float32
    unit : float
    less : float
        Is subtracted; an even number of units, so that halves are rounded the same way with it or without.
    out : float32, optional
    """
    rounder = 1.5 * 2**23 * unit
    out = np.add(values, np.float32(rounder - less), out=out)
    return np.subtract(out, np.float32(rounder), out=out)


def whole_taps(taps: Sequence[float]) -> np.ndarray:
    """Round the weights of a filter to parts of `TAP_PARTS` whose sum is 1; float64."""
    parts = np.round(TAP_PARTS * np.asarray(taps, float))
    parts[np.argmax(parts)] += TAP_PARTS - parts.sum()
    return parts / TAP_PARTS

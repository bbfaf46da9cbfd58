"""The response of a camera whose files do not hold linear light: tone curves of JPEG files, gamma of exported files.

The response is a curve over decoded values, one for all channels. It is stored as local exponents q = d ln light /
d ln value, 1 everywhere where values are linear, at evenly spaced codes of the sRGB curve: steps of equal visibility.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear

KNOTS = 10  # exponents of a curve; chosen by hand
_PLACES = 513  # of the table, evenly over sRGB codes; above a value of .01 powers .5 to 3 are off by less than 2e-5
_LEAST = 1e-6  # decoded value whose logarithm stands for that of 0


@dataclass(frozen=True)
class ResponseCurve:
    """Light of decoded values; 0 and 1 stay what they are."""

    # D ln light / d ln value, positive, at evenly spaced sRGB codes from 0 to 1, linear between them.
    exponents: tuple[float, ...]

    def light(self, values: np.ndarray) -> np.ndarray:
        """Return the linear light of decoded values; float32 of the same shape.

        Beyond 0 and 1, where noise and other levels lead, values keep the scale of the curve's ends.
        """
        decoded = np.asarray(values, np.float32)
        at, light = response_table(self.exponents)
        found = np.interp(decoded, at, light)
        below = light[1] / at[1]
        return np.where(decoded < at[1], decoded * below, np.where(decoded > 1, decoded, found)).astype(np.float32)

    def exponent(self, values: np.ndarray) -> np.ndarray:
        """Return the local exponent at decoded values; float64 of the same shape."""
        knots = np.linspace(0, 1, len(self.exponents))
        return np.asarray(np.interp(linear_to_srgb(values), knots, self.exponents), float)


@lru_cache(maxsize=256)
def response_table(exponents: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return decoded values at evenly spaced sRGB codes, and their light; (P,) float64 each, both from 0 to 1."""
    codes = np.linspace(0, 1, _PLACES)
    values = srgb_to_linear(codes).astype(float)
    values[-1] = 1.0
    logs = np.log(np.maximum(values, _LEAST))
    q = np.interp(codes, np.linspace(0, 1, len(exponents)), exponents)
    steps = np.diff(logs) * (q[1:] + q[:-1]) / 2
    light = np.exp(-np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]]))
    light[0] = 0.0
    values.setflags(write=False)
    light.setflags(write=False)
    return values, light

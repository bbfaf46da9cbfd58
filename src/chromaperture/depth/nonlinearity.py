"""The bias of a shift matcher: a smooth curve from linear to measured disparity.

Blurs of the two halves of a pupil are mirror images, not shifted copies. A shift matcher therefore measures a little
less than the shift of their centroids near focus and a little more far from it, with any lens. The bias depends on the
width of the blur, that is on the disparity, and hardly on the image position: one curve holds for the whole frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from chromaperture.system.errors import InputError

_KNOTS = 512  # of the table of the inverse: linear between them it is good to 1e-4 px (test_nonlinearity.py)
_FINE = 8  # samples of the curve per knot, from which the table is interpolated; chosen by hand, not tuned
_MIN_SLOPE = 0.2  # d measured / d linear: a flatter curve is refused, it would magnify errors 5 times; chosen by hand


@dataclass(frozen=True, eq=False)  # compared by identity: it holds an array
class Nonlinearity:
    """Measured disparity = linear disparity + h(linear disparity); raises InputError where it is not monotonic."""

    # low_px to high_px: range of linear disparity in which h was fitted; beyond it h is constant
    low_px: float
    high_px: float
    # (K,) float64, px, of the Chebyshev polynomials T_2, T_3, ... over that range; A and B account for T_0 and T_1
    coefficients: np.ndarray

    def __post_init__(self) -> None:
        if not self.high_px > self.low_px:
            raise InputError(f"nonlinearity over an empty range {self.low_px:g}..{self.high_px:g} px")
        if self.is_folded:
            raise InputError("the matcher's nonlinearity turns back: photograph more boards, evenly spaced")

    @property
    def is_folded(self) -> bool:
        """Whether the measured disparity falls, or hardly rises, with the linear one."""
        return bool(np.min(self.slope(np.linspace(self.low_px, self.high_px, _KNOTS))) < _MIN_SLOPE)

    def measured(self, linear_px: np.ndarray | float) -> np.ndarray:
        """Return the disparity that the matcher measures; same shape, px."""
        linear = np.asarray(linear_px, float)
        return linear + chebyshev.chebval(self._scaled(linear), self._series())

    def linear(self, measured_px: np.ndarray | float) -> np.ndarray:
        """Return the disparity that is linear in inverse depth; same shape, px, NaN stays NaN."""
        measured, (knots, table) = np.asarray(measured_px, float), self.inverse_table
        inside = np.interp(measured, knots, table)  # NaN stays NaN
        beyond = measured - np.clip(measured, knots[0], knots[-1])
        return inside + beyond

    @cached_property
    def inverse_table(self) -> tuple[np.ndarray, np.ndarray]:
        """Measured disparities, evenly spaced over their range, and their linear disparities; two (N,) float64, px."""
        linear = np.linspace(self.low_px, self.high_px, _FINE * _KNOTS)
        measured = self.measured(linear)
        knots = np.linspace(measured[0], measured[-1], _KNOTS)
        return knots, np.interp(knots, measured, linear)

    def slope(self, linear_px: np.ndarray | float) -> np.ndarray:
        """Return d measured / d linear disparity; same shape."""
        linear = np.asarray(linear_px, float)
        scaled = self._scaled(linear)
        inside = (linear > self.low_px) & (linear < self.high_px)
        return np.where(inside | np.isnan(linear), 1 + chebyshev.chebval(scaled, self.slope_series()), 1.0)

    def errors(self, linear_px: np.ndarray | float, covariance: np.ndarray) -> np.ndarray:
        """Return the variance of h and its covariance with A, B and delta; (..., 4)."""
        terms = chebyshev.chebvander(self._scaled(np.asarray(linear_px, float)), len(self.coefficients) + 1)[..., 2:]
        with_others, own = terms @ covariance[:, :3], ((terms @ covariance[:, 3:]) * terms).sum(axis=-1)
        return np.concatenate([own[..., None], with_others], axis=-1)

    def slope_series(self) -> np.ndarray:
        """Return the Chebyshev coefficients of dh / dd over the range."""
        return chebyshev.chebder(self._series()) * 2 / (self.high_px - self.low_px)

    def _series(self) -> np.ndarray:
        return np.concatenate([[0.0, 0.0], self.coefficients])

    def _scaled(self, linear_px: np.ndarray) -> np.ndarray:
        return scaled(linear_px, self.low_px, self.high_px)


def scaled(linear_px: np.ndarray, low_px: float, high_px: float) -> np.ndarray:
    """Map a disparity range to [-1, 1], clipped; same shape."""
    return np.clip((2 * linear_px - low_px - high_px) / (high_px - low_px), -1, 1)

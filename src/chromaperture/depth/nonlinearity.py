"""What a shift matcher reads besides the shift: a smooth curve between linear and measured disparity.

The views of two halves of a pupil are mirror images of each other, not shifted copies. Matching them by a shift
therefore reads a little less than the shift of their centroids near focus and a little more far from it, whatever the
lens. The reading depends on how wide the blur is, that is on the disparity, and hardly on the place in the frame: one
curve serves the whole camera. The paper's form and its inverse hold for the linear disparity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from chromaperture.errors import InputError

_KNOTS = 512  # of the table that inverts the curve: linear between them it is good to 1e-4 px
_FINE = 8  # times denser is the curve that the table is read from
_MIN_SLOPE = 0.2


@dataclass(frozen=True, eq=False)  # holds an array: one curve is another only if it is the same object
class Nonlinearity:
    """Measured disparity = linear disparity + h(linear disparity).

    Attributes
    ----------
    low_px, high_px : float, px
        Range of linear disparity in which h was fitted; beyond it keeps its last value.
    coefficients : (K,) float64, px
        Of the Chebyshev polynomials T_2, T_3, ... over that range. T_0 and T_1 belong to A and B.

    Raises
    ------
    InputError
        The curve turns back, so that two depths would read the same.
    """

    low_px: float
    high_px: float
    coefficients: np.ndarray

    def __post_init__(self) -> None:
        if not self.high_px > self.low_px:
            raise InputError(f"nonlinearity over an empty range {self.low_px:g}..{self.high_px:g} px")
        if self.is_folded:
            raise InputError("the matcher's nonlinearity turns back: photograph more boards, evenly spread")

    @property
    def is_folded(self) -> bool:
        """Whether the measured disparity falls, or hardly rises, where the linear one rises."""
        return bool(np.min(self.slope(np.linspace(self.low_px, self.high_px, _KNOTS))) < _MIN_SLOPE)

    def measured(self, linear_px: np.ndarray | float) -> np.ndarray:
        """Disparity that the matcher reads; same shape, px."""
        linear = np.asarray(linear_px, float)
        return linear + chebyshev.chebval(self._scaled(linear), self._series())

    def linear(self, measured_px: np.ndarray | float) -> np.ndarray:
        """Disparity that is linear in inverse depth; same shape, px, NaN stays NaN."""
        measured, (knots, table) = np.asarray(measured_px, float), self.inverse_table
        inside = np.interp(measured, knots, table)  # NaN stays NaN
        beyond = measured - np.clip(measured, knots[0], knots[-1])
        return inside + beyond

    @cached_property
    def inverse_table(self) -> tuple[np.ndarray, np.ndarray]:
        """Measured disparities, evenly over their range, and the linear ones there; two (N,) float64, px."""
        linear = np.linspace(self.low_px, self.high_px, _FINE * _KNOTS)
        measured = self.measured(linear)
        knots = np.linspace(measured[0], measured[-1], _KNOTS)
        return knots, np.interp(knots, measured, linear)

    def slope(self, linear_px: np.ndarray | float) -> np.ndarray:
        """Give the derivative of the measured by the linear disparity; same shape."""
        linear = np.asarray(linear_px, float)
        scaled = self._scaled(linear)
        inside = (linear > self.low_px) & (linear < self.high_px)
        return np.where(inside | np.isnan(linear), 1 + chebyshev.chebval(scaled, self.slope_series()), 1.0)

    def errors(self, linear_px: np.ndarray | float, covariance: np.ndarray) -> np.ndarray:
        """Variance of h at some disparities and its covariance with A, B and delta; (..., 4).

        Parameters
        ----------
        linear_px : (...) float, px
        covariance : (K, 3 + K) float
            Of the coefficients with A, B and delta, and with one another.
        """
        terms = chebyshev.chebvander(self._scaled(np.asarray(linear_px, float)), len(self.coefficients) + 1)[..., 2:]
        with_others, own = terms @ covariance[:, :3], ((terms @ covariance[:, 3:]) * terms).sum(axis=-1)
        return np.concatenate([own[..., None], with_others], axis=-1)

    def slope_series(self) -> np.ndarray:
        """Coefficients of h's derivative, of T_0, T_1, ... over the range."""
        return chebyshev.chebder(self._series()) * 2 / (self.high_px - self.low_px)

    def _series(self) -> np.ndarray:
        return np.concatenate([[0.0, 0.0], self.coefficients])

    def _scaled(self, linear_px: np.ndarray) -> np.ndarray:
        return scaled(linear_px, self.low_px, self.high_px)


def scaled(linear_px: np.ndarray, low_px: float, high_px: float) -> np.ndarray:
    """Disparity over its range as [-1, 1], clipped; same shape."""
    return np.clip((2 * linear_px - low_px - high_px) / (high_px - low_px), -1, 1)

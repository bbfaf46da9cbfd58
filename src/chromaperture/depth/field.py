"""The depth curve of every pixel as two smooth fields (paper section 3.4, Figure 7).

Field curvature moves A and vignetting lowers B towards the corners. Both enter the disparity linearly, d = A - B q with
q = 1 / (depth - delta), so both are fitted at once, as polynomials over the frame, by linear least squares; the paper's
b(i, j) and z_of(i, j) follow from them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from chromaperture.depth.conversion import DepthModel
from chromaperture.errors import InputError

_HUBER = 1.345
_ROUNDS = 8


@dataclass(frozen=True)
class DepthField:
    """Depth curves over the frame.

    Attributes
    ----------
    infinity_disparity_px, scale_px_mm : (N,) float64
        Coefficients of A (px) and B (px mm): products of Chebyshev polynomials in x and y over [-1, 1] of total
        degree up to n, ordered by the degree in x, then in y; N = (n + 1)(n + 2) / 2. One number is a constant field.
    sensor_to_pupil_mm : float
        delta, the same in the whole frame.
    covariance : (3, 3) float64
        Of A, B, delta in the middle of the frame.
    """

    infinity_disparity_px: np.ndarray
    scale_px_mm: np.ndarray
    sensor_to_pupil_mm: float
    covariance: np.ndarray

    @classmethod
    def constant(cls, model: DepthModel) -> DepthField:
        """Give one curve for the whole frame."""
        return cls(
            np.atleast_1d(np.asarray(model.infinity_disparity_px, float)),
            np.atleast_1d(np.asarray(model.scale_px_mm, float)),
            float(np.asarray(model.sensor_to_pupil_mm)),
            np.asarray(model.covariance, float),
        )

    def on_axis(self, width_px: int, height_px: int) -> DepthModel:
        """Give the curve in the middle of the frame, as numbers."""
        x, y = np.array([(width_px - 1) / 2]), np.array([(height_px - 1) / 2])
        (basis,) = polynomials(x, y, width_px, height_px, degree_of(len(self.scale_px_mm)))
        return DepthModel(
            float(basis @ self.infinity_disparity_px),
            float(basis @ self.scale_px_mm),
            self.sensor_to_pupil_mm,
            self.covariance,
        )

    def model(self, width_px: int, height_px: int) -> DepthModel:
        """Evaluate the fields; maps of (height, width), or numbers where the fields are constant."""
        if len(self.scale_px_mm) == 1:
            return self.on_axis(width_px, height_px)
        size = (width_px, height_px)
        return DepthModel(
            _evaluate(self.infinity_disparity_px, *size),
            _evaluate(self.scale_px_mm, *size),
            self.sensor_to_pupil_mm,
            self.covariance,
        )


def _evaluate(coefficients: np.ndarray, width_px: int, height_px: int) -> np.ndarray:
    """Field over the whole frame; (height, width) float64."""
    degree = degree_of(len(coefficients))
    i, j = np.divmod(np.arange((degree + 1) ** 2), degree + 1)
    square = np.zeros((degree + 1) ** 2)
    square[i + j <= degree] = coefficients
    u, v = np.linspace(-1, 1, width_px), np.linspace(-1, 1, height_px)
    return chebyshev.chebgrid2d(u, v, square.reshape(degree + 1, degree + 1)).T


def degree_of(count: int) -> int:
    """Total degree of a polynomial with so many coefficients; raises InputError if there is none."""
    degree = round((np.sqrt(8 * count + 1) - 3) / 2)
    if count < 1 or (degree + 1) * (degree + 2) // 2 != count:
        raise InputError(f"{count} coefficients are not a polynomial of total degree 0, 1, 2, ... (1, 3, 6, 10, 15)")
    return degree


def polynomials(x: np.ndarray, y: np.ndarray, width_px: int, height_px: int, degree: int) -> np.ndarray:
    """Chebyshev products of total degree up to ``degree`` at pixels; (..., N) float64."""
    u = (2 * np.asarray(x, float) - (width_px - 1)) / max(width_px - 1, 1)
    v = (2 * np.asarray(y, float) - (height_px - 1)) / max(height_px - 1, 1)
    products = chebyshev.chebvander2d(u, v, [degree, degree])
    i, j = np.divmod(np.arange((degree + 1) ** 2), degree + 1)
    return products[..., i + j <= degree]


def fit_depth_field(
    x_px: np.ndarray,
    y_px: np.ndarray,
    inverse_distance: np.ndarray,
    disparity_px: np.ndarray,
    sigma_px: np.ndarray,
    *,
    size_px: tuple[int, int],
    degree: int,
    sensor_to_pupil_mm: float,
    covariance: np.ndarray,
) -> tuple[DepthField, np.ndarray]:
    """Fit both fields to disparities measured anywhere in the frame, at known distances from the pupil.

    Parameters
    ----------
    x_px, y_px : (N,) float
        Where in the frame.
    inverse_distance : (N,) float, 1/mm
        q = 1 / (distance from the sensor - delta).
    disparity_px, sigma_px : (N,) float
        Measured; NaN is left out.
    size_px : (width, height)
    degree : int
    sensor_to_pupil_mm : float
    covariance : (3, 3) float
        Of A, B, delta on the axis, to be kept with the field.

    Returns
    -------
    field : DepthField
    residual_px : (N,) float64, measured minus fitted, NaN where nothing was measured

    Raises
    ------
    InputError
        Too few measurements, or all at one distance.
    """
    known = np.isfinite(disparity_px) & np.isfinite(sigma_px)
    basis = polynomials(x_px, y_px, *size_px, degree)
    count = basis.shape[-1]
    if known.sum() < 20 * count or np.ptp(inverse_distance[known]) == 0:
        raise InputError(
            f"{known.sum()} measurements do not fix depth fields of degree {degree}: photograph more boards, with "
            "texture in the whole frame"
        )
    mean_q = float(np.mean(inverse_distance[known]))  # a scaled and centred q keeps the equations well conditioned
    spread_q = float(np.std(inverse_distance[known]))
    scaled = (inverse_distance - mean_q) / spread_q
    rows = np.concatenate([basis, -scaled[:, None] * basis], axis=1)
    weights = np.where(known, 1 / np.maximum(sigma_px, 1e-6), 0.0)
    target = np.where(known, disparity_px, 0.0)
    robust = np.ones(len(rows))
    solution = np.zeros(2 * count)
    for _ in range(_ROUNDS):  # iteratively reweighted least squares with Huber's weights
        weighted = rows * (weights**2 * robust)[:, None]
        solution, *_ = np.linalg.lstsq(weighted.T @ rows, weighted.T @ target, rcond=None)
        residual = np.where(known, disparity_px - rows @ solution, np.nan)
        standard = np.abs(residual) * weights
        scale = 1.4826 * float(np.nanmedian(standard[known]))
        robust = np.where(standard > _HUBER * scale, _HUBER * scale / np.maximum(standard, 1e-12), 1.0)
        robust = np.where(standard > 6 * scale, 0.0, robust)  # a wrong layer says nothing about the curve
    # d = a - b (q - mean) / spread = (a + b mean / spread) - (b / spread) q
    slope = solution[count:] / spread_q
    field = DepthField(solution[:count] + slope * mean_q, slope, sensor_to_pupil_mm, np.asarray(covariance, float))
    return field, residual

"""Disparity to millimetres in one pass over a picture; `conversion` holds the same formulas in NumPy, its oracle."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from chromaperture.depth.nonlinearity import Nonlinearity

_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class Curve(NamedTuple):
    """A nonlinearity as numbers: range and Chebyshev series of its slope, range and table of its inverse; all px."""

    low_px: float
    high_px: float
    slope: np.ndarray
    first_px: float
    last_px: float
    linear_px: np.ndarray


class Fields(NamedTuple):
    """A model's fields as matrices of the picture's size, or of one element: A, B, delta, and the six covariances."""

    infinity_px: np.ndarray
    scale_px_mm: np.ndarray
    pupil_mm: np.ndarray
    covariance: tuple[np.ndarray, ...]


def curve_of(nonlinearity: Nonlinearity | None) -> Curve:
    """Give what the kernel needs of a nonlinearity; empty where there is none."""
    if nonlinearity is None:
        return Curve(0.0, 0.0, np.empty(0), 0.0, 0.0, np.empty(0))
    knots, linear = nonlinearity.inverse_table
    slope = nonlinearity.slope_series()
    slope = np.concatenate([slope, np.zeros(max(0, 2 - len(slope)))])  # two at least: Clenshaw's rule begins with two
    ends = float(nonlinearity.low_px), float(nonlinearity.high_px)
    return Curve(*ends, slope, float(knots[0]), float(knots[-1]), linear)


def fields_of(
    infinity_px: np.ndarray | float,
    scale_px_mm: np.ndarray | float,
    pupil_mm: np.ndarray | float,
    covariance: np.ndarray,
) -> Fields:
    """Lay a model's fields out as the kernel reads them; each must be a number or (H, W), the covariance with 3 x 3."""
    parts = (infinity_px, scale_px_mm, pupil_mm)
    a, b, delta = (np.ascontiguousarray(np.atleast_2d(np.asarray(part, float))) for part in parts)
    c = np.asarray(covariance)
    c = c if c.dtype == np.float32 else c.astype(float)
    return Fields(a, b, delta, tuple(np.ascontiguousarray(np.atleast_2d(c[..., i, j])) for i, j in _PAIRS))


def depth_and_sigma(
    disparity_px: np.ndarray, sigma_px: np.ndarray, fields: Fields, curve: Curve, *, max_depth_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and its standard deviation, two (H, W) float32, mm; NaN unknown.

    Parameters
    ----------
    disparity_px : (H, W) float
    sigma_px : (H, W) or (1, 1) float
    fields, curve
        From `fields_of` and `curve_of`.
    max_depth_mm : float
    """
    depth_mm, sigma_mm = (np.empty(disparity_px.shape, np.float32) for _ in range(2))
    _convert(disparity_px, sigma_px, *fields, *curve, float(max_depth_mm), depth_mm, sigma_mm)
    return depth_mm, sigma_mm


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
def _convert(  # type: ignore[no-untyped-def]
    disparity, sigma, infinity, scale, pupil, covariance, low, high, series, first, last, table, max_depth,
    depth_out, sigma_out,
):  # fmt: skip
    height, width = disparity.shape
    caa, cab, cad, cbb, cbd, cdd = covariance
    # A field of one element is read at 0, 0 everywhere.
    sa, sb, sp, sc, ss = (
        int(infinity.size > 1), int(scale.size > 1), int(pupil.size > 1), int(caa.size > 1), int(sigma.size > 1)
    )  # fmt: skip
    curved = len(table) > 0
    per_px = (len(table) - 1) / (last - first) if curved else 0.0
    for y in numba.prange(height):
        for x in range(width):
            a, b, delta = infinity[y * sa, x * sa], scale[y * sb, x * sb], pupil[y * sp, x * sp]
            d = float(disparity[y, x])
            if curved:
                d = _linear(d, first, last, per_px, table)
            if not (a - d) * (max_depth - delta) >= b:  # at infinity, beyond the reach, or unknown
                depth_out[y, x] = sigma_out[y, x] = np.nan
                continue
            by_b = 1 / (a - d)  # divisions are what takes the time here
            z = b * by_b
            depth_out[y, x] = z + delta
            error = float(sigma[y * ss, x * ss])
            if curved:
                error /= _slope(d, low, high, series)
            i, j = y * sc, x * sc
            by_d = z * by_b
            variance = (
                by_d**2 * (error**2 + caa[i, j])
                + by_b**2 * cbb[i, j]
                + cdd[i, j]
                + 2 * (by_b * cbd[i, j] - by_d * cad[i, j] - by_d * by_b * cab[i, j])
            )
            sigma_out[y, x] = 0.0 if variance < 0 else np.sqrt(variance)


@numba.njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _linear(measured, first, last, per_px, table):  # type: ignore[no-untyped-def]
    """Linear between the table's entries, which are evenly spaced, and straight on beyond them."""
    if not measured > first:  # NaN stays NaN
        return table[0] + (measured - first)
    if measured >= last:
        return table[-1] + (measured - last)
    at = (measured - first) * per_px
    k = min(int(at), len(table) - 2)
    return table[k] + (table[k + 1] - table[k]) * (at - k)


@numba.njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _slope(linear, low, high, series):  # type: ignore[no-untyped-def]
    """Give the derivative of the measured by the linear disparity: Clenshaw's rule for Chebyshev polynomials."""
    if linear <= low or linear >= high:
        return 1.0
    s = (2 * linear - low - high) / (high - low)
    c0, c1 = series[-2], series[-1]
    for n in range(len(series) - 3, -1, -1):
        c0, c1 = series[n] - c1, c0 + c1 * 2 * s
    return 1 + (c0 + c1 * s)

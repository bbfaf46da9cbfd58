"""Disparity to millimetres in one compiled pass over a picture; ``conversion.py`` has the same formulas in NumPy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.threads import in_parallel

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # upper triangle of the covariance of A, B, delta


class CurveTable(NamedTuple):
    """A nonlinearity, px: range and series of its slope, range and table of its inverse, ``errors`` (N, 4)."""

    low_px: float
    high_px: float
    slope: np.ndarray
    first_px: float
    last_px: float
    linear_px: np.ndarray
    errors: np.ndarray


class FieldMaps(NamedTuple):
    """A, B, delta and their six covariances, each (H, W) or (1, 1)."""

    infinity_px: np.ndarray
    scale_px_mm: np.ndarray
    pupil_mm: np.ndarray
    covariance: tuple[np.ndarray, ...]


def curve_table(nonlinearity: Nonlinearity | None, covariance: np.ndarray | None) -> CurveTable:
    """Return the tables of a nonlinearity and its covariance; empty without one."""
    if nonlinearity is None:
        return CurveTable(0.0, 0.0, np.empty(0), 0.0, 0.0, np.empty(0), np.empty((0, 4)))
    knots, linear = nonlinearity.inverse_table
    slope = nonlinearity.slope_series()
    slope = np.concatenate([slope, np.zeros(max(0, 2 - len(slope)))])  # Clenshaw's rule starts with two
    ends = float(nonlinearity.low_px), float(nonlinearity.high_px)
    errors = np.empty((0, 4)) if covariance is None else nonlinearity.errors(linear, covariance)
    return CurveTable(*ends, slope, float(knots[0]), float(knots[-1]), linear, np.ascontiguousarray(errors))


def field_maps(
    infinity_px: np.ndarray | float,
    scale_px_mm: np.ndarray | float,
    pupil_mm: np.ndarray | float,
    covariance: np.ndarray,
) -> FieldMaps:
    """Return the fields as contiguous matrices; each is a number or (H, W), the covariance with two more axes 3 x 3."""
    parts = (infinity_px, scale_px_mm, pupil_mm)
    a, b, delta = (np.ascontiguousarray(np.atleast_2d(np.asarray(part, float))) for part in parts)
    c = np.asarray(covariance)
    c = c if c.dtype == np.float32 else c.astype(float)
    return FieldMaps(a, b, delta, tuple(np.ascontiguousarray(np.atleast_2d(c[..., i, j])) for i, j in PAIRS))


def depth_and_sigma(
    disparity_px: np.ndarray, sigma_px: np.ndarray, fields: FieldMaps, curve: CurveTable, *, max_depth_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute depth and its standard deviation, two (H, W) float32, mm; NaN unknown."""
    depth_mm, sigma_mm = (np.empty(disparity_px.shape, np.float32) for _ in range(2))

    def rows(thread: int, first: int, last: int) -> None:
        _convert(disparity_px, sigma_px, fields, curve, float(max_depth_mm), depth_mm, sigma_mm, first, last)

    in_parallel(rows, len(disparity_px))
    return depth_mm, sigma_mm


@compiled(error_model="numpy")
def _convert(disparity, sigma, fields, curve, max_depth, depth_out, sigma_out, first_row, last_row):  # type: ignore[no-untyped-def]
    width, first, last, table = disparity.shape[1], curve.first_px, curve.last_px, curve.linear_px
    infinity, scale, pupil = fields.infinity_px, fields.scale_px_mm, fields.pupil_mm
    caa, cab, cad, cbb, cbd, cdd = fields.covariance
    # A factor 0 makes every pixel read element 0, 0 of a (1, 1) field.
    sa, sb, sp, sc, ss = (
        int(infinity.size > 1), int(scale.size > 1), int(pupil.size > 1), int(caa.size > 1), int(sigma.size > 1)
    )  # fmt: skip
    curved, uncertain = len(table) > 0, len(curve.errors) > 0
    per_px = (len(table) - 1) / (last - first) if curved else 0.0
    for y in range(first_row, last_row):
        for x in range(width):
            a, b, delta = infinity[y * sa, x * sa], scale[y * sb, x * sb], pupil[y * sp, x * sp]
            d, k, part = float(disparity[y, x]), 0, 0.0
            if curved:
                k, part = _place(d, first, last, per_px, len(table))
                beyond = min(d - first, 0.0) + max(d - last, 0.0)  # slope 1 outside; NaN stays NaN
                d = table[k] + part * (table[k + 1] - table[k]) + beyond
            if not (a - d) * (max_depth - delta) >= b:  # at infinity, too far, or unknown
                depth_out[y, x] = sigma_out[y, x] = np.nan
                continue
            by_b = 1 / (a - d)  # divisions take most of the time here
            z = b * by_b
            depth_out[y, x] = z + delta
            i, j = y * sc, x * sc
            by_d = z * by_b
            by_reading = by_d / _slope(d, curve.low_px, curve.high_px, curve.slope) if curved else by_d
            variance = (
                by_d**2 * caa[i, j]
                + by_b**2 * cbb[i, j]
                + cdd[i, j]
                + 2 * (by_b * cbd[i, j] - by_d * cad[i, j] - by_d * by_b * cab[i, j])
            )
            if uncertain:
                own, with_a, with_b, with_delta = _row(curve.errors, k, part)
                variance += by_reading * (by_reading * own + 2 * (by_d * with_a - by_b * with_b - with_delta))
            variance = 0.0 if variance < 0 else variance
            sigma_out[y, x] = np.sqrt((by_reading * float(sigma[y * ss, x * ss])) ** 2 + variance)


@inlined(inline="always", error_model="numpy")
def _place(measured, first, last, per_px, count):  # type: ignore[no-untyped-def]
    """Return the entry of an evenly spaced table and the weight of the next one, clamped to its ends."""
    if not measured > first:
        return 0, 0.0
    if measured >= last:
        return count - 2, 1.0
    at = (measured - first) * per_px
    k = min(int(at), count - 2)
    return k, at - k


@inlined(inline="always", error_model="numpy")
def _row(table, k, part):  # type: ignore[no-untyped-def]
    """Return a row of a table with four columns, interpolated linearly."""
    return (
        table[k, 0] + part * (table[k + 1, 0] - table[k, 0]),
        table[k, 1] + part * (table[k + 1, 1] - table[k, 1]),
        table[k, 2] + part * (table[k + 1, 2] - table[k, 2]),
        table[k, 3] + part * (table[k + 1, 3] - table[k, 3]),
    )


@inlined(inline="always", error_model="numpy")
def _slope(linear, low, high, series):  # type: ignore[no-untyped-def]
    """Return d measured / d linear disparity: Clenshaw's rule for Chebyshev polynomials."""
    if linear <= low or linear >= high:
        return 1.0
    s = (2 * linear - low - high) / (high - low)
    c0, c1 = series[-2], series[-1]
    for n in range(len(series) - 3, -1, -1):
        c0, c1 = series[n] - c1, c0 + c1 * 2 * s
    return 1 + (c0 + c1 * s)

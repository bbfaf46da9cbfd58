"""Disparity to depth and back, with an error bar (paper sections 3.2 to 3.4).

The package computes with ``d = A - B / z``, z being the distance from the entrance pupil: disparity is linear in
inverse depth for every paraxial lens. The paper's Eqs. (7) to (10), see `PaperParameters`, are the same curve.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.settings.methods import DepthConfig
from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.errors import InputError
from chromaperture.system.threads import in_parallel

Map = np.ndarray | float


@dataclass(frozen=True, repr=False)
class DepthModel:
    """The curve ``d = A - B / (depth_mm - delta)``, one for the whole image or one for every pixel.

    Attributes
    ----------
    infinity_disparity_px : float or (H, W) array, px
        A: disparity of an object at infinity.
    scale_px_mm : float or (H, W) array, px mm, > 0
        B: half baseline times image distance over pixel pitch.
    sensor_to_pupil_mm : float or (H, W) array, mm
        delta: distance from the sensor plane to the entrance pupil.
    covariance : (..., 3, 3) array
        Covariance of (A, B, delta); leading dimensions must broadcast with the image. Zero: exactly known.
    nonlinearity : Nonlinearity, optional
        Measured disparity as a function of the disparity that is linear in inverse depth.
    curve_covariance : (K, 3 + K) array, optional
        Covariance of the K coefficients of the nonlinearity with (A, B, delta), averaged over the frame, and with one
        another. None: exactly known.

    Raises
    ------
    InputError
        B is not positive, or a covariance has the wrong shape.
    """

    infinity_disparity_px: Map
    scale_px_mm: Map
    sensor_to_pupil_mm: Map
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    nonlinearity: Nonlinearity | None = None
    curve_covariance: np.ndarray | None = None

    def __post_init__(self) -> None:
        if np.any(np.asarray(self.scale_px_mm) <= 0):
            raise InputError(
                "depth scale B must be positive everywhere: check the signs of disparity and depth, "
                "or that cyan and yellow are not swapped"
            )
        if np.shape(self.covariance)[-2:] != (3, 3):
            raise InputError(f"covariance of (A, B, delta) must end in 3x3, got {np.shape(self.covariance)}")
        if self.curve_covariance is not None:
            count = 0 if self.nonlinearity is None else len(self.nonlinearity.coefficients)
            if np.shape(self.curve_covariance) != (count, 3 + count):
                raise InputError(
                    f"covariance of {count} coefficients of the nonlinearity must be {count}x{3 + count}, got "
                    f"{np.shape(self.curve_covariance)}"
                )

    @property
    def in_focus_mm(self) -> Map:
        """Depth of the focus surface, where the disparity is 0; mm from the sensor, inf when A is 0."""
        return self.sensor_to_pupil_mm + focus_from_pupil(self.infinity_disparity_px, self.scale_px_mm)

    def __repr__(self) -> str:
        a, b, delta = (
            f"{np.mean(v):.5g}" if np.size(v) < 2 else f"{np.min(v):.5g} to {np.max(v):.5g}"
            for v in (self.infinity_disparity_px, self.scale_px_mm, self.sensor_to_pupil_mm)
        )
        return f"DepthModel(A = {a} px, B = {b} px mm, delta = {delta} mm)"

    @cached_property
    def tables(self) -> tuple[FieldMaps, CurveTable]:
        """Input of the compiled conversion, computed once."""
        parts = (self.infinity_disparity_px, self.scale_px_mm, self.sensor_to_pupil_mm)
        return (field_maps(*parts, self.covariance), curve_table(self.nonlinearity, self.curve_covariance))


def disparity_to_inverse_depth(disparity_px: Map, model: DepthModel) -> np.ndarray:
    """Compute 1 / z from the entrance pupil, 1/mm, NaN unknown; its error is symmetric, unlike depth's."""
    disparity = _map(disparity_px, model)
    if model.nonlinearity is not None:
        disparity = model.nonlinearity.linear(disparity)
    return (np.asarray(model.infinity_disparity_px, float) - disparity) / model.scale_px_mm


def disparity_to_depth(
    disparity_px: Map, model: DepthModel, sigma_px: Map | None = None, *, max_depth_mm: float = DepthConfig.max_depth_mm
) -> tuple[np.ndarray, np.ndarray]:
    """Compute depth and its standard deviation.

    Pictures go through the compiled form, other shapes through the NumPy form; both are named `depth_and_sigma`.

    Parameters
    ----------
    disparity_px : (H, W) float, px, half disparity, + beyond focus
    model : DepthModel
    sigma_px : (H, W) float, px, optional
        Standard deviation of the disparity. Without it that of the depth is unknown.
    max_depth_mm : float, mm from the sensor
        Farther depths, and disparities at or beyond that of infinity, are unknown.

    Returns
    -------
    depth_mm : (H, W) float32, mm from the sensor plane; NaN unknown
    sigma_mm : (H, W) float32, mm; NaN unknown

    Raises
    ------
    InputError
        The shapes do not fit, or ``max_depth_mm`` is not a finite depth in front of the pupil.
    """
    reach_mm = max_depth_mm - np.asarray(model.sensor_to_pupil_mm, float)
    if not np.isfinite(max_depth_mm) or np.any(reach_mm <= 0):
        raise InputError(f"max_depth_mm must be finite and beyond the entrance pupil, got {max_depth_mm:g}")
    if sigma_px is not None and _is_picture(disparity_px, sigma_px, model):
        disparity, sigma = (np.ascontiguousarray(np.atleast_2d(v)) for v in (disparity_px, sigma_px))
        return converted(disparity, sigma, *model.tables, max_depth_mm=max_depth_mm)
    return depth_and_sigma(disparity_px, sigma_px, model, max_depth_mm=max_depth_mm)


def depth_and_sigma(
    disparity_px: Map, sigma_px: Map | None, model: DepthModel, *, max_depth_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute `disparity_to_depth` in NumPy, for any shape; `converted` is compiled."""
    reach_mm = max_depth_mm - np.asarray(model.sensor_to_pupil_mm, float)
    inverse = disparity_to_inverse_depth(disparity_px, model)
    z = _reciprocal(inverse, inverse * reach_mm >= 1)
    depth = (z + model.sensor_to_pupil_mm).astype(np.float32)
    if sigma_px is None:
        return depth, np.full(depth.shape, np.nan, np.float32)
    return depth, depth_sigma(z, model, sigma_px).astype(np.float32)


def depth_sigma(z_mm: Map, model: DepthModel, sigma_px: Map) -> np.ndarray:
    """Propagate errors of d, A, B, delta and the nonlinearity to depth; first order, with correlations."""
    z = np.asarray(z_mm, float)
    c = np.asarray(model.covariance, float)
    by_b = z / model.scale_px_mm  # depth = B / (A - d) + delta: d depth / dB = z / B,
    by_d = z * by_b  # d depth / dd = z^2 / B = -d depth / dA, d depth / ddelta = 1
    calibrated = (
        by_d**2 * c[..., 0, 0]
        + by_b**2 * c[..., 1, 1]
        + c[..., 2, 2]
        + 2 * (by_b * c[..., 1, 2] - by_d * c[..., 0, 2] - by_d * by_b * c[..., 0, 1])
    )
    by_reading = by_d
    if model.nonlinearity is not None:
        linear = model.infinity_disparity_px - model.scale_px_mm / z
        by_reading = by_d / model.nonlinearity.slope(linear)  # a flatter curve magnifies errors
        if model.curve_covariance is not None:
            curve = model.nonlinearity.errors(linear, model.curve_covariance)
            own, with_a, with_b, with_delta = np.moveaxis(curve, -1, 0)
            # At a fixed reading, a change T_k dc_k of the curve lowers the linear disparity by T_k dc_k / slope.
            calibrated = (
                calibrated + by_reading**2 * own + by_reading * 2 * (by_d * with_a - by_b * with_b - with_delta)
            )
    # Rounding, and averaging the nonlinearity's covariance over the frame, can make the variance slightly negative.
    return np.sqrt(np.square(by_reading * np.asarray(sigma_px, float)) + np.maximum(calibrated, 0.0))


def depth_to_disparity(depth_mm: Map, model: DepthModel) -> np.ndarray:
    """Compute the half disparity measured at a depth: d = A - B / (depth_mm - delta), then the nonlinearity.

    Parameters
    ----------
    depth_mm : (H, W) float, mm from the sensor plane; inf is allowed
    model : DepthModel

    Returns
    -------
    (H, W) float64, px, + beyond focus; NaN at or behind the entrance pupil.

    Raises
    ------
    InputError
        A curve over the frame has another shape than the depth.
    """
    z = _map(depth_mm, model) - model.sensor_to_pupil_mm
    linear = np.asarray(model.infinity_disparity_px - model.scale_px_mm * _reciprocal(z, z > 0))
    return linear if model.nonlinearity is None else model.nonlinearity.measured(linear)


def _reciprocal(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return 1 / values, NaN outside ``where``."""
    values, where = np.broadcast_arrays(values, where)
    return np.divide(1.0, values, out=np.full(values.shape, np.nan), where=where)


def focus_from_pupil(infinity_disparity_px: Map, scale_px_mm: Map) -> np.ndarray:
    """Return the distance z_of = B / A of the focus surface from the entrance pupil, mm; inf where A is 0."""
    at_infinity, scale = np.broadcast_arrays(np.asarray(infinity_disparity_px, float), scale_px_mm)
    return np.divide(scale, at_infinity, out=np.full(scale.shape, np.inf), where=at_infinity != 0)


def _is_picture(disparity_px: Map, sigma_px: Map, model: DepthModel) -> bool:
    """Return whether both are (H, W) floats and the model's fields are numbers or (H, W), as the kernel needs."""
    disparity, sigma = np.asarray(disparity_px), np.asarray(sigma_px)
    if disparity.ndim != 2 or disparity.dtype.kind != "f" or sigma.dtype.kind != "f":
        return False
    parts = (model.infinity_disparity_px, model.scale_px_mm, model.sensor_to_pupil_mm)
    shapes = [np.shape(part) for part in parts] + [sigma.shape, np.shape(model.covariance)[:-2]]
    return all(shape in ((), disparity.shape) for shape in shapes)


def _map(values: Map, model: DepthModel) -> np.ndarray:
    """Return the values as float64 after checking their shape against that of the model's fields."""
    values = np.asarray(values, float)
    for name in ("infinity_disparity_px", "scale_px_mm", "sensor_to_pupil_mm"):
        shape = np.shape(getattr(model, name))
        if shape and values.ndim and shape != values.shape:
            raise InputError(
                f"the camera's {name} was calibrated for {shape} px and the image has {values.shape}: "
                "use images of the calibrated size"
            )
    return values


@dataclass(frozen=True)
class PaperParameters:
    """The parameters of Eqs. (8) to (10), each a number for the whole image or (H, W) for every pixel.

    Depth z~ from the sensor of a point with half disparity d, Eq. (9), with pixel pitch mu::

        z~ = (b f z~_of - 2 mu d (z~_of - delta - f) delta) / (b f - 2 mu d (z~_of - delta - f))

    Eq. (8) is the same from the entrance pupil, z = z~ - delta; Eq. (7) is (8) for a thin lens, delta = 0; Eq. (10) is
    (9) with maps b(i, j) and z~_of(i, j). All are ``z = B / (A - d)`` with

        B = b F / (2 mu),    A = B / z_of,    1 / f = 1 / F + 1 / z_of,    z_of = z~_of - delta,

    F being the distance from the pinhole's centre to its sensor (paper section 3.4); ``docs/equations.md`` derives it.
    """

    in_focus_mm: Map  # z~_of: depth of the focus surface from the sensor
    baseline_mm: Map  # b: twice the distance of a view's centroid from the centre of the entrance pupil
    sensor_to_pupil_mm: Map  # delta
    focal_length_mm: Map  # f


def paper_to_model(parameters: PaperParameters, *, pixel_pitch_mm: float) -> DepthModel:
    """Return A, B and delta, exactly known; raises InputError for a focus within the focal length."""
    z_focus = np.asarray(parameters.in_focus_mm, float) - parameters.sensor_to_pupil_mm
    shrink = 1 - parameters.focal_length_mm / z_focus  # f / F, Eq. (2); 1 for focus at infinity
    if np.any(shrink <= 0):
        raise InputError(
            "the focus surface must be farther from the entrance pupil than the focal length, "
            f"{np.max(parameters.focal_length_mm):g} mm"
        )
    scale = parameters.baseline_mm * (parameters.focal_length_mm / shrink) / (2 * pixel_pitch_mm)
    return DepthModel(scale / z_focus, scale, parameters.sensor_to_pupil_mm)


def model_to_paper(model: DepthModel, *, image_distance_mm: float, pixel_pitch_mm: float) -> PaperParameters:
    """Return the paper's parameters of a depth curve; F is the focal length in px times the pixel pitch."""
    z_focus = focus_from_pupil(model.infinity_disparity_px, model.scale_px_mm)
    return PaperParameters(
        in_focus_mm=z_focus + model.sensor_to_pupil_mm,
        baseline_mm=2 * pixel_pitch_mm * model.scale_px_mm / image_distance_mm,
        sensor_to_pupil_mm=model.sensor_to_pupil_mm,
        focal_length_mm=1 / (1 / image_distance_mm + 1 / z_focus),
    )


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


def converted(
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

"""Disparity to depth and back, with an error bar (paper sections 3.2 to 3.4).

The package works with ``d = A - B / z``, where z is the distance from the entrance pupil: disparity is linear
in inverse depth. It holds for every lens in the paraxial approximation and is the same curve as the paper's
Eqs. (7) to (10), which are in ``paper_form.py``; ``docs/equations.md`` derives both.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from chromaperture.config import DepthConfig
from chromaperture.depth.conversion_kernels import Curve, Fields, curve_of, depth_and_sigma, fields_of
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.errors import InputError

Map = np.ndarray | float


@dataclass(frozen=True)
class DepthModel:
    """The curve ``d = A - B / (depth_mm - delta)`` of a whole image, or of every pixel.

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
        How the matcher's reading differs from the disparity that is linear in inverse depth.
    curve_covariance : (K, 3 + K) array, optional
        Covariance of the nonlinearity's coefficients with (A, B, delta), as it is over the frame on average, and with
        one another. Without it they are exactly known.

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

    @cached_property
    def prepared(self) -> tuple[Fields, Curve]:
        """What the compiled conversion reads, laid out once for all pictures."""
        parts = (self.infinity_disparity_px, self.scale_px_mm, self.sensor_to_pupil_mm)
        return fields_of(*parts, self.covariance), curve_of(self.nonlinearity, self.curve_covariance)


def disparity_to_inverse_depth(disparity_px: Map, model: DepthModel) -> np.ndarray:
    """Inverse of the distance from the entrance pupil, the quantity in which disparity is linear.

    Average this and not the depth: its error is as symmetric as the disparity's.

    Parameters
    ----------
    disparity_px : (H, W) float, px, half disparity, + beyond focus
    model : DepthModel

    Returns
    -------
    (H, W) float64, 1/mm; 0 at infinity, negative where the disparity exceeds that of infinity, NaN unknown.
    """
    disparity = _map(disparity_px, model)
    if model.nonlinearity is not None:
        disparity = model.nonlinearity.linear(disparity)
    return (np.asarray(model.infinity_disparity_px, float) - disparity) / model.scale_px_mm


def disparity_to_depth(
    disparity_px: Map,
    model: DepthModel,
    sigma_px: Map | None = None,
    *,
    max_depth_mm: float = DepthConfig.max_depth_mm,
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and its standard deviation.

    Parameters
    ----------
    disparity_px : (H, W) float, px, half disparity, + beyond focus
    model : DepthModel
    sigma_px : (H, W) float, px, optional
        Standard deviation of the disparity. Without it the depth's is unknown.
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
        return depth_and_sigma(disparity, sigma, *model.prepared, max_depth_mm=max_depth_mm)
    return depth_by_formulas(disparity_px, model, sigma_px, max_depth_mm=max_depth_mm)


def depth_by_formulas(
    disparity_px: Map, model: DepthModel, sigma_px: Map | None = None, *, max_depth_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """`disparity_to_depth` for any shape, to be read; it is compiled for pictures in ``conversion_kernels``."""
    reach_mm = max_depth_mm - np.asarray(model.sensor_to_pupil_mm, float)
    inverse = disparity_to_inverse_depth(disparity_px, model)
    z = _reciprocal(inverse, inverse * reach_mm >= 1)
    depth = (z + model.sensor_to_pupil_mm).astype(np.float32)
    if sigma_px is None:
        return depth, np.full(depth.shape, np.nan, np.float32)
    return depth, depth_sigma(z, model, sigma_px).astype(np.float32)


def depth_sigma(z_mm: Map, model: DepthModel, sigma_px: Map) -> np.ndarray:
    """Propagate the errors of d, A, B, delta and the nonlinearity, correlations included, to the depth (first order).

    Parameters
    ----------
    z_mm : (H, W) float, mm from the entrance pupil
    model : DepthModel
    sigma_px : (H, W) float, px

    Returns
    -------
    (H, W) float64, mm
    """
    z = np.asarray(z_mm, float)
    c = np.asarray(model.covariance, float)
    by_b = z / model.scale_px_mm  # depth = B / (A - d) + delta: its derivative after B is z / B,
    by_d = z * by_b  # after d z^2 / B, after A minus that, after delta 1
    calibrated = (
        by_d**2 * c[..., 0, 0]
        + by_b**2 * c[..., 1, 1]
        + c[..., 2, 2]
        + 2 * (by_b * c[..., 1, 2] - by_d * c[..., 0, 2] - by_d * by_b * c[..., 0, 1])
    )
    by_reading = by_d
    if model.nonlinearity is not None:
        linear = model.infinity_disparity_px - model.scale_px_mm / z
        by_reading = by_d / model.nonlinearity.slope(linear)  # one that rises slower than the disparity tells less
        if model.curve_covariance is not None:
            curve = model.nonlinearity.errors(linear, model.curve_covariance)
            own, with_a, with_b, with_delta = np.moveaxis(curve, -1, 0)
            # A reading stays and the curve rises by T_k dc_k: the linear disparity falls by that over the slope.
            calibrated = calibrated + by_reading**2 * own + by_reading * 2 * (
                by_d * with_a - by_b * with_b - with_delta
            )
    # A fitted covariance is positive only to rounding, and that of the nonlinearity only on average over the frame.
    return np.sqrt(np.square(by_reading * np.asarray(sigma_px, float)) + np.maximum(calibrated, 0.0))


def depth_to_disparity(depth_mm: Map, model: DepthModel) -> np.ndarray:
    """Half disparity that is measured of an object at a depth: d = A - B / (depth_mm - delta), as the matcher reads it.

    Parameters
    ----------
    depth_mm : (H, W) float, mm from the sensor plane; inf is allowed
    model : DepthModel

    Returns
    -------
    (H, W) float64, px, + beyond focus; NaN at or behind the entrance pupil.
    """
    z = _map(depth_mm, model) - model.sensor_to_pupil_mm
    linear = np.asarray(model.infinity_disparity_px - model.scale_px_mm * _reciprocal(z, z > 0))
    return linear if model.nonlinearity is None else model.nonlinearity.measured(linear)


def _reciprocal(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """1 / values, NaN where not wanted."""
    values, where = np.broadcast_arrays(values, where)
    return np.divide(1.0, values, out=np.full(values.shape, np.nan), where=where)


def focus_from_pupil(infinity_disparity_px: Map, scale_px_mm: Map) -> np.ndarray:
    """Give the distance z_of = B / A of the focus surface from the entrance pupil; inf where A is 0."""
    at_infinity, scale = np.broadcast_arrays(np.asarray(infinity_disparity_px, float), scale_px_mm)
    return np.divide(scale, at_infinity, out=np.full(scale.shape, np.inf), where=at_infinity != 0)


def _is_picture(disparity_px: Map, sigma_px: Map, model: DepthModel) -> bool:
    """Whether these are floats, (H, W), and the model's fields are numbers or (H, W): what the kernel takes."""
    disparity, sigma = np.asarray(disparity_px), np.asarray(sigma_px)
    if disparity.ndim != 2 or disparity.dtype.kind != "f" or sigma.dtype.kind != "f":
        return False
    parts = (model.infinity_disparity_px, model.scale_px_mm, model.sensor_to_pupil_mm)
    shapes = [np.shape(part) for part in parts] + [sigma.shape, np.shape(model.covariance)[:-2]]
    return all(shape in ((), disparity.shape) for shape in shapes)


def _map(values: Map, model: DepthModel) -> np.ndarray:
    """Give the values as float64, checked against the size of the model's fields."""
    values = np.asarray(values, float)
    for name in ("infinity_disparity_px", "scale_px_mm", "sensor_to_pupil_mm"):
        shape = np.shape(getattr(model, name))
        if shape and values.ndim and shape != values.shape:
            raise InputError(
                f"the camera's {name} was calibrated for {shape} px and the image has {values.shape}: "
                "use images of the calibrated size"
            )
    return values

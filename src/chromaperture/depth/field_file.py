"""Depth fields as trees of plain values, for the camera file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from chromaperture.depth.field import DepthField, LocalField, degree_of
from chromaperture.depth.nonlinearity import Nonlinearity


def field_to_tree(field: DepthField) -> dict[str, Any]:
    """Return a field as a tree of plain values, and of arrays where there are thousands of values."""
    tree = dict(plain(dataclasses.asdict(field)))
    if field.local is not None:
        maps = {name: getattr(field.local, name) for name in ("infinity_disparity_px", "scale_px_mm")}
        tree["local"] = {**tree["local"], **maps}
    return tree


def field_from_tree(tree: Mapping[str, Any]) -> DepthField:
    """Rebuild a field; raises KeyError, TypeError or ValueError where the tree holds none."""
    infinity, scale = (
        np.atleast_1d(np.array(_numbers(tree[n]), float)) for n in ("infinity_disparity_px", "scale_px_mm")
    )
    for coefficients in (infinity, scale):
        degree_of(len(coefficients))
        finite(coefficients, coefficients.shape[:1])
    if len(infinity) != len(scale):
        raise ValueError("the two depth fields differ in degree")
    (delta,) = finite([tree["sensor_to_pupil_mm"]], (1,))
    covariance = np.array(_numbers(tree["covariance"]), np.float64)
    curve = tree.get("nonlinearity")
    if curve is not None:
        (low, high) = finite([curve["low_px"], curve["high_px"]], (2,))
        curve = Nonlinearity(float(low), float(high), finite(curve["coefficients"], (len(curve["coefficients"]),)))
    terms = 0 if curve is None else len(curve.coefficients)
    sizes = (3, 2 * len(infinity) + 1, 2 * len(infinity) + 1 + terms)
    if covariance.shape not in [(size, size) for size in sizes]:
        raise ValueError(f"a covariance of shape {covariance.shape} does not fit its depth field")
    local = tree.get("local")
    if local is not None:
        shape = np.shape(local["scale_px_mm"])
        (start, step) = finite([local["start_px"], local["step_px"]], (2,))
        if len(shape) != 2 or not step > 0:
            raise ValueError("a local field is no map")
        infinities, scales = (
            finite(local[name], shape).astype(np.float32) for name in ("infinity_disparity_px", "scale_px_mm")
        )
        local = LocalField(float(start), float(step), infinities, scales, finite(local["covariance"], (2, 2)))
    return DepthField(infinity, scale, float(delta), finite(covariance, covariance.shape), curve, local)


def plain(value: Any) -> Any:
    """Turn small arrays and NumPy scalars into lists and numbers, which YAML shows as text."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value


def finite(value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return a float64 array; raises ValueError where the shape differs or a number is not finite."""
    array = np.array(_numbers(value), dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"expected finite numbers of shape {shape}")
    return array


def _numbers(value: Any) -> np.ndarray:
    """Return an array of numbers; raises ValueError for texts and switches, which NumPy would convert."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise ValueError("expected numbers")
    return array

"""The blur model of a lens from its prescription: its numbers are fitted to traced rays, without photographs."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import scipy.optimize

from chromaperture.optics.lens_blur import BlurModel, displacement, rims
from chromaperture.optics.ray_table import RayTable

_LEAST_LIGHT = 0.5  # of a ray's light in the middle of the frame: less is cut by a rim
_RIMS = ("front_rim_radius", "front_rim_shift", "rear_rim_radius", "rear_rim_shift")
# Colour errors are those of one wavelength here, see `fit_to_rays`.
_NOT_FITTED = (*_RIMS, "contrast_fall")
_FITTED = tuple(
    f.name for f in fields(BlurModel) if not f.name.endswith(("red_px", "blue_px")) and f.name not in _NOT_FITTED
)
_START = (1.2, 0.2, 1.2, 0.2)  # of the rims, in the order of `_RIMS`; chosen by hand


def fit_to_rays(open_rays: RayTable, *, pupil_radius_mm: float) -> tuple[BlurModel, float]:
    """Fit the blur model to green rays of a traced lens.

    A ray through the pupil point xi that starts at a pixel meets the distance z beside the chief ray by
    ``D = o + z s``; a point of the scene at z is therefore displaced by ``-J D / z`` on the sensor, J being the px that
    a change of the chief ray's slope by 1 is. That is linear in all numbers of the model but its rims.

    ``open_rays``: of the lens without film; ``pupil_radius_mm``: of the entrance pupil. Returns ``model`` without
    errors of colour; ``rms_px`` of the rays that no rim cuts, from the model, for a point at infinity.
    """
    green = 1 if len(open_rays.origin) == 3 else 0
    chief = open_rays.chief.astype(float)
    origin = open_rays.origin[green].astype(float) - chief[:, :, None, :2]
    slope = open_rays.slope[green].astype(float) - chief[:, :, None, 2:]
    px_of_slope = _px_of_slope(open_rays, chief)
    light = open_rays.weight[1].astype(float)
    middle = light[light.shape[0] // 2, light.shape[1] // 2]
    passed = light > _LEAST_LIGHT * np.maximum(middle, 1e-12 + middle.max() * _LEAST_LIGHT)
    inverses = (0.0, 1e-3)  # of the distance: the model is linear in it
    units = [BlurModel(**({"infinity_px": 0.0, "scale_px_mm": 0.0} | {name: 1.0})) for name in _FITTED]
    rows: list[np.ndarray] = []
    targets: list[np.ndarray] = []
    ends: list[bool] = []
    for i, y in enumerate(open_rays.y_px):
        for j, x in enumerate(open_rays.x_px):
            position = _frame_position(open_rays, x, y)
            points = origin[i, j] / pupil_radius_mm
            kept = passed[i, j]
            for inverse_mm in inverses:
                beside = -(origin[i, j] * inverse_mm + slope[i, j]) @ px_of_slope[i, j].T
                columns = [displacement(unit, points[kept], position, inverse_mm, 1).ravel() for unit in units]
                rows.append(np.stack(columns, axis=1))
                targets.append(beside[kept].ravel())
                ends.append(inverse_mm == 0)
    design, target = np.concatenate(rows), np.concatenate(targets)
    at_infinity = np.concatenate([np.full(len(t), end) for t, end in zip(targets, ends, strict=True)])
    unit = np.linalg.norm(design, axis=0)
    numbers = np.linalg.lstsq(design / unit, target, rcond=None)[0] / unit
    residual = (target - design @ numbers)[at_infinity]
    model = BlurModel(**dict(zip(_FITTED, map(float, numbers), strict=True)))
    return _with_rims(model, open_rays, origin / pupil_radius_mm, light, middle), float(
        np.sqrt(2 * np.mean(residual**2))
    )


def _px_of_slope(table: RayTable, chief: np.ndarray) -> np.ndarray:
    """Px by which the image moves where the slope of the chief ray grows by 1; (Gy, Gx, 2, 2)."""
    by_row, by_column = np.gradient(chief[..., 2:], table.y_px, table.x_px, axis=(0, 1))
    return np.linalg.inv(np.stack([by_column, by_row], axis=-1))


def _frame_position(table: RayTable, x_px: float, y_px: float) -> np.ndarray:
    half = table.width_px / 2
    return np.array([(x_px - (table.width_px - 1) / 2) / half, (y_px - (table.height_px - 1) / 2) / half])


def _with_rims(
    model: BlurModel, table: RayTable, points: np.ndarray, light: np.ndarray, middle: np.ndarray
) -> BlurModel:
    """Fit the rims to the light that passes, relative to that in the middle of the frame."""
    used = middle > _LEAST_LIGHT * middle.max()
    places = [(i, j) for i in range(len(table.y_px)) for j in range(len(table.x_px))]
    falloff = light[..., used] / middle[used]
    relative = np.clip(falloff / np.maximum(falloff.max(axis=-1, keepdims=True), 1e-9), 0, 1)

    def misfit(values: np.ndarray) -> np.ndarray:
        trial = replace(model, **dict(zip(_RIMS, map(float, values), strict=True)))
        found = [
            rims(trial, points[i, j][used], _frame_position(table, table.x_px[j], table.y_px[i])) - relative[i, j]
            for i, j in places
        ]
        return np.concatenate(found)

    best = scipy.optimize.least_squares(misfit, _START, diff_step=0.02)
    return replace(model, **dict(zip(_RIMS, map(float, best.x), strict=True)))

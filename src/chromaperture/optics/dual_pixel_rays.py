"""Rays of a lens with a dual-pixel sensor, and the blur model that is fitted to traced rays, without photographs.

A microlens images the pupil onto the two halves of its pixel, but blurred and with crosstalk: neither half sees half a
pupil. To first order the sensitivity is a ramp across the pupil, ``1 +- s(x) xi``, which is flatter towards the sides
of the sensor, where light meets the pixels at an angle. The slope at the centre and the place where it is halved are
two numbers of the sensor; everything else is the lens's prescription.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import scipy.optimize

from chromaperture.optics.lens_blur import BlurModel, displacement, rims
from chromaperture.optics.ray_table import RayTable
from chromaperture.system.errors import InputError

# Film of halves that see their side of the pupil alone: green is the mean of both, and tells nothing more.
PURE = {"cyan": (0.0, 0.5, 1.0), "yellow": (1.0, 0.5, 0.0)}
HALF_PUPIL_CENTROID = 4 / (3 * np.pi)  # of a half disc, in its radii


@dataclass(frozen=True)
class HalfPixels:
    """How the two halves of a pixel see the pupil: ``1 + s xi`` and ``1 - s xi`` of the light at xi in the pupil."""

    slope: float  # s in the middle of the sensor, in (0, 1]
    half_slope_px: float  # distance from the middle, along the rows, at which s is halved: s / (1 + (x / half_slope)^2)

    def __post_init__(self) -> None:
        if not (0 < self.slope <= 1 and self.half_slope_px > 0):
            raise InputError("half pixels need a slope between 0 and 1 and a positive half_slope_px")

    def slope_at(self, x_px: np.ndarray) -> np.ndarray:
        """Return the slope at distances from the middle of the sensor; the shape of ``x_px``."""
        return np.asarray(self.slope / (1 + (np.asarray(x_px, float) / self.half_slope_px) ** 2))

    def film(self) -> dict[str, tuple[float, float, float]]:
        """Return the leaking film of halves whose centroids are those of the ramps in the middle of the sensor."""
        contrast = self.slope / 4 / HALF_PUPIL_CENTROID  # the centroid of 1 + s xi over a disc is s / 4
        low, high = (1 - contrast) / 2, (1 + contrast) / 2
        return {"cyan": (low, 0.5, high), "yellow": (high, 0.5, low)}


def half_pixel_rays(open_rays: RayTable, halves: HalfPixels, *, pupil_radius_mm: float) -> RayTable:
    """Weight the rays of an open pupil as a dual-pixel sensor does: red one half, blue the other, green their mean.

    Red is the half that sees the right of the pupil, as it is behind halves of cyan and yellow film. Each image point
    gives both halves the same light, as in files whose shading is corrected.

    ``open_rays``: of the lens without film; green is used for all; ``pupil_radius_mm``: of the entrance pupil.
    """
    green = 1 if len(open_rays.origin) == 3 else 0
    xi = (open_rays.origin[green, ..., 0] - open_rays.chief[..., None, 0]) / pupil_radius_mm
    slope = halves.slope_at(open_rays.x_px - (open_rays.width_px - 1) / 2)[None, :, None]
    light = open_rays.weight[1]
    both = light.sum(axis=-1, keepdims=True)
    sides = [light * np.maximum(1 + sign * slope * xi, 0) for sign in (1, -1)]
    right, left = (side * both / side.sum(axis=-1, keepdims=True) / 2 for side in sides)
    weight = np.stack([right, light / 2, left]).astype(np.float32)
    origin, slopes = (part[green : green + 1] for part in (open_rays.origin, open_rays.slope))
    return replace(open_rays, origin=origin, slope=slopes, weight=weight)


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

    ``open_rays``: of the lens without film; ``pupil_radius_mm``: of the entrance pupil. Returns ``model``: without
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

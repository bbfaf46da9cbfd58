"""Tables of the rays that reach a pixel, for a first-order camera or a traced lens.

One renderer works with both. Rays are stored where they cross the plane of the entrance pupil, in the camera frame (mm,
x right, y down, z forward, 0 at the sensor), for the upright picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.optics.aperture import DESIGNS, Aperture
from chromaperture.optics.paraxial import paraxial
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.prescription import Prescription
from chromaperture.optics.psf import pupil_samples
from chromaperture.optics.trace import trace
from chromaperture.system.errors import InputError

_REACH = 1.2  # of the paraxial exit pupil is sampled: off the axis the pupil moves and stretches
_SPLIT = 4  # sub-rays across a cell, for the part of it that stop and rims vignette; chosen by hand, not tuned


@dataclass(frozen=True)
class RayTable:
    """Rays from a grid of image points through the pupil."""

    width_px: int
    height_px: int
    x_px: np.ndarray  # (Gx,) float64; image points of the table, equally spaced
    y_px: np.ndarray  # (Gy,) float64
    z_mm: float  # plane of ``origin``, the entrance pupil, from the sensor
    # (G, Gy, Gx, S, 2) float32 each: where ray s crosses that plane, mm, and its dx/dz, dy/dz towards the
    # scene. G is 3 for a lens with colour errors (one set for each sensor channel), else 1
    origin: np.ndarray
    slope: np.ndarray
    weight: np.ndarray  # (3, Gy, Gx, S) float32; light of each ray in R, G, B; the open pupil on the axis sums to 1
    chief: np.ndarray  # (Gy, Gx, 4) float32; origin and slope of the green ray through the stop's centre


def pinhole_rays(camera: PupilCamera, aperture: Aperture, *, cells: int = 20) -> RayTable:
    """Tabulate the rays of a first-order camera; they are linear in the image, so its four corners are enough.

    ``cells``: pupil samples across the pupil, even; their number is about 0.8 cells^2.
    """
    points, light = pupil_samples(aperture, cells)
    lit = light.any(axis=1)
    points, light = points[lit], light[lit]
    x_px = np.array([0.0, max(camera.width_px - 1, 1)])
    y_px = np.array([0.0, max(camera.height_px - 1, 1)])
    chief = np.zeros((2, 2, 4), np.float32)
    chief[..., 2] = (x_px - camera.center_px[0]) / camera.focal_px
    chief[..., 3] = ((y_px - camera.center_px[1]) / camera.focal_px)[:, None]
    pupil = camera.pupil_radius_mm * points
    # All rays of a pixel meet in the focus plane.
    slope = chief[None, :, :, None, 2:] - pupil / (camera.focus_mm - camera.sensor_to_pupil_mm)
    return RayTable(
        width_px=camera.width_px,
        height_px=camera.height_px,
        x_px=x_px,
        y_px=y_px,
        z_mm=camera.sensor_to_pupil_mm,
        origin=np.broadcast_to(pupil, slope.shape).astype(np.float32),
        slope=slope.astype(np.float32),
        weight=np.broadcast_to(light.T[:, None, None], (3, 2, 2, len(light))).astype(np.float32),
        chief=chief,
    )


def lens_rays(
    lens: Prescription,
    aperture: Aperture,
    *,
    width_px: int,
    height_px: int,
    pixel_pitch_mm: float,
    cells: int = 20,
    nodes: int = 19,
) -> RayTable:
    """Tabulate the rays of a real lens, traced from the sensor.

    ``aperture``: pupil coordinates in stop radii, in the plane of the stop or of the filter (see `with_filter_at`);
    ``cells``: pupil samples across the exit pupil, even; ``nodes``: image points of the table along the longer side;
    rays between them are interpolated. Raises InputError: no ray from the middle of the sensor passes, or a rim other
    than the stop limits it.
    """
    data = paraxial(lens)
    longer = max(width_px, height_px)
    gx, gy = (max(3, round(nodes * side / longer)) for side in (width_px, height_px))
    x_px, y_px = np.linspace(0, width_px - 1, gx), np.linspace(0, height_px - 1, gy)
    image_mm = np.stack(
        np.meshgrid((x_px - (width_px - 1) / 2) * pixel_pitch_mm, (y_px - (height_px - 1) / 2) * pixel_pitch_mm),
        axis=-1,
    ).reshape(-1, 2)

    unit = _open_light(lens, cells)
    light = lens_light(lens, aperture, image_mm, cells=cells) / unit
    bundles = [lens_bundle(lens, image_mm, wavelength_um=w, cells=cells) for w in lens.wavelengths_um]
    used = light.any(axis=(0, 1))
    chief = chief_rays(lens, image_mm)
    origin, slope = (
        np.stack([_filled(bundle[i][:, used], chief[:, 2 * i : 2 * i + 2], image_mm) for bundle in bundles])
        for i in range(2)
    )
    return RayTable(
        width_px=width_px,
        height_px=height_px,
        x_px=x_px,
        y_px=y_px,
        z_mm=data.sensor_to_entrance_pupil_mm,
        origin=origin.reshape(3, gy, gx, -1, 2).astype(np.float32),
        slope=slope.reshape(3, gy, gx, -1, 2).astype(np.float32),
        weight=light[..., used].reshape(3, gy, gx, -1).astype(np.float32),
        chief=chief.reshape(gy, gx, 4).astype(np.float32),
    )


def _filled(rays: np.ndarray, chief: np.ndarray, image_mm: np.ndarray) -> np.ndarray:
    """Extrapolate rays that miss the glass from the nearest image point, for the interpolation; (P, S, 2).

    They carry no light. Their difference from the chief ray is copied.
    """
    rays = rays - chief[:, None]
    for s in np.flatnonzero(np.isnan(rays).any(axis=(0, 2))):
        missing = np.isnan(rays[:, s, 0])
        apart = ((image_mm[missing, None] - image_mm[None, ~missing]) ** 2).sum(axis=-1)
        rays[missing, s] = rays[~missing, s][apart.argmin(axis=1)]
    return rays + chief[:, None]


def _open_light(lens: Prescription, cells: int) -> float:
    """Compute the light of the open pupil on the axis, the unit of all weights; check that the stop limits it."""
    light = lens_light(lens, DESIGNS["open"], np.zeros((1, 2)), cells=cells)[1]
    if not light.any():
        raise InputError(f"no ray from the sensor's middle passes lens {lens.name!r}: check its stop and diameters")
    rim = np.stack([np.cos(np.linspace(0, 2 * np.pi, 64)), np.sin(np.linspace(0, 2 * np.pi, 64))], -1)
    # Rays just inside the stop must pass all other rims.
    _, _, hit = _from_sensor(lens, np.zeros((len(rim), 2)), 0.97 * rim, lens.wavelengths_um[1])
    if not hit.clear[np.hypot(*hit.at_stop.T) < 0.985].all():
        raise InputError(
            f"the stop of lens {lens.name!r} is larger than its glass lets through on the axis: make the "
            "stop's clear_diameter_mm smaller"
        )
    return float(light.sum())


def _from_sensor(lens, image_mm, pupil, wavelength_um):  # type: ignore[no-untyped-def]
    """Trace one ray for each pair of image point and exit-pupil point, (N, 2) each, to the scene.

    Returns origins and slopes at the entrance pupil, (N, 2) each, and the traced rays.
    """
    data, first = paraxial(lens), lens.first_vertex_to_sensor_mm
    # Upright picture: the image point (x, y) lies at (-x, -y) on the sensor.
    start = np.column_stack([-image_mm, np.full(len(image_mm), first)])
    target = np.column_stack([pupil * data.exit_diameter_mm / 2, np.full(len(pupil), data.exit_pupil_mm)])
    # An exit pupil behind the sensor lies on the same lines, but backwards.
    direction = target - start if data.exit_pupil_mm < first else start - target
    rays = trace(lens, start, direction, wavelength_um=wavelength_um, from_sensor=True)
    # In the lens frame z points to the sensor, in the camera frame away from it.
    slope = -rays.direction[:, :2] / rays.direction[:, 2:]
    return rays.position[:, :2] + slope * (rays.position[:, 2:] - data.entrance_pupil_mm), slope, rays


def _all_pairs(image_mm: np.ndarray, pupil: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pair every image point (P, 2) with every pupil point (S, 2); two (P S, 2) arrays."""
    return np.repeat(image_mm, len(pupil), axis=0), np.tile(pupil, (len(image_mm), 1))


def _exit_points(cells: int) -> np.ndarray:
    """Sample the exit pupil on a square grid, in paraxial radii; (S, 2)."""
    axis = ((np.arange(cells) + 0.5) * 2 / cells - 1) * _REACH
    points = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    return points[np.hypot(*points.T) < _REACH]


def lens_bundle(
    lens: Prescription, image_mm: np.ndarray, *, wavelength_um: float, cells: int = 20
) -> tuple[np.ndarray, np.ndarray]:
    """Trace the rays of image points through a lens to the scene.

    ``image_mm`` (P, 2) float: image points from the image's centre, upright picture, mm on the sensor; ``cells``:
    samples across the exit pupil. Returns ``origin, slope`` (P, S, 2) float64: camera frame, origin in the plane of the
    entrance pupil, mm. NaN where no ray passes the glass.
    """
    points = _exit_points(cells)
    origin, slope, _ = _from_sensor(lens, *_all_pairs(image_mm, points), wavelength_um)
    shape = (len(image_mm), len(points), 2)
    return origin.reshape(shape), slope.reshape(shape)


def lens_light(lens: Prescription, aperture: Aperture, image_mm: np.ndarray, *, cells: int = 20) -> np.ndarray:
    """Compute the light of each ray of `lens_bundle` in R, G, B, proportional to the irradiance on the sensor.

    Vignetting is that of green rays: between the colours these points of the pupil move by about 1e-3 radii.

    ``image_mm`` (P, 2) float. Returns (3, P, S) float64; 0 where stop, rims or film block the ray.
    """
    data = paraxial(lens)
    points = _exit_points(cells)
    offsets = ((np.arange(_SPLIT) + 0.5) / _SPLIT - 0.5) * 2 * _REACH / cells
    distance2 = (lens.first_vertex_to_sensor_mm - data.exit_pupil_mm) ** 2
    light = np.zeros((len(image_mm) * len(points), 3))
    for dx in offsets:
        for dy in offsets:
            fine = points + np.array([dx, dy])
            _, _, rays = _from_sensor(lens, *_all_pairs(image_mm, fine), lens.wavelengths_um[1])
            # Without the pupil's rim: the stop cuts the light, and film off its plane may be wider.
            passed = aperture.film_map(*np.nan_to_num(rays.at_filter, nan=2.0).T)
            # Irradiance of a uniform scene: equal areas of the exit pupil's plane are weighted by cos^4 of their slope.
            side2 = ((image_mm[:, None] + fine * data.exit_diameter_mm / 2) ** 2).sum(axis=-1).ravel()
            light += passed * (rays.clear * (distance2 / (distance2 + side2)) ** 2)[:, None]
    return light.T.reshape(3, len(image_mm), len(points)) / _SPLIT**2


def chief_rays(lens: Prescription, image_mm: np.ndarray) -> np.ndarray:
    """Trace green rays through the stop's centre.

    ``image_mm`` (P, 2) float: image points from the image's centre, upright picture. Returns (P, 4) float64: origin x,
    y in the plane of the entrance pupil (mm), slope x, y. Raises InputError: the stop's centre cannot be reached from
    an image point.
    """
    aim = np.zeros((len(image_mm), 2))
    step = 1e-3
    for _ in range(20):  # Newton with a finite-difference Jacobian on where the ray crosses the stop
        trial = aim[:, None] + step * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        hits, ends = [], []
        for i in range(3):
            origin, slope, rays = _from_sensor(lens, image_mm, trial[:, i], lens.wavelengths_um[1])
            hits.append(rays.at_stop)
            ends.append(np.hstack([origin, slope]))
        jacobian = np.stack([(hits[1] - hits[0]) / step, (hits[2] - hits[0]) / step], axis=-1)
        if not np.isfinite(jacobian).all():
            break
        if np.abs(hits[0]).max() < 1e-10:
            return ends[0]
        aim = aim - np.linalg.solve(jacobian, hits[0][..., None])[..., 0]
    raise InputError(
        f"the stop of lens {lens.name!r} cannot be reached from the whole sensor: use a smaller sensor or "
        "check the stop"
    )

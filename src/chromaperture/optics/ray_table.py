"""Tables of the rays that reach a pixel, for a first-order camera or a traced lens.

One renderer works with both. Rays are stored where they cross the plane of the entrance pupil, in the camera frame (mm,
x right, y down, z forward, 0 at the sensor), for the upright picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from chromaperture.optics.aperture import DESIGNS, Aperture
from chromaperture.optics.pinhole import PupilCamera, paraxial
from chromaperture.optics.prescription import Prescription
from chromaperture.optics.psf import pupil_samples
from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.errors import InputError
from chromaperture.system.threads import in_parallel

_NEWTON_STEPS = 12  # at most; each doubles the correct digits near the solution
_CONVERGED_MM = 1e-11  # a thousand roundings of a coordinate of some 10 mm


@dataclass(frozen=True)
class TracedRays:
    """Rays behind the last surface they meet."""

    # (N, 3) float64 each, mm: on the last surface traced, and the unit direction behind it; lens frame
    # (z towards the sensor, 0 at the first vertex). NaN where a ray missed a surface or was totally reflected
    position: np.ndarray
    direction: np.ndarray
    # (N, 2) float64 each: where the ray crosses the stop and the filter plane, in units of the stop's radius
    at_stop: np.ndarray
    at_filter: np.ndarray
    clear: np.ndarray  # (N,) bool; the ray passes inside every clear aperture, the stop's included


def trace(
    lens: Prescription, origin: np.ndarray, direction: np.ndarray, *, wavelength_um: float, from_sensor: bool = False
) -> TracedRays:
    """Trace rays (N, 3), mm in the lens frame (z towards the sensor, 0 at the first vertex), through a lens."""
    order = np.arange(len(lens.surfaces))
    index = lens.indices(wavelength_um)
    before, behind = index[:-1], index[1:]
    if from_sensor:
        order, before, behind = order[::-1], behind, before
    width = max((len(s.coefficients) for s in lens.surfaces), default=0)
    coefficients = np.zeros((len(order), width))
    for i, s in enumerate(lens.surfaces):
        coefficients[i, : len(s.coefficients)] = s.coefficients
    start = np.array(origin, np.float64)
    aim = np.array(direction, np.float64)
    aim /= np.linalg.norm(aim, axis=1, keepdims=True)
    crossings = np.empty((len(start), 2, 2))
    clear = np.ones(len(start), np.bool_)
    columns = [(1 / s.radius_mm, s.conic, s.semi_diameter_mm) for s in lens.surfaces]
    curvature, conic, semi_diameter = np.ascontiguousarray(np.array(columns).T)
    surfaces = _Surfaces(
        order.astype(np.int64), lens.vertices_mm, curvature, conic, coefficients, semi_diameter, before / behind,
        lens.stop_index, lens.filter_index,
    )  # fmt: skip
    in_parallel(lambda _, first, last: _trace(start, aim, crossings, clear, surfaces, first, last), len(start))
    crossings /= lens.surfaces[lens.stop_index].semi_diameter_mm
    return TracedRays(start, aim, crossings[:, 0], crossings[:, 1], clear)


class _Surfaces(NamedTuple):
    """Surfaces of a lens as the kernel reads them, each array (N,) by number of the surface, mm."""

    order: np.ndarray  # numbers of the surfaces in the order in which light meets them
    vertex: np.ndarray
    curvature: np.ndarray
    conic: np.ndarray
    coefficients: np.ndarray  # (N, K)
    semi_diameter: np.ndarray
    index_ratio: np.ndarray  # refractive index before over behind, as light travels
    stop: int
    film: int


@inlined(inline="always")
def _sag(r2, curvature, conic, coefficients):  # type: ignore[no-untyped-def]
    """Compute the height of the surface over its vertex plane, and its derivative by r^2."""
    root2 = 1 - (1 + conic) * curvature * curvature * r2
    if root2 <= 0:
        return math.nan, math.nan
    root = math.sqrt(root2)
    z = curvature * r2 / (1 + root)
    slope = curvature / (2 * root)
    power = r2
    for i in range(coefficients.size):
        slope += (i + 2) * coefficients[i] * power
        power *= r2
        z += coefficients[i] * power
    return z, slope


@compiled()
def _trace(position, direction, crossings, clear, surfaces, first, last):  # type: ignore[no-untyped-def]
    """Trace rays in place."""
    for n in range(first, last):
        x, y, z = position[n, 0], position[n, 1], position[n, 2]
        dx, dy, dz = direction[n, 0], direction[n, 1], direction[n, 2]
        for i in surfaces.order:
            # Newton on the distance along the ray, from the vertex plane.
            t = (surfaces.vertex[i] - z) / dz
            slope = 0.0
            for _ in range(_NEWTON_STEPS):
                px, py = x + t * dx, y + t * dy
                r2 = px * px + py * py
                sag, slope = _sag(r2, surfaces.curvature[i], surfaces.conic[i], surfaces.coefficients[i])
                error = z + t * dz - surfaces.vertex[i] - sag
                t -= error / (dz - 2 * slope * (px * dx + py * dy))
                if abs(error) < _CONVERGED_MM:
                    break
            x, y, z = x + t * dx, y + t * dy, z + t * dz
            if x * x + y * y > surfaces.semi_diameter[i] ** 2:
                clear[n] = False
            if i == surfaces.stop:
                crossings[n, 0, 0], crossings[n, 0, 1] = x, y
            if i == surfaces.film:
                crossings[n, 1, 0], crossings[n, 1, 1] = x, y
            # Snell's law in vector form; the normal points against the ray.
            nx, ny, nz = -2 * slope * x, -2 * slope * y, 1.0
            scale = 1 / math.sqrt(nx * nx + ny * ny + nz * nz)
            cosine = (nx * dx + ny * dy + nz * dz) * scale
            if cosine > 0:
                scale = -scale
            else:
                cosine = -cosine
            nx, ny, nz = nx * scale, ny * scale, nz * scale
            ratio = surfaces.index_ratio[i]
            root2 = 1 - ratio * ratio * (1 - cosine * cosine)
            if not root2 >= 0:  # total reflection, or NaN from a missed surface
                x = math.nan
                clear[n] = False
                break
            along = ratio * cosine - math.sqrt(root2)
            dx, dy, dz = ratio * dx + along * nx, ratio * dy + along * ny, ratio * dz + along * nz
        if math.isnan(x):
            y = z = dx = dy = dz = x
            clear[n] = False
        position[n, 0], position[n, 1], position[n, 2] = x, y, z
        direction[n, 0], direction[n, 1], direction[n, 2] = dx, dy, dz


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
    """Tabulate the rays of a first-order camera, linear in the image: the four corners are enough."""
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
    """Extrapolate rays that miss the glass, and carry no light, from the nearest image point; (P, S, 2)."""
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
    """Trace a ray for each pair of image and exit-pupil point; returns origins, slopes and the traced rays."""
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
    """Trace rays of image points (P, 2), mm, to the scene: origin, slope (P, S, 2), NaN where glass stops them."""
    points = _exit_points(cells)
    origin, slope, _ = _from_sensor(lens, *_all_pairs(image_mm, points), wavelength_um)
    shape = (len(image_mm), len(points), 2)
    return origin.reshape(shape), slope.reshape(shape)


def lens_light(lens: Prescription, aperture: Aperture, image_mm: np.ndarray, *, cells: int = 20) -> np.ndarray:
    """Compute the light of each ray of `lens_bundle` in R, G, B, (3, P, S), vignetted as green is."""
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
    """Trace green rays of image points (P, 2), mm, through the stop's centre: origin and slope, (P, 4)."""
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

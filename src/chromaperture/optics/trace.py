"""Sequential ray tracing through the surfaces of a prescription, either way."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from chromaperture.optics.prescription import Prescription
from chromaperture.system.compilation import compiled, inlined
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
    """Trace rays through a lens.

    ``origin``, ``direction`` (N, 3) float, mm: lens frame: z towards the sensor, 0 at the first vertex; x, y as in the
    camera frame. Directions need not be normalised and must point towards the lens; ``from_sensor``: trace from the
    sensor to the scene.
    """
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

"""Sequential ray tracing through the surfaces of a prescription, either way."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from chromaperture.optics.prescription import Prescription

_NEWTON_STEPS = 12
_CONVERGED_MM = 1e-11


@dataclass(frozen=True)
class TracedRays:
    """Rays behind the last surface they meet.

    Attributes
    ----------
    position, direction : (N, 3) float64, mm
        On the last surface traced, and the unit direction behind it; lens frame (z towards the sensor, 0 at
        the first vertex). NaN where a ray missed a surface or was totally reflected.
    at_stop, at_filter : (N, 2) float64
        Where the ray crosses the stop and the filter plane, in units of the stop's radius.
    clear : (N,) bool
        The ray passes inside every clear aperture, the stop's included.
    """

    position: np.ndarray
    direction: np.ndarray
    at_stop: np.ndarray
    at_filter: np.ndarray
    clear: np.ndarray


def trace(
    lens: Prescription,
    origin: np.ndarray,
    direction: np.ndarray,
    *,
    wavelength_um: float,
    from_sensor: bool = False,
) -> TracedRays:
    """Trace rays through a lens.

    Parameters
    ----------
    lens : Prescription
    origin, direction : (N, 3) float, mm
        Lens frame: z towards the sensor, 0 at the first vertex; x, y as in the camera frame. Directions need
        not be normalised and must point towards the lens.
    wavelength_um : float
    from_sensor : bool
        Trace from the sensor to the scene.

    Returns
    -------
    TracedRays
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
    _trace(
        start, aim, crossings, clear, order.astype(np.int64), lens.vertices_mm,
        np.array([1 / s.radius_mm for s in lens.surfaces]), np.array([s.conic for s in lens.surfaces]),
        coefficients, np.array([s.semi_diameter_mm for s in lens.surfaces]),
        before, behind, lens.stop_index, lens.filter_index,
    )  # fmt: skip
    crossings /= lens.surfaces[lens.stop_index].semi_diameter_mm
    return TracedRays(start, aim, crossings[:, 0], crossings[:, 1], clear)


@numba.njit(cache=True, inline="always")
def _sag(r2: float, curvature: float, conic: float, coefficients: np.ndarray) -> tuple[float, float]:
    """Height of the surface over its vertex plane, and its derivative by r^2."""
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


@numba.njit(cache=True, parallel=True)
def _trace(  # type: ignore[no-untyped-def]
    position, direction, crossings, clear, order, vertices, curvature, conic, coefficients, semi,
    before, behind, stop, film,
):  # fmt: skip
    """Trace in place; every ray on its own."""
    for n in numba.prange(position.shape[0]):
        x, y, z = position[n, 0], position[n, 1], position[n, 2]
        dx, dy, dz = direction[n, 0], direction[n, 1], direction[n, 2]
        for i in order:
            # Newton on the distance along the ray, from the vertex plane.
            t = (vertices[i] - z) / dz
            slope = 0.0
            for _ in range(_NEWTON_STEPS):
                px, py = x + t * dx, y + t * dy
                sag, slope = _sag(px * px + py * py, curvature[i], conic[i], coefficients[i])
                error = z + t * dz - vertices[i] - sag
                t -= error / (dz - 2 * slope * (px * dx + py * dy))
                if abs(error) < _CONVERGED_MM:
                    break
            x, y, z = x + t * dx, y + t * dy, z + t * dz
            if x * x + y * y > semi[i] * semi[i]:
                clear[n] = False
            if i == stop:
                crossings[n, 0, 0], crossings[n, 0, 1] = x, y
            if i == film:
                crossings[n, 1, 0], crossings[n, 1, 1] = x, y
            # Snell's law as vectors; the normal is turned against the ray.
            nx, ny, nz = -2 * slope * x, -2 * slope * y, 1.0
            scale = 1 / math.sqrt(nx * nx + ny * ny + nz * nz)
            cosine = (nx * dx + ny * dy + nz * dz) * scale
            if cosine > 0:
                scale = -scale
            else:
                cosine = -cosine
            nx, ny, nz = nx * scale, ny * scale, nz * scale
            ratio = before[i] / behind[i]
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

"""First-order data of a lens by paraxial ray tracing: focal length, principal planes, pupils, focus."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from chromaperture.optics.prescription import Prescription
from chromaperture.system.errors import InputError


@dataclass(frozen=True)
class Paraxial:
    """First-order data; positions in mm from the first vertex, + towards the sensor."""

    focal_length_mm: float  # effective focal length in air
    back_focus_mm: float  # last vertex to the image of infinity
    front_principal_mm: float  # position of the principal plane H
    rear_principal_mm: float  # and of H'
    entrance_pupil_mm: float  # position of the image of the stop in the scene's space
    exit_pupil_mm: float  # and in the sensor's
    entrance_diameter_mm: float
    exit_diameter_mm: float
    sensor_to_entrance_pupil_mm: float  # the paper's delta
    focus_from_pupil_mm: float  # of what is in focus on the sensor, to the entrance pupil; inf when focused at infinity
    # F: distance of a pinhole in the entrance pupil from an image plane of the sensor's scale; fx = F / mu
    pinhole_distance_mm: float


def _matrix(lens: Prescription, wavelength_um: float, first: int, last: int) -> np.ndarray:
    """Compute the matrix on (height, n * slope) from before surface ``first`` to behind ``last - 1``."""
    n = lens.indices(wavelength_um)
    m = np.eye(2)
    for i in range(first, last):
        surface = lens.surfaces[i]
        m = np.array([[1, 0], [-(n[i + 1] - n[i]) / surface.radius_mm, 1]]) @ m
        if i < last - 1:
            m = np.array([[1, surface.thickness_mm / n[i + 1]], [0, 1]]) @ m
    return m


@lru_cache(maxsize=64)
def paraxial(lens: Prescription, *, wavelength_um: float | None = None) -> Paraxial:
    """Compute the first-order data of a lens.

    ``wavelength_um``: green when absent. Raises InputError: the lens has no power, or its stop is imaged to infinity by
    either half, or the sensor lies inside the focus.
    """
    wave = lens.wavelengths_um[1] if wavelength_um is None else wavelength_um
    n, stop, count = lens.indices(wave), lens.stop_index, len(lens.surfaces)
    vertices = lens.vertices_mm
    whole = _matrix(lens, wave, 0, count)
    if whole[1, 0] >= -1e-9:
        raise InputError(
            f"lens {lens.name!r} does not collect light (power {-whole[1, 0]:.2g} / mm): check the signs of its radii"
        )
    focal = -1 / whole[1, 0]
    back_focus = whole[0, 0] * focal
    front = _matrix(lens, wave, 0, stop)
    to_stop = lens.surfaces[stop - 1].thickness_mm / n[stop] if stop else 0.0
    front = np.array([[1, to_stop], [0, 1]]) @ front
    rear = _matrix(lens, wave, stop, count)
    if abs(front[0, 0]) < 1e-6 or abs(rear[1, 1]) < 1e-6:
        raise InputError(
            f"the stop of lens {lens.name!r} cannot be reached: it lies in a focus of the lens in front or behind"
        )
    # Rays through the stop's centre meet the axis in object space at the entrance pupil: A y + B u = 0.
    entrance = front[0, 1] / front[0, 0]
    exit_from_last = -rear[0, 1] / rear[1, 1]
    radius = lens.surfaces[stop].semi_diameter_mm
    in_focus = _conjugate(lens.sensor_gap_mm, whole, lens.name)
    gap = lens.sensor_gap_mm
    # Height and slope, behind the lens, of a chief ray of object slope 1.
    after = whole @ np.array([-entrance, 1.0])
    return Paraxial(
        focal_length_mm=float(focal),
        back_focus_mm=float(back_focus),
        front_principal_mm=float((1 - whole[1, 1]) / whole[1, 0]) * -1,
        rear_principal_mm=float(vertices[-1] + back_focus - focal),
        entrance_pupil_mm=float(entrance),
        exit_pupil_mm=float(vertices[-1] + exit_from_last),
        entrance_diameter_mm=float(2 * radius / abs(front[0, 0])),
        exit_diameter_mm=float(2 * radius / abs(rear[1, 1])),
        sensor_to_entrance_pupil_mm=float(vertices[-1] + gap - entrance),
        focus_from_pupil_mm=float(in_focus + entrance),
        pinhole_distance_mm=float(abs(after[0] + gap * after[1])),
    )


def _conjugate(gap: float, whole: np.ndarray, name: str) -> float:
    """Compute the distance in front of the first vertex that is imaged at ``gap`` behind the last."""
    a, b, c, d = whole[0, 0], whole[0, 1], whole[1, 0], whole[1, 1]
    # (1 gap; 0 1) whole (1 s; 0 1) has no height-from-slope term: (a + gap c) s + b + gap d = 0.
    denominator = a + gap * c
    if abs(denominator) < 1e-12:
        return float("inf")
    distance = -(b + gap * d) / denominator
    if distance <= 0:
        raise InputError(
            f"the sensor of lens {name!r} lies {gap:g} mm behind the glass, inside the focus: nothing real "
            "is sharp there"
        )
    return distance


def focused_at(lens: Prescription, distance_mm: float) -> Prescription:
    """Move the sensor so that a distance is in focus paraxially.

    ``distance_mm``: from the sensor plane; inf is allowed. Raises InputError: too close: object and image are at least
    four focal lengths apart.
    """
    data = paraxial(replace(lens, sensor_gap_mm=1e6))
    f = data.focal_length_mm
    if not distance_mm > 0:
        raise InputError(f"focus distance must be positive and in mm, got {distance_mm:g}")
    if np.isinf(distance_mm):
        return replace(lens, sensor_gap_mm=data.back_focus_mm)
    between = data.rear_principal_mm - data.front_principal_mm
    total = distance_mm - between  # object to H plus H' to sensor
    if total < 4 * f:
        raise InputError(
            f"cannot focus at {distance_mm:g} mm: an object this near lies too close to the focal length; "
            f"the nearest is {4 * f + between:.0f} mm"
        )
    image = (total - np.sqrt(total * (total - 4 * f))) / 2  # s + s' = total, 1/s + 1/s' = 1/f
    return replace(lens, sensor_gap_mm=float(data.rear_principal_mm + image - lens.vertices_mm[-1]))

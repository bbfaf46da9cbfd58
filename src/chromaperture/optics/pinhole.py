"""First-order camera: a pinhole in the entrance pupil, with a pupil radius and a focus distance.

Holds the paper's Eqs. (2) to (6) for any lens. With distances z from the entrance pupil and the image distance F, the
rim of the pupil (radius R) is displaced from the sharp image by r = F R (1/z_f - 1/z), half the circle of confusion c
of Eq. (5): for a thin lens, F = z_if = f z_of / (z_of - f) by Eq. (2), and

    c = 2 r = f D (z_od - z_of) / (z_od (z_of - f)),      d = beta c / (2 mu)                  Eqs. (5), (6)

Eq. (4) of the paper is misprinted: with (3) it leads to (5) with z_od and z_of exchanged and the sign reversed. What
its Figure 1 shows is 1/z_of + 1/(z_id (1 + c/D)) = 1/f, from which (5) follows.
"""

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
    """Compute the first-order data of a lens, in green when no wavelength is given."""
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
    """Move the sensor so that a distance from it, or inf, is in focus paraxially; raises as `image_distance`."""
    data = paraxial(replace(lens, sensor_gap_mm=1e6))
    f = data.focal_length_mm
    image = image_distance(f, distance_mm, between_mm=data.rear_principal_mm - data.front_principal_mm)
    return replace(lens, sensor_gap_mm=float(data.rear_principal_mm + image - lens.vertices_mm[-1]))


def image_distance(focal_length_mm: float, distance_mm: float, *, between_mm: float = 0.0) -> float:
    """Return the distance of the rear principal plane from the sensor, for a focus so far from the sensor.

    ``between_mm``: the rear principal plane from the front one. Raises InputError: nothing there can be in focus.
    """
    if not distance_mm > 0:
        raise InputError(f"focus distance must be positive and in mm, got {distance_mm:g}")
    if np.isinf(distance_mm):
        return focal_length_mm
    total = distance_mm - between_mm  # object to H plus H' to sensor
    if total < 4 * focal_length_mm:
        raise InputError(
            f"cannot focus at {distance_mm:g} mm: an object this near lies too close to the focal length; "
            f"the nearest is {4 * focal_length_mm + between_mm:.0f} mm"
        )
    # s + s' = total, 1/s + 1/s' = 1/f
    return float((total - np.sqrt(total * (total - 4 * focal_length_mm))) / 2)


@dataclass(frozen=True)
class PupilCamera:
    """A pinhole camera with a finite pupil."""

    width_px: int
    height_px: int
    focal_px: float  # F / mu: fx of a pinhole calibration, px
    pupil_radius_mm: float  # radius of the entrance pupil
    focus_mm: float  # distance of the focus plane from the sensor plane; inf is allowed
    sensor_to_pupil_mm: float  # delta, from the sensor plane to the entrance pupil
    pixel_pitch_mm: float  # mu; only diffraction and the printed figures need it

    def __post_init__(self) -> None:
        if min(self.width_px, self.height_px) < 1 or not (self.focal_px > 0 and self.pixel_pitch_mm > 0):
            raise InputError("a camera needs a positive image size, focal_px and pixel_pitch_mm")
        if not (self.pupil_radius_mm > 0 and self.sensor_to_pupil_mm >= 0):
            raise InputError("a camera needs a positive pupil_radius_mm and a sensor_to_pupil_mm of at least 0")
        # Nearer than F from the pupil the picture would be larger than the object.
        if not self.focus_mm - self.sensor_to_pupil_mm > self.image_distance_mm:
            raise InputError(
                f"focus at {self.focus_mm:g} mm is closer than a scale of 1:1, which is not supported: it must exceed "
                f"{self.sensor_to_pupil_mm + self.image_distance_mm:.0f} mm from the sensor"
            )

    @property
    def image_distance_mm(self) -> float:
        """F: distance of the pinhole from an image plane of the sensor's scale."""
        return self.focal_px * self.pixel_pitch_mm

    @property
    def center_px(self) -> tuple[float, float]:
        """Image point of the axis, the middle of the image; (0, 0) is the centre of the top-left pixel."""
        return (self.width_px - 1) / 2, (self.height_px - 1) / 2

    @property
    def f_number(self) -> float:
        """Image distance over the diameter of the entrance pupil."""
        return self.image_distance_mm / (2 * self.pupil_radius_mm)

    def blur_radius_px(self, depth_mm: np.ndarray | float) -> np.ndarray:
        """Compute r = (F R / mu)(1 / z_f - 1 / z), px, + beyond the focus: Eq. (5); depth is from the sensor."""
        z = np.asarray(depth_mm, float) - self.sensor_to_pupil_mm
        if np.any(z <= 0):
            raise InputError(
                f"a depth of {np.nanmin(z) + self.sensor_to_pupil_mm:g} mm lies behind the entrance pupil, which is "
                f"{self.sensor_to_pupil_mm:g} mm from the sensor; unknown depth is NaN"
            )
        return self.focal_px * self.pupil_radius_mm * (1 / (self.focus_mm - self.sensor_to_pupil_mm) - 1 / z)

    def disparity_px(self, depth_mm: np.ndarray | float, beta: float) -> np.ndarray:
        """Compute the half disparity of channels with centroids at ``beta`` pupil radii, px: d = A - B / z, Eq. (6)."""
        return beta * self.blur_radius_px(depth_mm)


def pupil_camera(lens: Prescription, *, width_px: int, height_px: int, pixel_pitch_mm: float) -> PupilCamera:
    """Approximate a lens to first order."""
    data = paraxial(lens)
    return PupilCamera(
        width_px=width_px,
        height_px=height_px,
        focal_px=data.pinhole_distance_mm / pixel_pitch_mm,
        pupil_radius_mm=data.entrance_diameter_mm / 2,
        focus_mm=data.focus_from_pupil_mm + data.sensor_to_entrance_pupil_mm,  # inf stays inf
        sensor_to_pupil_mm=data.sensor_to_entrance_pupil_mm,
        pixel_pitch_mm=pixel_pitch_mm,
    )


def thin_lens_camera(
    focal_length_mm: float, f_number: float, focus_mm: float, *, width_px: int, height_px: int, pixel_pitch_mm: float
) -> PupilCamera:
    """Return the camera of a thin lens in focus at a distance from the sensor; raises InputError."""
    if not (0 < focal_length_mm < np.inf and 0 < f_number < np.inf and 0 < pixel_pitch_mm < np.inf):
        raise InputError("focal length, f-number and pixel pitch must be positive")
    distance = image_distance(focal_length_mm, focus_mm)
    return PupilCamera(
        width_px=width_px,
        height_px=height_px,
        focal_px=distance / pixel_pitch_mm,
        pupil_radius_mm=focal_length_mm / f_number / 2,
        focus_mm=focus_mm,
        sensor_to_pupil_mm=distance,
        pixel_pitch_mm=pixel_pitch_mm,
    )


def centered_pinhole(focal_px: float, image_size: tuple[int, int]) -> np.ndarray:
    """Build a camera matrix with square pixels and the axis through the middle of the frame; (3, 3) float64, px."""
    width, height = image_size
    return np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1.0]])

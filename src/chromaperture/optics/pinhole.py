"""First-order camera: a pinhole in the entrance pupil, with a pupil radius and a focus distance.

Holds the paper's Eqs. (2) to (6) for any lens. With distances z from the entrance pupil and the image distance F, the
rim of the pupil (radius R) is displaced from the sharp image by r = F R (1/z_f - 1/z), half the circle of confusion c
of Eq. (5): for a thin lens, F = z_if = f z_of / (z_of - f) by Eq. (2), and

    c = 2 r = f D (z_od - z_of) / (z_od (z_of - f)),      d = beta c / (2 mu)                  Eqs. (5), (6)

Eq. (4) of the paper is misprinted: with (3) it leads to (5) with z_od and z_of exchanged and the sign reversed. What
its Figure 1 shows is 1/z_of + 1/(z_id (1 + c/D)) = 1/f, from which (5) follows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.optics.paraxial import paraxial
from chromaperture.optics.prescription import Prescription
from chromaperture.system.errors import InputError


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
        """Compute the displacement of the pupil's edge, r = (F R / mu)(1 / z_f - 1 / z), + beyond the focus: Eq. (5).

        ``depth_mm`` (...) float: distance from the sensor plane; NaN stays NaN, inf is allowed. Returns (...) float64,
        px. Raises InputError: a depth at or behind the entrance pupil.
        """
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


def centered_pinhole(focal_px: float, image_size: tuple[int, int]) -> np.ndarray:
    """Build a camera matrix with square pixels and the axis through the middle of the frame; (3, 3) float64, px."""
    width, height = image_size
    return np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1.0]])

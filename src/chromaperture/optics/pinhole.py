"""What a lens is to first order: a pinhole in the entrance pupil, with a pupil radius and a focus."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from chromaperture.errors import InputError
from chromaperture.optics.paraxial import paraxial
from chromaperture.optics.prescription import Prescription


@dataclass(frozen=True)
class PupilCamera:
    """A pinhole camera with a finite pupil.

    Attributes
    ----------
    width_px, height_px : int
    focal_px : float
        F / mu: fx of a pinhole calibration, px.
    pupil_radius_mm : float
        Radius of the entrance pupil.
    focus_mm : float
        Distance of the focus plane from the sensor plane; inf is allowed.
    sensor_to_pupil_mm : float
        delta, from the sensor plane to the entrance pupil.
    pixel_pitch_mm : float
        mu; only diffraction and the printed figures need it.
    """

    width_px: int
    height_px: int
    focal_px: float
    pupil_radius_mm: float
    focus_mm: float
    sensor_to_pupil_mm: float
    pixel_pitch_mm: float

    def __post_init__(self) -> None:
        if min(self.width_px, self.height_px) < 1 or not (self.focal_px > 0 and self.pixel_pitch_mm > 0):
            raise InputError("a camera needs a positive image size, focal_px and pixel_pitch_mm")
        if not (self.pupil_radius_mm > 0 and self.sensor_to_pupil_mm >= 0):
            raise InputError(
                "a camera needs a positive pupil_radius_mm and a sensor_to_pupil_mm of at least 0"
            )
        # The paraxial focal length is below F: an object inside it would be imaged behind the camera.
        if not self.focus_mm - self.sensor_to_pupil_mm > self.image_distance_mm:
            raise InputError(
                f"focus at {self.focus_mm:g} mm lies inside the focal length: it must exceed "
                f"{self.sensor_to_pupil_mm + self.image_distance_mm:.0f} mm from the sensor"
            )

    @property
    def image_distance_mm(self) -> float:
        """F: distance of the pinhole from an image plane of the sensor's scale."""
        return self.focal_px * self.pixel_pitch_mm

    @property
    def center_px(self) -> tuple[float, float]:
        """The axis meets the middle of the image; (0, 0) is the centre of the top-left pixel."""
        return (self.width_px - 1) / 2, (self.height_px - 1) / 2

    @property
    def f_number(self) -> float:
        """Of the cone that reaches the sensor's pinhole equivalent."""
        return self.image_distance_mm / (2 * self.pupil_radius_mm)

    def blur_radius_px(self, depth_mm: np.ndarray | float) -> np.ndarray:
        """Signed displacement of the pupil's edge, r = (F R / mu)(1 / z_f - 1 / z), + beyond the focus.

        Parameters
        ----------
        depth_mm : (...) float
            Distance from the sensor plane; NaN stays NaN, inf is allowed.

        Returns
        -------
        (...) float64, px

        Raises
        ------
        InputError
            A depth at or behind the entrance pupil.
        """
        z = np.asarray(depth_mm, float) - self.sensor_to_pupil_mm
        if np.any(z <= 0):
            raise InputError(
                f"a depth of {np.nanmin(z) + self.sensor_to_pupil_mm:g} mm lies behind the entrance pupil, "
                "which is "
                f"{self.sensor_to_pupil_mm:g} mm from the sensor; unknown depth is NaN"
            )
        return self.focal_px * self.pupil_radius_mm * (1 / (self.focus_mm - self.sensor_to_pupil_mm) - 1 / z)

    def disparity_px(self, depth_mm: np.ndarray | float, beta: float) -> np.ndarray:
        """Half disparity of channels whose centroids lie at ``beta`` pupil radii, px: d = A - B / z."""
        return beta * self.blur_radius_px(depth_mm)


def pupil_camera(lens: Prescription, *, width_px: int, height_px: int, pixel_pitch_mm: float) -> PupilCamera:
    """Reduce a lens to its first order.

    Parameters
    ----------
    lens : Prescription
    width_px, height_px : int
    pixel_pitch_mm : float

    Returns
    -------
    PupilCamera
    """
    data = paraxial(lens)
    return PupilCamera(
        width_px=width_px,
        height_px=height_px,
        focal_px=data.pinhole_distance_mm / pixel_pitch_mm,
        pupil_radius_mm=data.entrance_diameter_mm / 2,
        focus_mm=data.in_focus_mm + data.sensor_to_entrance_pupil_mm
        if math.isfinite(data.in_focus_mm)
        else math.inf,
        sensor_to_pupil_mm=data.sensor_to_entrance_pupil_mm,
        pixel_pitch_mm=pixel_pitch_mm,
    )


def centered_pinhole(focal_px: float, image_size: tuple[int, int]) -> np.ndarray:
    """Camera matrix with square pixels and the axis through the middle of the frame; (3, 3) float64, px."""
    width, height = image_size
    return np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1.0]])

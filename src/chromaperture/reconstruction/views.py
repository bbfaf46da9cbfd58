"""What one measured frame gives to the reconstruction: pinhole pictures, cleaned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from chromaperture.camera import CodedApertureCamera, DepthFrame
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.errors import InputError
from chromaperture.reconstruction.settings import ReconstructionConfig


@dataclass(frozen=True)
class View:
    """One picture of a pinhole camera without distortion in the centre of the entrance pupil.

    Attributes
    ----------
    color : (H, W, 3) uint8
        sRGB.
    z_mm, sigma_mm : (H, W) float32
        Distance from the pupil along the axis and its standard deviation; NaN unknown.
    time_s : float
    index : int
    """

    color: np.ndarray
    z_mm: np.ndarray
    sigma_mm: np.ndarray
    time_s: float = 0.0
    index: int = 0


def undistorter(camera: CodedApertureCamera) -> Callable[[DepthFrame, float, int], View]:
    """Make the function that turns a measured frame, its time and number into a View; raises InputError."""
    cal = camera.calibration
    if not cal.is_calibrated:
        raise InputError("a 3D model needs a calibrated camera; make one with 'chromaperture calibrate'")
    size = (cal.sensor.width_px, cal.sensor.height_px)
    matrix, to_pupil_mm = cal.lens.camera_matrix, cal.depth[camera.config.quality].sensor_to_pupil_mm
    straight = cv2.initUndistortRectifyMap(matrix, cal.lens.distortion, None, matrix, size, cv2.CV_32FC1)

    def nearest(values: np.ndarray) -> np.ndarray:
        # A mean of two depths is a place where nothing is: the nearest pixel's is taken. Nothing outside is known.
        values = np.ascontiguousarray(values, np.float32)
        return cv2.remap(values, *straight, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))

    def view(frame: DepthFrame, time_s: float, index: int) -> View:
        color = np.rint(linear_to_srgb(frame.color) * 255).astype(np.uint8)
        color = cv2.remap(color, *straight, cv2.INTER_LINEAR)
        return View(color, nearest(frame.depth_mm - np.float32(to_pupil_mm)), nearest(frame.sigma_mm), time_s, index)

    return view


def cleaned(view: View, config: ReconstructionConfig) -> View:
    """Forget what would spoil a model: wide error bars, far points, and pixels at a step of depth."""
    z = view.z_mm
    with np.errstate(invalid="ignore"):
        kept = (z > 0) & (z <= config.max_distance_mm) & (view.sigma_mm <= config.max_relative_sigma * z)
    kept &= ~near_steps(z, jump=config.edge_jump, reach_px=config.edge_px)
    nan = np.float32(np.nan)
    return View(view.color, np.where(kept, z, nan), np.where(kept, view.sigma_mm, nan), view.time_s, view.index)


def near_steps(z_mm: np.ndarray, *, jump: float, reach_px: int) -> np.ndarray:
    """Find flying pixels: those with a relative step of depth within reach.

    Parameters
    ----------
    z_mm : (H, W) float32, NaN unknown
    jump : float
        Step relative to the distance.
    reach_px : int

    Returns
    -------
    (H, W) bool
    """
    known = np.isfinite(z_mm) & (z_mm > 0)
    inverse = np.where(known, 1.0 / np.where(known, z_mm, 1.0), np.nan).astype(np.float32)  # planes stay planes
    window = np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)
    nearest = cv2.dilate(np.where(known, inverse, -1.0), window, borderType=cv2.BORDER_REPLICATE)
    farthest = cv2.erode(np.where(known, inverse, 1e9), window, borderType=cv2.BORDER_REPLICATE)
    return known & (nearest - farthest > jump * np.where(known, inverse, 1.0))

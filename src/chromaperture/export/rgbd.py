"""From a source and a camera to undistorted RGB-D pictures, as other programs want them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from chromaperture.camera import CodedApertureCamera
from chromaperture.capture.source import Frame
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.errors import InputError


@dataclass(frozen=True)
class RgbdFrame:
    """One picture of a pinhole camera without distortion in the centre of the entrance pupil.

    Attributes
    ----------
    color : (H, W, 3) uint8
        sRGB.
    z_mm : (H, W) float32
        Distance from the pupil along the axis; NaN unknown.
    time_s : float
    index : int
    """

    color: np.ndarray
    z_mm: np.ndarray
    time_s: float
    index: int


def rgbd_frames(frames: Iterable[Frame], camera: CodedApertureCamera) -> Iterator[RgbdFrame]:
    """Measure every frame and take the lens's distortion out.

    Parameters
    ----------
    frames : iterable of Frame
    camera : CodedApertureCamera
        Calibrated.

    Yields
    ------
    RgbdFrame

    Raises
    ------
    InputError
        A camera that was never calibrated, frames that cannot be measured.
    """
    cal = camera.calibration
    if not cal.is_calibrated:
        raise InputError("an RGB-D sequence needs a calibrated camera; make one with 'chromaperture calibrate'")
    size = (cal.sensor.width_px, cal.sensor.height_px)
    matrix, to_pupil_mm = cal.lens.camera_matrix, cal.depth[camera.config.quality].sensor_to_pupil_mm
    straight = cv2.initUndistortRectifyMap(matrix, cal.lens.distortion, None, matrix, size, cv2.CV_32FC1)
    for frame in frames:
        made = camera.measure(frame.image)
        color = np.rint(linear_to_srgb(made.color) * 255).astype(np.uint8)
        # A mean of two depths is a place where nothing is: the nearest pixel's is taken. Nothing outside is known.
        z_mm = (made.depth_mm - to_pupil_mm).astype(np.float32)
        nan = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": float("nan")}
        z_mm = cv2.remap(z_mm, *straight, cv2.INTER_NEAREST, **nan)  # type: ignore[call-overload]
        yield RgbdFrame(cv2.remap(color, *straight, cv2.INTER_LINEAR), z_mm, frame.time_s, frame.index)

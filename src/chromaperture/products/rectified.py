"""Convert a measured frame to undistorted pinhole pictures of colour and depth, for 3D models and other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Literal

import cv2
import numpy as np

from chromaperture.camera.camera import CodedApertureCamera, DepthFrame
from chromaperture.capture.picture_header import other_size
from chromaperture.capture.source import Frame
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.system.errors import InputError

CAMERA_FRAME = "camera_optical_frame"  # x right, y down, z forward
DepthEncoding = Literal["16UC1", "32FC1"]  # of REP 118: mm, 0 unknown, or m, NaN unknown


@dataclass(frozen=True)
class View:
    """Picture of a pinhole camera without distortion, centred in the entrance pupil."""

    color: np.ndarray  # (H, W, 3) uint8: sRGB
    # ``z_mm``, ``sigma_mm``: (H, W) float32: distance from the pupil along the axis and its standard deviation; NaN
    # unknown.
    z_mm: np.ndarray
    sigma_mm: np.ndarray
    time_s: float = 0.0
    index: int = 0
    confidence: np.ndarray | None = None  # (H, W) float32 in [0, 1], NaN outside the frame; None where it is not known

    @property
    def time_ns(self) -> int:
        """The stamp of its messages, see `stamp_ns`."""
        return stamp_ns(self.time_s)

    def ros_pictures(self, encoding: DepthEncoding, z_mm: np.ndarray) -> dict[str, tuple[str, np.ndarray]]:
        """Return encoding and pixels of colour, depth (``z_mm``), sigma and confidence (m), as REP 118 has them."""
        pictures = {
            "color": ("rgb8", self.color),
            "depth": (encoding, encoded_depth(z_mm, encoding)),
            "sigma": ("32FC1", (self.sigma_mm / 1000).astype("<f4")),
        }
        if self.confidence is not None:
            pictures["confidence"] = ("32FC1", self.confidence.astype("<f4"))
        return pictures


_FIRST_NS = 1000  # PCL keeps whole microseconds


def stamp_ns(time_s: float) -> int:
    """Return seconds as whole nanoseconds, as exactly as they are known, and the 0 of a first frame as 1000.

    A stamp of 0 is no time in ROS: tf takes it for the latest, filters for none. Nothing else moves, so that stamps
    of a simulated clock still fit those of other topics.
    """
    whole, part = divmod(time_s, 1.0)  # time_s * 1e9 is rounded to 256 ns
    return max(int(whole) * 10**9 + round(part * 1e9), _FIRST_NS)


def encoded_depth(z_mm: np.ndarray, encoding: DepthEncoding) -> np.ndarray:
    """Encode depth (H, W) in mm, NaN unknown, as REP 118: 16UC1 in whole mm, 0 unknown; 32FC1 in m, NaN unknown."""
    if encoding == "32FC1":
        return (z_mm / 1000).astype("<f4")
    known = np.isfinite(z_mm) & (z_mm > 0) & (z_mm < 65535)
    return np.where(known, np.rint(np.where(known, z_mm, 0)), 0).astype("<u2")


def of_stream(camera: CodedApertureCamera, frames: Iterable[Frame]) -> tuple[CodedApertureCamera, Iterator[Frame]]:
    """Return the camera at the size of a stream's frames, where they show the whole frame, and the stream."""
    rest = iter(frames)
    first = next(rest, None)
    if first is None:
        return camera, rest
    height, width = first.counts.shape[:2]
    camera = camera.at_size(width, height) if camera.shows_frame_at((width, height)) else camera
    return camera, chain([first], rest)


def undistorter(camera: CodedApertureCamera) -> Callable[[DepthFrame, float, int], View]:
    """Return a function that converts a measured frame, its time and number to a View; raises InputError."""
    cal = camera.calibration
    if not cal.is_calibrated:
        raise InputError("undistorted depth needs a calibrated camera; make one with 'chromaperture calibrate'")
    size = (cal.sensor.width_px, cal.sensor.height_px)
    matrix, to_pupil_mm = cal.lens.camera_matrix, cal.depth[camera.config.quality].sensor_to_pupil_mm
    straight = cv2.initUndistortRectifyMap(matrix, cal.lens.distortion, None, matrix, size, cv2.CV_32FC1)

    def nearest(values: np.ndarray) -> np.ndarray:
        # The mean of two depths belongs to no surface: take the nearest pixel's. Outside the frame depth is unknown.
        values = np.ascontiguousarray(values, np.float32)
        return cv2.remap(values, *straight, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))

    def view(frame: DepthFrame, time_s: float, index: int) -> View:
        if frame.depth_mm.shape != size[::-1]:
            height, width = frame.depth_mm.shape
            raise InputError(other_size(width, height, size))
        color = linear_to_srgb_bytes(frame.color)
        color = cv2.remap(color, *straight, cv2.INTER_LINEAR)
        z_mm, sigma_mm = nearest(frame.depth_mm - np.float32(to_pupil_mm)), nearest(frame.sigma_mm)
        return View(color, z_mm, sigma_mm, time_s, index, nearest(frame.confidence))

    return view

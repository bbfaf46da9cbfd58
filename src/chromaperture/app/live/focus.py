"""Refocus the live picture: fast, without restoration, at half size."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from chromaperture.camera.camera import CodedApertureCamera, DepthFrame
from chromaperture.effects.edge_aware import filter_disparity
from chromaperture.effects.refocus_device import compositor_of
from chromaperture.effects.refocusing import Focus, refocus
from chromaperture.effects.restore import focus_radius
from chromaperture.effects.transfer_functions import radius_per_disparity
from chromaperture.system.errors import InputError

_SCALE = 2  # reduction of the picture's sides; a quarter of the pixels


def refocuser(camera: CodedApertureCamera) -> Callable[[DepthFrame, float, float], np.ndarray]:
    """Return a function that focuses the frames of one calibrated camera elsewhere, as another lens would.

    It takes the frame, the new focus (mm from the sensor plane), and the diameter of the new pupil in units of the
    camera's own; returns (H / 2, W / 2, 3) float32, linear RGB, the colours unchanged where refocusing is impossible.
    """
    compositor = compositor_of(camera)
    per_disparity = np.float32(radius_per_disparity(camera.calibration, camera.config.quality))

    def refocused(frame: DepthFrame, focus_mm: float, strength: float) -> np.ndarray:
        part = slice(None, None, _SCALE)
        color = np.ascontiguousarray(frame.color[part, part], np.float32)
        disparity, sigma = frame.disparity_px[part, part] / _SCALE, frame.disparity_sigma_px[part, part] / _SCALE
        try:
            radius = filter_disparity(disparity, sigma, color)[0] * per_disparity
            lens = Focus(focus_radius(camera, focus_mm) / _SCALE, strength)
            return refocus(color, radius, lens, compositor=compositor)
        except InputError:  # no depth is known, or the blur fills the picture
            return color

    return refocused

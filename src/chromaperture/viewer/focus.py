"""Refocus the live picture: fast, without restoration, at half size."""

from __future__ import annotations

import numpy as np

from chromaperture.camera import CodedApertureCamera, DepthFrame
from chromaperture.effects.edge_aware import filter_disparity
from chromaperture.effects.refocusing import Focus, refocus
from chromaperture.effects.restore import focus_radius
from chromaperture.effects.transfer_functions import radius_per_disparity
from chromaperture.errors import InputError

_SCALE = 2  # reduction of the picture's sides; a quarter of the pixels


class Refocuser:
    """Refocus the frames of one calibrated camera."""

    def __init__(self, camera: CodedApertureCamera) -> None:
        self.camera = camera
        self._per_disparity = np.float32(radius_per_disparity(camera.calibration, camera.config.quality))

    def __call__(self, frame: DepthFrame, *, focus_mm: float, strength: float) -> np.ndarray:
        """Blur the aligned colours as a lens with another focus would.

        Parameters
        ----------
        frame : DepthFrame
        focus_mm : float
            From the sensor plane.
        strength : float
            Diameter of the new pupil in units of the camera's own.

        Returns
        -------
        (H / 2, W / 2, 3) float32, linear RGB
            The colours unchanged where refocusing is impossible.
        """
        part = slice(None, None, _SCALE)
        color = np.ascontiguousarray(frame.color[part, part], np.float32)
        disparity, sigma = frame.disparity_px[part, part] / _SCALE, frame.disparity_sigma_px[part, part] / _SCALE
        try:
            radius = filter_disparity(disparity, sigma, color)[0] * self._per_disparity
            return refocus(color, radius, Focus(focus_radius(self.camera, focus_mm) / _SCALE, strength))
        except InputError:  # no depth is known, or the blur fills the picture
            return color

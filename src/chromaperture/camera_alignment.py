"""The colour picture of a camera: its channels aligned to the view of the pupil's centre (paper section 5.1)."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from chromaperture.camera_file import Calibration
from chromaperture.color.alignment import align_channels, channel_directions, fill_unknown, white_balance
from chromaperture.color.lens_shift import LensShift
from chromaperture.config import Config, Quality
from chromaperture.depth.conversion import DepthModel, disparity_to_inverse_depth


class ChannelAlignment:
    """How far a camera's channels are displaced at a disparity that it measured.

    Parameters
    ----------
    calibration : Calibration
    config : Config
    depth_model : DepthModel or None
        Curve of the disparities that are measured; None for a camera that was never calibrated.
    """

    def __init__(self, calibration: Calibration, config: Config, depth_model: DepthModel | None) -> None:
        self.calibration, self.depth_model = calibration, depth_model
        self.uses_blur = config.matcher.uses_blur
        self.shifts = channel_shifts(calibration, config.quality)

    def align(self, image: np.ndarray, disparity_px: np.ndarray) -> np.ndarray:
        """Align the channels and white balance them.

        Parameters
        ----------
        image : (H, W, 3) float32, linear RGB
        disparity_px : (H, W) float32, px; NaN unknown

        Returns
        -------
        (H, W, 3) float32, linear RGB
        """
        filled = fill_unknown(disparity_px)
        aligned = align_channels(image, filled, self.shifts, displacement_px=self.displacement(filled))
        return white_balance(aligned, self.calibration.film.aperture)

    @cached_property
    def lens_shift(self) -> LensShift | None:
        """Displacement of the channels by the lens; None where its blur was not fitted."""
        blur = self.calibration.field_blur()
        if blur is None or not self.calibration.is_calibrated:
            return None
        pupil_mm = float(self.calibration.on_axis("accurate").sensor_to_pupil_mm)
        return LensShift(blur, near_mm=self.calibration.near_mm - pupil_mm, far_mm=self.calibration.far_mm - pupil_mm)

    def blur_radius_px(self, disparity_px: np.ndarray) -> np.ndarray | None:
        """Return the blur radius on the axis at the distance of every pixel, see `LensShift`.

        Parameters
        ----------
        disparity_px : (H, W) float, px
            As this camera measures it.

        Returns
        -------
        (H, W) float32, px; None where the blur is not known
        """
        if self.lens_shift is None or self.depth_model is None:
            return None
        layer = np.asarray(disparity_px, float)
        if not self.uses_blur:  # from this method's disparity to the layer of the blur at that distance
            curve = self.calibration.depth_model("accurate")
            inverse_mm = disparity_to_inverse_depth(layer, self.depth_model)
            layer = curve.infinity_disparity_px - curve.scale_px_mm * inverse_mm
            layer = layer if curve.nonlinearity is None else curve.nonlinearity.measured(layer)
        return self.lens_shift.layer_radius_px(layer).astype(np.float32)

    def displacement(self, disparity_px: np.ndarray) -> np.ndarray | None:
        """Return the displacement of the channels where the method uses the lens's blur, (3, 2, H, W) px; else None."""
        radius = self.blur_radius_px(disparity_px) if self.uses_blur else None
        return None if radius is None or self.lens_shift is None else self.lens_shift(radius)


def channel_shifts(calibration: Calibration, quality: Quality) -> np.ndarray:
    """Displacement of the sensor's R, G, B per px of the disparity that a quality measures; (3, 2) float64."""
    aperture = calibration.aperture
    if len(aperture.views) > 2:  # every channel moves with its centroid
        return channel_directions(aperture, calibration.film.transmissions())
    # Two channels are what "real-time" matches; the distance of unmixed views follows from its and their own curve.
    shifts = channel_directions(aperture, {})
    shifts /= np.linalg.norm(shifts, axis=1).max()
    if not calibration.is_calibrated:
        return shifts
    channels, matched = (calibration.on_axis(q).scale_px_mm for q in ("real-time", quality))
    return shifts * (float(channels) / float(matched))

"""The colour picture of a camera: its channels aligned to the view of the pupil's centre (paper section 5.1)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np

from chromaperture.color.alignment import (
    align_channels,
    channel_directions,
    fill_unknown,
    rows_filler,
    white_balance,
    white_gains,
)
from chromaperture.color.lens_shift import LensMoves, LensShift
from chromaperture.color.row_alignment import aligned_bands, row_moves
from chromaperture.depth.conversion import DepthModel, disparity_to_inverse_depth
from chromaperture.matching.result import Alignment
from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import at_scale
from chromaperture.settings.methods import Config, Quality
from chromaperture.system.threads import each_band

# Of a band: displacements, depth buffers and samples, 60 bytes a pixel and thread, stay near the cache. Chosen by hand.
_BAND_PX = 1_000_000
_MOST_HALO = 0.25  # of a band's rows, that neighbours compute too; chosen by hand
# Rows that a band sees beyond its own: what the largest displacement by the lens may be, of that of the centroids in
# the frame's middle; the neighbourhood of an occluded pixel (7 px) with the samples of Lanczos' filter (4 px); and
# lateral colour, px of the working scale.
_MOST_BEYOND, _AROUND_PX, _LATERAL_PX = 2.0, 12, 4


class ChannelAlignment:
    """How far a camera's channels are displaced at a disparity that it measured."""

    def __init__(self, calibration: Calibration, config: Config) -> None:
        self.calibration, self.config = calibration, config
        self.uses_blur = config.matcher.uses_blur
        self.shifts = channel_shifts(calibration, config.quality)

    @cached_property
    def depth_model(self) -> DepthModel | None:
        """Curve of the disparities that are measured; None for a camera that was never calibrated."""
        return self.calibration.depth_model(self.config.quality) if self.calibration.is_calibrated else None

    @cached_property
    def numbers(self) -> Alignment:
        """What `align` needs, for a method that aligns as it measures."""
        white = np.asarray(self.calibration.film.aperture, float)
        return Alignment(np.asarray(self.shifts, float), white.max() / white, round(self.config.scale), self.lens_moves)

    def align(self, image: np.ndarray, disparity_px: np.ndarray) -> np.ndarray:
        """Align the channels of linear RGB (H, W, 3) by a disparity, NaN unknown, and white balance them."""
        color = np.empty(image.shape, np.float32)
        self.align_bands(image, disparity_px, color.__setitem__)
        return color

    def align_bands(
        self,
        image: np.ndarray,
        disparity_px: np.ndarray,
        take: Callable[[slice, np.ndarray], None],
        *,
        multiple: int = 1,
    ) -> None:
        """As `align`, in bands from multiples of ``multiple`` rows, which ``take`` gets on any thread in any order."""
        along = None if self.uses_blur else row_moves(self.shifts)
        if along is not None and image.shape[:2] == disparity_px.shape:
            gains = white_gains(self.calibration.film.aperture)
            filler = rows_filler(disparity_px, step=round(self.config.scale))
            return aligned_bands(image, filler, along, take, gains, multiple=multiple)
        filled = fill_unknown(disparity_px, step=round(self.config.scale))
        height, width = filled.shape
        halo = self._rows_beyond(filled)
        rows = max(1, _BAND_PX // width, math.ceil(halo / _MOST_HALO))
        rows = -(-rows // multiple) * multiple
        if rows >= height:
            return take(slice(0, height), self._aligned(image, filled, 0, height))

        def align(band: slice) -> None:
            seen = slice(max(0, band.start - halo), min(height, band.stop + halo))
            aligned = self._aligned(image[seen], filled[seen], seen.start, height)
            take(band, aligned[band.start - seen.start :][: band.stop - band.start])

        return each_band(align, height, rows_a_band=rows)

    def _rows_beyond(self, filled: np.ndarray) -> int:
        """Return how many rows a band sees beyond its own."""
        largest = max(float(filled.max()), -float(filled.min()))
        if self.uses_blur:
            moved = _MOST_BEYOND * largest * max(1.0, float(np.abs(self.shifts).max()))
            return math.ceil(moved + _LATERAL_PX * self.config.scale) + _AROUND_PX
        return math.ceil(largest * float(np.abs(self.shifts[:, 1]).max())) + _AROUND_PX

    def _aligned(self, image: np.ndarray, filled: np.ndarray, first_row: int, height: int) -> np.ndarray:
        """Align a band of a frame of so many rows."""
        moved = self.displacement(filled, first_row=first_row, height=height)
        # What cubics smooth is finer than the light of a picture that is matched at fewer pixels.
        exact = self.config.scale == 1
        aligned = align_channels(image, filled, self.shifts, displacement_px=moved, exact=exact)
        return white_balance(aligned, self.calibration.film.aperture)

    @cached_property
    def lens_shift(self) -> LensShift | None:
        """Displacement of the channels by the lens; None where its blur was not fitted."""
        return _lens_shift(self.calibration)

    def blur_radius_px(self, disparity_px: np.ndarray) -> np.ndarray | None:
        """Return the blur radius on the axis at the distance of every pixel, float32; None where not known."""
        if self.lens_shift is None or self.depth_model is None:
            return None
        layer = np.asarray(disparity_px, float)
        if not self.uses_blur:  # from this method's disparity to the layer of the blur at that distance
            curve = self.calibration.depth_model("accurate")
            inverse_mm = disparity_to_inverse_depth(layer, self.depth_model)
            layer = curve.infinity_disparity_px - curve.scale_px_mm * inverse_mm
            layer = layer if curve.nonlinearity is None else curve.nonlinearity.measured(layer)
        return self.lens_shift.layer_radius_px(layer).astype(np.float32)

    def displacement(
        self, disparity_px: np.ndarray, *, first_row: int = 0, height: int | None = None
    ) -> np.ndarray | None:
        """Return the channels' displacement (3, 2, H, W), px, of a frame or a band of it, else None."""
        shift = self._working_shift if self.uses_blur else None
        if shift is None:
            return None
        factor = np.float32(self.calibration.sensor.width_px / shift.blur.width_px)
        radius = shift.layer_radius_px(np.asarray(disparity_px, float) / factor).astype(np.float32)
        found = shift(radius, first_row=first_row, height=height)
        return found if factor == 1 else np.multiply(found, factor, out=found)

    @cached_property
    def lens_moves(self) -> LensMoves | None:
        """What `displacement` is computed from; None where it is None."""
        shift = self._working_shift if self.uses_blur else None
        factor = 1.0 if shift is None else self.calibration.sensor.width_px / shift.blur.width_px
        return None if shift is None else shift.moves(factor, exact=self.config.scale == 1)

    @cached_property
    def _working_shift(self) -> LensShift | None:
        """`lens_shift` at the working scale, in whose px the frequencies are that it takes into account."""
        return self.lens_shift if self.config.scale == 1 else _lens_shift(at_scale(self.calibration, self.config.scale))


def _lens_shift(calibration: Calibration) -> LensShift | None:
    """Return the displacement of the channels by a camera's lens; None where its blur was not fitted."""
    blur = calibration.field_blur()
    if blur is None or not calibration.is_calibrated:
        return None
    pupil_mm = float(calibration.on_axis("accurate").sensor_to_pupil_mm)
    return LensShift(blur, near_mm=calibration.near_mm - pupil_mm, far_mm=calibration.far_mm - pupil_mm)


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

"""The whole method on one screen: one photograph in, millimetres out."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import default_config, label_maps, noise_model
from chromaperture.capture.checks import check_capture
from chromaperture.color.alignment import align_channels, channel_directions, fill_unknown, white_balance
from chromaperture.color.lens_shift import LensShift
from chromaperture.color.unmixing import pure_channels
from chromaperture.config import Config, DepthConfig, ExecutionName, Quality
from chromaperture.depth.conversion import DepthModel, disparity_to_depth, disparity_to_inverse_depth
from chromaperture.disparity.estimate import method_for
from chromaperture.disparity.result import Disparity

StageTimer = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True)
class DepthFrame:
    """What is measured from one photograph, every map in the view of the pupil's centre; (H, W) arrays.

    Attributes
    ----------
    depth_mm, sigma_mm : float32, mm
        Distance from the sensor plane along the axis and its standard deviation; NaN unknown.
    disparity_px, disparity_sigma_px : float32, px
        Signed half disparity, 0 in focus, + beyond, and its standard deviation; NaN unknown.
    confidence : float32 in [0, 1]
    color : (H, W, 3) float32
        Linear RGB with the channels aligned and white balanced.
    """

    depth_mm: np.ndarray
    sigma_mm: np.ndarray
    disparity_px: np.ndarray
    disparity_sigma_px: np.ndarray
    confidence: np.ndarray
    color: np.ndarray

    @property
    def valid(self) -> np.ndarray:
        """(H, W) bool: where the depth is known."""
        return np.isfinite(self.depth_mm)


class CodedApertureCamera:
    """A camera with a colour-coded aperture, at the focus setting it was calibrated for.

    Parameters
    ----------
    calibration : Calibration
    config : Config, optional
        Searches the calibration's working range at real-time quality when absent.
    execution : {"numba", "numpy"}
        Of the matcher: compiled, or readable and slow.
    """

    def __init__(
        self, calibration: Calibration, config: Config | None = None, *, execution: ExecutionName = "numba"
    ) -> None:
        self.calibration = calibration
        self.config = config or default_config(calibration)
        self.execution: ExecutionName = execution
        self.method = method_for(
            self.config.matcher,
            aperture=calibration.aperture,
            unmixing=calibration.unmixing,
            label_maps=label_maps(calibration, self.config.matcher),
            blur=calibration.field_blur(),
            execution=execution,
        )
        self.noise = noise_model(calibration)
        self.depth_model = calibration.depth_model(self.config.quality) if calibration.is_calibrated else None
        self.shifts = channel_shifts(calibration, self.config.quality)

    def measure(self, image: np.ndarray, *, stage: StageTimer = lambda name: nullcontext()) -> DepthFrame:
        """Measure depth in millimetres for every pixel of one photograph.

        Parameters
        ----------
        image : (H, W, 3) float, linear RGB, 1.0 = white level
            From `chromaperture.read_image`.
        stage : callable, optional
            ``with stage(name):`` is entered around each stage, for timing and progress.

        Returns
        -------
        DepthFrame

        Raises
        ------
        InputError
            The image cannot be used, or is not of this camera's size.
        """
        sensor = self.calibration.sensor
        with stage("check"):
            image = check_capture(image, sensor.width_px, sensor.height_px)
        with stage("disparity"):  # Eq. (1) and section 3.1
            disparity = self.method.match(image, self.noise)
        with stage("depth"):  # Eq. (10)
            depth_mm, sigma_mm = millimetres(disparity, self.depth_model, self.config.depth)
        with stage("color"):  # section 5.1
            filled = fill_unknown(disparity.value_px)
            aligned = align_channels(image, filled, self.shifts, displacement_px=self.displacement(filled))
            color = white_balance(aligned, self.calibration.film.aperture)
        return DepthFrame(depth_mm, sigma_mm, disparity.value_px, disparity.sigma_px, disparity.confidence, color)

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
        if not self.config.matcher.uses_blur:  # from this method's disparity to the layer of the blur at that distance
            curve = self.calibration.depth_model("accurate")
            inverse_mm = disparity_to_inverse_depth(layer, self.depth_model)
            layer = curve.infinity_disparity_px - curve.scale_px_mm * inverse_mm
            layer = layer if curve.nonlinearity is None else curve.nonlinearity.measured(layer)
        return self.lens_shift.layer_radius_px(layer).astype(np.float32)

    def displacement(self, disparity_px: np.ndarray) -> np.ndarray | None:
        """Return the displacement of the channels where the method uses the lens's blur, (3, 2, H, W) px; else None."""
        radius = self.blur_radius_px(disparity_px) if self.config.matcher.uses_blur else None
        return None if radius is None or self.lens_shift is None else self.lens_shift(radius)


def millimetres(disparity: Disparity, model: DepthModel | None, config: DepthConfig) -> tuple[np.ndarray, np.ndarray]:
    """Depth and its standard deviation in mm; all NaN for a camera that was never calibrated; two (H, W) float32."""
    if model is None:
        unknown = np.full(disparity.value_px.shape, np.nan, np.float32)
        return unknown, unknown.copy()
    return disparity_to_depth(disparity.value_px, model, sigma_px=disparity.sigma_px, max_depth_mm=config.max_depth_mm)


def channel_shifts(calibration: Calibration, quality: Quality) -> np.ndarray:
    """Displacement of the sensor's R, G, B per px of the disparity that a quality measures; (3, 2) float64."""
    aperture = calibration.aperture
    if pure_channels(aperture) is None:  # every channel mixes the filters and moves with its centroid
        return channel_directions(aperture, calibration.film.transmissions())
    shifts = channel_directions(aperture, {})
    if not calibration.is_calibrated:
        return shifts
    # Leaking film brings the pure channels closer together: by their own curve, where a quality matches other views.
    pure, matched = (calibration.on_axis(q).scale_px_mm for q in ("real-time", quality))
    return shifts * (float(pure) / float(matched))


def load_camera(
    path: str | Path, *, quality: Quality = "real-time", execution: ExecutionName = "numba"
) -> CodedApertureCamera:
    """Open a camera file; raises InputError when it is missing, damaged or of a newer format."""
    calibration = Calibration.load(path)
    return CodedApertureCamera(calibration, default_config(calibration, quality), execution=execution)

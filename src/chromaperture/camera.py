"""The whole method on one screen: one photograph in, millimetres out."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from chromaperture.camera_file import Calibration
from chromaperture.capture.checks import check_capture
from chromaperture.color.alignment import align_channels, channel_directions, fill_unknown, white_balance
from chromaperture.color.lens_shift import LensShift
from chromaperture.color.noise import photon_noise_variance
from chromaperture.color.unmixing import pure_channels
from chromaperture.config import Config, DepthConfig, MatcherConfig, Quality
from chromaperture.depth.conversion import DepthModel, disparity_to_depth, disparity_to_inverse_depth
from chromaperture.disparity.estimate import Disparity, colour_spaces, estimate_disparity
from chromaperture.disparity.semiglobal import LayerField, layer_field

StageTimer = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True)
class DepthFrame:
    """What one photograph tells, every map in the view of the pupil's centre; (H, W) arrays.

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
    """

    def __init__(self, calibration: Calibration, config: Config | None = None) -> None:
        self.calibration = calibration
        self.config = config or default_config(calibration)
        self.depth_model = calibration.depth_model(self.config.quality) if calibration.is_calibrated else None
        self.fields = layer_fields(calibration, self.config.matcher)
        self.blur = calibration.field_blur() if self.config.matcher.phase is not None else None
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
        cal = self.calibration
        with stage("check"):
            image = check_capture(image, cal.sensor.width_px, cal.sensor.height_px)
            noise = None if self.config.matcher.coarse is not None else sensor_noise(image, cal)  # not used there
        with stage("disparity"):  # Eq. (1) and section 3.1
            disparity = estimate_disparity(
                image,
                aperture=cal.aperture,
                unmixing=cal.unmixing,
                noise_variance=noise,
                fields=self.fields,
                blur=self.blur,
                config=self.config.matcher,
            )
        with stage("depth"):  # Eq. (10)
            depth_mm, sigma_mm = millimetres(disparity, self.depth_model, self.config.depth)
        with stage("color"):  # section 5.1
            filled = fill_unknown(disparity.value_px)
            aligned = align_channels(image, filled, self.shifts, displacement_px=self.displacement(filled))
            color = white_balance(aligned, cal.film.aperture)
        return DepthFrame(
            depth_mm, sigma_mm, disparity.value_px, disparity.sigma_px, disparity.confidence, color
        )

    @cached_property
    def lens_shift(self) -> LensShift | None:
        """How the lens displaces the channels; None where its blur was not fitted."""
        blur = self.calibration.field_blur()
        if blur is None or not self.calibration.is_calibrated:
            return None
        pupil_mm = float(self.calibration.on_axis("accurate").sensor_to_pupil_mm)
        return LensShift(blur, near_mm=self.calibration.near_mm - pupil_mm, far_mm=self.calibration.far_mm - pupil_mm)

    def blur_radius_px(self, disparity_px: np.ndarray) -> np.ndarray | None:
        """Blur radius on the axis at the distance of every pixel, see `LensShift`; None where the blur is not known.

        Parameters
        ----------
        disparity_px : (H, W) float, px
            As this camera measures it.
        """
        if self.lens_shift is None or self.depth_model is None:
            return None
        layer = np.asarray(disparity_px, float)
        if self.blur is None:  # other matchers read the distance; the layer that shows it is the blur's own curve
            curve = self.calibration.depth_model("accurate")
            inverse_mm = disparity_to_inverse_depth(layer, self.depth_model)
            layer = curve.infinity_disparity_px - curve.scale_px_mm * inverse_mm
            layer = layer if curve.nonlinearity is None else curve.nonlinearity.measured(layer)
        return self.lens_shift.layer_radius_px(layer).astype(np.float32)

    def displacement(self, disparity_px: np.ndarray) -> np.ndarray | None:
        """Displacement of the channels where the matcher knows the lens's blur, (3, 2, H, W) px; else None."""
        radius = self.blur_radius_px(disparity_px) if self.blur is not None else None
        return None if radius is None or self.lens_shift is None else self.lens_shift(radius)


def millimetres(
    disparity: Disparity, model: DepthModel | None, config: DepthConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and its standard deviation in mm; all NaN for a camera that was never calibrated; two (H, W) float32."""
    if model is None:
        unknown = np.full(disparity.value_px.shape, np.nan, np.float32)
        return unknown, unknown.copy()
    return disparity_to_depth(
        disparity.value_px,
        model,
        sigma_px=disparity.sigma_px,
        max_depth_mm=config.max_depth_mm,
    )


def channel_shifts(calibration: Calibration, quality: Quality) -> np.ndarray:
    """Displacement of the sensor's R, G, B per px of the disparity that a quality measures; (3, 2) float64."""
    aperture = calibration.aperture
    if pure_channels(aperture) is None:  # every channel mixes the filters and goes with its centroid
        return channel_directions(aperture, calibration.film.transmissions())
    shifts = channel_directions(aperture, {})
    if not calibration.is_calibrated:
        return shifts
    # Leaks draw the pure channels together: their own curve tells how far apart they are where another one was matched.
    pure, matched = (calibration.on_axis(q).scale_px_mm for q in ("real-time", quality))
    return shifts * (float(pure) / float(matched))


def layer_fields(calibration: Calibration, config: MatcherConfig) -> list[LayerField] | None:
    """Tell a global method what equal depth means at every pixel, in each colour space it matches."""
    if (config.optimiser is None and config.coarse is None) or not calibration.is_calibrated:
        return None
    spaces = colour_spaces(calibration.aperture, calibration.unmixing, config)
    qualities: tuple[Quality, ...] = ("accurate", "real-time")  # of the unmixed and of the pure views
    if config.coarse is not None:
        qualities = ("real-time",)
    used = qualities[:1] if config.phase is not None else qualities[: len(spaces)]
    models = [calibration.depth_model(quality) for quality in used]
    axis = calibration.on_axis(qualities[0])
    reference = (float(axis.infinity_disparity_px), float(axis.scale_px_mm))
    shape = (calibration.sensor.height_px, calibration.sensor.width_px)
    return [
        layer_field(
            np.broadcast_to(model.infinity_disparity_px, shape),
            np.broadcast_to(model.scale_px_mm, shape),
            reference=reference,
        )
        for model in models
    ]


def sensor_noise(image: np.ndarray, calibration: Calibration) -> np.ndarray | None:
    """Noise variance of every channel from the sensor's electrons, (H, W, 3); None where they are not known."""
    sensor = calibration.sensor
    if sensor.full_well_electrons is None or sensor.read_noise_electrons is None:
        return None
    return photon_noise_variance(
        image,
        full_well_electrons=sensor.full_well_electrons,
        read_noise_electrons=sensor.read_noise_electrons,
    )


def default_config(calibration: Calibration, quality: Quality = "real-time") -> Config:
    """Give the settings for a camera: the quality's preset over the camera's own working range."""
    blur = calibration.field_blur() if quality == "accurate" else None
    matcher = MatcherConfig.preset(quality) if blur is None else MatcherConfig.psf_aware(blur.reach)
    if calibration.is_calibrated:
        matcher = matcher.with_range(*calibration.disparity_range_px(quality))
    return Config(quality=quality, matcher=matcher)


def load_camera(path: str | Path, *, quality: Quality = "real-time") -> CodedApertureCamera:
    """Open a camera file; raises InputError when it is missing, damaged or of a newer format."""
    calibration = Calibration.load(path)
    return CodedApertureCamera(calibration, default_config(calibration, quality))

"""From a camera file to its matcher: settings, labels of equal depth, noise, and the method that uses them."""

from __future__ import annotations

import warnings
from functools import partial
from typing import Literal

import numpy as np

from chromaperture.color.image import without_defects
from chromaperture.color.noise import noise_ratio, photon_noise_variance
from chromaperture.color.shared_noise import shared_noise_ratio
from chromaperture.matching.estimate import method_for
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import LabelMap, label_map
from chromaperture.matching.result import ESTIMATED_NOISE, Method, NoiseModel
from chromaperture.matching.working_scale import ScaledMethod
from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import accurate_scale, at_scale, working_scale
from chromaperture.settings.methods import AccurateConfig, Config, ExecutionName, MatcherConfig, Quality, preset
from chromaperture.system.errors import CaptureWarning


def photograph_quality(calibration: Calibration) -> Quality:
    """Return the quality of single photographs: the best that the camera was calibrated for."""
    return "accurate" if "accurate" in calibration.depth else "real-time"


def default_config(
    calibration: Calibration, quality: Quality = "real-time", *, scale: float | Literal["auto"] = "auto"
) -> Config:
    """Return a quality's settings over the camera's range; ``auto`` scale is what its blur allows."""
    if scale == "auto":
        scale = accurate_scale(calibration) if quality == "accurate" else working_scale(calibration)
    calibration = at_scale(calibration, scale)
    matcher = preset(quality)
    blur = calibration.field_blur()
    if isinstance(matcher, AccurateConfig) and blur is not None:
        full_well, one_pair = calibration.sensor.full_well_electrons, len(blur.pairs) == 1
        matcher = AccurateConfig.for_blur(blur.reach, one_pair=one_pair, full_well_electrons=full_well)
    elif isinstance(matcher, AccurateConfig) and calibration.is_calibrated:
        matcher = AccurateConfig.for_range(*calibration.disparity_range_px(quality))
    if calibration.is_calibrated:
        matcher = matcher.with_range(*calibration.disparity_range_px(quality))
    if isinstance(matcher, AccurateConfig) and matcher.uses_blur and calibration.sensor.dual_pixel is not None:
        matcher = matcher.with_half_pixels()
    return Config(quality=quality, matcher=matcher, scale=scale)


def label_maps(calibration: Calibration, config: MatcherConfig) -> list[LabelMap]:
    """Return what equal depth means at every pixel, for each view space that a method matches; none uncalibrated."""
    if not (config.label_curves and calibration.is_calibrated):
        return []
    axis = calibration.on_axis(config.label_curves[0])
    reference = (float(axis.infinity_disparity_px), float(axis.scale_px_mm))
    shape = (calibration.sensor.height_px, calibration.sensor.width_px)
    models = [calibration.depth_model(quality) for quality in config.label_curves]
    return [
        label_map(
            np.broadcast_to(model.infinity_disparity_px, shape),
            np.broadcast_to(model.scale_px_mm, shape),
            reference=reference,
        )
        for model in models
    ]


def noise_model(calibration: Calibration) -> NoiseModel:
    """Return the noise of the sensor from its electrons; estimated in every image where they are not known."""
    sensor = calibration.sensor
    if sensor.full_well_electrons is None or sensor.read_noise_electrons is None:
        return ESTIMATED_NOISE
    variance = partial(
        photon_noise_variance,
        full_well_electrons=sensor.full_well_electrons,
        read_noise_electrons=sensor.read_noise_electrons,
    )
    return NoiseModel(variance, is_known=True)


def noise_of_photographs(calibration: Calibration, *, halves: bool = False) -> NoiseModel:
    """Return `noise_model` times each photograph's `noise_ratio`: it may be at another ISO than the calibration.

    ``halves``: the likelihood is that of half pixels, see `shared_noise_ratio`.
    """
    noise = noise_model(calibration)
    if not noise.is_known:
        return noise

    def variance(image: np.ndarray) -> np.ndarray:
        expected = noise.variance(image)
        if halves:
            expected = expected * np.float32(shared_noise_ratio(image, expected))
        return np.asarray(expected * np.float32(noise_ratio(image, expected)))

    return NoiseModel(variance, is_known=True)


def repaired(image: np.ndarray, calibration: Calibration) -> np.ndarray:
    """Return an image without its defective pixels, by the noise of the camera and of the photograph."""
    by_camera = without_defects(image, noise_model(calibration).variance)
    if by_camera is image:  # a photograph has the noise of its camera or more: then nothing stands out of that either
        return image
    return without_defects(image, noise_of_photographs(calibration).variance)


def sensor_noise(image: np.ndarray, calibration: Calibration) -> np.ndarray | None:
    """Return the noise variance of every channel of an image, (H, W, 3); None where it is not known."""
    noise = noise_model(calibration)
    return noise.variance(image) if noise.is_known else None


def scaled_method(
    calibration: Calibration, config: Config, execution: ExecutionName = "numba", device: str = "cpu"
) -> Method:
    """Compose a configuration's method for photographs of full size; above scale 1 it is the reduced camera's."""
    working = at_scale(calibration, config.scale)
    halves = isinstance(config.matcher, AccurateConfig) and config.matcher.spectral.dual_pixel
    method: Method = method_for(
        config.matcher,
        aperture=working.aperture,
        unmixing=working.unmixing,
        label_maps=label_maps(working, config.matcher),
        blur=working.field_blur(),
        channel_moves_px=working.channel_moves_px,
        noise=noise_of_photographs(working, halves=halves),
        execution=execution,
    )
    if config.scale > 1:
        size_px = (working.sensor.width_px, working.sensor.height_px)
        method = ScaledMethod(method, config.matcher, size_px, working.aperture, execution_named(execution))
    if device == "cpu":
        return method
    from chromaperture.matching.device.gpu_method import on_device  # its stages are not needed on the CPU

    pixels = calibration.sensor.width_px * calibration.sensor.height_px
    return on_device(method, device, lambda text: warnings.warn(text, CaptureWarning, stacklevel=4), pixels=pixels)

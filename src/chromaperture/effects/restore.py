"""From a measured photograph to its sharp, naturally coloured picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from chromaperture.camera import CodedApertureCamera, channel_shifts
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import sensor_noise
from chromaperture.color.alignment import align_channels, linear_displacement
from chromaperture.color.image import SATURATION
from chromaperture.color.noise import estimate_noise_variance
from chromaperture.color.registration import residual_displacement
from chromaperture.color.unmixing import pure_channels
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.effects.all_in_focus import SharpenConfig, all_in_focus
from chromaperture.effects.restoration_tiles import by_tiles
from chromaperture.effects.same_photograph import check_same_photograph
from chromaperture.effects.steady import steady_disparity
from chromaperture.effects.transfer_functions import Blur, LensBlur, ThinLensBlur, camera_blur, radius_per_disparity
from chromaperture.errors import InputError

_TILES, _LEAST_TILE_PX = 5, 96  # along the width, over each of which the blur counts as constant
_LAYER_ERROR_PX = 0.065  # of half disparity; the error of the blur radius is that over the blur's reach
FITTED_ERROR, UNFITTED_ERROR = 0.2, 0.45  # least and largest share of contrast by which the kernels are taken as wrong
_KERNEL_ERROR = (0.15, 0.3)  # least and largest error of their transfer functions

Sharpness = Literal["aligned", "fast", "full"]
SHARPNESS: tuple[Sharpness, ...] = get_args(Sharpness)


@dataclass(frozen=True)
class SharpPicture:
    """A restored picture.

    Attributes
    ----------
    color : (H, W, 3) float32, linear RGB, white balanced
    radius_px : (H, W) float32, px
        Signed blur radius that the capture had at every pixel, + beyond focus.
    """

    color: np.ndarray
    radius_px: np.ndarray


def restore(
    image: np.ndarray,
    disparity_px: np.ndarray,
    camera: CodedApertureCamera,
    *,
    sigma_px: np.ndarray | None = None,
    sharpness: Sharpness = "full",
    blur: Blur | None = None,
) -> SharpPicture:
    """Align the channels, take the filters' tint away, and sharpen what was out of focus.

    Parameters
    ----------
    image : (H, W, 3) float, linear RGB, 1.0 = white level
    disparity_px : (H, W) float, px; NaN is filled along the picture's surfaces
        As this camera measured it.
    camera : CodedApertureCamera
    sigma_px : (H, W) float, px, optional
        Standard deviation of the disparity.
    sharpness : "aligned", "fast" or "full"
        Leave the blur; a Wiener filter a layer; all layers and channels solved for together.
    blur : Blur, optional
        The camera's transfer functions; when absent those of its calibrated blur, or else of its aperture before a
        thin lens.

    Returns
    -------
    SharpPicture

    Raises
    ------
    InputError
        The disparity is of another photograph or unknown everywhere, or the sharpness is unknown.
    """
    if sharpness not in SHARPNESS:
        raise InputError(f"unknown sharpness {sharpness!r}: choose {', '.join(SHARPNESS)}")
    if image.shape[:2] != disparity_px.shape:
        raise InputError(f"disparity {disparity_px.shape} and image {image.shape[:2]} differ in size: two photographs")
    cal, quality = camera.calibration, camera.config.quality
    gains = white_gains(cal)
    balanced = np.maximum(np.asarray(image, np.float32), 0) * gains
    shifts, scale = channel_shifts(cal, quality), np.float32(radius_per_disparity(cal, quality))
    lens, measured = camera.lens_shift, camera.blur_radius_px(disparity_px)
    if lens is None or measured is None:
        measured = np.asarray(disparity_px, np.float32) * scale
    else:
        scale = np.float32(lens.blur.model.scale_px_mm / cal.on_axis(quality).scale_px_mm)
    first = align_channels(balanced, disparity_px, shifts)
    check_same_photograph(balanced, first)
    radius, spread = steady_disparity(measured / scale, sigma_px, first)
    radius, spread = radius * scale, spread * scale
    displacement = linear_displacement(radius / scale, shifts) if lens is None else lens(radius)
    aligned = align_channels(balanced, radius / scale, shifts, displacement_px=displacement)
    # Three small sub-apertures, one a channel, blur alike, so that single surfaces can be registered.
    alike = len(cal.aperture.views) > 2 and pure_channels(cal.aperture) is not None
    displacement = displacement + residual_displacement(aligned, radius / scale, surfaces=alike)
    aligned = align_channels(balanced, radius / scale, shifts, displacement_px=displacement)
    aligned = np.maximum(aligned, 0)
    if sharpness == "aligned":
        return SharpPicture(aligned, radius)
    variance = sensor_noise(image, cal)
    noise = (estimate_noise_variance(image) if variance is None else variance).mean(axis=(0, 1)) * gains**2
    rounds = 3 if sharpness == "full" else 0
    if lens is None or blur is not None:
        settings = SharpenConfig(model_error=UNFITTED_ERROR, reweightings=rounds)
    else:
        settings = fitted_settings(lens.blur.reach, reweightings=rounds)
    saturated = np.asarray(image.max(axis=2) >= SATURATION)
    if blur is None:
        blur = camera_blur(cal) if lens is None else LensBlur(lens)

    def sharpened(piece: tuple[slice, slice], center: tuple[float, float] | None) -> np.ndarray:
        return all_in_focus(
            balanced[piece], radius[piece], blur, noise_variance=noise, aligned=aligned[piece],
            radius_sigma_px=spread[piece], saturated=saturated[piece], config=settings, center=center,
        )  # fmt: skip

    if isinstance(blur, ThinLensBlur):  # the same all over the frame
        return SharpPicture(sharpened((slice(None), slice(None)), None), radius)
    reach = math.ceil(float(np.abs(radius).max()))
    tile_px = max(_LEAST_TILE_PX, radius.shape[1] // _TILES)
    return SharpPicture(by_tiles(radius.shape, sharpened, tile_px=tile_px, overlap_px=reach + 4), radius)


def fitted_settings(reach: float, *, reweightings: int = 3) -> SharpenConfig:
    """How far a fitted blur is trusted.

    A design whose views lie close together tells distance, and with it the blur's radius, less exactly.

    Parameters
    ----------
    reach : float
        Half disparity over the radius of the blur.
    reweightings : int
    """
    error = _LAYER_ERROR_PX / reach
    return SharpenConfig(
        model_error=float(np.clip(error, FITTED_ERROR, UNFITTED_ERROR)),
        kernel_error=float(np.clip(error, *_KERNEL_ERROR)),
        reweightings=reweightings,
    )


def white_gains(calibration: Calibration) -> np.ndarray:
    """Gain of each channel that makes a white sheet behind the aperture white; (3,) float32, the smallest 1."""
    white = np.asarray(calibration.film.aperture, np.float32)
    return white.max() / white


def focus_radius(camera: CodedApertureCamera, focus_mm: float) -> float:
    """Blur radius, px, that the camera gives an object at a distance from its sensor plane, on the axis.

    Raises
    ------
    InputError
        The camera was never calibrated, or the distance lies behind its entrance pupil.
    """
    cal, quality = camera.calibration, camera.config.quality
    model = cal.on_axis(quality)
    if not focus_mm > float(model.sensor_to_pupil_mm):
        raise InputError(f"--focus {focus_mm:g} mm lies inside the lens; give the distance from the sensor in mm")
    if camera.lens_shift is None:
        return float(depth_to_disparity(focus_mm, model)) * radius_per_disparity(cal, quality)
    return float(camera.lens_shift.layer_radius_px(depth_to_disparity(focus_mm, cal.on_axis("accurate"))))

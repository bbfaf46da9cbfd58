"""Restore the sharp, naturally coloured picture from a measured photograph."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise, product
from typing import Literal, get_args

import cv2
import numpy as np

from chromaperture.camera.alignment import channel_shifts
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import noise_of_photographs
from chromaperture.color.alignment import align_channels, linear_displacement, white_gains
from chromaperture.color.image import SATURATION, without_defects
from chromaperture.color.registration import residual_displacement
from chromaperture.color.unmixing import pure_channels
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.effects.all_in_focus import SharpenConfig, all_in_focus
from chromaperture.effects.edge_aware import filter_disparity
from chromaperture.effects.layered_model import Blur, LensTransfer, ThinLensBlur, radius_per_disparity
from chromaperture.system.errors import InputError

_TILES, _MIN_TILE_PX = 5, 96  # tiles along the width, in each of which the blur counts as constant; chosen by hand
# Pictures of more pixels are restored in tiles of this side at most, without what is around them: transfer functions of
# all layers and transforms of a tile and 150 px around it take 0.5 GB, of a whole picture 150 bytes a pixel and layer.
_LARGE_PX, _MOST_TILE_PX = 1 << 21, 512
# Rows around a band beyond what its channels are displaced by: the neighbourhood of an occluded pixel (7 px), and the
# samples of Lanczos' filter (4 px).
_AROUND_PX = 12
_LAYER_ERROR_PX = 0.065  # of half disparity; the error of the blur radius is that over the blur's reach
# Range of the error allowed to the kernels, as a fraction of the contrast, and of that of their transfer functions;
# docs/colour.md, "Everything in focus", states what designs get, and the gain over a thin lens's kernels.
FITTED_ERROR, UNFITTED_ERROR = 0.2, 0.45
_KERNEL_ERROR = (0.15, 0.3)

Sharpness = Literal["aligned", "fast", "full"]
SHARPNESS: tuple[Sharpness, ...] = get_args(Sharpness)


@dataclass(frozen=True)
class SharpPicture:
    """A restored picture.

    Attributes
    ----------
    color : (H, W, 3) float32, linear RGB, white balanced
    radius_px : (H, W) float32, px
        Signed blur radius of the capture at every pixel, + beyond focus.
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
    """Align the channels, remove the filters' tint, and sharpen what was out of focus.

    ``image`` (H, W, 3) float, linear RGB, 1.0 = white level; ``disparity_px`` (H, W) float, px; NaN is filled along the
    picture's surfaces: as this camera measured it; ``sigma_px`` (H, W) float, px: standard deviation of the disparity;
    ``sharpness`` "aligned", "fast" or "full": keep the blur; a Wiener filter for each layer; a joint solution of all
    layers and channels; ``blur``: the camera's transfer functions; when absent those of its calibrated blur, or else of
    its aperture in front of a thin lens. Raises InputError: the disparity is of another photograph or unknown
    everywhere, or the sharpness is unknown.
    """
    if sharpness not in SHARPNESS:
        raise InputError(f"unknown sharpness {sharpness!r}: choose {', '.join(SHARPNESS)}")
    if image.shape[:2] != disparity_px.shape:
        raise InputError(f"disparity {disparity_px.shape} and image {image.shape[:2]} differ in size: two photographs")
    gains = white_gains(camera.calibration.film.aperture)
    noise = noise_of_photographs(camera.calibration).variance(image)
    image = without_defects(np.asarray(image, np.float32), lambda _: noise)
    balanced = np.maximum(np.asarray(image, np.float32), 0) * gains
    aligned, radius, scatter = _aligned(balanced, disparity_px, sigma_px, camera)
    if sharpness == "aligned":
        return SharpPicture(aligned, radius)
    noise_variance = noise.mean(axis=(0, 1)) * gains**2
    fitted = camera.alignment.lens_shift if blur is None else None
    rounds = SharpenConfig.reweightings if sharpness == "full" else 0
    settings = SharpenConfig(model_error=UNFITTED_ERROR, reweightings=rounds)
    if fitted is not None:
        settings = fitted_settings(fitted.blur.reach, reweightings=rounds)
    thin = ThinLensBlur(camera.calibration.aperture.with_film(camera.calibration.film.transmissions()))
    transfer = blur or (thin if fitted is None else LensTransfer(fitted))
    saturated = np.asarray(image.max(axis=2) >= SATURATION)

    def sharpened(piece: tuple[slice, slice], middle: tuple[float, float] | None) -> np.ndarray:
        return all_in_focus(
            balanced[piece], radius[piece], partial(transfer, frame_position=middle), noise_variance=noise_variance,
            aligned=aligned[piece], radius_sigma_px=scatter[piece], saturated=saturated[piece], config=settings,
        )  # fmt: skip

    changes = not isinstance(transfer, ThinLensBlur)  # over the frame
    tile_px = max(_MIN_TILE_PX, radius.shape[1] // _TILES) if changes else max(radius.shape)
    if radius.size > _LARGE_PX:
        tile_px = min(tile_px, _MOST_TILE_PX)
    elif not changes:
        return SharpPicture(sharpened((slice(None), slice(None)), None), radius)
    overlap_px = math.ceil(float(np.abs(radius).max())) + 4
    return SharpPicture(by_tiles(radius.shape, sharpened, tile_px=tile_px, overlap_px=overlap_px), radius)


def _aligned(
    balanced: np.ndarray, disparity_px: np.ndarray, sigma_px: np.ndarray | None, camera: CodedApertureCamera
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Align the channels by the capture's own samples, twice; returns picture, blur radius and its error."""
    cal, quality = camera.calibration, camera.config.quality
    shifts, scale = channel_shifts(cal, quality), np.float32(radius_per_disparity(cal, quality))
    lens, radius = camera.alignment.lens_shift, camera.alignment.blur_radius_px(disparity_px)
    if lens is None or radius is None:
        radius = np.asarray(disparity_px, np.float32) * scale
    else:
        scale = np.float32(lens.blur.model.scale_px_mm / cal.on_axis(quality).scale_px_mm)
    guide = align_channels(balanced, disparity_px, shifts)
    check_same_photograph(balanced, guide)
    disparity, scatter = filter_disparity(radius / scale, sigma_px, guide)
    radius = disparity * scale
    disparity = radius / scale

    def displaced(rows: slice) -> np.ndarray:
        if lens is None:
            return np.stack(list(linear_displacement(disparity[rows], shifts)))
        return lens(radius[rows], first_row=rows.start, height=len(radius))

    aligned = _align_bands(balanced, disparity, shifts, displaced)
    # Three small sub-apertures, one a channel, blur in the same way, so that single surfaces can be registered.
    same_shape = len(cal.aperture.views) > 2 and pure_channels(cal.aperture) is not None
    residual = residual_displacement(aligned, disparity, surfaces=same_shape)
    if residual.any():
        aligned = _align_bands(balanced, disparity, shifts, lambda rows: displaced(rows) + residual[:, :, rows])
    return np.maximum(aligned, 0, out=aligned), radius, scatter * scale


def _align_bands(
    balanced: np.ndarray, disparity: np.ndarray, shifts: np.ndarray, displaced: Callable[[slice], np.ndarray]
) -> np.ndarray:
    """Align the channels by displacements, (3, 2, rows, W) px, of which those of a band are made at a time."""
    height, width = disparity.shape
    rows_a_band = max(height if disparity.size <= _LARGE_PX else 1, _LARGE_PX // width)
    color = np.empty(balanced.shape, np.float32)
    for top in range(0, height, rows_a_band):
        band = slice(top, min(top + rows_a_band, height))
        moved = displaced(band)
        reach = math.ceil(float(np.abs(moved[:, 1]).max())) + _AROUND_PX
        seen = slice(max(0, top - reach), min(height, band.stop + reach))
        moved = moved if seen == band else displaced(seen)
        found = align_channels(balanced[seen], disparity[seen], shifts, displacement_px=moved)
        color[band] = found[top - seen.start :][: band.stop - top]
    return color


def brightened(picture: SharpPicture) -> SharpPicture:
    """Scale a restored picture so that its brightest 0.2 % lie just below white."""
    return replace(picture, color=picture.color * float(0.95 / max(np.percentile(picture.color, 99.8), 1e-6)))


def radius_at(picture: SharpPicture, x: int, y: int) -> float:
    """Return the capture's blur radius at a pixel: the median of a window of 7 px."""
    return float(np.median(picture.radius_px[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4]))


def fitted_settings(reach: float, *, reweightings: int) -> SharpenConfig:
    """Return the settings for a fitted blur: the smaller its reach, the less exact is the blur radius."""
    error = _LAYER_ERROR_PX / reach
    return SharpenConfig(
        model_error=float(np.clip(error, FITTED_ERROR, UNFITTED_ERROR)),
        kernel_error=float(np.clip(error, *_KERNEL_ERROR)),
        reweightings=reweightings,
    )


def focus_radius(camera: CodedApertureCamera, focus_mm: float) -> float:
    """Return the blur radius, px, on the axis of an object at a distance from the sensor plane."""
    cal, quality = camera.calibration, camera.config.quality
    model = cal.on_axis(quality)
    if not focus_mm > float(model.sensor_to_pupil_mm):
        raise InputError(f"a focus at {focus_mm:g} mm lies inside the lens; give its distance from the sensor in mm")
    if camera.alignment.lens_shift is None:
        return float(depth_to_disparity(focus_mm, model)) * radius_per_disparity(cal, quality)
    return float(camera.alignment.lens_shift.layer_radius_px(depth_to_disparity(focus_mm, cal.on_axis("accurate"))))


Restorer = Callable[[tuple[slice, slice], tuple[float, float]], np.ndarray]


def by_tiles(shape: tuple[int, int], restore: Restorer, *, tile_px: int, overlap_px: int) -> np.ndarray:
    """Restore by tiles, given their place and frame position, over which blur is constant; blend the overlaps."""
    total, weights = np.zeros((*shape, 3), np.float32), np.zeros((*shape, 1), np.float32)
    for rows, columns in _tiles(shape, tile_px, overlap_px):
        middle = ((columns.start + columns.stop) / shape[1] - 1, (rows.start + rows.stop) / shape[0] - 1)
        weight = np.outer(*(_ramp(s, n, overlap_px) for s, n in zip((rows, columns), shape, strict=True)))[..., None]
        total[rows, columns] += weight * restore((rows, columns), middle)
        weights[rows, columns] += weight
    return total / weights


def _tiles(shape: tuple[int, int], tile_px: int, overlap_px: int) -> Iterator[tuple[slice, slice]]:
    """Divide a frame into parts of about equal size, each widened by the overlap on every side."""
    axes = []
    for size in shape:
        edges = np.linspace(0, size, max(1, round(size / tile_px)) + 1).astype(int)
        spans = ((max(int(a) - overlap_px, 0), min(int(b) + overlap_px, size)) for a, b in pairwise(edges))
        axes.append([slice(*span) for span in spans])
    return product(axes[0], axes[1])


def _ramp(piece: slice, size: int, overlap_px: int) -> np.ndarray:
    """Return the weight along one side of a tile: it rises over the overlap, except at the border of the frame."""
    x = np.arange(piece.start, piece.stop) + 0.5
    rise = (x - piece.start) / (2 * overlap_px) if piece.start > 0 else np.ones(len(x))
    if piece.stop < size:
        rise = np.minimum(rise, (piece.stop - x) / (2 * overlap_px))
    return np.clip(rise, 1e-3, 1).astype(np.float32)  # never 0: the weights' sum divides


_SMOOTH_PX, _WINDOW_PX = 1.0, 8.0  # standard deviations against noise and of the local window; chosen by hand
# Of larger pictures so many bands are compared, evenly spaced, of so many pixels together; chosen by hand.
_BANDS, _MOST_PX = 8, 1 << 21
_MAX_LOSS = 0.03  # of correlation. On bench50 a scene's own disparity gains 0.02 to 0.15, another's loses 0.035 to 0.2


def channel_agreement(color: np.ndarray) -> float:
    """Return the local correlation of the channels, whatever its sign, weighted by their contrast; 0 to 1."""
    correlated = contrast = 0.0
    for band in _bands(*color.shape[:2]):
        tone = np.sqrt(np.maximum(np.asarray(color[band], np.float32), 0))
        tone = cv2.GaussianBlur(tone, (0, 0), _SMOOTH_PX) - cv2.GaussianBlur(tone, (0, 0), _WINDOW_PX)
        power = cv2.GaussianBlur(tone * tone, (0, 0), _WINDOW_PX)
        for a, b in combinations(range(3), 2):
            correlated += float(np.abs(cv2.GaussianBlur(tone[..., a] * tone[..., b], (0, 0), _WINDOW_PX)).sum())
            contrast += float(np.sqrt(power[..., a] * power[..., b]).sum())
    return correlated / contrast if contrast > 0 else 1.0


def _bands(height: int, width: int) -> list[slice]:
    """Return the rows of a picture that are compared: all of them, or evenly spaced bands."""
    rows = _MOST_PX // (_BANDS * width)
    if height <= _BANDS * rows:
        return [slice(0, height)]
    return [slice(top, top + max(rows, 1)) for top in (height - rows) * (2 * np.arange(_BANDS) + 1) // (2 * _BANDS)]


def check_same_photograph(image: np.ndarray, aligned: np.ndarray) -> None:
    """Reject a disparity by which the channels correlate clearly less than they did as captured."""
    if channel_agreement(aligned) < channel_agreement(image) - _MAX_LOSS:
        raise InputError(
            "this disparity moves the photograph's channels farther apart instead of together: it is of another "
            "photograph, or of another camera; measure it again from this one"
        )

"""The fast renderer: a picture with depth, cut into layers of equal blur.

    y_k = sum_l (a_l J_l * h_kl) (1 - sum_m a_m * h_km),    m: layers nearer than l by more than a depth edge

Within a surface neighbouring layers add up; only a surface that stands clear before another hides it. What a
near object hides and its blurred rim reveals is not in the picture; a second sheet behind the near sides of
depth edges continues the far surface there, mirrored at the edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft

from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture, channel_transmission
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.psf import geometric_otf

_SHARP_PX = 0.02  # blur below is none: the centroid of a half pupil moves by less than 0.01 px


@dataclass(frozen=True)
class LayeredCapture:
    """What the layered renderer made.

    Attributes
    ----------
    image : (H, W, 3) float32
        Linear light behind the aperture; reflectance 1 through the open pupil gives 1.
    layer_count : int
        Layers that held any pixel.
    """

    image: np.ndarray
    layer_count: int


def render_layers(
    color: np.ndarray,
    depth_mm: np.ndarray,
    *,
    camera: PupilCamera,
    aperture: Aperture,
    pitch_px: float = 0.5,
    edge_px: float = 0.7,
) -> LayeredCapture:
    """Photograph an RGB-D picture taken from the pupil's centre.

    Parameters
    ----------
    color : (H, W, 3) float
        Sharp, linear.
    depth_mm : (H, W) float
        Distance from the sensor plane. NaN takes the nearest known depth.
    camera : PupilCamera
        Its size must be the picture's.
    aperture : Aperture
    pitch_px : float
        Distance of two layers in blur radius; between two layers light is shared linearly.
    edge_px : float
        Neighbours whose blur radii differ by more are two surfaces, one before the other.

    Returns
    -------
    LayeredCapture

    Raises
    ------
    InputError
        Wrong shapes, no known depth, depth behind the camera.
    """
    color = np.asarray(color, np.float32)
    depth = np.asarray(depth_mm, np.float64)
    if color.shape != (camera.height_px, camera.width_px, 3) or depth.shape != color.shape[:2]:
        raise InputError(
            f"colour {color.shape} and depth {depth.shape} must both have the camera's size, "
            f"{camera.height_px} rows of {camera.width_px}"
        )
    radius = camera.blur_radius_px(fill_unknown(depth)).astype(np.float32)
    reach = math.ceil(float(np.abs(radius).max())) + 2
    # A filtered picture falls to nothing at its rim: continue it by its mirror image. Coarse steps keep the
    # size, and with it the transfer functions, the same from frame to frame of a video.
    pad = min(16 * math.ceil(reach / 16), min(depth.shape) - 1)
    size = tuple(scipy.fft.next_fast_len(n + 2 * pad, real=True) for n in depth.shape)
    rims = (pad, size[0] - depth.shape[0] - pad, pad, size[1] - depth.shape[1] - pad)
    color = np.asarray(cv2.copyMakeBorder(color, *rims, borderType=cv2.BORDER_REFLECT_101), np.float32)
    radius = np.asarray(cv2.copyMakeBorder(radius, *rims, borderType=cv2.BORDER_REFLECT_101), np.float32)
    behind_color, behind_radius = behind_edges(color, radius, reach, edge_px)

    hidden = behind_radius != radius
    total = np.zeros((3, *size), np.float32)
    cover = np.zeros((3, *size), np.float32)
    before = np.zeros((3, *size), np.float32)  # coverage by surfaces that stand clear in front
    waiting: list[tuple[int, np.ndarray]] = []
    count = 0
    first, last = math.floor(float(radius.min()) / pitch_px), math.ceil(float(behind_radius.max()) / pitch_px)
    for level in range(first, last + 1):  # near to far
        front = _matte(radius / np.float32(pitch_px) - level)
        back = np.where(hidden, _matte(behind_radius / np.float32(pitch_px) - level), np.float32(0))
        if not (front.any() or back.any()):
            continue
        count += 1
        while waiting and (level - waiting[0][0]) * pitch_px > edge_px:
            before += waiting.pop(0)[1]
        shown = color * front[..., None] + behind_color * back[..., None]
        planes = np.concatenate([shown.transpose(2, 0, 1), (front + back)[None]])
        lit, veil = _blurred(planes, aperture, level * pitch_px)
        seen = np.clip(1 - before, 0, 1)
        total += lit * seen
        cover += veil * seen
        waiting.append((level, veil))
    image = total / np.maximum(cover, np.float32(1e-3))
    image *= channel_transmission(aperture).astype(np.float32)[:, None, None]
    crop = image[:, pad : pad + depth.shape[0], pad : pad + depth.shape[1]]
    return LayeredCapture(np.ascontiguousarray(np.maximum(crop, 0).transpose(1, 2, 0)), count)


def fill_unknown(depth_mm: np.ndarray) -> np.ndarray:
    """Give unknown (NaN) depths the nearest known one; raises InputError where none is known."""
    unknown = np.isnan(depth_mm)
    if not unknown.any():
        return depth_mm
    if unknown.all():
        raise InputError("the depth map knows no depth at all: every pixel is NaN")
    return depth_mm[_nearest(~unknown)]


def _nearest(wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the nearest wanted pixel, for every pixel."""
    _, labels = cv2.distanceTransformWithLabels(
        (~wanted).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(wanted)
    lookup = np.zeros((int(labels.max()) + 1, 2), np.int64)
    lookup[labels[rows, columns]] = np.stack([rows, columns], -1)
    found = lookup[labels]
    return found[..., 0], found[..., 1]


def behind_edges(color: np.ndarray, radius: np.ndarray, reach: int, edge_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Continue far surfaces behind the near sides of depth edges.

    Parameters
    ----------
    color : (H, W, 3) float32
    radius : (H, W) float32
        Signed blur radius, px; smaller is nearer.
    reach : int
        How far behind an edge, px.
    edge_px : float

    Returns
    -------
    color, radius : as given, but with the far surface where the near one hides it
    """
    beside = cv2.erode(radius, np.ones((3, 3), np.uint8))
    far_side = radius - beside > edge_px
    if not far_side.any():
        return color, radius
    row, column = _nearest(far_side)
    y, x = np.indices(radius.shape, dtype=np.int64)
    hidden = (np.hypot(y - row, x - column) <= reach) & (radius[row, column] - radius > edge_px)
    # Mirror at the far pixel next to the edge, unless the mirror image is near again.
    my = np.clip(2 * row - y, 0, radius.shape[0] - 1)
    mx = np.clip(2 * column - x, 0, radius.shape[1] - 1)
    usable = np.abs(radius[my, mx] - radius[row, column]) <= edge_px
    my, mx = np.where(usable, my, row), np.where(usable, mx, column)
    out_color = np.where(hidden[..., None], color[my, mx], color)
    return out_color, np.where(hidden, radius[my, mx], radius)


def _matte(level: np.ndarray) -> np.ndarray:
    """Share of a layer in a pixel ``level`` layers beyond it: the two nearest layers share its light."""
    return np.maximum(1 - np.abs(level), 0)


def _blurred(planes: np.ndarray, aperture: Aperture, radius_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Colour (3, h, w) and coverage (3, h, w) of a layer as each channel's pupil blurs them."""
    if abs(radius_px) < _SHARP_PX:
        return planes[:3], np.broadcast_to(planes[3], (3, *planes.shape[1:]))
    shape = planes.shape[1:]
    otf = geometric_otf(aperture, radius_px, (shape[0], shape[1]))
    with scipy.fft.set_workers(-1):
        spectra = scipy.fft.rfft2(planes)
        blurred = scipy.fft.irfft2(np.concatenate([spectra[:3] * otf, spectra[3] * otf]), s=shape)
    return blurred[:3], np.clip(blurred[3:], 0, 1)

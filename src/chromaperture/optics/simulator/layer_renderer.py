"""The fast renderer: a picture with depth, split into layers of equal blur.

    y_k = sum_l (a_l J_l * h_kl) (1 - sum_m a_m * h_km),    m: layers nearer than l by more than a depth edge

Within a surface neighbouring layers are added; only a surface that is clearly nearer occludes another. What the blurred
rim of a near object reveals is not in the picture; a second sheet behind the near sides of depth edges extrapolates the
far surface, mirrored at the edge.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import scipy.fft

from chromaperture.optics.aperture import Aperture, channel_transmission
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.psf import geometric_otf
from chromaperture.optics.simulator.textures import srgb_to_linear
from chromaperture.system.errors import InputError
from chromaperture.system.storage import natural

_EDGE_PX = 0.7  # neighbours whose blur radii differ by more are two surfaces; chosen by hand
_SHARP_PX = 0.02  # smaller blur is skipped: it moves the centroid of a half pupil by less than 0.01 px


@dataclass(frozen=True)
class LayeredCapture:
    """Result of the layered renderer."""

    # (H, W, 3) float32: linear light behind the aperture; reflectance 1 through the open pupil gives 1
    image: np.ndarray
    layer_count: int  # layers that are not empty


def render_layers(
    color: np.ndarray, depth_mm: np.ndarray, *, camera: PupilCamera, aperture: Aperture, pitch_px: float = 0.5
) -> LayeredCapture:
    """Photograph a linear RGB-D picture, taken from the pupil's centre, in layers of blur radius."""
    color = np.asarray(color, np.float32)
    depth = np.asarray(depth_mm, np.float64)
    if color.shape != (camera.height_px, camera.width_px, 3) or depth.shape != color.shape[:2]:
        raise InputError(
            f"colour {color.shape} and depth {depth.shape} must both have the camera's size, "
            f"{camera.height_px} rows of {camera.width_px}"
        )
    radius = camera.blur_radius_px(fill_unknown(depth)).astype(np.float32)
    reach = math.ceil(float(np.abs(radius).max())) + 2
    pad, (color, radius) = _mirrored((color, radius), reach)
    size = radius.shape
    behind_color, behind_radius = behind_edges(color, radius, reach, _EDGE_PX)

    hidden = behind_radius != radius
    total = np.zeros((3, *size), np.float32)
    cover = np.zeros((3, *size), np.float32)
    before = np.zeros((3, *size), np.float32)  # coverage by surfaces that are clearly nearer
    waiting: list[tuple[int, np.ndarray]] = []
    count = 0
    # The light of one surface is divided between two layers, which do not hide each other.
    apart = max(math.floor(_EDGE_PX / pitch_px), 1)
    first, last = math.floor(float(radius.min()) / pitch_px), math.ceil(float(behind_radius.max()) / pitch_px)
    for level in range(first, last + 1):  # near to far
        front = _matte(radius / np.float32(pitch_px) - level)
        back = np.where(hidden, _matte(behind_radius / np.float32(pitch_px) - level), np.float32(0))
        if not (front.any() or back.any()):
            continue
        count += 1
        while waiting and level - waiting[0][0] > apart:
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


def _mirrored(pictures: Sequence[np.ndarray], reach: int) -> tuple[int, list[np.ndarray]]:
    """Extend pictures by mirrored borders of at least ``reach`` px, as filters are periodic; returns the border too."""
    shape = pictures[0].shape[:2]
    # Steps of 16 px keep the size, and so the cached transfer functions, from frame to frame of a video.
    pad = min(16 * math.ceil(reach / 16), min(shape) - 1)
    height, width = (scipy.fft.next_fast_len(n + 2 * pad, real=True) for n in shape)
    rims = (pad, height - shape[0] - pad, pad, width - shape[1] - pad)
    return pad, [
        np.asarray(cv2.copyMakeBorder(p, *rims, borderType=cv2.BORDER_REFLECT_101), np.float32) for p in pictures
    ]


def fill_unknown(depth_mm: np.ndarray) -> np.ndarray:
    """Replace unknown (NaN) depths by the nearest known one; raises InputError when none is known."""
    unknown = np.isnan(depth_mm)
    if not unknown.any():
        return depth_mm
    if unknown.all():
        raise InputError("the depth map holds no depth at all: every pixel is NaN")
    return depth_mm[_nearest(~unknown)]


def _nearest(wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find row and column of the nearest wanted pixel, for every pixel."""
    _, labels = cv2.distanceTransformWithLabels(
        (~wanted).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(wanted)
    lookup = np.zeros((int(labels.max()) + 1, 2), np.int64)
    lookup[labels[rows, columns]] = np.stack([rows, columns], -1)
    found = lookup[labels]
    return found[..., 0], found[..., 1]


def behind_edges(color: np.ndarray, radius: np.ndarray, reach: int, edge_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Extrapolate colour and blur radius of far surfaces behind the near sides of depth edges."""
    beside = cv2.erode(radius, np.ones((3, 3), np.uint8))
    far_side = radius - beside > edge_px
    if not far_side.any():
        return color, radius
    row, column = _nearest(far_side)
    y, x = np.indices(radius.shape, dtype=np.int64)
    hidden = (np.hypot(y - row, x - column) <= reach) & (radius[row, column] - radius > edge_px)
    # Mirror at the far pixel next to the edge, unless the mirrored pixel is on the near surface too.
    my = np.clip(2 * row - y, 0, radius.shape[0] - 1)
    mx = np.clip(2 * column - x, 0, radius.shape[1] - 1)
    usable = np.abs(radius[my, mx] - radius[row, column]) <= edge_px
    my, mx = np.where(usable, my, row), np.where(usable, mx, column)
    out_color = np.where(hidden[..., None], color[my, mx], color)
    return out_color, np.where(hidden, radius[my, mx], radius)


def _matte(level: np.ndarray) -> np.ndarray:
    """Compute a layer's weight at a pixel ``level`` layers beyond it: linear between the two nearest layers."""
    return np.maximum(1 - np.abs(level), 0)


def _blurred(planes: np.ndarray, aperture: Aperture, radius_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Blur colour (3, h, w) and coverage (3, h, w) of a layer by each channel's pupil."""
    if abs(radius_px) < _SHARP_PX:
        return planes[:3], np.broadcast_to(planes[3], (3, *planes.shape[1:]))
    shape = planes.shape[1:]
    otf = geometric_otf(aperture, radius_px, (shape[0], shape[1]))
    with scipy.fft.set_workers(-1):
        spectra = scipy.fft.rfft2(planes)
        blurred = scipy.fft.irfft2(np.concatenate([spectra[:3] * otf, spectra[3] * otf]), s=shape)
    return blurred[:3], np.clip(blurred[3:], 0, 1)


_UNKNOWN = (0, 65535)  # counts of unknown depth, as depth cameras write it


def read_rgbd(
    color_path: Path, depth_path: Path, *, depth_unit_mm: float = 1.0, sensor_to_pupil_mm: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Read a colour picture and its depth: (H, W, 3) float32, linear, and (H, W) float32, mm, NaN unknown.

    Colour is 8-bit sRGB or 16-bit linear; depth one channel of 16 bits in ``depth_unit_mm``, 0 and 65535 unknown, to
    which ``sensor_to_pupil_mm`` is added: depth cameras measure from their pinhole, this package from the sensor plane.
    Raises InputError: a file that cannot be read, depth that is not 16 bit, sizes that differ.
    """
    color = _read(color_path, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    depth = _read(depth_path, cv2.IMREAD_UNCHANGED)
    if depth.ndim != 2 or depth.dtype != np.uint16:
        raise InputError(f"{depth_path} must hold one channel of 16 bits (mm by default), got {depth.dtype}")
    if color.shape[:2] != depth.shape:
        raise InputError(f"colour {color.shape[:2]} and depth {depth.shape} differ in size: register them first")
    white = 255.0 if color.dtype == np.uint8 else 65535.0
    value = color[..., ::-1].astype(np.float32) / np.float32(white)
    if color.dtype == np.uint8:
        value = srgb_to_linear(value)
    known = ~np.isin(depth, _UNKNOWN)
    depth_mm = np.where(known, depth * np.float32(depth_unit_mm) + np.float32(sensor_to_pupil_mm), np.nan)
    return np.ascontiguousarray(value, np.float32), depth_mm.astype(np.float32)


def _read(path: Path, flags: int) -> np.ndarray:
    picture = cv2.imread(str(path), flags) if path.is_file() else None
    if picture is None:
        raise InputError(f"cannot read {path} as a picture")
    return np.asarray(picture)


def rgbd_pairs(folder: Path) -> list[tuple[Path, Path]]:
    """Find colour pictures and their depth: NAME.color.* with NAME.depth.png, or rgb/ and depth/ in equal order."""
    if not os.path.isdir(folder):
        raise InputError(f"no RGB-D sequence or scene file at {folder}")
    if (folder / "rgb").is_dir() and (folder / "depth").is_dir():
        colors, depths = (sorted((folder / part).iterdir(), key=natural) for part in ("rgb", "depth"))
        if len(colors) != len(depths):
            raise InputError(f"{folder} holds {len(colors)} pictures in rgb/ and {len(depths)} in depth/")
        pairs = list(zip(colors, depths, strict=True))
    else:
        found = ((p, folder / f"{p.name.split('.color.')[0]}.depth.png") for p in folder.glob("*.color.*"))
        pairs = sorted(((c, d) for c, d in found if d.is_file()), key=lambda pair: natural(pair[0]))
    if not pairs:
        raise InputError(f"{folder} holds no NAME.color.* with NAME.depth.png, nor rgb/ and depth/")
    return pairs

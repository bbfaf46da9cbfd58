"""Compute the photograph of another lens: other focus, f-number or shape of the pupil.

Layers of equal new blur, near to far, are blurred with their pixel weights, I = sum_l V_l (a_l J_l * k_l) / sum_l V_l
(a_l * k_l), V_l = 1 - sum of a_m * k_m over clearly nearer layers m, in linear light: a sharp edge occludes the blurred
background, which shows through a blurred edge. What near surfaces hide is extrapolated. Large pictures are computed
tile by tile.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np
from PIL import Image

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear
from chromaperture.effects.layered_model import layer_radii
from chromaperture.effects.refocusing_kernels import add_layer, layer_bounds, layer_planes, normalise, over_rows
from chromaperture.matching.device.device import DeviceError
from chromaperture.matching.device.gpu_method import DeviceMethod, device_method
from chromaperture.matching.device.refocus_stages import RefocusChain, RefocusLayer
from chromaperture.optics.simulator.layer_renderer import behind_edges
from chromaperture.system.errors import InputError, OutOfMemoryError

# Blur radii in px, chosen by hand; not tuned. docs/colour.md measures error and time of the whole.
_SHARP_PX = 0.3  # new blur below which nothing is done
_EDGE_PX = 1.0  # jump of the capture's blur radius that separates two surfaces
_GROWTH = 0.12  # distance of two layers, of their radius
_SCALES = ((3.0, 1), (7.0, 2), (16.0, 4), (math.inf, 8))  # blur up to this radius is computed at this reduction
_MAX_PX = 120.0  # bounds time and margins
_COARSEST = 8  # of these reductions
# Side of a tile without what is around it: 0.3 GB. A device, which plans anew for every shape, takes full HD in one.
_TILE_PX, _DEVICE_TILE_PX = 1024, 2048


@dataclass(frozen=True)
class Focus:
    """Focus and pupil of the new picture."""

    radius_px: float  # blur radius that the capture has on the new focus surface
    strength: float = 1.0  # diameter of the new pupil in units of the camera's own: its f-number over the new one
    bokeh: str = "disc"  # shape of the pupil, see `bokeh_mask`


# Blurs and adds layers on a device, as `_composite`; None where that is left to the CPU.
Compositor = Callable[..., np.ndarray | None]


def refocus(
    color: np.ndarray,
    radius_px: np.ndarray,
    focus: Focus,
    *,
    compositor: Compositor | None = None,
    tile_px: int | None = None,
) -> np.ndarray:
    """Blur a sharp picture as a lens with another focus would; (H, W, 3) float32, linear RGB.

    ``radius_px`` (H, W): signed blur radius that the capture had, px, + beyond its focus: orders near and far, no NaN;
    ``compositor``: a camera's device, see `compositor_of`; ``tile_px``: side of the parts that are computed one after
    the other. Raises InputError: sizes differ, the depth has holes, or the blur would be larger than the picture can
    hold.
    """
    if color.shape[:2] != radius_px.shape:
        raise InputError(f"picture {color.shape[:2]} and depth {radius_px.shape} differ in size: of two photographs")
    if not np.isfinite(radius_px).all():
        raise InputError("the depth must be known everywhere; fill the holes of the disparity first")
    if not (math.isfinite(focus.strength) and focus.strength >= 0):
        raise InputError(f"the new pupil must have a size >= 0, got {focus.strength:g}")
    color, radius = np.ascontiguousarray(color, np.float32), np.ascontiguousarray(radius_px, np.float32)
    low, high = (float(np.float32(focus.strength) * (end - focus.radius_px)) for end in (radius.min(), radius.max()))
    largest = max(-low, high)
    if largest > min(_MAX_PX, min(radius.shape) / 2):
        raise InputError(f"the new blur would reach {largest:.0f} px: choose a larger f-number or a farther focus")
    if largest < _SHARP_PX:
        return color.copy()
    # New blur rises with depth, because the pupil's scale is positive; hidden surfaces lie where others are seen.
    radii = layer_radii(np.array([low, high], np.float32), growth=_GROWTH)
    reach = math.ceil(largest) + 1
    # What is hidden comes from up to twice as far; of the blur, whole pixels of the coarsest scale.
    margin = -(-(3 * reach + 2) // _COARSEST) * _COARSEST + 4 * _COARSEST
    tile_px = tile_px or (_TILE_PX if compositor is None else _DEVICE_TILE_PX)
    out = np.empty_like(color)
    for top in range(0, len(radius), tile_px):
        for left in range(0, radius.shape[1], tile_px):
            above, before = (max(first - margin, 0) // _COARSEST * _COARSEST for first in (top, left))
            around = np.s_[above : top + tile_px + margin, before : left + tile_px + margin]
            inner = np.s_[top - above : top - above + tile_px, left - before : left - before + tile_px]
            part = _refocused(color[around], radius[around], radii, reach, focus, compositor)
            out[top : top + tile_px, left : left + tile_px] = part[inner]
    return out


def _refocused(
    color: np.ndarray, radius: np.ndarray, radii: np.ndarray, reach: int, focus: Focus, compositor: Compositor | None
) -> np.ndarray:
    """Refocus a part of a picture by layers that are the same everywhere."""
    color, radius = np.ascontiguousarray(color), np.ascontiguousarray(radius)
    behind, behind_radius = behind_edges(color, radius, reach, _EDGE_PX)
    hidden = behind_radius != radius
    new, behind_new = (
        (part - np.float32(focus.radius_px)) * np.float32(focus.strength) for part in (radius, behind_radius)
    )
    parts = (color, behind), (new, behind_new), hidden, _layers(new, behind_new, hidden, radii, focus)
    found = None if compositor is None else compositor(*parts)
    return _composite(*parts) if found is None else found


def _layers(
    new: np.ndarray, behind_new: np.ndarray, hidden: np.ndarray, radii: np.ndarray, focus: Focus
) -> list[RefocusLayer]:
    """Divide a picture into layers, near to far; those without any pixel are left out."""
    mask = bokeh_mask(focus.bokeh)
    nodes = np.array([-np.inf, *radii, np.inf], np.float32)
    if len(radii) == 1:
        nodes = np.array([radii[0] - 1, radii[0], radii[0] + 1], np.float32)
    else:  # outer neighbours of the ends: no pixel lies beyond, up to rounding
        nodes[0], nodes[-1] = 2 * radii[0] - radii[1], 2 * radii[-1] - radii[-2]
    height, width = new.shape
    extent = np.empty((height, 2), np.int64)
    found: list[RefocusLayer] = []
    pending: list[tuple[float, int]] = []  # layers that do not yet hide others
    gap = max(_EDGE_PX * focus.strength, 1.0)
    for i, radius in enumerate(float(r) for r in radii):
        below, here, above = nodes[i : i + 3]
        over_rows(layer_bounds, height, new, behind_new, hidden, below, above, extent)
        rows = np.flatnonzero(extent[:, 1] >= 0)
        if not rows.size:
            continue
        # Clearly nearer surfaces occlude this one; neighbouring layers of its own surface add to it.
        joined = []
        while pending and radius - pending[0][0] > max(gap, 1.5 * float(here - below)):
            joined.append(pending.pop(0)[1])
        pending.append((radius, len(found)))
        scale = _scale(radius)
        reach = math.ceil(abs(radius)) + 2 * scale
        # Pixels of the coarser picture lie alike in every tile.
        top, left = (max(int(first) - reach, 0) // scale * scale for first in (rows[0], extent[:, 0].min()))
        bottom, right = min(int(rows[-1]) + reach + 1, height), min(int(extent[:, 1].max()) + reach + 1, width)
        is_sharp = abs(radius) < _SHARP_PX
        kernel = np.ones((1, 1), np.float32) if is_sharp else bokeh_kernel(mask, radius / scale)
        found.append(RefocusLayer((below, here, above), (top, left, bottom, right), scale, kernel, tuple(joined)))
    return found


def _composite(
    pictures: tuple[np.ndarray, np.ndarray],
    radii: tuple[np.ndarray, np.ndarray],
    hidden: np.ndarray,
    layers: Sequence[RefocusLayer],
) -> np.ndarray:
    """Blur and add the layers, as `RefocusChain.composite` does on a device."""
    (color, behind), (new, behind_new) = pictures, radii
    height, width = new.shape
    total, before = np.zeros((height, width, 4), np.float32), np.zeros((height, width), np.float32)
    covers: dict[int, np.ndarray] = {}  # of layers that hide nothing yet
    for number, layer in enumerate(layers):
        for joined in layer.joined:
            top, left, bottom, right = layers[joined].box
            before[top:bottom, left:right] += covers.pop(joined)
        top, left, bottom, right = layer.box
        planes, corner = np.zeros((bottom - top, right - left, 4), np.float32), (top, left)
        over_rows(layer_planes, len(planes), color, new, behind, behind_new, hidden, layer.nodes, corner, planes)
        blurred = _blurred(planes, layer)
        over_rows(add_layer, len(blurred), total, before, blurred, corner)
        covers[number] = blurred[..., 3].copy()  # all of `blurred` would stay in memory
    out = np.empty((height, width, 3), np.float32)
    over_rows(normalise, height, total, out)
    return out


def _scale(radius_px: float) -> int:
    return next(scale for limit, scale in _SCALES if abs(radius_px) <= limit)


def _blurred(planes: np.ndarray, layer: RefocusLayer) -> np.ndarray:
    """Convolve (h, w, 4) with the pupil; large spots at a lower resolution, because they have no fine detail."""
    if len(layer.kernel) == 1:
        return planes
    if layer.scale == 1:
        return _convolved(planes, layer.kernel)
    scale, (height, width) = layer.scale, planes.shape[:2]
    margins = (-height % scale, -width % scale)
    padded = cv2.copyMakeBorder(planes, 0, margins[0], 0, margins[1], borderType=cv2.BORDER_REPLICATE)
    small = cv2.resize(padded, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
    small = _convolved(small, layer.kernel)
    large = cv2.resize(small, padded.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(large[:height, :width])


def _convolved(planes: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    # OpenCV correlates: rotate the kernel for a convolution.
    return np.asarray(cv2.filter2D(planes, -1, kernel[::-1, ::-1].copy(), borderType=cv2.BORDER_REFLECT))


BackgroundEffect = Literal["keep", "desaturate", "blur"]
BACKGROUND_EFFECTS: tuple[BackgroundEffect, ...] = get_args(BackgroundEffect)
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of linear sRGB, IEC 61966-2-1
_RAMP_PX = 1.0  # blur radius over which the background sets in, and its distance from the focus; chosen by hand


def background_weight(radius_px: np.ndarray, focus_radius_px: float) -> np.ndarray:
    """Return how far each pixel belongs to the background of the focus, a smooth step; (H, W) float32 in [0, 1]."""
    t = np.clip((radius_px - np.float32(focus_radius_px)) / _RAMP_PX - 1, 0, 1).astype(np.float32)
    return t * t * (3 - 2 * t)


def desaturate_background(color: np.ndarray, radius_px: np.ndarray, focus_radius_px: float) -> np.ndarray:
    """Turn what lies beyond a surface's signed blur radius grey at its own luminance; (H, W, 3)."""
    grey = (color @ _LUMINANCE)[..., None]
    weight = background_weight(radius_px, focus_radius_px)[..., None]
    return np.asarray(color + weight * (grey - color), np.float32)


def apply_background(
    color: np.ndarray,
    radius_px: np.ndarray,
    focus: Focus,
    effect: BackgroundEffect,
    *,
    compositor: Compositor | None = None,
) -> np.ndarray:
    """Refocus with one of the effects, see `refocus`; raises InputError for an unknown one; (H, W, 3) float32."""
    if effect not in BACKGROUND_EFFECTS:
        raise InputError(f"unknown background effect {effect!r}: choose {', '.join(BACKGROUND_EFFECTS)}")
    if effect == "blur":  # only what lies behind the focus
        radius_px = np.maximum(radius_px, np.float32(focus.radius_px))
    elif effect == "desaturate":
        color = desaturate_background(color, radius_px, focus.radius_px)
    return refocus(color, radius_px, focus, compositor=compositor)


_FRAMES_PER_SECOND = 12
_MIN_SWEEP_PX = 3.0  # blur radius: range of the sweep of a flat scene; chosen by hand
SUFFIXES = (".gif", ".mp4")


def sweep(
    color: np.ndarray, radius_px: np.ndarray, focus: Focus, *, frames: int = 24, compositor: Compositor | None = None
) -> Iterator[np.ndarray]:
    """Yield pictures, (H, W, 3) uint8 sRGB, focused from near to far with a pupil and its strength."""
    if frames < 2:
        raise InputError(f"a sweep needs at least 2 frames, got {frames}")
    near, far = np.percentile(radius_px, (2, 98))  # without outliers
    short = max(0.0, _MIN_SWEEP_PX - (far - near)) / 2
    near, far = near - short, far + short
    for radius in np.linspace(near, far, frames):
        picture = refocus(color, radius_px, replace(focus, radius_px=float(radius)), compositor=compositor)
        yield np.rint(linear_to_srgb(picture) * 255).astype(np.uint8)


def write_sweep(path: Path, frames: Iterator[np.ndarray]) -> None:
    """Write frames forwards and backwards; raises InputError for a suffix other than .gif and .mp4."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"cannot write a sweep as {path.suffix or 'a file without suffix'}: choose .gif or .mp4")
    forwards = list(frames)
    shown = forwards + forwards[-2:0:-1]
    if path.suffix.lower() == ".gif":
        pictures = [Image.fromarray(frame).quantize(128, dither=Image.Dither.FLOYDSTEINBERG) for frame in shown]
        pictures[0].save(
            path, save_all=True, append_images=pictures[1:], duration=1000 // _FRAMES_PER_SECOND, loop=0, format="GIF"
        )
        return
    height, width = shown[0].shape[0] // 2 * 2, shown[0].shape[1] // 2 * 2  # the codec needs even sides
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), _FRAMES_PER_SECOND, (width, height))
    if not video.isOpened():
        raise InputError("this OpenCV cannot write MP4; choose a .gif")
    try:
        for frame in shown:
            video.write(np.ascontiguousarray(frame[:height, :width, ::-1]))
    finally:
        video.release()


_NUMBERS = 4  # of a pixel, in the largest array


@dataclass
class DeviceCompositor:
    """The compositor of `refocus` on a device as long as that works; safe from several threads."""

    behind: DeviceMethod  # whose device it is; where that fails the CPU takes over in both
    _chain: RefocusChain | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __call__(
        self,
        pictures: tuple[np.ndarray, np.ndarray],
        radii: tuple[np.ndarray, np.ndarray],
        hidden: np.ndarray,
        layers: Sequence[RefocusLayer],
    ) -> np.ndarray | None:
        """Return the picture, see `RefocusChain.composite`; None where the CPU has to do it."""
        device, size = self.behind.on_gpu.device, (hidden.shape[0], hidden.shape[1])
        if self.behind.has_failed or 4 * _NUMBERS * hidden.size > device.largest_bytes:
            return None
        try:
            with self._lock:
                if self._chain is None or self._chain.size != size:
                    self._chain = None  # gives its memory back before the next takes its own
                    self._chain = RefocusChain(device, size)
                return self._chain.composite(pictures, radii, hidden, layers)
        except (DeviceError, OutOfMemoryError) as error:
            self._chain = None
            self.behind.fall_back(error)
        return None


def compositor_of(camera: CodedApertureCamera) -> DeviceCompositor | None:
    """Return what refocuses on the device of a camera; None where it has none."""
    behind = device_method(camera.method)
    return None if behind is None else DeviceCompositor(behind)


_GRID = 256  # cells along a side of a mask; one or more a px of the largest blur of `refocus`, radius 120 px
_BLACK = 0.02  # linear light of the brightest pixel below which a picture counts as black; chosen by hand


def bokeh_mask(name: str) -> np.ndarray:
    """Return the transmission, (256, 256) over [-1, 1]^2, of ``disc``, ``hex`` or a picture file."""
    axis = (np.arange(_GRID, dtype=np.float32) + 0.5) * 2 / _GRID - 1
    x, y = np.meshgrid(axis, axis)
    if name == "disc":
        return np.clip((1 - np.hypot(x, y)) * _GRID / 2 + 0.5, 0, 1).astype(np.float32)
    if name == "hex":
        reach = np.max([np.abs(x * math.cos(t) + y * math.sin(t)) for t in np.radians((30.0, 90.0, 150.0))], axis=0)
        edge = math.cos(math.radians(30))  # distance of the sides of a hexagon with corners at radius 1
        return np.clip((edge - reach) * _GRID / 2 + 0.5, 0, 1).astype(np.float32)
    return _from_picture(Path(name))


def _from_picture(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    if picture is None:
        raise InputError(f"unknown bokeh {str(path)!r}: choose disc, hex, or a readable picture file")
    value = np.atleast_3d(picture).astype(np.float32) / (255.0 if picture.dtype == np.uint8 else 65535.0)
    light = srgb_to_linear(value[..., :3].mean(axis=2))
    if value.shape[2] == 4:
        light = light * value[..., 3]
    if not light.max() > _BLACK:
        raise InputError(f"the bokeh picture {path.name} is black: draw the opening in white")
    side = max(light.shape)
    square = np.zeros((side, side), np.float32)
    top, left = (side - light.shape[0]) // 2, (side - light.shape[1]) // 2
    square[top : top + light.shape[0], left : left + light.shape[1]] = light / light.max()
    return np.asarray(cv2.resize(square, (_GRID, _GRID), interpolation=cv2.INTER_AREA), np.float32)


def bokeh_kernel(mask: np.ndarray, radius_px: float) -> np.ndarray:
    """Return the pupil scaled to a signed blur radius, turned by half in front of the focus; odd, unit sum."""
    return _kernel(mask.tobytes(), mask.shape[0], round(float(radius_px), 3))


@lru_cache(maxsize=256)
def _kernel(data: bytes, count: int, radius_px: float) -> np.ndarray:
    mask = np.frombuffer(data, np.float32).reshape(count, count)
    if radius_px < 0:
        mask = mask[::-1, ::-1]
    radius = abs(radius_px)
    size = 2 * math.ceil(radius) + 1
    # Each cell of the mask is a square of light; its overlap with the pixels is exact and separates into x and y.
    edges = np.arange(size + 1) - size / 2
    cells = ((np.arange(count) + 0.5) * 2 / count - 1) * radius
    half = max(radius / count, 1e-6)
    overlap = np.diff(np.clip((edges[:, None] - cells) / (2 * half) + 0.5, 0, 1), axis=0)
    kernel = overlap @ mask @ overlap.T
    kernel = np.asarray(kernel / kernel.sum(), np.float32)
    kernel.flags.writeable = False
    return kernel

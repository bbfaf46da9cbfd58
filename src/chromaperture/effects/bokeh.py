"""Shapes of the out-of-focus spot: a disc, a hexagon, or a picture."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from chromaperture.color.srgb import srgb_to_linear
from chromaperture.system.errors import InputError

_GRID = 256  # cells along a side of a mask; one or more a px of the largest blur of `refocus`, radius 120 px
_BLACK = 0.02  # linear light of the brightest pixel below which a picture counts as black; chosen by hand


def bokeh_mask(name: str) -> np.ndarray:
    """Return the transmission of the pupil used for refocusing.

    ``name``: ``disc``, ``hex``, or the path of a picture file, light on dark; its alpha channel multiplies the light.
    Returns (256, 256) float32 in [0, 1] over [-1, 1]^2 in pupil radii. Raises InputError: no such shape or file, or the
    picture is black.
    """
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
    """Return the pupil scaled to a blur radius; (s, s) float32, unit sum, s odd.

    ``mask`` (n, n) float32: from `bokeh_mask`; ``radius_px``: signed: upright beyond the focus, rotated by 180 degrees
    in front of it.
    """
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

"""Arrays as text inside a page: bytes of equal weight together, deflated, in base64; `maps.js` unpacks them."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np

from chromaperture.color.color_maps import draw_levels

# Pixels of a map, and points of a cloud, in one page; chosen by hand: five maps are 15 MB of page, and a phone turns
# the points without a jerk.
MOST_PIXELS = 1_000_000
MOST_POINTS = 400_000
_LEVEL = 6  # of zlib; 9 takes four times as long for 1 % less, as measured on depth of 720x480 px


def packed(values: np.ndarray) -> str:
    """Encode an array for a page; little-endian, row by row.

    The first bytes of all numbers come first, then the second, and so on: neighbours share their exponents, and
    deflate finds that. Depth of 720x480 px takes 0.77 MB so, and 1.0 MB otherwise.

    Returns base64 of a zlib stream.
    """
    values = np.ascontiguousarray(values)
    raw = values.astype(values.dtype.newbyteorder("<"), copy=False).reshape(-1).view(np.uint8)
    planes = np.ascontiguousarray(raw.reshape(-1, values.dtype.itemsize).T)
    return base64.b64encode(zlib.compress(planes.tobytes(), _LEVEL)).decode("ascii")


def every(shape: tuple[int, ...], most: int = MOST_PIXELS) -> int:
    """Return of how many columns and rows a page shows one, so that it holds at most ``most`` pixels."""
    step = 1
    while -(-shape[0] // step) * -(-shape[1] // step) > most:
        step += 1
    return step


def packed_map(values: np.ndarray) -> dict[str, Any]:
    """Return a map (H, W), NaN unknown, as `maps.js` reads it; every n-th pixel of a large one."""
    step = every(values.shape)
    shown = np.asarray(values[::step, ::step], np.float32)
    return {
        "width": values.shape[1],
        "height": values.shape[0],
        "step": step,
        "columns": shown.shape[1],
        "rows": shown.shape[0],
        "values": packed(shown),
    }


def packed_points(points_mm: np.ndarray, colors: np.ndarray) -> dict[str, Any]:
    """Return points (N, 3) float, mm, and their colours (N, 3) uint8, sRGB, as `cloud.js` reads them."""
    step = max(1, -(-len(points_mm) // MOST_POINTS))
    shown = np.asarray(points_mm[::step], np.float32)
    return {
        "count": len(points_mm),
        "shown": len(shown),
        "points": packed(shown),
        "colors": packed(np.asarray(colors[::step], np.uint8)),
    }


def palette(name: str) -> str:
    """Return the 256 colours of a map and that of unknown pixels, base64 of (257, 3) bytes."""
    levels = np.append(np.arange(256) / 255.999, np.nan)[None]
    return base64.b64encode(draw_levels(levels, name)[0].tobytes()).decode("ascii")

"""Pictures of 8 bits to light on the device, and its maps to pictures: both ends of a chain in a browser."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.matching.device.device import Array, Chain

ROW_PX = 64  # a row of a picture that WebGPU copies to or from a texture begins at a multiple of 256 bytes
_SPARSE = 8192  # pixels from which ranges of colours are found; their 2nd percentile is good to 0.15 %


def row_pitch(width: int) -> int:
    """Return the pixels from row to row of a picture that WebGPU copies."""
    return -(-width // ROW_PX) * ROW_PX


def add_light_of_counts(chain: Chain, size: tuple[int, int], light: np.ndarray) -> Array:
    """Add the stage from ``counts`` to ``image``, (H, W, 3); ``light``: (256,) float, linear light of the counts.

    ``counts`` is a picture ``form[0]`` times as large as the image, of ``form[1]`` pixels from row to row.
    """
    height, width = size
    image = chain.array("image", 3 * height * width)
    counts, form = chain.array("counts", height * row_pitch(width), np.uint32), chain.array("form", 4, np.uint32)
    chain.add(
        "light_of_counts", [counts, form, chain.constant("light", light), image], height * width, width=width,
        height=height, saturation=SATURATION,
    )  # fmt: skip
    return image


def add_sparse_maps(
    chain: Chain, size: tuple[int, int], maps: tuple[str, str], *, shifts: np.ndarray, balance: np.ndarray
) -> tuple[int, int]:
    """Add the stage to ``sparse``, (3, h, w): depth, error bar and the brightest channel of every so many pixels.

    Returns (h, w). ``maps``: names of depth and error bar, of ``size`` (H, W); ``shifts``: (3, 2), displacement of the
    channels per px of disparity; ``balance``: (3,), factors of the channels that make white of white.
    """
    height, width = size
    step = max(1, round(math.sqrt(height * width / _SPARSE)))
    down, across = -(-height // step), -(-width // step)
    sparse = chain.array("sparse", 3 * down * across, np.uint32)
    chain.add(
        "sparse_maps", [*_shown(chain, maps), sparse], down * across, step=step, sparse_width=across,
        sparse_height=down, **_seen(size, shifts, balance),
    )  # fmt: skip
    return down, across


def add_colored_maps(
    chain: Chain,
    size: tuple[int, int],
    maps: tuple[str, str],
    colors: np.ndarray,
    *,
    shifts: np.ndarray,
    balance: np.ndarray,
    most_relative: float | None,
) -> None:
    """Add the stage to ``picture``, (H, pitch), of what ``look`` says: view, low, high, white.

    ``colors``: (2, 257, 3) uint8, sRGB, of depth and error bar, the last for unknown pixels; colours are dark where the
    error bar over depth is beyond ``most_relative``. The rest as `add_sparse_maps`.
    """
    height, width = size
    packed = colors.astype(np.uint32) @ np.array([1, 1 << 8, 1 << 16], np.uint32) | np.uint32(0xFF000000)
    pitch = row_pitch(width)
    look, picture = chain.array("look", 4), chain.array("picture", height * pitch, np.uint32)
    chain.add(
        "colored_maps", [*_shown(chain, maps), chain.constant("colors", packed.ravel()), look, picture], height * width,
        pitch=pitch, is_depth=most_relative is not None, most_relative=float(most_relative or 0),
        **_seen(size, shifts, balance),
    )  # fmt: skip


def _shown(chain: Chain, maps: tuple[str, str]) -> list[Array]:
    """Return picture, disparity, depth and error bar; an array may be bound twice where it is only read."""
    return [chain.arrays[name] for name in ("image", "disparity", *maps)]


def _seen(size: tuple[int, int], shifts: np.ndarray, balance: np.ndarray) -> dict[str, Any]:
    return {
        "width": size[1], "height": size[0], "shifts": [float(v) for v in np.ravel(shifts)],
        "balance": [float(v) for v in balance],
    }  # fmt: skip

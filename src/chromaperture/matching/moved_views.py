"""Displacement of the channels by the lens at every disparity alike, taken off before they are matched.

Views move along their directions in the pupil with the disparity. A lens adds to that: lateral colour moves a channel
over the frame, and vignetting and axial colour move its centroid. Pairs of three channels then agree at disparities of
their own, up to 0.4 px apart through a double Gauss (docs/decisions.md, *Channels where the lens moves them*).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

# Of a px of the halved picture, to which displacements are rounded: weights between four pixels are then whole parts of
# 1024, so that sums of light in whole units are exact (`whole_light.py`). OpenCV's remap has the same parts.
MOVE_PARTS = 32


class PixelMaps(NamedTuple):
    """Where a view of the halved picture is sampled, as `cv2.remap` takes it."""

    pixels: np.ndarray  # (h, w, 2) int16: column and row of the upper left of four pixels
    parts: np.ndarray  # (h, w) uint16: parts of the way to the next row, times `MOVE_PARTS`, and to the next column


def halved_moves(table_px: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the displacement of every view at every pixel of the halved picture; (K, h, w, 2) int16.

    ``table_px`` (rows, columns, K, 2) float, px of the full picture: at places evenly spaced over the frame, the first
    and last on its border pixels; linear between them; ``size`` (int, int): H, W of the full picture. Returns (K, h, w,
    2) int16: (x, y) in parts of a px of the halved picture, `MOVE_PARTS` a px.
    """
    table = np.asarray(table_px, float)
    return _halved_moves(table.tobytes(), table.shape, *size)


def pixel_maps(table_px: np.ndarray, size: tuple[int, int]) -> list[PixelMaps]:
    """Return where every view of the halved picture is sampled; parameters as those of `halved_moves`."""
    table = np.asarray(table_px, float)
    return _pixel_maps(table.tobytes(), table.shape, *size)


def moved(view: np.ndarray, maps: PixelMaps) -> np.ndarray:
    """Sample a halved view (h, w) float32 between four pixels each, the picture continued by its border."""
    return np.asarray(cv2.remap(view, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


@lru_cache(maxsize=2)  # tens of milliseconds, for every picture of a camera alike
def _halved_moves(table: bytes, shape: tuple[int, ...], height: int, width: int) -> np.ndarray:
    values = np.frombuffer(table).reshape(shape)
    rows, columns = (_weights(n, count) for n, count in zip((height, width), shape[:2], strict=True))
    parts = np.einsum("yr,rckd,xc->kyxd", rows, MOVE_PARTS / 2 * values, columns, optimize=True)
    return np.rint(parts).astype(np.int16)


@lru_cache(maxsize=2)
def _pixel_maps(table: bytes, shape: tuple[int, ...], height: int, width: int) -> list[PixelMaps]:
    moves = _halved_moves(table, shape, height, width).astype(np.int32)
    moves[..., 0] += MOVE_PARTS * np.arange(moves.shape[2])
    moves[..., 1] += MOVE_PARTS * np.arange(moves.shape[1])[:, None]
    pixels, parts = (moves // MOVE_PARTS).astype(np.int16), (moves % MOVE_PARTS).astype(np.uint16)
    return [
        PixelMaps(np.ascontiguousarray(at), np.ascontiguousarray(MOVE_PARTS * part[..., 1] + part[..., 0]))
        for at, part in zip(pixels, parts, strict=True)
    ]


def _weights(full: int, count: int) -> np.ndarray:
    """Return the weights of a side's places in every second pixel; (ceil(full / 2), count)."""
    place = np.arange(0, full, 2) * ((count - 1) / max(full - 1, 1))
    return np.asarray(np.maximum(1 - np.abs(place[:, None] - np.arange(count)), 0))

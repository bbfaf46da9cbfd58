"""A blur that changes over the frame: the picture is restored in overlapping tiles, each with its own kernels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

Restorer = Callable[[tuple[slice, slice], tuple[float, float]], np.ndarray]


def tile_slices(shape: tuple[int, int], *, tile_px: int, overlap_px: int) -> Iterator[tuple[slice, slice]]:
    """Cut a frame into tiles of about equal size, each wider than its share by the overlap on every side."""
    axes = []
    for size in shape:
        count = max(1, round(size / tile_px))
        edges = np.linspace(0, size, count + 1).astype(int)
        axes.append(
            [
                slice(max(int(a) - overlap_px, 0), min(int(b) + overlap_px, size))
                for a, b in pairwise(edges)
            ]
        )
    for rows in axes[0]:
        for columns in axes[1]:
            yield rows, columns


def by_tiles(shape: tuple[int, int], restore: Restorer, *, tile_px: int = 256, overlap_px: int = 24) -> np.ndarray:
    """Restore tile by tile and blend the overlaps.

    Parameters
    ----------
    shape : (int, int)
    restore : callable
        Called with a tile and its centre in the frame, (x, y) from -1 to 1; gives (h, w, 3).
    tile_px, overlap_px : int
        Over a tile the blur counts as constant; the overlap should hold its kernel.

    Returns
    -------
    (H, W, 3) float32
    """
    total, weights = np.zeros((*shape, 3), np.float32), np.zeros((*shape, 1), np.float32)
    for rows, columns in tile_slices(shape, tile_px=tile_px, overlap_px=overlap_px):
        middle = ((columns.start + columns.stop) / shape[1] - 1, (rows.start + rows.stop) / shape[0] - 1)
        weight = np.outer(*(_ramp(s, n, overlap_px) for s, n in zip((rows, columns), shape, strict=True)))[..., None]
        total[rows, columns] += weight * restore((rows, columns), middle)
        weights[rows, columns] += weight
    return total / weights


def _ramp(piece: slice, size: int, overlap_px: int) -> np.ndarray:
    """Weight along one side of a tile: rises over the overlap, except at the frame's own rim."""
    length = piece.stop - piece.start
    x = np.arange(length) + 0.5
    rise = np.ones(length)
    if piece.start > 0:
        rise = np.minimum(rise, x / (2 * overlap_px))
    if piece.stop < size:
        rise = np.minimum(rise, (length - x) / (2 * overlap_px))
    return np.clip(rise, 1e-3, 1).astype(np.float32)

"""Restore a picture in overlapping tiles, each with its own kernels, where the blur changes over the frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise, product

import numpy as np

Restorer = Callable[[tuple[slice, slice], tuple[float, float]], np.ndarray]


def by_tiles(shape: tuple[int, int], restore: Restorer, *, tile_px: int, overlap_px: int) -> np.ndarray:
    """Restore tile by tile and blend the overlaps.

    ``shape`` (int, int); ``restore``: called with a tile and the frame position of its centre, (x, y) from -1 to 1;
    returns (h, w, 3); ``tile_px``, ``overlap_px``: over a tile the blur counts as constant; the overlap should be as
    wide as its kernel. Returns (H, W, 3) float32.
    """
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

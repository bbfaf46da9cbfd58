"""Alignment of channels that are displaced horizontally only, one row after the other: a row stays in the cache.

`shift_kernels.shift_along_rows`, `visibility.visible_from` and `fill_hidden` compute the same one after the other, of
the whole picture.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from chromaperture.color.shift_kernels import A
from chromaperture.color.visibility import OCCLUSION_PX, RADIUS_PX, STILL, fill_hidden_rows
from chromaperture.system.compilation import compiled
from chromaperture.system.threads import each_band

_PAD = 8  # samples beyond both ends of a row: cubics are evaluated up to 4 px outside, and reach 2 px farther


_BAND_ROWS = 128  # of which `RADIUS_PX` more on both sides are computed again; chosen by hand


class RowMoves(NamedTuple):
    """How channels are displaced horizontally."""

    moves: np.ndarray  # (3,) float32: displacement of the channels per px of disparity; 0 leaves a channel as it is
    views: np.ndarray  # (3,) float32: the same for the depth buffer; 0 sees everything
    order: np.ndarray  # (3,) int64: channels, the best guide of `fill_hidden` first


def row_moves(directions: np.ndarray) -> RowMoves | None:
    """Return how channels of these directions, (3, 2) x before y, move along rows; None where one moves across."""
    u = np.asarray(directions, float)
    lengths = np.linalg.norm(u, axis=1)
    if (np.abs(u[:, 1]) >= STILL).any():
        return None
    across = u[:, 0].astype(np.float32)
    zero = np.float32(0)
    moves, views = np.where(np.abs(u[:, 0]) < STILL, zero, across), np.where(lengths < STILL, zero, across)
    return RowMoves(moves, views, np.argsort(lengths, kind="stable"))


def align_by_rows(
    image: np.ndarray, disparity_rows: Callable[[slice], np.ndarray], along: RowMoves, gains: np.ndarray | None = None
) -> np.ndarray:
    """Align the channels; (H, W, 3) float32 of what `aligned_bands` makes."""
    color = np.empty(image.shape, np.float32)
    aligned_bands(image, disparity_rows, along, color.__setitem__, gains)
    return color


def aligned_bands(
    image: np.ndarray,
    disparity_rows: Callable[[slice], np.ndarray],
    along: RowMoves,
    take: Callable[[slice, np.ndarray], None],
    gains: np.ndarray | None = None,
    *,
    multiple: int = 1,
) -> None:
    """Align the channels in bands of rows, each from its first sample to its last.

    ``image`` (H, W, 3) float32, linear RGB; ``disparity_rows``: returns the disparity of some rows, (rows, W) float32,
    px, finite; ``take``: gets the rows of every band and its colours, (rows, W, 3) float32, as `align_channels` makes
    them, then `white_balance`; on any thread, in any order; ``gains`` (3,) float: by which the aligned channels are
    multiplied; what is below black then becomes black; ``multiple``: of which every band's first row is one.
    """
    height = len(image)
    picture = np.ascontiguousarray(image, np.float32)
    factors = None if gains is None else np.asarray(gains, np.float32)

    def align(band: slice) -> None:
        seen = slice(max(0, band.start - RADIUS_PX), min(height, band.stop + RADIUS_PX))
        disparity = np.ascontiguousarray(disparity_rows(seen), np.float32)
        moved, visible = np.empty((*disparity.shape, 3), np.float32), np.empty((*disparity.shape, 3), np.bool_)
        _align(picture[seen], disparity, along.moves, along.views, moved, visible)
        first, last = band.start - seen.start, band.stop - seen.start
        fill_hidden_rows(moved, visible, disparity, along.order, moved, first, last)
        color = moved[first:last]
        if factors is not None:
            scale_channels(color, factors, color)
        take(band, color)

    each_band(align, height, rows_a_band=-(-_BAND_ROWS // multiple) * multiple)


@compiled(error_model="numpy")
def _align(image, disparity, moves, views, color, visible):  # type: ignore[no-untyped-def]
    width = disparity.shape[1]
    padded, nearest = np.empty(width + 2 * _PAD, np.float32), np.empty(width + 2 * _PAD, np.float32)
    target, weights = np.empty(width, np.uint32), np.empty((4, width), np.float32)
    one, two, three = np.float32(1), np.float32(2), np.float32(3)
    left, right, far = np.float32(-4), np.float32(width + 4), np.float32(1e9)
    for y in range(len(disparity)):
        line = disparity[y]
        for k in range(3):
            move, view = moves[k], views[k]
            if move == 0:
                for x in range(width):
                    color[y, x, k] = image[y, x, k]
            else:
                for x in range(width):
                    padded[x + _PAD] = image[y, x, k]
                padded[:_PAD] = padded[_PAD]
                padded[width + _PAD :] = padded[width + _PAD - 1]
                for x in range(width):  # as `shift_kernels._shift`, from whose clamped samples the padding frees
                    at = min(max(np.float32(x) + line[x] * move, left), right) + np.float32(_PAD)
                    first = np.int32(at)
                    t = at - np.float32(first)
                    u = one - t
                    w0, w3 = A * t * u * u, A * u * t * t
                    w1 = ((A + two) * t - (A + three)) * t * t + one
                    target[x] = first - 1
                    weights[0, x], weights[1, x], weights[2, x], weights[3, x] = w0, w1, one - w0 - w1 - w3, w3
                for x in range(width):
                    i = np.uint64(target[x])
                    color[y, x, k] = (
                        weights[0, x] * padded[i] + weights[1, x] * padded[i + np.uint64(1)]
                        + weights[2, x] * padded[i + np.uint64(2)] + weights[3, x] * padded[i + np.uint64(3)]
                    )  # fmt: skip
            if view == 0:
                for x in range(width):
                    visible[y, x, k] = True
                continue
            nearest[:] = far
            for x in range(width):  # what lies outside of the picture goes to the padding
                t = min(max(np.float32(x) + line[x] * view, np.float32(-2)), np.float32(width + 1)) + np.float32(8.5)
                i = np.uint32(t)
                target[x] = i
                nearest[i] = min(nearest[i], line[x])
            for i in range(_PAD):
                nearest[i] = nearest[width + _PAD + i] = -far  # not seen
            for x in range(width):
                visible[y, x, k] = nearest[target[x]] > line[x] - np.float32(OCCLUSION_PX)


@compiled(error_model="numpy")
def scale_channels(color, gains, out):  # type: ignore[no-untyped-def]
    """Multiply the channels of (H, W, 3) by gains, into ``out``; what is below black becomes black."""
    red, green, blue = gains[0], gains[1], gains[2]
    for y in range(color.shape[0]):
        for x in range(color.shape[1]):
            out[y, x, 0] = max(color[y, x, 0] * red, np.float32(0))
            out[y, x, 1] = max(color[y, x, 1] * green, np.float32(0))
            out[y, x, 2] = max(color[y, x, 2] * blue, np.float32(0))

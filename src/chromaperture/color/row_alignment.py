"""What each channel sees, and alignment of channels that are displaced horizontally only.

Every channel looks past the edges of near things from its own side, so that a strip of the background is missing in it.
Its colour is predicted from the channels that see it: within a surface the colours of a small neighbourhood lie on a
line. `aligned_bands` does row by row, in the cache, what `shift_along_rows`, `visible_from` and `fill_hidden` do for
the whole picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from chromaperture.system.compilation import compiled
from chromaperture.system.threads import each_band, in_parallel

# Chosen by hand, not tuned, unless a reason is given.
STILL = 1e-3  # displacement per px of disparity that counts as none: the accuracy of `view_directions`
OCCLUSION_PX = 0.5  # difference of disparity from which the nearer pixel occludes the farther
RADIUS_PX = 7  # half side of the neighbourhood in which the colour line is fitted
SAME_SURFACE_PX = 1  # largest difference of disparity within a surface
FEWEST = 12  # visible neighbours of the same surface for a fit of two parameters
RIDGE = np.float32(1e-4)  # variance of a uniform neighbourhood, (white level)^2: noise of 1 %


def visible_from(disparity_px: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Find the pixels of the centre view that a channel sees, by a depth buffer in its view; (H, W) bool."""
    ux, uy = np.float32(direction[0]), np.float32(direction[1])
    if math.hypot(float(direction[0]), float(direction[1])) < STILL:
        return np.ones(disparity_px.shape, bool)
    seen = np.empty(disparity_px.shape, np.bool_)
    disparity = np.ascontiguousarray(disparity_px, np.float32)
    if abs(float(direction[1])) < STILL:  # rows are independent
        in_parallel(lambda _, first, last: _visible_rows(disparity, ux, seen, first, last), len(disparity))
    else:
        _visible(disparity, ux, uy, seen)
    return seen


@compiled(error_model="numpy")
def _visible_rows(disparity, ux, seen, first_row, last_row):  # type: ignore[no-untyped-def]
    width = disparity.shape[1]
    target = np.empty(width, np.int32)
    for y in range(first_row, last_row):
        nearest = np.full(width, np.float32(1e9))
        for x in range(width):
            d = disparity[y, x]
            t = min(max(np.float32(x) + d * ux, np.float32(-2)), np.float32(width + 1)) + np.float32(4.5)
            target[x] = np.int32(t) - 4  # rounds to nearest: truncation of a positive number
        for x in range(width):
            t = target[x]
            if 0 <= t < width:
                nearest[t] = min(nearest[t], disparity[y, x])
        for x in range(width):
            t = target[x]
            seen[y, x] = 0 <= t < width and nearest[t] > disparity[y, x] - np.float32(OCCLUSION_PX)


@compiled()
def _visible(disparity, ux, uy, seen):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    nearest = np.full((height, width), np.float32(1e9))
    for y in range(height):
        for x in range(width):
            d = disparity[y, x]
            ty, tx = math.floor(y + d * uy + np.float32(0.5)), math.floor(x + d * ux + np.float32(0.5))
            if 0 <= tx < width and 0 <= ty < height and d < nearest[ty, tx]:
                nearest[ty, tx] = d
    for y in range(height):
        for x in range(width):
            d = disparity[y, x]
            ty, tx = math.floor(y + d * uy + np.float32(0.5)), math.floor(x + d * ux + np.float32(0.5))
            inside = 0 <= tx < width and 0 <= ty < height
            seen[y, x] = inside and nearest[ty, tx] > d - np.float32(OCCLUSION_PX)


def fill_hidden(
    color: np.ndarray,
    visible: np.ndarray,
    disparity_px: np.ndarray,
    order: np.ndarray,
    *,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Predict occluded samples from the colour line of their own surface.

    ``color`` (H, W, 3) float32, linear RGB: aligned channels; ``visible`` (H, W, 3) bool: from `visible_from`, for each
    channel; ``disparity_px`` (H, W) float32, px, no NaN; ``order`` (3,) int: channels, the best guide first: the one
    that moves least is occluded least; ``out`` (H, W, 3) float32: result; may be ``color``, of which only visible
    samples are read. Returns (H, W, 3) float32; a sample with too few visible neighbours keeps its value.
    """
    if out is None:
        out = np.array(color, np.float32)
    color, disparity = np.ascontiguousarray(color, np.float32), np.asarray(disparity_px, np.float32)
    order = np.asarray(order)
    in_parallel(
        lambda _, first, last: fill_hidden_rows(color, visible, disparity, order, out, first, last), len(disparity)
    )
    return out


@compiled()
def fill_hidden_rows(color, visible, disparity, order, out, first_row, last_row):  # type: ignore[no-untyped-def]
    """Do the work of `fill_hidden` for some rows."""
    height, width = disparity.shape
    for y in range(first_row, last_row):
        for x in range(width):
            for k in range(3):
                if visible[y, x, k]:
                    continue
                guide = -1
                for candidate in order:
                    if candidate != k and visible[y, x, candidate]:
                        guide = candidate
                        break
                count = 0
                sg, sk, sgg, sgk = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
                for j in range(max(0, y - RADIUS_PX), min(height, y + RADIUS_PX + 1)):
                    for i in range(max(0, x - RADIUS_PX), min(width, x + RADIUS_PX + 1)):
                        if not visible[j, i, k] or abs(disparity[j, i] - disparity[y, x]) > SAME_SURFACE_PX:
                            continue
                        if guide >= 0 and not visible[j, i, guide]:
                            continue
                        g = color[j, i, guide] if guide >= 0 else np.float32(0)
                        v = color[j, i, k]
                        sg += g
                        sk += v
                        sgg += g * g
                        sgk += g * v
                        count += 1
                if count < FEWEST:
                    continue
                n = np.float32(count)
                slope = (sgk / n - sg * sk / n / n) / (sgg / n - sg * sg / n / n + RIDGE)
                guided = color[y, x, guide] - sg / n if guide >= 0 else np.float32(0)
                out[y, x, k] = max(sk / n + slope * guided, np.float32(0))


A = np.float32(-0.75)  # slope of the cubic at 1, as in OpenCV: `cv2.remap` of release 5 gives the same picture


def shift_along_rows(image: np.ndarray, displacement_px: np.ndarray, channel: int, out: np.ndarray) -> None:
    """Sample a channel at x + displacement by cubic interpolation into ``out``, with replicated borders."""
    displacement = np.ascontiguousarray(displacement_px)
    in_parallel(lambda _, first, last: _shift(image, displacement, channel, out, first, last), len(displacement))


@compiled(error_model="numpy")
def _shift(image, displacement, k, out, first_row, last_row):  # type: ignore[no-untyped-def]
    width = displacement.shape[1]
    one, two, three, right = np.float32(1), np.float32(2), np.float32(3), np.float32(width + 4)
    for y in range(first_row, last_row):
        for x in range(width):
            at = np.float32(x) + displacement[y, x]
            # Beyond 4 px outside only the border is sampled. Adding 8 makes truncation round down.
            at = min(max(at, np.float32(-4)), right) + np.float32(8)
            first = np.int32(at)
            t = at - np.float32(first)
            first -= np.int32(8)
            # Weights of the cubic at distances 1 + t, t, 1 - t and 2 - t; their sum is 1.
            u = one - t
            w0, w3 = A * t * u * u, A * u * t * t
            w1 = ((A + two) * t - (A + three)) * t * t + one
            w2 = one - w0 - w1 - w3
            if 1 <= first < width - 2:
                out[y, x, k] = (
                    w0 * image[y, first - 1, k] + w1 * image[y, first, k]
                    + w2 * image[y, first + 1, k] + w3 * image[y, first + 2, k]
                )  # fmt: skip
            else:
                total = np.float32(0)
                for n, w in enumerate((w0, w1, w2, w3)):
                    total += w * image[y, min(max(first - 1 + n, 0), width - 1), k]
                out[y, x, k] = total


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

"""Alignment of channels that are displaced horizontally only, one row after the other: a row stays in the cache.

`shift_kernels.shift_along_rows` and `visibility.visible_from` compute the same for one channel at a time.
"""

from __future__ import annotations

import numpy as np

from chromaperture.color.shift_kernels import A
from chromaperture.color.visibility import OCCLUSION_PX
from chromaperture.compilation import compiled
from chromaperture.threads import in_parallel

_PAD = 8  # samples beyond both ends of a row: cubics are evaluated up to 4 px outside, and reach 2 px farther


def align_rows(
    image: np.ndarray, disparity_px: np.ndarray, moves: np.ndarray, views: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sample each channel at x + its move times the disparity, by cubics, and find which pixels it sees.

    Parameters
    ----------
    image : (H, W, 3) float32
    disparity_px : (H, W) float32, px, finite
    moves : (3,) float32
        Displacement of the channels per px of disparity; 0 leaves a channel as it is.
    views : (3,) float32
        The same for the depth buffer; 0 sees everything.

    Returns
    -------
    color : (H, W, 3) float32
    visible : (H, W, 3) bool
    """
    image, disparity = (np.ascontiguousarray(part, np.float32) for part in (image, disparity_px))
    color, visible = np.empty(image.shape, np.float32), np.empty(image.shape, np.bool_)
    along = np.asarray(moves, np.float32), np.asarray(views, np.float32)
    in_parallel(lambda _, first, last: _align(image, disparity, *along, color, visible, first, last), len(disparity))
    return color, visible


@compiled(error_model="numpy")
def _align(image, disparity, moves, views, color, visible, first_row, last_row):  # type: ignore[no-untyped-def]
    width = disparity.shape[1]
    padded, nearest = np.empty(width + 2 * _PAD, np.float32), np.empty(width + 2 * _PAD, np.float32)
    target, weights = np.empty(width, np.uint32), np.empty((4, width), np.float32)
    one, two, three = np.float32(1), np.float32(2), np.float32(3)
    left, right, far = np.float32(-4), np.float32(width + 4), np.float32(1e9)
    for y in range(first_row, last_row):
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


def balance(color: np.ndarray, gains: np.ndarray, out: np.ndarray) -> None:
    """Scale the channels, (H, W, 3) float32, into ``out``, which may be the same; below black all is black."""
    factors = np.asarray(gains, np.float32)
    in_parallel(lambda _, first, last: _balance(color, factors, out, first, last), len(color))


@compiled(error_model="numpy")
def _balance(color, gains, out, first_row, last_row):  # type: ignore[no-untyped-def]
    red, green, blue = gains[0], gains[1], gains[2]
    for y in range(first_row, last_row):
        for x in range(color.shape[1]):
            out[y, x, 0] = max(color[y, x, 0] * red, np.float32(0))
            out[y, x, 1] = max(color[y, x, 1] * green, np.float32(0))
            out[y, x, 2] = max(color[y, x, 2] * blue, np.float32(0))

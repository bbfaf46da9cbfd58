"""Occlusion in the channels' views, and the colour of occluded pixels.

Every channel looks past the edges of near things from its own side. Seen from the pupil's centre, a strip of the
background is therefore missing in that channel. Its colour is predicted from the channels that do see it: within a
surface the colours of a small neighbourhood lie on a line, so one channel is an affine function of another.
"""

from __future__ import annotations

import math

import numpy as np

from chromaperture.system.compilation import compiled
from chromaperture.system.threads import in_parallel

# Chosen by hand, not tuned, unless a reason is given.
STILL = 1e-3  # displacement per px of disparity that counts as none: the accuracy of `view_directions`
OCCLUSION_PX = 0.5  # difference of disparity from which the nearer pixel occludes the farther
RADIUS_PX = 7  # half side of the neighbourhood in which the colour line is fitted
SAME_SURFACE_PX = 1  # largest difference of disparity within a surface
FEWEST = 12  # visible neighbours of the same surface for a fit of two parameters
RIDGE = np.float32(1e-4)  # variance of a uniform neighbourhood, (white level)^2: noise of 1 %


def visible_from(disparity_px: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Find the pixels of the centre view that a channel sees, by a depth buffer in the channel's view.

    ``disparity_px`` (H, W) float32, px, no NaN; the smaller is the nearer; ``direction`` (2,) float: displacement (x,
    y) of the channel per px of disparity. Returns (H, W) bool.
    """
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

"""What a displaced view cannot see, and the colour it would have had there.

Every channel looks past the edges of near things from its own side. Seen from the pupil's centre a strip of the
background is therefore missing in that channel. Its colour is told by the channels that do see it: within a surface
the colours of a small neighbourhood lie on a line, so that one channel is an affine function of another.
"""

from __future__ import annotations

import math

import numba
import numpy as np

_HIDDEN = 0.5  # px of disparity by which the hider is nearer
_REACH = 7  # half side of the neighbourhood that tells the colour line
_LEAST = 12  # known neighbours of the same surface
_RIDGE = np.float32(1e-4)  # variance below which a neighbourhood is plain, (white level)^2


def visible_from(disparity_px: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Tell which pixels of the centre view a channel sees: a depth buffer in the channel's own view.

    Parameters
    ----------
    disparity_px : (H, W) float32, px, no NaN; the smaller is the nearer
    direction : (2,) float
        Displacement (x, y) of the channel per px of disparity.

    Returns
    -------
    (H, W) bool
    """
    ux, uy = float(direction[0]), float(direction[1])
    if math.hypot(ux, uy) < 1e-3:
        return np.ones(disparity_px.shape, bool)
    seen = np.empty(disparity_px.shape, np.bool_)
    disparity = np.ascontiguousarray(disparity_px, np.float32)
    if abs(uy) < 1e-3:  # rows do not meddle with each other
        _visible_rows(disparity, np.float32(ux), seen)
    else:
        _visible(disparity, np.float32(ux), np.float32(uy), seen)
    return seen


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
def _visible_rows(disparity, ux, seen):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for y in numba.prange(height):
        nearest, place = np.full(width, np.float32(1e9)), np.empty(width, np.int32)
        for x in range(width):
            d = disparity[y, x]
            t = min(max(np.float32(x) + d * ux, np.float32(-2)), np.float32(width + 1)) + np.float32(4.5)
            place[x] = np.int32(t) - 4  # towards zero is down there
        for x in range(width):
            t = place[x]
            if 0 <= t < width:
                nearest[t] = min(nearest[t], disparity[y, x])
        for x in range(width):
            t = place[x]
            seen[y, x] = 0 <= t < width and nearest[t] > disparity[y, x] - np.float32(_HIDDEN)


@numba.njit(cache=True, nogil=True)
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
            seen[y, x] = inside and nearest[ty, tx] > d - np.float32(_HIDDEN)


def fill_hidden(
    color: np.ndarray,
    visible: np.ndarray,
    disparity_px: np.ndarray,
    order: np.ndarray,
    *,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Give hidden samples the colour line of their own surface.

    Parameters
    ----------
    color : (H, W, 3) float32, linear RGB
        Aligned channels.
    visible : (H, W, 3) bool
        Which of its samples are seen.
    disparity_px : (H, W) float32, px, no NaN
    order : (3,) int
        Channels, the best guide first: the one that moves least sees most.
    out : (H, W, 3) float32, optional
        Where to; may be ``color``, of which only visible samples are read.

    Returns
    -------
    (H, W, 3) float32
    """
    if out is None:
        out = np.array(color, np.float32)
    depth = np.asarray(disparity_px, np.float32)
    _fill(np.ascontiguousarray(color, np.float32), visible, depth, np.asarray(order), out)
    return out


@numba.njit(cache=True, parallel=True)
def _fill(color, visible, disparity, order, out):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for y in numba.prange(height):
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
                for j in range(max(0, y - _REACH), min(height, y + _REACH + 1)):
                    for i in range(max(0, x - _REACH), min(width, x + _REACH + 1)):
                        if not visible[j, i, k] or abs(disparity[j, i] - disparity[y, x]) > 1:
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
                if count < _LEAST:
                    continue  # nothing better is known than what the sample shows
                n = np.float32(count)
                slope = (sgk / n - sg * sk / n / n) / (sgg / n - sg * sg / n / n + _RIDGE)
                guided = color[y, x, guide] - sg / n if guide >= 0 else np.float32(0)
                out[y, x, k] = max(sk / n + slope * guided, np.float32(0))

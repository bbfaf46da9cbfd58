# mypy: disallow-untyped-defs=False
"""Second half of the compiled matcher: a strip of columns from scores filtered along x to the winner.

A strip is read once, upwards; the upward recursion of all its layers stays in the cache until the downward recursion
meets it. The winner is found with the layer's number in the low bits of the score, so that the largest lane says who
it is.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from chromaperture.disparity import simd as v
from chromaperture.disparity.bands import SCORE_SCALE, STRIP, compiled, compiled_parallel

_ONE = np.float32(1)
_ZERO = np.float32(0)
_HALF = np.float32(0.5)
_RAISED = np.float32(2)  # added to scores in [-1, 1]: positive floats are ordered as their bits are
_BEND_FLOOR = np.float32(1e-12)


@compiled_parallel
def take_winners(volume, share, links_y, near, layers, first, step, scratch, disparity, peak, curvature):
    """Filter the volume along y, find the best layer, refine it by a parabola.

    Parameters
    ----------
    volume : (strips, H, slabs, STRIP, 8) int16, flat
    share : (H, W) float32; the weights the scores stand for
    links_y : (H, W) float32; weight with which a pixel hears its upper neighbour
    near : float32; link weight on an even guide
    layers : int
    first, step : float32, px; disparity of the first layer and distance of two
    scratch : (threads, n) float32
    disparity, peak, curvature : (H, W) float32; written
    """
    height, width = share.shape
    strips = (width + STRIP - 1) // STRIP
    slabs = (layers + v.LANES - 1) // v.LANES
    threads = len(scratch)
    for thread in prange(threads):
        own = scratch[thread]
        links = np.zeros((height + 1, STRIP), np.float32)
        scale = np.empty((height, STRIP), np.float32)
        inverse = np.empty((height, STRIP), np.float32)
        tags = _tags(slabs)
        for strip in range(strips * thread // threads, strips * (thread + 1) // threads):
            _strip_maps(share, links_y, near, strip, links, scale, inverse)
            _take_strip(
                volume, strip, height, slabs, near, links, scale, inverse, tags, layers, first, step, own,
                disparity, peak, curvature,
            )  # fmt: skip


@compiled
def _tags(slabs):
    """Bits that name each layer (the earlier the larger, to win a tie), behind the mask of the bits to keep."""
    layers = slabs * v.LANES
    mask = 1
    while mask < layers:
        mask *= 2
    mask -= 1
    tags = np.empty(layers + v.LANES, np.int32)
    for s in range(layers):
        tags[v.LANES + s] = mask - s
    for i in range(v.LANES):
        tags[i] = ~mask
    return tags


@compiled
def _strip_maps(share, links_y, near, strip, links, scale, inverse):
    """Links of a strip, weights of its int16 scores, and one over the weights filtered along y."""
    height, width = share.shape
    left = min(strip * STRIP, width)
    used = min(STRIP, width - left)
    for y in range(height):
        for j in range(used):
            links[y, j] = links_y[y, left + j]
            scale[y, j] = share[y, left + j]
    for y in range(height):
        for j in range(used, STRIP):
            links[y, j], scale[y, j] = _ZERO, _ONE
    end = height - 1
    gain = _ONE - near
    for j in range(STRIP):
        links[0, j] = _ZERO
        links[height, j] = _ZERO
        inverse[end, j] = scale[end, j] / gain
    for y in range(end - 1, 0, -1):
        for j in range(STRIP):
            inverse[y, j] = scale[y, j] + links[y + 1, j] * inverse[y + 1, j]
    state = np.empty(STRIP, np.float32)
    for j in range(STRIP):
        inverse[0, j] = scale[0, j] + links[1, j] * inverse[1, j]
        state[j] = scale[0, j] / gain
        inverse[0, j] = _ONE / (inverse[0, j] + state[j])
    for y in range(1, height):
        for j in range(STRIP):
            state[j] = scale[y, j] + links[y, j] * state[j]
            inverse[y, j] = _ONE / (inverse[y, j] + state[j])
    for y in range(height):
        for j in range(STRIP):
            scale[y, j] /= SCORE_SCALE


@compiled
def _take_strip(
    volume, strip, height, slabs, near, links, scale, inverse, tags, layers, first, step, scratch,
    disparity, peak, curvature,
):  # fmt: skip
    width = disparity.shape[1]
    lanes = slabs * v.LANES
    row_size = STRIP * lanes
    at_strip = strip * height * row_size
    endless = v.spread(_ONE / (_ONE - near))
    # Upwards; in the volume a slab's columns are neighbours, in the scratch as well.
    for y in range(height - 1, -1, -1):
        at = y * row_size
        for i in range(0, row_size, STRIP * v.LANES):
            for j in range(STRIP):
                here = at + i + j * v.LANES
                x = v.mul(v.load_shorts(volume, at_strip + here), v.spread_at(scale, y * STRIP + j))
                link = v.spread_at(links, (y + 1) * STRIP + j)
                below = v.fma(link, v.load(scratch, here + row_size), x) if y < height - 1 else v.mul(endless, x)
                v.store(scratch, here, below)
    # Downwards, from what the upward recursion gained at each row. The row below the last is its own.
    state = np.zeros(row_size, np.float32)
    scores = np.empty((STRIP, lanes), np.float32)
    best = np.empty(STRIP * v.LANES, np.float32)
    winners = best.view(np.int32)
    tag_values = tags.view(np.float32)
    raised = v.spread(_RAISED)
    gain = v.spread(_ONE - near)
    keep = v.load(tag_values, 0)
    mask = ~tags[0]
    for y in range(height):
        at = y * row_size
        for j in range(STRIP):
            link, link_below = v.spread_at(links, y * STRIP + j), v.spread_at(links, (y + 1) * STRIP + j)
            share = v.spread_at(inverse, y * STRIP + j)
            largest = v.spread(_ZERO)
            for slab in range(slabs):
                i = (slab * STRIP + j) * v.LANES
                up = v.load(scratch, at + i)
                if y == height - 1:
                    x = v.mul(gain, up)
                else:
                    x = v.fnma(link_below, v.load(scratch, at + i + row_size), up)
                down = v.fma(link, v.load(state, i), x) if y > 0 else v.mul(endless, x)
                v.store(state, i, down)
                score = v.fma(v.add(down, up), share, raised)
                v.store(scores, j * lanes + slab * v.LANES, score)
                largest = v.larger(largest, v.tagged(score, keep, v.load(tag_values, (slab + 1) * v.LANES)))
            v.store(best, j * v.LANES, largest)
        ab = v.halves_larger(v.load(best, 0), v.load(best, v.LANES))
        cd = v.halves_larger(v.load(best, 2 * v.LANES), v.load(best, 3 * v.LANES))
        four = v.quarters_larger(ab, cd)
        v.store(best, 0, v.eighths_larger(four, four))
        for j in range(min(STRIP, width - strip * STRIP)):
            x = strip * STRIP + j
            winner = min(mask - (winners[j] & mask), layers - 1)
            inner = min(max(winner, 1), layers - 2)
            left, center, right = scores[j, inner - 1], scores[j, inner], scores[j, inner + 1]
            bend = max(center + center - left - right, _ZERO)
            slope = right - left
            offset, rise = _ZERO, _ZERO
            if bend > _BEND_FLOOR:
                offset = min(max(_HALF * slope / bend, -_HALF), _HALF)
                rise = slope * slope / (np.float32(8) * bend)
            disparity[y, x] = first + step * (np.float32(inner) + offset) if winner == inner else np.nan
            peak[y, x] = center - _RAISED + rise
            curvature[y, x] = bend / (step * step)


@compiled_parallel
def unpack_scores(volume, out):
    """Give the volume as (H, W, D) float32 scores."""
    height, width, layers = out.shape
    slabs = (layers + v.LANES - 1) // v.LANES
    for y in prange(height):
        for x in range(width):
            at = ((x // STRIP) * height + y) * slabs * STRIP * v.LANES + (x % STRIP) * v.LANES
            for s in range(layers):
                i = at + (s // v.LANES) * STRIP * v.LANES + s % v.LANES
                out[y, x, s] = np.float32(volume[i]) / SCORE_SCALE

# mypy: disallow-untyped-defs=False
"""Second half of the compiled matcher: a strip of columns from scores filtered along x to the winner.

A strip is read once, upwards; the upward recursion of all its layers stays in the cache until the downward recursion
meets it. The winner is found with the layer's number in the low bits of the score, so that the largest lane says who
it is.
"""

from __future__ import annotations

import numpy as np

from chromaperture.disparity import simd as v
from chromaperture.disparity.layout import BLOCK, ONE, SCORE_SCALE, ZERO, compiled, inner

_HALF = np.float32(0.5)
STRIP = 4  # columns filtered together: for 1000 rows of 32 layers they fill half a megabyte
BATCH = 8  # rows whose winners are refined together
AHEAD = 8  # rows by which the volume is fetched before its use
_RAISED = np.float32(2)  # added to scores in [-1, 1]: positive floats are ordered as their bits are
_BEND_FLOOR = np.float32(1e-12)


@compiled
def take_winners(
    volume, share, links_y, near, layers, first, step, first_block, last_block, scratch, disparity, peak, curvature
):  # fmt: skip
    """Filter the volume along y, find the best layer, refine it by a parabola.

    Parameters
    ----------
    volume : (blocks, H, slabs, BLOCK, 8) int16, flat
    share : (H, W16) float32; the weights the scores stand for; W16 is the width in whole blocks
    links_y : (H, W16) float32; weight with which a pixel hears its upper neighbour
    near : float32; link weight on an even guide
    layers : int
    first, step : float32, px; disparity of the first layer and distance of two
    first_block, last_block : int; the blocks of columns from the first to before the last
    scratch : (H * STRIP * D8,) float32
    disparity, peak, curvature : (H, W) float32; written
    """
    height, width = disparity.shape
    slabs = (layers + v.LANES - 1) // v.LANES
    links = np.empty((height + 1) * BLOCK, np.float32)
    scale = np.empty(height * BLOCK, np.float32)
    inverse = np.empty(height * BLOCK, np.float32)
    tags = _tags(slabs)
    for block in range(first_block, last_block):
        left = block * BLOCK
        _block_maps(share, links_y, near, left, links, scale, inverse)
        for x in range(left, min(left + BLOCK, width), STRIP):
            _take_strip(
                volume, x, slabs, near, links, scale, inverse, tags, layers, first, step, scratch,
                disparity, peak, curvature,
            )  # fmt: skip


@inner
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


@inner
def _block_maps(share, links_y, near, left, links, scale, inverse):
    """Links of a block of columns, weights of its int16 scores, and one over the weights filtered along y."""
    height = share.shape[0]
    endless, unit = v.spread(ONE / (ONE - near)), v.spread(ONE / SCORE_SCALE)
    one, nothing = v.spread(ONE), v.spread(ZERO)
    for j in range(0, BLOCK, v.LANES):
        v.store(links, height * BLOCK + j, nothing)
        state = nothing
        for y in range(height - 1, -1, -1):
            weight, i = v.load(share[y], left + j), y * BLOCK + j
            state = v.fma(v.load(links, i + BLOCK), state, weight) if y < height - 1 else v.mul(endless, weight)
            v.store(inverse, i, state)
            v.store(links, i, v.load(links_y[y], left + j))
        for y in range(height):
            weight, i = v.load(share[y], left + j), y * BLOCK + j
            state = v.fma(v.load(links, i), state, weight) if y > 0 else v.mul(endless, weight)
            v.store(inverse, i, v.div(one, v.add(state, v.load(inverse, i))))
            v.store(scale, i, v.mul(weight, unit))


@inner
def _take_strip(
    volume, left, slabs, near, links, scale, inverse, tags, layers, first, step, scratch,
    disparity, peak, curvature,
):  # fmt: skip
    height, width = disparity.shape
    lanes = slabs * v.LANES
    row_size = STRIP * lanes
    volume_row = BLOCK * lanes
    column = left % BLOCK
    at_volume = left // BLOCK * height * volume_row + column * v.LANES
    endless = v.spread(ONE / (ONE - near))
    # Upwards; in the volume a slab's columns are neighbours, in the scratch a column's slabs.
    for y in range(height - 1, -1, -1):
        ahead = at_volume + max(y - AHEAD, 0) * volume_row
        for slab in range(slabs):
            v.prefetch(volume, ahead + slab * BLOCK * v.LANES)
        for j in range(STRIP):
            weight = v.spread_at(scale, y * BLOCK + column + j)
            link = v.spread_at(links, (y + 1) * BLOCK + column + j)
            here = y * row_size + j * lanes
            there = at_volume + y * volume_row + j * v.LANES
            for _ in range(slabs):
                x = v.mul(v.load_shorts(volume, there), weight)
                below = v.fma(link, v.load(scratch, here + row_size), x) if y < height - 1 else v.mul(endless, x)
                v.store(scratch, here, below)
                here, there = here + v.LANES, there + BLOCK * v.LANES
    # Downwards, a batch of rows at a time: the winners of many pixels need not wait for each other.
    state = np.zeros(row_size, np.float32)
    scores = np.empty(BATCH * row_size, np.float32)
    largest = np.empty(BATCH * STRIP + v.LANES, np.float32)
    found = np.empty((3, BATCH * STRIP), np.float32)
    used = min(STRIP, width - left)
    for top in range(0, height, BATCH):
        bottom = min(top + BATCH, height)
        _score_rows(top, bottom, height, lanes, column, near, links, inverse, tags, scratch, state, scores, largest)
        _refine(largest.view(np.int32), ~tags[0], scores, lanes, layers, first, step, found)
        for y in range(top, bottom):
            for j in range(used):
                i = (y - top) * STRIP + j
                disparity[y, left + j] = found[0, i]
                peak[y, left + j] = found[1, i]
                curvature[y, left + j] = found[2, i]


@inner
def _score_rows(top, bottom, height, lanes, column, near, links, inverse, tags, scratch, state, scores, largest):
    """Scores of a batch of rows, raised by `_RAISED`, and of each pixel the largest with its tag."""
    tag_values = tags.view(np.float32)
    best = np.empty(STRIP * v.LANES, np.float32)
    raised, gain, endless = v.spread(_RAISED), v.spread(ONE - near), v.spread(ONE / (ONE - near))
    keep = v.load(tag_values, 0)
    row_size = STRIP * lanes
    for y in range(top, bottom):
        out = (y - top) * row_size
        for j in range(STRIP):
            link = v.spread_at(links, y * BLOCK + column + j)
            link_below = v.spread_at(links, (y + 1) * BLOCK + column + j)
            share = v.spread_at(inverse, y * BLOCK + column + j)
            most = v.spread(ZERO)
            here = y * row_size + j * lanes
            for i in range(0, lanes, v.LANES):
                up, below = v.load(scratch, here + i), v.load(scratch, here + i + row_size)
                # What the upward recursion gained here is the weighted score; the row after the last is slack.
                x = v.fnma(link_below, below, up) if y < height - 1 else v.mul(gain, up)
                down = v.fma(link, v.load(state, j * lanes + i), x) if y > 0 else v.mul(endless, x)
                v.store(state, j * lanes + i, down)
                score = v.fma(v.add(down, up), share, raised)
                v.store(scores, out + j * lanes + i, score)
                most = v.larger(most, v.tagged(score, keep, v.load(tag_values, v.LANES + i)))
            v.store(best, j * v.LANES, most)
        ab = v.halves_larger(v.load(best, 0), v.load(best, v.LANES))
        cd = v.halves_larger(v.load(best, 2 * v.LANES), v.load(best, 3 * v.LANES))
        four = v.quarters_larger(ab, cd)
        v.store(largest, (y - top) * STRIP, v.eighths_larger(four, four))


@inner
def _refine(winners, mask, scores, lanes, layers, first, step, found):
    """Parabola through the best layer and its neighbours, for a batch of pixels."""
    count = BATCH * STRIP
    low, center, high = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    for i in range(count):
        winner = min(max(mask - (winners[i] & mask), 0), layers - 1)
        inner = min(max(winner, 1), layers - 2)
        at = i * lanes + inner
        low[i], center[i], high[i] = scores[at - 1], scores[at], scores[at + 1]
        found[0, i] = np.float32(inner) if winner == inner else np.float32(np.nan)
    square = ONE / (step * step)
    for i in range(count):
        bend = max(center[i] + center[i] - low[i] - high[i], ZERO)
        slope = high[i] - low[i]
        ratio = slope / bend if bend > _BEND_FLOOR else ZERO
        found[0, i] = first + step * (found[0, i] + min(max(_HALF * ratio, -_HALF), _HALF))
        found[1, i] = center[i] - _RAISED + np.float32(1 / 8) * slope * ratio
        found[2, i] = bend * square


@compiled
def unpack_scores(volume, top, bottom, out):
    """Give rows of the volume as (H, W, D) float32 scores."""
    height, width, layers = out.shape
    slabs = (layers + v.LANES - 1) // v.LANES
    for y in range(top, bottom):
        for x in range(width):
            at = ((x // BLOCK) * height + y) * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES
            for s in range(layers):
                i = at + (s // v.LANES) * BLOCK * v.LANES + s % v.LANES
                out[y, x, s] = np.float32(volume[i]) / SCORE_SCALE

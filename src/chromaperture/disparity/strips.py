# mypy: disallow-untyped-defs=False
"""Second half of the compiled matcher: a strip of columns from scores filtered along x to the winner.

The downward recursion runs first, over the whole strip, and leaves a mark every few rows. Then the strip is walked
upwards in batches between the marks: the downward recursion of a batch is done again and kept, the upward recursion
meets it, the winners of the batch are found together so that none waits for another. A batch stays in the fastest
cache. A winner is found with its layer's number in the low bits of the score: the largest lane says who it is.
"""

from __future__ import annotations

import numpy as np

from chromaperture.disparity import simd as v
from chromaperture.disparity.layout import BLOCK, ONE, SCORE_SCALE, ZERO, compiled, inner
from chromaperture.disparity.windows import copy

_HALF = np.float32(0.5)
BATCH = 8  # rows between two marks
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
    scratch : (`scratch_rows` (H) * BLOCK * D8,) float32
    disparity, peak, curvature : (H, W) float32; written
    """
    height = len(disparity)
    slabs = (layers + v.LANES - 1) // v.LANES
    links = np.empty((height + 1) * BLOCK, np.float32)
    scale = np.empty(height * BLOCK, np.float32)
    inverse = np.empty(height * BLOCK, np.float32)
    tags = _tags(slabs)
    for block in range(first_block, last_block):
        left = block * BLOCK
        _block_maps(share, links_y, near, left, links, scale, inverse)
        _take_strip(
            volume, left, slabs, near, links, scale, inverse, tags, layers, first, step, scratch,
            disparity, peak, curvature,
        )  # fmt: skip


def scratch_rows(height: int) -> int:
    """Rows of a strip that `take_winners` keeps: the marks, a batch and the row above it, the state."""
    return -(-height // BATCH) + 1 + BATCH + 2


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
    row_size = BLOCK * slabs * v.LANES
    at_volume = left // BLOCK * height * row_size
    batches = (height + BATCH - 1) // BATCH
    at_batch = (batches + 1) * row_size
    at_state = at_batch + (BATCH + 1) * row_size
    # All rows of a batch write to the mark below it, which keeps the last. Above the first row there is nothing.
    for i in range(0, row_size, v.LANES):
        v.store(scratch, i, v.spread(ZERO))
        v.store(scratch, at_state + i, v.spread(ZERO))
    for y in range(height):
        above, mark = ((y + BATCH - 1) // BATCH) * row_size, (y // BATCH + 1) * row_size
        _down(volume, at_volume + y * row_size, scale, links, y, near, scratch, above, mark, row_size)
    best, fours = np.empty(BLOCK * v.LANES, np.float32), np.empty(BLOCK + v.LANES, np.float32)
    largest = np.empty(BATCH * BLOCK + v.LANES, np.float32)
    found = np.empty((3, BATCH * BLOCK), np.float32)
    used = min(BLOCK, width - left)
    for batch in range(batches - 1, -1, -1):
        top, bottom = batch * BATCH, min((batch + 1) * BATCH, height)
        for y in range(top, bottom):  # each row of the maps is another page: have them at hand when they are written
            v.prefetch(disparity, y * width + left)
            v.prefetch(peak, y * width + left)
            v.prefetch(curvature, y * width + left)
        copy(scratch, batch * row_size, scratch, at_batch, row_size)
        for y in range(top, bottom):
            here = at_batch + (y - top + 1) * row_size
            _down(volume, at_volume + y * row_size, scale, links, y, near, scratch, here - row_size, here, row_size)
        for y in range(bottom - 1, top - 1, -1):
            here = at_batch + (y - top + 1) * row_size
            _up(y, height, slabs, near, links, inverse, tags, scratch, here, at_state, best)
            for i in range(0, BLOCK, 4):
                ab = v.halves_larger(v.load(best, i * 8), v.load(best, i * 8 + 8))
                cd = v.halves_larger(v.load(best, i * 8 + 16), v.load(best, i * 8 + 24))
                four = v.quarters_larger(ab, cd)
                v.store(fours, i, v.eighths_larger(four, four))
            copy(fours, 0, largest, (y - top) * BLOCK, BLOCK)
        _refine(largest.view(np.int32), ~tags[0], scratch, at_batch + row_size, row_size, layers, first, step, found)
        for y in range(top, bottom):
            at = y * width + left
            for j in range(used):
                i = (y - top) * BLOCK + j
                v.put(disparity, at + j, v.get(found[0], i))
                v.put(peak, at + j, v.get(found[1], i))
                v.put(curvature, at + j, v.get(found[2], i))


@inner
def _down(volume, at_volume, scale, links, y, near, scratch, above, here, row_size):
    """One row of the downward recursion, from ``above`` to ``here`` in the scratch."""
    # An end of the column stands for itself: the recursions take it 1 / gain times.
    start = v.spread(ONE / (ONE - near) if y == 0 else ONE)
    for j in range(BLOCK):
        weight = v.mul(start, v.spread_at(scale, y * BLOCK + j))
        link = v.spread_at(links, y * BLOCK + j)
        for i in range(j * v.LANES, row_size, BLOCK * v.LANES):
            x = v.mul(v.load_shorts(volume, at_volume + i), weight)
            v.store(scratch, here + i, v.fma(link, v.load(scratch, above + i), x))


@inner
def _up(y, height, slabs, near, links, inverse, tags, scratch, here, at_state, best):
    """One row of the upward recursion; leaves the scores, raised by `_RAISED`, and the largest of every column."""
    size = BLOCK * v.LANES
    row_size = slabs * size
    tag_values = tags.view(np.float32)
    keep, raised = v.load(tag_values, 0), v.spread(_RAISED)
    gain, start = v.spread(ONE - near), v.spread(ONE / (ONE - near))
    for j in range(BLOCK):
        link, link_below = v.spread_at(links, y * BLOCK + j), v.spread_at(links, (y + 1) * BLOCK + j)
        share = v.spread_at(inverse, y * BLOCK + j)
        most = v.spread(ZERO)
        tag = v.LANES
        for i in range(j * v.LANES, row_size, size):
            # What the downward recursion gained here is the weighted score.
            down = v.load(scratch, here + i)
            if 0 < y < height - 1:
                x = v.fnma(link, v.load(scratch, here - row_size + i), down)
                up = v.fma(link_below, v.load(scratch, at_state + i), x)
            elif y == 0:
                up = v.fma(link_below, v.load(scratch, at_state + i), v.mul(gain, down))
            else:
                up = v.mul(start, v.fnma(link, v.load(scratch, here - row_size + i), down))
            v.store(scratch, at_state + i, up)
            score = v.fma(v.add(up, down), share, raised)
            v.store(scratch, here + i, score)
            most = v.larger(most, v.tagged(score, keep, v.load(tag_values, tag)))
            tag += v.LANES
        v.store(best, j * v.LANES, most)


@inner
def _refine(winners, mask, scores, at_scores, row_size, layers, first, step, found):
    """Parabola through the best layer and its neighbours, for a batch of pixels."""
    count = BATCH * BLOCK
    low, center, high = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    for i in range(count):
        winner = min(max(mask - (v.get(winners, i) & mask), 0), layers - 1)
        inner = min(max(winner, 1), layers - 2)
        column = i & (BLOCK - 1)
        at = at_scores + (i - column) // BLOCK * row_size + column * v.LANES
        low[i] = v.get(scores, at + _of_layer(inner - 1))
        center[i] = v.get(scores, at + _of_layer(inner))
        high[i] = v.get(scores, at + _of_layer(inner + 1))
        found[0, i] = np.float32(inner) if winner == inner else np.float32(np.nan)
    square = ONE / (step * step)
    for i in range(count):
        bend = max(center[i] + center[i] - low[i] - high[i], ZERO)
        slope = high[i] - low[i]
        ratio = slope / bend if bend > _BEND_FLOOR else ZERO
        found[0, i] = first + step * (found[0, i] + min(max(_HALF * ratio, -_HALF), _HALF))
        found[1, i] = center[i] - _RAISED + np.float32(1 / 8) * slope * ratio
        found[2, i] = bend * square


@inner
def _of_layer(layer):
    """Where a layer lies from a column's first one."""
    lane = layer & (v.LANES - 1)
    return (layer - lane) * BLOCK + lane


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

# mypy: disallow-untyped-defs=False
"""Second half of the compiled matcher: a strip of columns from scores filtered along x to the winner.

The downward recursion runs first, over the whole strip, and saves its state every few rows. Then the strip is walked
upwards in batches between the saved rows: the downward recursion of a batch is done again and kept, the upward one
meets it, the best layers of the batch are found together, so that their latencies overlap. A batch stays in the fastest
cache. The best layer is found with its number in the low bits of the score: the largest lane holds it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.compiled.layout import BLOCK, ONE, SCORE_SCALE, ZERO, inner, kernel
from chromaperture.matching.compiled.windows import copy

_HALF = np.float32(0.5)
BATCH = 8  # rows between two saved states
_RAISED = np.float32(2)  # added to scores in [-1, 1]: positive floats are ordered as their bits are
_BEND_FLOOR = np.float32(1e-12)


class Columns(NamedTuple):
    """Settings of the filter along y and of the parabola."""

    layers: int
    first_px: np.float32  # disparity of the first layer
    step_px: np.float32
    even_link: np.float32  # link weight on an even guide


@kernel
def take_winners(volume, maps, settings, first_block, last_block, scratch, winner):
    """Filter the volume along y, find the best layer, refine it by a parabola.

    ``volume`` (blocks, H, slabs, BLOCK, 8) float32, flat; ``first_block``, ``last_block`` int; the blocks of columns
    from the first to before the last; ``scratch`` (`scratch_rows` (H) * BLOCK * D8,) float32; ``winner`` Winner;
    written.
    """
    height = len(winner.disparity_px)
    slabs = (settings.layers + v.LANES - 1) // v.LANES
    links = np.empty((height + 1) * BLOCK, np.float32)
    inverse = np.empty(height * BLOCK, np.float32)
    tags = _tags(slabs)
    for block in range(first_block, last_block):
        left = block * BLOCK
        _block_maps(maps.filtered, maps.links_y, settings.even_link, left, links, inverse)
        _take_strip(volume, left, slabs, settings, links, inverse, tags, scratch, winner)


def scratch_rows(height: int) -> int:
    """Rows of a strip that `take_winners` keeps: the saved rows, a batch and the row above it, the state."""
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
def _block_maps(weights, links_y, even_link, left, links, inverse):
    """Links of a block of columns, and one over the weights filtered along y."""
    height = weights.shape[0]
    border_gain = v.broadcast(ONE / (ONE - even_link))
    one, nothing = v.broadcast(ONE), v.broadcast(ZERO)
    for j in range(0, BLOCK, v.LANES):
        v.store(links, height * BLOCK + j, nothing)
        state = nothing
        for y in range(height - 1, -1, -1):
            weight, i = v.load(weights[y], left + j), y * BLOCK + j
            state = v.fma(v.load(links, i + BLOCK), state, weight) if y < height - 1 else v.mul(border_gain, weight)
            v.store(inverse, i, state)
            v.store(links, i, v.load(links_y[y], left + j))
        for y in range(height):
            weight, i = v.load(weights[y], left + j), y * BLOCK + j
            state = v.fma(v.load(links, i), state, weight) if y > 0 else v.mul(border_gain, weight)
            v.store(inverse, i, v.div(one, v.add(state, v.load(inverse, i))))


@inner
def _take_strip(volume, left, slabs, settings, links, inverse, tags, scratch, winner):
    even_link = settings.even_link
    disparity, peak, curvature = winner.disparity_px, winner.peak, winner.curvature
    height, width = disparity.shape
    row_size = BLOCK * slabs * v.LANES
    at_volume = left // BLOCK * height * row_size
    batches = (height + BATCH - 1) // BATCH
    at_batch = (batches + 1) * row_size
    at_state = at_batch + (BATCH + 1) * row_size
    # All rows of a batch write to the saved row below it, which keeps the last. Above the first row there is nothing.
    for i in range(0, row_size, v.LANES):
        v.store(scratch, i, v.broadcast(ZERO))
        v.store(scratch, at_state + i, v.broadcast(ZERO))
    for y in range(height):
        above, saved = ((y + BATCH - 1) // BATCH) * row_size, (y // BATCH + 1) * row_size
        _down(volume, at_volume + y * row_size, links, y, even_link, scratch, above, saved, row_size)
    best, fours = np.empty(BLOCK * v.LANES, np.float32), np.empty(BLOCK + v.LANES, np.float32)
    largest = np.empty(BATCH * BLOCK + v.LANES, np.float32)
    found = np.empty((3, BATCH * BLOCK), np.float32)
    used = min(BLOCK, width - left)
    for batch in range(batches - 1, -1, -1):
        top, bottom = batch * BATCH, min((batch + 1) * BATCH, height)
        for y in range(top, bottom):  # each row of the maps is another page: load them before they are written
            v.prefetch(disparity, y * width + left)
            v.prefetch(peak, y * width + left)
            v.prefetch(curvature, y * width + left)
        copy(scratch, batch * row_size, scratch, at_batch, row_size)
        for y in range(top, bottom):
            here = at_batch + (y - top + 1) * row_size
            at = at_volume + y * row_size
            _down(volume, at, links, y, even_link, scratch, here - row_size, here, row_size)
        for y in range(bottom - 1, top - 1, -1):
            here = at_batch + (y - top + 1) * row_size
            _up(y, height, slabs, even_link, links, inverse, tags, scratch, here, at_state, best)
            for i in range(0, BLOCK, 4):
                ab = v.halves_larger(v.load(best, i * 8), v.load(best, i * 8 + 8))
                cd = v.halves_larger(v.load(best, i * 8 + 16), v.load(best, i * 8 + 24))
                four = v.quarters_larger(ab, cd)
                v.store(fours, i, v.eighths_larger(four, four))
            copy(fours, 0, largest, (y - top) * BLOCK, BLOCK)
        _refine(largest.view(np.int32), ~tags[0], scratch, at_batch + row_size, row_size, settings, found)
        for y in range(top, bottom):
            at = y * width + left
            for j in range(used):
                i = (y - top) * BLOCK + j
                v.put(disparity, at + j, v.get(found[0], i))
                v.put(peak, at + j, v.get(found[1], i))
                v.put(curvature, at + j, v.get(found[2], i))


@inner
def _down(volume, at_volume, links, y, even_link, scratch, above, here, row_size):
    """One row of the downward recursion, from ``above`` to ``here`` in the scratch."""
    # The sample at an end of the column has no gain: the recursions take it 1 / gain times.
    start = v.broadcast(ONE / (ONE - even_link) if y == 0 else ONE)
    for j in range(BLOCK):
        link = v.broadcast_at(links, y * BLOCK + j)
        for i in range(j * v.LANES, row_size, BLOCK * v.LANES):
            x = v.mul(v.load(volume, at_volume + i), start)
            v.store(scratch, here + i, v.fma(link, v.load(scratch, above + i), x))


@inner
def _up(y, height, slabs, even_link, links, inverse, tags, scratch, here, at_state, best):
    """One row of the upward recursion; leaves the scores, and the largest of every column, raised by `_RAISED`."""
    size = BLOCK * v.LANES
    row_size = slabs * size
    tag_values = tags.view(np.float32)
    keep, raised = v.load(tag_values, 0), v.broadcast(_RAISED)
    gain, start = v.broadcast(ONE - even_link), v.broadcast(ONE / (ONE - even_link))
    for j in range(BLOCK):
        link, link_below = v.broadcast_at(links, y * BLOCK + j), v.broadcast_at(links, (y + 1) * BLOCK + j)
        normaliser = v.broadcast_at(inverse, y * BLOCK + j)
        most = v.broadcast(ZERO)
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
            score = v.mul(v.add(up, down), normaliser)
            v.store(scratch, here + i, score)
            most = v.larger(most, v.tagged(v.add(score, raised), keep, v.load(tag_values, tag)))
            tag += v.LANES
        v.store(best, j * v.LANES, most)


@inner
def _refine(winners, mask, scores, at_scores, row_size, settings, found):
    """Parabola through the best layer and its neighbours, for a batch of pixels."""
    layers, first, step = settings.layers, settings.first_px, settings.step_px
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
        found[1, i] = center[i] + np.float32(1 / 8) * slope * ratio
        found[2, i] = bend * square


@inner
def _of_layer(layer):
    """Where a layer lies from a column's first one."""
    lane = layer & (v.LANES - 1)
    return (layer - lane) * BLOCK + lane


@kernel
def unpack_scores(volume, top, bottom, out):
    """Unpack rows of the volume to (H, W, D) float32 scores."""
    height, width, layers = out.shape
    slabs = (layers + v.LANES - 1) // v.LANES
    for y in range(top, bottom):
        for x in range(width):
            at = ((x // BLOCK) * height + y) * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES
            for s in range(layers):
                i = at + (s // v.LANES) * BLOCK * v.LANES + s % v.LANES
                out[y, x, s] = np.float32(volume[i]) / SCORE_SCALE

# mypy: disallow-untyped-defs=False
"""Semi-global matching of the compiled real-time matcher: messages along rows and columns, eight layers a vector.

On a path the message a pixel q sends to its neighbour is, of its cost c including all that it heard itself,
``m(d) = min(c(d), c(d - 1) + e slope, c(d + 1) + e slope, min c + e jump) - min c``. The sum of the four messages
and the pixel's own cost decides.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from chromaperture.disparity import simd as v
from chromaperture.disparity.coarse import LEAST_LEFT, SPREAD_POWER
from chromaperture.disparity.layout import BLOCK, GROUP, ONE, SCORE_SCALE, ZERO, compiled, inner

assert SPREAD_POWER == 8  # squared three times below

_LEAST_LEFT = np.float32(LEAST_LEFT)
_NATS = np.float32(32000 / (-0.5 * math.log(LEAST_LEFT)))  # a nat of likelihood in int16
_CLOSED = np.float32(1e4)  # cost of layers that only fill the last vector, and of those beyond the ends
_RAISED = np.float32(8)  # makes all costs positive: positive floats are ordered as their bits are
_FAR = np.float32(3e4)
_HALF = np.float32(0.5)
_THREE, _FOUR, _FIVE = np.float32(3), np.float32(4), np.float32(5)
_EIGHTH = np.float32(0.125)


class Penalties(NamedTuple):
    """Settings, float32 but for the count of layers."""

    slope: np.float32
    jump: np.float32
    temperature: np.float32
    first: np.float32
    step: np.float32
    layers: int


@compiled
def pool_rows(volume, sums, mask, links, offset, scale, penalties, two_views, top, bottom):
    """Turn scores into likelihoods and add up the messages along x.

    Parameters
    ----------
    volume : (blocks, H, slabs, BLOCK, 8) int16, flat; scores, then likelihoods
    sums : like volume; written: both messages
    mask, links : (H, W) float32
    offset, scale : (H, W) float32, a `LayerField`, or (1, 1) without
    penalties : Penalties
    two_views : bool
    top, bottom : int; the rows from ``top`` to before ``bottom``
    """
    height, width = mask.shape
    slabs = (penalties.layers + v.LANES - 1) // v.LANES
    pitch = (slabs + 2) * v.LANES
    closed = _closed(penalties.layers, slabs)
    paths = np.empty((2 * GROUP + 1) * pitch, np.float32)
    evidence, labels = np.zeros(slabs * v.LANES + 3, np.float32), np.empty(slabs * v.LANES, np.float32)
    least = np.empty(GROUP * v.LANES, np.float32)
    unit = np.float32(32000) / (np.float32(3) * penalties.jump)
    for row in range(top, bottom, GROUP):
        rows = min(GROUP, bottom - row)
        for j in range(rows):
            y = row + j
            if len(scale) > 1:
                _read_at_labels(volume, offset[y], scale[y], y, height, slabs, penalties, evidence, labels)
            _likelihoods(volume, mask[y], y, height, slabs, two_views)
        _start(paths, least, rows, pitch)
        for x in range(width):
            for j in range(rows):
                y = row + j
                at = ((x // BLOCK) * height + y) * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES
                here, there = (2 * j + (x & 1)) * pitch, (2 * j + 1 - (x & 1)) * pitch
                weight = v.get(links[y], x)
                _pass_on(
                    volume, sums, at, slabs, weight, penalties, unit, closed, paths, there, here,
                    least, j * v.LANES, False,
                )  # fmt: skip
        _start(paths, least, rows, pitch)
        for x in range(width - 1, -1, -1):
            for j in range(rows):
                y = row + j
                at = ((x // BLOCK) * height + y) * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES
                here, there = (2 * j + (x & 1)) * pitch, (2 * j + 1 - (x & 1)) * pitch
                weight = v.get(links[y], x + 1) if x + 1 < width else ZERO
                _pass_on(
                    volume, sums, at, slabs, weight, penalties, unit, closed, paths, there, here,
                    least, j * v.LANES, True,
                )  # fmt: skip
    v.fence()


@compiled
def pool_columns(volume, sums, links, penalties, first_block, last_block, layer, low, middle, high, spread):
    """Add the messages along y and find the best layer of every pixel.

    Parameters
    ----------
    volume, sums : from `pool_rows`
    links : (H, W) float32
    penalties : Penalties
    first_block, last_block : int; blocks of columns
    layer : (H, W) float32; written: the best layer
    low, middle, high : (H, W) float32; written: likelihoods of the layers around it, nats
    spread : (H, W) float32, px; written: how far layers of little more cost lie
    """
    height, width = layer.shape
    slabs = (penalties.layers + v.LANES - 1) // v.LANES
    pitch = (slabs + 2) * v.LANES
    closed = _closed(penalties.layers, slabs)
    paths = np.empty((2 * BLOCK + 1) * pitch, np.float32)
    least = np.empty(BLOCK * v.LANES, np.float32)
    costs = np.empty(pitch, np.float32)
    lanes = np.empty(2 * v.LANES, np.float32)
    for i in range(v.LANES):
        lanes[i] = np.float32(i)
    tag_bits = _tags(slabs)
    tags, mask = tag_bits.view(np.float32), ~tag_bits[0]
    bits = lanes.view(np.int32)
    unit = np.float32(32000) / (np.float32(3) * penalties.jump)
    for block in range(first_block, last_block):
        left = block * BLOCK
        used = min(BLOCK, width - left)
        start = block * height * slabs * BLOCK * v.LANES
        _start(paths, least, BLOCK, pitch)
        for y in range(height):
            for j in range(used):
                at = start + y * slabs * BLOCK * v.LANES + j * v.LANES
                here, there = (2 * j + (y & 1)) * pitch, (2 * j + 1 - (y & 1)) * pitch
                weight = v.get(links, y * width + left + j)
                _pass_on(
                    volume, sums, at, slabs, weight, penalties, unit, closed, paths, there, here,
                    least, j * v.LANES, True,
                )  # fmt: skip
        _start(paths, least, BLOCK, pitch)
        for y in range(height - 1, -1, -1):
            for j in range(used):
                at = start + y * slabs * BLOCK * v.LANES + j * v.LANES
                here, there = (2 * j + (y & 1)) * pitch, (2 * j + 1 - (y & 1)) * pitch
                weight = v.get(links, (y + 1) * width + left + j) if y + 1 < height else ZERO
                winner = _decide(
                    volume, sums, at, slabs, weight, penalties, unit, closed, tags, paths, there, here,
                    least, j * v.LANES, costs, lanes, bits, mask,
                )  # fmt: skip
                i = y * width + left + j
                v.put(layer, i, np.float32(winner))
                inside = min(max(winner, 1), penalties.layers - 2)
                _put_likelihood(volume, at, inside - 1, low, i)
                _put_likelihood(volume, at, inside, middle, i)
                _put_likelihood(volume, at, inside + 1, high, i)
                place = np.float32(winner)
                v.put(spread, i, penalties.step * _spread(costs, slabs, place, penalties, lanes))


@inner
def _put_likelihood(volume, at, layer, out, i):
    own = v.get(volume, at + (layer >> 3) * BLOCK * v.LANES + (layer & (v.LANES - 1)))
    v.put(out, i, np.float32(own) * (ONE / _NATS))


@inner
def _closed(count, slabs):
    """Cost of each layer for not being one."""
    closed = np.zeros(slabs * v.LANES, np.float32)
    for s in range(count, slabs * v.LANES):
        closed[s] = _CLOSED
    return closed


@inner
def _tags(slabs):
    """Give the number of each layer as bits, behind the mask of the bits of a cost to keep."""
    bits = 1
    while bits < slabs * v.LANES:
        bits *= 2
    tags = np.empty((slabs + 1) * v.LANES, np.int32)
    for i in range(v.LANES):
        tags[i] = ~(bits - 1)
    for s in range(slabs * v.LANES):
        tags[v.LANES + s] = s
    return tags


@inner
def _start(paths, least, lines, pitch):
    """Nothing heard yet; beyond the first and the last layer everything is too far."""
    for i in range(0, (2 * lines + 1) * pitch):
        paths[i] = ZERO
    for line in range(2 * lines):
        for i in range(v.LANES):
            paths[line * pitch + i] = _FAR
            paths[(line + 1) * pitch - v.LANES + i] = _FAR
    for i in range(lines * v.LANES):
        least[i] = ZERO


@inner
def _likelihoods(volume, mask, y, height, slabs, two_views):
    """One row of scores to log-likelihoods, nats: -ln(1 - s^2) / 2 of two views, -ln(1 - s) of three."""
    one, nothing, limit = v.spread(ONE), v.spread(ZERO), v.spread(_LEAST_LEFT)
    unit, nats = v.spread(ONE / SCORE_SCALE), -_HALF * _NATS
    for x in range(len(mask)):
        factor = v.spread(nats * mask[x])
        at = ((x // BLOCK) * height + y) * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES
        for i in range(at, at + slabs * BLOCK * v.LANES, BLOCK * v.LANES):
            score = v.larger(v.mul(v.load_shorts(volume, i), unit), nothing)
            if two_views:
                left = v.fnma(score, score, one)
            else:
                left = v.sub(one, score)
                left = v.mul(left, left)
            v.put_shorts(volume, i, v.mul(factor, v.logarithm(v.larger(left, limit))))


@inner
def _read_at_labels(volume, offset, scale, y, height, slabs, penalties, evidence, labels):
    """Read one row of scores at the labels of a field, by cubics through four layers; 0 beyond them."""
    count = penalties.layers
    for x in range(len(offset)):
        at = ((x // BLOCK) * height + y) * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES
        for s in range(slabs):
            v.store(evidence, s * v.LANES + 1, v.load_shorts(volume, at + s * BLOCK * v.LANES))
        evidence[0] = evidence[1]
        evidence[count + 1] = evidence[count]
        begin = (offset[x] + (scale[x] - ONE) * penalties.first) / penalties.step
        for k in range(count):
            place = begin + scale[x] * np.float32(k)
            below = min(max(int(place), 0), count - 2)
            t = place - np.float32(below)
            before, low = v.get(evidence, below), v.get(evidence, below + 1)
            high, after = v.get(evidence, below + 2), v.get(evidence, below + 3)
            third = _THREE * (low - high) + after - before  # Catmull and Rom's cubic
            second = before + before - _FIVE * low + _FOUR * high - after
            value = low + _HALF * t * (high - before + t * (second + t * third))
            labels[k] = value if ZERO <= t <= ONE else ZERO
        for k in range(count, slabs * v.LANES):
            labels[k] = ZERO
        for s in range(slabs):
            v.put_shorts(volume, at + s * BLOCK * v.LANES, v.load(labels, s * v.LANES))


@inner
def _pass_on(
    volume, sums, at, slabs, weight, penalties, unit, closed, paths, there, here, least, at_least, add
):  # fmt: skip
    """File the message that comes in from ``there`` and leave the costs of ``here`` for the next pixel."""
    smallest = v.load(least, at_least)
    near, far = v.spread(weight * penalties.slope), v.spread(weight * penalties.jump)
    far = v.add(smallest, far)
    into, nats = v.spread(unit), v.spread(-ONE / _NATS)
    lowest = v.spread(_FAR)
    there, here = there + v.LANES, here + v.LANES
    for s in range(0, slabs * v.LANES, v.LANES):
        beside = v.smaller(v.load(paths, there + s - 1), v.load(paths, there + s + 1))
        heard = v.smaller(v.smaller(v.load(paths, there + s), v.add(beside, near)), far)
        heard = v.sub(heard, smallest)
        i = at + s * BLOCK
        if add:
            v.put_shorts(sums, i, v.fma(heard, into, v.load_shorts(sums, i)))
        else:
            v.put_shorts(sums, i, v.mul(heard, into))
        cost = v.fma(v.load_shorts(volume, i), nats, v.add(heard, v.load(closed, s)))
        v.store(paths, here + s, cost)
        lowest = v.smaller(lowest, cost)
    v.store(least, at_least, v.least_lane(lowest))


@inner
def _decide(
    volume, sums, at, slabs, weight, penalties, unit, closed, tags, paths, there, here, least, at_least, costs, lanes,
    bits, mask,
):  # fmt: skip
    """Do as `_pass_on` with the last message; leaves the sum of all in ``costs`` and returns the best layer."""
    smallest = v.load(least, at_least)
    near, far = v.spread(weight * penalties.slope), v.spread(weight * penalties.jump)
    far = v.add(smallest, far)
    nats_sum, nats, raised = v.spread(ONE / unit), v.spread(-ONE / _NATS), v.spread(_RAISED)
    keep = v.load(tags, 0)
    lowest, best = v.spread(_FAR), v.spread(_FAR)
    there, here = there + v.LANES, here + v.LANES
    for s in range(0, slabs * v.LANES, v.LANES):
        beside = v.smaller(v.load(paths, there + s - 1), v.load(paths, there + s + 1))
        heard = v.smaller(v.smaller(v.load(paths, there + s), v.add(beside, near)), far)
        heard = v.sub(heard, smallest)
        i = at + s * BLOCK
        cost = v.fma(v.load_shorts(volume, i), nats, v.add(heard, v.load(closed, s)))
        v.store(paths, here + s, cost)
        lowest = v.smaller(lowest, cost)
        total = v.add(v.fma(v.load_shorts(sums, i), nats_sum, cost), raised)
        v.store(costs, s, total)
        best = v.smaller(best, v.tagged(total, keep, v.load(tags, v.LANES + s)))
    v.store(least, at_least, v.least_lane(lowest))
    v.store(lanes, v.LANES, v.least_lane(best))
    return np.int64(v.get(bits, v.LANES) & mask)


@inner
def _spread(costs, slabs, place, penalties, lanes):
    """Root mean square distance of the layers from ``place``, weighted by (1 - what they cost more)^8; layers."""
    cooling = v.spread(-_EIGHTH / penalties.temperature)
    least = v.get(costs, np.int64(place))
    start = v.spread(ONE + least * _EIGHTH / penalties.temperature)
    nothing = v.spread(ZERO)
    weights, squares = nothing, nothing
    away = v.sub(v.load(lanes, 0), v.spread(place))
    eight = v.spread(np.float32(v.LANES))
    for s in range(0, slabs * v.LANES, v.LANES):
        weight = v.larger(v.fma(v.load(costs, s), cooling, start), nothing)
        weight = v.mul(weight, weight)
        weight = v.mul(weight, weight)
        weight = v.mul(weight, weight)
        weights = v.add(weights, weight)
        squares = v.fma(weight, v.mul(away, away), squares)
        away = v.add(away, eight)
    return np.sqrt(v.lane(v.sum_lanes(squares), 0) / v.lane(v.sum_lanes(weights), 0))

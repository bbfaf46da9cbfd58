# mypy: disallow-untyped-defs=False
"""Path costs along rows and columns, eight layers a vector: the inner part of `four_paths.py`.

A pixel q with the path cost c, its own included, adds to its neighbour on the path
``m(d) = min(c(d), min c + e jump) - min c``. The sum of these over the four paths and the pixel's own cost decide.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from chromaperture.disparity.cpu import simd as v
from chromaperture.disparity.cpu.layout import BLOCK, GROUP, ONE, SCORE_SCALE, ZERO, inner, kernel
from chromaperture.disparity.stages.four_paths import LEAST_DETERMINANT, POSTERIOR_POWER

assert POSTERIOR_POWER == 8  # squared three times below

_LEAST_DETERMINANT = np.float32(LEAST_DETERMINANT)
_NATS = np.float32(32000 / (-0.5 * math.log(LEAST_DETERMINANT)))  # a nat of log-likelihood in int16
_CLOSED = np.float32(1e4)  # nats; cost of the lanes beyond the last layer
_RAISED = np.float32(8)  # nats; makes all costs positive: positive floats are ordered as their bits are
_FAR = np.float32(3e4)  # nats; beyond any sum of costs, and of those of `_CLOSED`
_HALF = np.float32(0.5)
_THREE, _FOUR, _FIVE = np.float32(3), np.float32(4), np.float32(5)
_EIGHTH = np.float32(0.125)


class Settings(NamedTuple):
    """Penalty and temperature, nats; the first layer and their distance, px; float32 but for the count."""

    jump: np.float32
    temperature: np.float32
    first: np.float32
    step: np.float32
    layers: int


class Lines(NamedTuple):
    """State of the lines that are walked together.

    Each line has two slots in ``paths``, for the pixel before and the pixel here.
    """

    volume: np.ndarray  # int16, flat: log-likelihoods
    sums: np.ndarray  # int16, flat: sum of the path costs
    paths: np.ndarray  # costs of a path, nats
    least: np.ndarray  # a vector a line: the least cost of the pixel before
    closed: np.ndarray  # cost of each lane for being no layer
    pitch: int  # length of a slot
    slabs: int
    unit: np.float32  # a nat of the sum of three path costs in int16


class Decision(NamedTuple):
    """Arrays for finding the best layer of one pixel."""

    costs: np.ndarray  # sum of all paths, raised
    lanes: np.ndarray  # 0 to 7, then room for the vector of the best
    bits: np.ndarray  # the same memory as integers
    tags: np.ndarray  # bits that name each layer, behind the mask of the bits of a cost to keep
    mask: int  # of the bits that name a layer


@kernel
def along_rows(volume, sums, mask, links, labels, settings, two_views, top, bottom):
    """Turn scores into log-likelihoods and add up the path costs along x.

    Parameters
    ----------
    volume : (blocks, H, slabs, BLOCK, 8) int16, flat; scores, then log-likelihoods
    sums : like volume; written: the costs of both paths
    mask, links : (H, W) float32
    labels : LabelMap, (H, W) float32 or (1, 1)
    settings : Settings
    two_views : bool
    top, bottom : int; the rows from ``top`` to before ``bottom``
    """
    height, width = mask.shape
    lines = _lines(volume, sums, settings, GROUP)
    slabs = lines.slabs
    scores, at_labels = np.zeros(slabs * v.LANES + 3, np.float32), np.empty(slabs * v.LANES, np.float32)
    for row in range(top, bottom, GROUP):
        rows = min(GROUP, bottom - row)
        for j in range(rows):
            y = row + j
            if labels.scale.size > 1:
                _read_at_labels(lines, labels.offset_px[y], labels.scale[y], y, height, settings, scores, at_labels)
            _likelihoods(lines, mask[y], y, height, two_views)
        _start(lines, rows)
        for x in range(width):
            for j in range(rows):
                at = _address(row + j, x, height, slabs)
                _propagate(lines, settings, at, v.get(links[row + j], x), j, x & 1, False)
        _start(lines, rows)
        for x in range(width - 1, -1, -1):
            for j in range(rows):
                at = _address(row + j, x, height, slabs)
                weight = v.get(links[row + j], x + 1) if x + 1 < width else ZERO
                _propagate(lines, settings, at, weight, j, x & 1, True)
    v.fence()


@kernel
def along_columns(volume, sums, links, settings, first_block, last_block, winner):
    """Add the path costs along y and find the best layer of every pixel.

    Parameters
    ----------
    volume, sums : from `along_rows`
    links : (H, W) float32
    settings : Settings
    first_block, last_block : int; blocks of columns
    winner : PathWinner; written
    """
    height, width = links.shape
    lines = _lines(volume, sums, settings, BLOCK)
    slabs = lines.slabs
    decision = _decision(slabs)
    for block in range(first_block, last_block):
        left = block * BLOCK
        used = min(BLOCK, width - left)
        _start(lines, BLOCK)
        for y in range(height):
            for j in range(used):
                at = _address(y, left + j, height, slabs)
                _propagate(lines, settings, at, v.get(links, y * width + left + j), j, y & 1, True)
        _start(lines, BLOCK)
        for y in range(height - 1, -1, -1):
            for j in range(used):
                at = _address(y, left + j, height, slabs)
                weight = v.get(links, (y + 1) * width + left + j) if y + 1 < height else ZERO
                best = _decide(lines, settings, at, weight, j, y & 1, decision)
                i = y * width + left + j
                v.put(winner.layer, i, np.float32(best))
                inside = min(max(best, 1), settings.layers - 2)
                _put_likelihood(volume, at, inside - 1, winner.before, i)
                _put_likelihood(volume, at, inside, winner.at, i)
                _put_likelihood(volume, at, inside + 1, winner.after, i)
                v.put(winner.sigma_px, i, settings.step * _posterior_sigma(decision, slabs, best, settings))


@inner
def _address(y, x, height, slabs):
    """Where the first layer of a pixel lies in the volume."""
    return ((x // BLOCK) * height + y) * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES


@inner
def _put_likelihood(volume, at, layer, out, i):
    own = v.get(volume, at + (layer >> 3) * BLOCK * v.LANES + (layer & (v.LANES - 1)))
    v.put(out, i, np.float32(own) * (ONE / _NATS))


@inner
def _lines(volume, sums, settings, count):
    """Room for ``count`` lines."""
    slabs = (settings.layers + v.LANES - 1) // v.LANES
    pitch = slabs * v.LANES
    closed = np.zeros(slabs * v.LANES, np.float32)
    for s in range(settings.layers, slabs * v.LANES):
        closed[s] = _CLOSED
    paths = np.empty(2 * count * pitch, np.float32)
    unit = np.float32(32000) / (_THREE * settings.jump)
    return Lines(volume, sums, paths, np.empty(count * v.LANES, np.float32), closed, pitch, slabs, unit)


@inner
def _decision(slabs):
    names = 1
    while names < slabs * v.LANES:
        names *= 2
    tags = np.empty((slabs + 1) * v.LANES, np.int32)
    for i in range(v.LANES):
        tags[i] = ~(names - 1)
    for s in range(slabs * v.LANES):
        tags[v.LANES + s] = s
    lanes = np.empty(2 * v.LANES, np.float32)
    for i in range(v.LANES):
        lanes[i] = np.float32(i)
    costs = np.empty((slabs + 2) * v.LANES, np.float32)
    return Decision(costs, lanes, lanes.view(np.int32), tags.view(np.float32), names - 1)


@inner
def _start(lines, count):
    """No cost has come in yet."""
    for i in range(2 * count * lines.pitch):
        lines.paths[i] = ZERO
    for i in range(count * v.LANES):
        lines.least[i] = ZERO


@inner
def _likelihoods(lines, mask, y, height, two_views):
    """One row of scores to log-likelihoods, nats: -ln(1 - s^2) / 2 of two views, -ln(1 - s) of three."""
    volume, slabs = lines.volume, lines.slabs
    one, nothing, limit = v.broadcast(ONE), v.broadcast(ZERO), v.broadcast(_LEAST_DETERMINANT)
    unit, nats = v.broadcast(ONE / SCORE_SCALE), -_HALF * _NATS
    for x in range(len(mask)):
        factor = v.broadcast(nats * mask[x])
        at = _address(y, x, height, slabs)
        for i in range(at, at + slabs * BLOCK * v.LANES, BLOCK * v.LANES):
            score = v.larger(v.mul(v.load_shorts(volume, i), unit), nothing)
            if two_views:
                determinant = v.fnma(score, score, one)
            else:
                determinant = v.sub(one, score)
                determinant = v.mul(determinant, determinant)
            v.put_shorts(volume, i, v.mul(factor, v.logarithm(v.larger(determinant, limit))))


@inner
def _read_at_labels(lines, offset, scale, y, height, settings, scores, at_labels):
    """Interpolate one row of scores at the labels of a map, by cubics through four layers; 0 beyond them."""
    volume, slabs, count = lines.volume, lines.slabs, settings.layers
    for x in range(len(offset)):
        at = _address(y, x, height, slabs)
        for s in range(slabs):
            v.store(scores, s * v.LANES + 1, v.load_shorts(volume, at + s * BLOCK * v.LANES))
        scores[0] = scores[1]
        scores[count + 1] = scores[count]
        begin = (offset[x] + (scale[x] - ONE) * settings.first) / settings.step
        for k in range(count):
            place = begin + scale[x] * np.float32(k)
            below = min(max(int(place), 0), count - 2)
            t = place - np.float32(below)
            before, low = v.get(scores, below), v.get(scores, below + 1)
            high, after = v.get(scores, below + 2), v.get(scores, below + 3)
            third = _THREE * (low - high) + after - before  # Catmull and Rom's cubic
            second = before + before - _FIVE * low + _FOUR * high - after
            value = low + _HALF * t * (high - before + t * (second + t * third))
            at_labels[k] = value if ZERO <= t <= ONE else ZERO
        for k in range(count, slabs * v.LANES):
            at_labels[k] = ZERO
        for s in range(slabs):
            v.put_shorts(volume, at + s * BLOCK * v.LANES, v.load(at_labels, s * v.LANES))


@inner
def _arrive(lines, settings, weight, line, parity):
    """Slots of the pixel here and the one before, the least cost there, and with a jump over the link between them."""
    here, there = (2 * line + parity) * lines.pitch, (2 * line + 1 - parity) * lines.pitch
    smallest = v.load(lines.least, line * v.LANES)
    return here, there, smallest, v.add(smallest, v.broadcast(weight * settings.jump))


@inner
def _incoming(paths, i, jump, smallest):
    """Costs of eight layers that come in from the pixel before: m(d) of the module's docstring."""
    return v.sub(v.smaller(v.load(paths, i), jump), smallest)


@inner
def _propagate(lines, settings, at, weight, line, parity, add):
    """Store or add the path costs that come in, and leave those of this pixel for the next one."""
    volume, sums, paths, slabs = lines.volume, lines.sums, lines.paths, lines.slabs
    here, there, smallest, jump = _arrive(lines, settings, weight, line, parity)
    into, nats = v.broadcast(lines.unit), v.broadcast(-ONE / _NATS)
    lowest = v.broadcast(_FAR)
    for s in range(0, slabs * v.LANES, v.LANES):
        incoming = _incoming(paths, there + s, jump, smallest)
        i = at + s * BLOCK
        if add:
            v.put_shorts(sums, i, v.fma(incoming, into, v.load_shorts(sums, i)))
        else:
            v.put_shorts(sums, i, v.mul(incoming, into))
        cost = v.fma(v.load_shorts(volume, i), nats, v.add(incoming, v.load(lines.closed, s)))
        v.store(paths, here + s, cost)
        lowest = v.smaller(lowest, cost)
    v.store(lines.least, line * v.LANES, v.least_lane(lowest))


@inner
def _decide(lines, settings, at, weight, line, parity, decision):
    """Propagate the last path costs, leave the sum of all in ``decision.costs`` and return the best layer."""
    volume, sums, paths, slabs = lines.volume, lines.sums, lines.paths, lines.slabs
    here, there, smallest, jump = _arrive(lines, settings, weight, line, parity)
    nats_sum, nats, raised = v.broadcast(ONE / lines.unit), v.broadcast(-ONE / _NATS), v.broadcast(_RAISED)
    keep = v.load(decision.tags, 0)
    lowest, best = v.broadcast(_FAR), v.broadcast(_FAR)
    for s in range(0, slabs * v.LANES, v.LANES):
        incoming = _incoming(paths, there + s, jump, smallest)
        i = at + s * BLOCK
        cost = v.fma(v.load_shorts(volume, i), nats, v.add(incoming, v.load(lines.closed, s)))
        v.store(paths, here + s, cost)
        lowest = v.smaller(lowest, cost)
        total = v.add(v.fma(v.load_shorts(sums, i), nats_sum, cost), raised)
        v.store(decision.costs, s, total)
        best = v.smaller(best, v.tagged(total, keep, v.load(decision.tags, v.LANES + s)))
    v.store(lines.least, line * v.LANES, v.least_lane(lowest))
    v.store(decision.lanes, v.LANES, v.least_lane(best))
    return np.int64(v.get(decision.bits, v.LANES) & decision.mask)


@inner
def _posterior_sigma(decision, slabs, best, settings):
    """Root mean square distance of the layers from the best, weighted by (1 - excess cost / 8 T)^8; in layers."""
    costs = decision.costs
    cooling = v.broadcast(-_EIGHTH / settings.temperature)
    start = v.broadcast(ONE + v.get(costs, best) * _EIGHTH / settings.temperature)
    nothing = v.broadcast(ZERO)
    weights, squares = nothing, nothing
    away = v.sub(v.load(decision.lanes, 0), v.broadcast(np.float32(best)))
    eight = v.broadcast(np.float32(v.LANES))
    for s in range(0, slabs * v.LANES, v.LANES):
        weight = v.larger(v.fma(v.load(costs, s), cooling, start), nothing)
        weight = v.mul(weight, weight)
        weight = v.mul(weight, weight)
        weight = v.mul(weight, weight)
        weights = v.add(weights, weight)
        squares = v.fma(weight, v.mul(away, away), squares)
        away = v.add(away, eight)
    return np.sqrt(v.lane(v.sum_lanes(squares), 0) / v.lane(v.sum_lanes(weights), 0))

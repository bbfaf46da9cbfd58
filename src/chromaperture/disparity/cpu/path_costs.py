# mypy: disallow-untyped-defs=False
"""Path costs along rows and columns, eight layers a vector: the inner part of `four_paths.py`.

A pixel q with the path cost c, its own included, adds to its neighbour on the path
``m(d) = min(c(d), min c + e jump) - min c``. The sum of these over the four paths and the pixel's own cost decide.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.disparity.cpu import simd as v
from chromaperture.disparity.cpu.layout import BLOCK, GROUP, ONE, SCORE_SCALE, ZERO, inner, kernel
from chromaperture.disparity.stages.four_paths import LEAST_DETERMINANT, NAT_PARTS, POSTERIOR_POWER

assert POSTERIOR_POWER == 8  # squared three times below

_LEAST_DETERMINANT = np.float32(LEAST_DETERMINANT)
_NATS = np.float32(NAT_PARTS)  # a nat of log-likelihood in int16
_CLOSED = np.float32(1e4)  # nats; cost of the lanes beyond the last layer
_RAISED = np.float32(8)  # nats; makes all costs positive: positive floats are ordered as their bits are
_FAR = np.float32(3e4)  # nats; beyond any sum of costs, and of those of `_CLOSED`
_HALF = np.float32(0.5)
_TWO, _THREE, _FOUR, _FIVE = np.float32(2), np.float32(3), np.float32(4), np.float32(5)
_EIGHTH = np.float32(0.125)
_BASE = 2 * v.LANES  # where a pixel's layers start in a scratch
_STEEP = np.float32(1e6)  # a label is beyond the last layer by a millionth of a layer, or not at all


class Layers(NamedTuple):
    """What was scored: the first layer and their distance, px; ``between``: labels lie between them."""

    first: np.float32
    step: np.float32
    number: int
    between: bool


class Settings(NamedTuple):
    """Penalty and temperature, nats; the first label and their distance, px; float32 but for the count."""

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
def along_rows(scores, volume, sums, mask, links, labels, layers, settings, two_views, top, bottom):
    """Turn scores of layers into log-likelihoods of labels and add up the path costs along x.

    Parameters
    ----------
    scores : (blocks, H, slabs, BLOCK, 8) int16, flat
    volume : of the labels; written: log-likelihoods; the scores' own memory unless labels lie between the layers
    sums : like volume; written: the costs of both paths
    mask, links : (H, W) float32
    labels : LabelMap, (H, W) float32 or (1, 1)
    layers : Layers
    settings : Settings
    two_views : bool
    top, bottom : int; the rows from ``top`` to before ``bottom``
    """
    height, width = mask.shape
    lines = _lines(volume, sums, settings, GROUP)
    slabs = lines.slabs
    own = (layers.number + v.LANES - 1) // v.LANES * v.LANES
    here = np.zeros(own + _BASE + 2 * v.LANES, np.float32)
    for i in range(v.LANES):
        here[i] = np.float32(i)
    at_labels = np.zeros((own + v.LANES) * max(1, np.int64(np.rint(layers.step / settings.step))), np.float32)
    many = labels.scale.size > 1
    for row in range(top, bottom, GROUP):
        rows = min(GROUP, bottom - row)
        for j in range(rows):
            y = row + j
            if layers.between:
                _read_at_labels(scores, lines, labels, y if many else 0, many, mask[y], y, height, layers, settings,
                                here, at_labels, two_views)  # fmt: skip
            else:
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
    """One row of scores to log-likelihoods in place: -ln(1 - s^2) / 2 of two views, -ln(1 - s) of three, nats."""
    volume, slabs = lines.volume, lines.slabs
    nats = -_HALF * _NATS
    for x in range(len(mask)):
        factor = v.broadcast(nats * mask[x])
        at = _address(y, x, height, slabs)
        for i in range(at, at + slabs * BLOCK * v.LANES, BLOCK * v.LANES):
            v.put_shorts(volume, i, v.mul(factor, _log_determinant(_unexplained(volume, i), two_views)))


@inner
def _unexplained(scores, i):
    """Read what eight scores leave of 1: of whole numbers, so that next to a score of 1 nothing is rounded off."""
    return v.mul(v.sub(v.broadcast(SCORE_SCALE), v.load_shorts(scores, i)), v.broadcast(ONE / SCORE_SCALE))


@inner
def _log_determinant(unexplained, two_views):
    """Logarithm of the determinant of the views' correlations, by what is left of 1 by the score."""
    unexplained = v.larger(v.smaller(unexplained, v.broadcast(ONE)), v.broadcast(ZERO))  # cubics overshoot
    determinant = v.mul(unexplained, v.sub(v.broadcast(_TWO), unexplained) if two_views else unexplained)
    return v.logarithm(v.larger(determinant, v.broadcast(_LEAST_DETERMINANT)))


@inner
def _read_at_labels(
    scores, lines, labels, map_row, many, mask, y, height, layers, settings, here, at_labels, two_views
):
    """One row of scores to log-likelihoods of labels, interpolated by cubics through four layers; 0 beyond them.

    ``here`` holds lane numbers, then from `_BASE` on a pixel's layers, at its end room for a vector.
    """
    volume, slabs, count = lines.volume, lines.slabs, layers.number
    own_slabs = (count + v.LANES - 1) // v.LANES
    nats = -_HALF * _NATS
    parts = np.int64(np.rint(layers.step / settings.step))
    for x in range(len(mask)):
        at = _address(y, x, height, own_slabs)
        for s in range(own_slabs):
            v.store(here, _BASE + s * v.LANES, _unexplained(scores, at + s * BLOCK * v.LANES))
        here[_BASE - 1] = here[_BASE]
        here[_BASE + count] = here[_BASE + count - 1]
        column = x if many else 0
        offset, scale = labels.offset_px[map_row, column], labels.scale[map_row, column]
        begin = (offset + scale * settings.first - layers.first) / layers.step
        part = scale / np.float32(parts)
        for k in range(0, count, v.LANES):
            if parts == 1:
                v.store(at_labels, k, _read_eight(here, begin, scale, k, count))
            elif parts == 2:
                even, odd = _read_eight(here, begin, scale, k, count), _read_eight(here, begin + part, scale, k, count)
                v.store(at_labels, 2 * k, v.shuffled_low(even, odd))
                v.store(at_labels, 2 * k + v.LANES, v.shuffled_high(even, odd))
            else:
                for n in range(parts):
                    eight = _read_eight(here, begin + np.float32(n) * part, scale, k, count)
                    for i in range(v.LANES):
                        v.put_lane(at_labels, (k + i) * parts + n, eight, i)
        factor = v.broadcast(nats * mask[x])
        at = _address(y, x, height, slabs)
        for s in range(slabs):
            logarithm = _log_determinant(v.load(at_labels, s * v.LANES), two_views)
            v.put_shorts(volume, at + s * BLOCK * v.LANES, v.mul(factor, logarithm))


@inner
def _read_eight(here, begin, scale, first, count):
    """Read what scores leave of 1 at eight places a ``scale`` apart, from ``begin + first * scale``.

    Places and layers count from 0; beyond the layers 1 is left.
    """
    low = begin + scale * np.float32(first)
    high = begin + scale * np.float32(first + v.LANES - 1)
    ahead = np.floor(low) - np.float32(first)
    if low >= ZERO and high < np.float32(count) and np.floor(high) - np.float32(first + v.LANES - 1) == ahead:
        # The layers below the eight places are neighbours.
        at = _BASE + first + np.int64(ahead)
        t = v.fma(v.load(here, 0), v.broadcast(scale - ONE), v.broadcast(low - np.floor(low)))
        before, middle, after, later = (
            v.load(here, at - 1),
            v.load(here, at),
            v.load(here, at + 1),
            v.load(here, at + 2),
        )
        two, three, four, five = v.broadcast(_TWO), v.broadcast(_THREE), v.broadcast(_FOUR), v.broadcast(_FIVE)
        third = v.fma(three, v.sub(middle, after), v.sub(later, before))  # Catmull and Rom's cubic
        second = v.sub(v.fma(four, after, v.fnma(five, middle, v.mul(two, before))), later)
        slope = v.fma(t, v.fma(t, third, second), v.sub(after, before))
        value = v.fma(v.mul(v.broadcast(_HALF), t), slope, middle)
        if high <= np.float32(count - 1):
            return value
        room = v.fnma(v.broadcast(scale), v.load(here, 0), v.broadcast(np.float32(count - 1) - low))
        inside = v.fma(room, v.broadcast(_STEEP), v.broadcast(ONE))  # 1 up to the last layer, 0 beyond
        inside = v.larger(v.smaller(inside, v.broadcast(ONE)), v.broadcast(ZERO))
        return v.fma(inside, v.sub(value, v.broadcast(ONE)), v.broadcast(ONE))
    spill = len(here) - v.LANES
    for i in range(v.LANES):
        place = low + scale * np.float32(i)
        below = min(max(np.int64(place), 0), count - 2)
        t = place - np.float32(below)
        at = _BASE + below
        before, middle, after, later = here[at - 1], here[at], here[at + 1], here[at + 2]
        third = _THREE * (middle - after) + later - before
        second = before + before - _FIVE * middle + _FOUR * after - later
        value = middle + _HALF * t * (after - before + t * (second + t * third))
        v.put(here, spill + i, value if ZERO <= t <= ONE and place >= ZERO else ONE)
    return v.load(here, spill)


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

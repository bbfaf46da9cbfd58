# mypy: disallow-untyped-defs=False
"""Path costs along rows and columns, eight layers a vector: the inner part of `four_paths.py`.

A pixel q with the path cost c, its own included, adds to its neighbour on the path
``m(d) = min(c(d), min c + e jump) - min c``. The sum of these over the four paths and the pixel's own cost decide.
Columns count a share of what rows have added as a pixel's own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.compiled.label_scores import BASE, NATS, address, likelihoods, read_at_labels
from chromaperture.matching.compiled.layout import BLOCK, GROUP, ONE, ZERO, inner, kernel
from chromaperture.matching.readable.four_paths import POSTERIOR_POWER

assert POSTERIOR_POWER == 8  # squared three times below

_CLOSED = np.float32(1e4)  # nats; cost of the lanes beyond the last layer
_RAISED = np.float32(8)  # nats; makes all costs positive: positive floats are ordered as their bits are
_FAR = np.float32(3e4)  # nats; beyond any sum of costs, and of those of `_CLOSED`
_TWO = np.float32(2)
_EIGHTH = np.float32(0.125)


class Settings(NamedTuple):
    """Penalty and temperature, nats; the first label and their distance, px; float32 but for the count."""

    jump: np.float32
    row_share: np.float32
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
    unit: np.float32  # a nat of the sum of two path costs in int16


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

    ``scores`` (blocks, H, slabs, BLOCK, 8) int16, flat; ``volume`` of the labels; written: log-likelihoods; the scores'
    own memory unless labels lie between the layers; ``sums`` like volume; written: the costs of both paths; ``mask``,
    ``links`` (H, W) float32; ``labels`` LabelMap, (H, W) float32 or (1, 1); ``top``, ``bottom`` int; the rows from
    ``top`` to before ``bottom``.
    """
    height, width = mask.shape
    lines = _lines(volume, sums, settings, GROUP)
    slabs = lines.slabs
    own = (layers.number + v.LANES - 1) // v.LANES * v.LANES
    here = np.zeros(own + BASE + 2 * v.LANES, np.float32)
    for i in range(v.LANES):
        here[i] = np.float32(i)
    at_labels = np.zeros((own + v.LANES) * max(1, np.int64(np.rint(layers.step / settings.step))), np.float32)
    many = labels.scale.size > 1
    for row in range(top, bottom, GROUP):
        rows = min(GROUP, bottom - row)
        for j in range(rows):
            y = row + j
            if layers.between:
                read_at_labels(scores, volume, slabs, labels, y if many else 0, many, mask[y], y, height, layers,
                               settings, here, at_labels, two_views)  # fmt: skip
            else:
                likelihoods(volume, slabs, mask[y], y, height, two_views)
        _start(lines, rows)
        for x in range(width):
            for j in range(rows):
                at = address(row + j, x, height, slabs)
                _propagate(lines, settings, at, v.get(links[row + j], x), j, x & 1, False)
        _start(lines, rows)
        for x in range(width - 1, -1, -1):
            for j in range(rows):
                at = address(row + j, x, height, slabs)
                weight = v.get(links[row + j], x + 1) if x + 1 < width else ZERO
                _propagate(lines, settings, at, weight, j, x & 1, True)
    v.fence()


@kernel
def along_columns(volume, sums, links, settings, first_block, last_block, winner):
    """Add the path costs along y and find the best layer of every pixel.

    ``links`` (H, W) float32; ``first_block``, ``last_block`` int; blocks of columns; ``winner`` PathWinner; written.
    """
    height, width = links.shape
    lines = _lines(volume, sums, settings, BLOCK)
    slabs = lines.slabs
    decision = _decision(slabs)
    down = np.empty(height * slabs * BLOCK * v.LANES, np.int16)  # what comes down the columns of a block
    for block in range(first_block, last_block):
        left = block * BLOCK
        used = min(BLOCK, width - left)
        _start(lines, BLOCK)
        for y in range(height):
            for j in range(used):
                at, in_block = address(y, left + j, height, slabs), address(y, j, height, slabs)
                _propagate_down(lines, settings, at, v.get(links, y * width + left + j), j, y & 1, down, in_block)
        _start(lines, BLOCK)
        for y in range(height - 1, -1, -1):
            for j in range(used):
                at, in_block = address(y, left + j, height, slabs), address(y, j, height, slabs)
                weight = v.get(links, (y + 1) * width + left + j) if y + 1 < height else ZERO
                best = _decide(lines, settings, at, weight, j, y & 1, decision, down, in_block)
                i = y * width + left + j
                v.put(winner.layer, i, np.float32(best))
                inside = min(max(best, 1), settings.layers - 2)
                _put_likelihood(volume, at, inside - 1, winner.before, i)
                _put_likelihood(volume, at, inside, winner.at, i)
                _put_likelihood(volume, at, inside + 1, winner.after, i)
                _put_likelihood(volume, at, max(inside - 2, 0), winner.far_before, i)
                _put_likelihood(volume, at, min(inside + 2, settings.layers - 1), winner.far_after, i)
                v.put(winner.sigma_px, i, settings.step * _posterior_sigma(decision, slabs, best, settings))


@inner
def _put_likelihood(volume, at, layer, out, i):
    own = v.get(volume, at + (layer >> 3) * BLOCK * v.LANES + (layer & (v.LANES - 1)))
    v.put(out, i, np.float32(own) * (ONE / NATS))


@inner
def _lines(volume, sums, settings, count):
    """Room for ``count`` lines."""
    slabs = (settings.layers + v.LANES - 1) // v.LANES
    pitch = slabs * v.LANES
    closed = np.zeros(slabs * v.LANES, np.float32)
    for s in range(settings.layers, slabs * v.LANES):
        closed[s] = _CLOSED
    paths = np.empty(2 * count * pitch, np.float32)
    unit = np.float32(32000) / (_TWO * settings.jump)  # `readable.four_paths.path_parts`
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
    into, nats = v.broadcast(lines.unit), v.broadcast(-ONE / NATS)
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
def _own_cost(lines, settings, i, s):
    """Cost of eight layers of a pixel as the columns see it: its own and a share of what comes along its row."""
    share, nats = v.broadcast(settings.row_share / lines.unit), v.broadcast(-ONE / NATS)
    along_row = v.fma(v.load_shorts(lines.sums, i), share, v.load(lines.closed, s))
    return v.fma(v.load_shorts(lines.volume, i), nats, along_row)


@inner
def _propagate_down(lines, settings, at, weight, line, parity, down, in_block):
    """Store the path costs that come down, and leave those of this pixel for the next one."""
    here, there, smallest, jump = _arrive(lines, settings, weight, line, parity)
    into, lowest = v.broadcast(lines.unit), v.broadcast(_FAR)
    for s in range(0, lines.slabs * v.LANES, v.LANES):
        incoming = _incoming(lines.paths, there + s, jump, smallest)
        v.put_shorts(down, in_block + s * BLOCK, v.mul(incoming, into))
        cost = v.add(_own_cost(lines, settings, at + s * BLOCK, s), incoming)
        v.store(lines.paths, here + s, cost)
        lowest = v.smaller(lowest, cost)
    v.store(lines.least, line * v.LANES, v.least_lane(lowest))


@inner
def _decide(lines, settings, at, weight, line, parity, decision, down, in_block):
    """Propagate the last path costs, leave the sum of all in ``decision.costs`` and return the best layer."""
    sums, paths, slabs = lines.sums, lines.paths, lines.slabs
    here, there, smallest, jump = _arrive(lines, settings, weight, line, parity)
    nats_sum, rest = v.broadcast(ONE / lines.unit), v.broadcast((ONE - settings.row_share) / lines.unit)
    raised = v.broadcast(_RAISED)
    keep = v.load(decision.tags, 0)
    lowest, best = v.broadcast(_FAR), v.broadcast(_FAR)
    for s in range(0, slabs * v.LANES, v.LANES):
        incoming = _incoming(paths, there + s, jump, smallest)
        i = at + s * BLOCK
        cost = v.add(_own_cost(lines, settings, i, s), incoming)
        v.store(paths, here + s, cost)
        lowest = v.smaller(lowest, cost)
        total = v.fma(v.load_shorts(down, in_block + s * BLOCK), nats_sum, v.add(cost, raised))
        total = v.fma(v.load_shorts(sums, i), rest, total)
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

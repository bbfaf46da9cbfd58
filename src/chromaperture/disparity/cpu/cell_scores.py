# mypy: disallow-untyped-defs=False
"""Correlations for cells of 2 x 2 px, compiled; ``stages/correlation.py`` explains what is computed.

Eight neighbouring cells are one vector. A thread takes bands of rows; for every layer it samples the views, sums their
products over windows along x, at every second px only, and then over the rows of a ring. Columns of even and of odd
number are kept apart, so that every second px is a neighbour in memory. Layers whose samples lie at the same sub-pixel
phase follow each other and share them.

Memory: 2 bytes a score and 0.5 MB a thread at 1280 px width.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from chromaperture.disparity.cpu import simd as v
from chromaperture.disparity.cpu.layout import BLOCK, ONE, SCORE_SCALE, ZERO, inner, kernel, whole_vectors
from chromaperture.disparity.cpu.workspace import Workspace
from chromaperture.disparity.stages.correlation import CELL_TAPS, SAMPLING, variance_floor
from chromaperture.disparity.views import Views, view_pairs
from chromaperture.stage_config import CorrelationConfig
from chromaperture.threads import in_parallel

_BAND_ROWS = 24  # of cells: the window's four rows more cost 8 %, and the samples, 0.4 MB, stay in the cache
_RING = 5  # rows of a window
_REACH = 2  # px of a window's taps
_OUTER, _NEXT, _MIDDLE = (np.float32(tap) for tap in CELL_TAPS)


class _Plan(NamedTuple):
    """How layers find their samples, in the order in which they are computed."""

    order: np.ndarray  # (D,) int: layers
    fresh: np.ndarray  # (D, K) bool: sampled anew for this layer, not left from the one before
    taps: np.ndarray  # (D, K, 2, 4) float32: along x, along y
    whole: np.ndarray  # (D, K, 2) int: px along x, along y
    pairs: np.ndarray  # (P, 2) int
    floors: np.ndarray  # (K,) float32: variances below are even areas
    margin: int  # px of the samples beyond the picture


def cell_scores(views: Views, layers_px: np.ndarray, memory: Workspace, *, config: CorrelationConfig) -> np.ndarray:
    """Score all layers of every cell; int16, flat, see ``layout.py``.

    Parameters
    ----------
    views : Views
    layers_px : (D,) float, px
    memory : Workspace
    config : CorrelationConfig
        Its ``cell_px`` is 2.
    """
    height, width = views.mask.shape
    rows, columns = -(-height // 2), -(-width // 2)
    plan = _plan(views, layers_px, config)
    count, series = views.pictures.shape[2], 2 * views.pictures.shape[2] + len(plan.pairs)
    wide = -(-columns // v.LANES) * v.LANES
    length = wide + plan.margin + 2 * v.LANES  # of the even or of the odd columns of a row
    halves = memory.array("halves", (count, 2, height, length), np.float32)
    volume = memory.array("volume", (-(-columns // BLOCK) * BLOCK * rows * whole_vectors(len(layers_px)),), np.int16)
    planes = np.ascontiguousarray(np.moveaxis(views.pictures, 2, 0), np.float32)

    def split(_: int, top: int, bottom: int) -> None:
        _split_columns(planes, plan.margin, halves, top, bottom)

    in_parallel(split, height)

    def score(_: int, first: int, last: int) -> None:
        samples = np.zeros((count, 2 * _BAND_ROWS + 2 * _REACH, 2, length), np.float32)
        sums = np.zeros((_RING * series + 1, wide + v.LANES), np.float32)
        for top in range(first, last, _BAND_ROWS):
            _score_band(halves, plan, samples, sums, top, min(top + _BAND_ROWS, last), columns, rows, volume)

    in_parallel(score, rows)
    return volume


def _plan(views: Views, layers_px: np.ndarray, config: CorrelationConfig) -> _Plan:
    taps_of = SAMPLING[config.sampling]
    offsets = layers_px[:, None, None] * views.directions  # (D, K, 2)
    whole = np.floor(offsets + 1e-9)  # 1e-9: a whole shift but for rounding is whole
    phases = np.round(np.maximum(offsets - whole, 0), 9)
    whole = whole.astype(np.int64)
    keys = [tuple((*phases[s].ravel(), *whole[s, :, 1])) for s in range(len(layers_px))]
    order = np.array(sorted(range(len(keys)), key=lambda s: keys[s]))
    fresh = np.ones((len(order), len(views.directions)), np.bool_)
    for i in range(1, len(order)):
        now, last = order[i], order[i - 1]
        for k in range(len(views.directions)):
            same = (phases[now, k] == phases[last, k]).all() and whole[now, k, 1] == whole[last, k, 1]
            fresh[i, k] = not same
    taps = np.array([[[taps_of(t) for t in phase] for phase in layer] for layer in phases], np.float32)
    # Whole vectors: the first and the last one of a row are not sampled.
    margin = v.LANES * (2 + math.ceil((np.abs(whole[..., 0]).max() + _REACH + 3) / v.LANES))
    pairs = np.array(view_pairs(len(views.directions)))
    return _Plan(order, fresh, taps, whole, pairs, variance_floor(views.pictures).astype(np.float32), margin)


@kernel
def _split_columns(planes, margin, halves, top, bottom):
    """Put the even and the odd columns of rows side by side, the picture continued by its borders."""
    count, _, width = planes.shape
    for k in range(count):
        for y in range(top, bottom):
            row, even, odd = planes[k, y], halves[k, 0, y], halves[k, 1, y]
            for i in range(len(even)):
                x = 2 * i - margin
                even[i] = row[min(max(x, 0), width - 1)]
                odd[i] = row[min(max(x + 1, 0), width - 1)]


@kernel
def _score_band(halves, plan, samples, sums, top, bottom, columns, rows, volume):
    """Score the rows of cells from ``top`` to before ``bottom``."""
    count, series = len(samples), (len(sums) - 1) // _RING
    layers = len(plan.order)
    slabs = (layers + v.LANES - 1) // v.LANES
    first, last = 2 * top - _REACH, 2 * (bottom - 1) + _REACH + 1  # rows of px
    ends = np.empty((count, 2), np.int64)  # where the samples of cell 0 start: of its own px, of the px after it
    scores = sums[_RING * series]
    used = (columns + v.LANES - 1) // v.LANES * v.LANES
    for step in range(layers):
        layer = plan.order[step]
        for k in range(count):
            if plan.fresh[step, k]:
                _sample(halves[k], plan.taps[layer, k], plan.whole[layer, k, 1], samples[k], first, last)
            ahead = plan.whole[layer, k, 0] + plan.margin
            length = samples.shape[3]
            ends[k, 0] = (ahead & 1) * length + (ahead >> 1)
            ends[k, 1] = ((ahead + 1) & 1) * length + ((ahead + 1) >> 1)
        for y in range(first, last):
            ring = (y - first) % _RING * series
            if count == 2:
                _sum_two(samples, y - first, ends, sums, ring, used)
            else:
                _sum_three(samples, y - first, ends, sums, ring, used)
            if y < first + 2 * _REACH or (y - first) % 2 == 1:
                continue
            row = top + (y - first - 2 * _REACH) // 2
            if count == 2:
                _score_two(sums, (y - first + 1) % _RING, series, plan.floors, used, scores)
            else:
                _score_three(sums, (y - first + 1) % _RING, series, plan.floors, used, scores)
            at = (row * slabs + layer // v.LANES) * BLOCK * v.LANES + layer % v.LANES
            for x in range(columns):
                place = at + (x // BLOCK) * rows * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES
                volume[place] = np.int16(np.rint(v.get(scores, x) * SCORE_SCALE))
    for layer in range(layers, slabs * v.LANES):  # lanes that only fill the last vector
        for row in range(top, bottom):
            at = (row * slabs + layer // v.LANES) * BLOCK * v.LANES + layer % v.LANES
            for x in range(columns):
                volume[at + (x // BLOCK) * rows * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES] = -SCORE_SCALE


@inner
def _sample(halves, taps, down, samples, first, last):
    """Read a view at a sub-pixel phase: rows of px from ``first`` to before ``last``, moved by ``down`` whole rows."""
    height, length = halves.shape[1:]
    x0, x1, x2, x3 = taps[0]
    y0, y1, y2, y3 = taps[1]
    a0, a1, a2, a3 = v.broadcast(x0), v.broadcast(x1), v.broadcast(x2), v.broadcast(x3)
    b0, b1, b2, b3 = v.broadcast(y0), v.broadcast(y1), v.broadcast(y2), v.broadcast(y3)
    lines = np.zeros((2, length + v.LANES), np.float32)
    even, odd = lines[0], lines[1]
    for y in range(first, last):
        at = y + down
        r0, r1 = min(max(at - 1, 0), height - 1) * length, min(max(at, 0), height - 1) * length
        r2, r3 = min(max(at + 1, 0), height - 1) * length, min(max(at + 2, 0), height - 1) * length
        for parity in range(2):
            view, line = halves[parity], lines[parity]
            for i in range(0, length, v.LANES):
                value = v.fma(b0, v.load(view, r0 + i), v.mul(b1, v.load(view, r1 + i)))
                v.store(line, i, v.fma(b3, v.load(view, r3 + i), v.fma(b2, v.load(view, r2 + i), value)))
        out = samples[y - first]
        to_even, to_odd = out[0], out[1]
        for i in range(v.LANES, length - v.LANES, v.LANES):
            before, here, beside = v.load(odd, i - 1), v.load(even, i), v.load(odd, i)
            after, later = v.load(even, i + 1), v.load(odd, i + 1)
            v.store(to_even, i, v.fma(a3, after, v.fma(a2, beside, v.fma(a1, here, v.mul(a0, before)))))
            v.store(to_odd, i, v.fma(a3, later, v.fma(a2, after, v.fma(a1, beside, v.mul(a0, here)))))


@inner
def _sum_two(samples, row, ends, sums, ring, used):
    """Mean, variance and covariance of two views in the part of every second window that lies in a row.

    Of differences from the middle: mean squares of 32 bits would take even areas for texture.
    """
    size = samples.shape[1] * samples.shape[2] * samples.shape[3]
    line = row * samples.shape[2] * samples.shape[3]
    a0, a1 = line + ends[0, 0], line + ends[0, 1]
    b0, b1 = size + line + ends[1, 0], size + line + ends[1, 1]
    outer, beside = v.broadcast(_OUTER), v.broadcast(_NEXT)
    pitch = sums.shape[1]
    out = ring * pitch
    for x in range(0, used, v.LANES):
        middle_a, middle_b = v.load(samples, a0 + x), v.load(samples, b0 + x)
        a, b = v.sub(v.load(samples, a0 + x - 1), middle_a), v.sub(v.load(samples, b0 + x - 1), middle_b)
        wa, wb = v.mul(outer, a), v.mul(outer, b)
        sa, sb, saa, sbb, sab = wa, wb, v.mul(wa, a), v.mul(wb, b), v.mul(wa, b)
        a, b = v.sub(v.load(samples, a0 + x + 1), middle_a), v.sub(v.load(samples, b0 + x + 1), middle_b)
        wa, wb = v.mul(outer, a), v.mul(outer, b)
        sa, sb = v.add(sa, wa), v.add(sb, wb)
        saa, sbb, sab = v.fma(wa, a, saa), v.fma(wb, b, sbb), v.fma(wa, b, sab)
        a, b = v.sub(v.load(samples, a1 + x - 1), middle_a), v.sub(v.load(samples, b1 + x - 1), middle_b)
        wa, wb = v.mul(beside, a), v.mul(beside, b)
        sa, sb = v.add(sa, wa), v.add(sb, wb)
        saa, sbb, sab = v.fma(wa, a, saa), v.fma(wb, b, sbb), v.fma(wa, b, sab)
        a, b = v.sub(v.load(samples, a1 + x), middle_a), v.sub(v.load(samples, b1 + x), middle_b)
        wa, wb = v.mul(beside, a), v.mul(beside, b)
        sa, sb = v.add(sa, wa), v.add(sb, wb)
        saa, sbb, sab = v.fma(wa, a, saa), v.fma(wb, b, sbb), v.fma(wa, b, sab)
        v.store(sums, out + x, v.add(middle_a, sa))
        v.store(sums, out + pitch + x, v.add(middle_b, sb))
        v.store(sums, out + 2 * pitch + x, v.fnma(sa, sa, saa))
        v.store(sums, out + 3 * pitch + x, v.fnma(sb, sb, sbb))
        v.store(sums, out + 4 * pitch + x, v.fnma(sa, sb, sab))


@inner
def _sum_three(samples, row, ends, sums, ring, used):
    """As `_sum_two`, of three views."""
    size = samples.shape[1] * samples.shape[2] * samples.shape[3]
    line = row * samples.shape[2] * samples.shape[3]
    pitch = sums.shape[1]
    out = ring * pitch
    nothing = v.broadcast(ZERO)
    for x in range(0, used, v.LANES):
        sa, sb, sc, saa, sbb, scc = nothing, nothing, nothing, nothing, nothing, nothing
        sab, sac, sbc = nothing, nothing, nothing
        middle_a = v.load(samples, line + x + ends[0, 0])
        middle_b = v.load(samples, size + line + x + ends[1, 0])
        middle_c = v.load(samples, 2 * size + line + x + ends[2, 0])
        for tap in range(4):
            odd = 1 if tap == 1 or tap == 2 else 0
            at = line + x + (-1 if tap < 2 else 0 if tap == 2 else 1)
            weight = v.broadcast(_NEXT if odd == 1 else _OUTER)
            a = v.sub(v.load(samples, at + ends[0, odd]), middle_a)
            b = v.sub(v.load(samples, size + at + ends[1, odd]), middle_b)
            c = v.sub(v.load(samples, 2 * size + at + ends[2, odd]), middle_c)
            wa, wb, wc = v.mul(weight, a), v.mul(weight, b), v.mul(weight, c)
            sa, sb, sc = v.add(sa, wa), v.add(sb, wb), v.add(sc, wc)
            saa, sbb, scc = v.fma(wa, a, saa), v.fma(wb, b, sbb), v.fma(wc, c, scc)
            sab, sac, sbc = v.fma(wa, b, sab), v.fma(wa, c, sac), v.fma(wb, c, sbc)
        v.store(sums, out + x, v.add(middle_a, sa))
        v.store(sums, out + pitch + x, v.add(middle_b, sb))
        v.store(sums, out + 2 * pitch + x, v.add(middle_c, sc))
        v.store(sums, out + 3 * pitch + x, v.fnma(sa, sa, saa))
        v.store(sums, out + 4 * pitch + x, v.fnma(sb, sb, sbb))
        v.store(sums, out + 5 * pitch + x, v.fnma(sc, sc, scc))
        v.store(sums, out + 6 * pitch + x, v.fnma(sa, sb, sab))
        v.store(sums, out + 7 * pitch + x, v.fnma(sa, sc, sac))
        v.store(sums, out + 8 * pitch + x, v.fnma(sb, sc, sbc))


@inner
def _of_row(sums, oldest, series, which, row, x):
    """Load one of the series of a row of the ring, of which ``oldest`` is the first."""
    return v.load(sums, (((oldest + row) % _RING) * series + which) * sums.shape[1] + x)


@inner
def _window(sums, oldest, series, which, x):
    """Sum one of the series over the rows of the ring."""
    ends = v.add(_of_row(sums, oldest, series, which, 0, x), _of_row(sums, oldest, series, which, 4, x))
    inside = v.add(_of_row(sums, oldest, series, which, 1, x), _of_row(sums, oldest, series, which, 3, x))
    value = v.mul(v.broadcast(_MIDDLE), _of_row(sums, oldest, series, which, 2, x))
    return v.fma(v.broadcast(_OUTER), ends, v.fma(v.broadcast(_NEXT), inside, value))


@inner
def _joined(sums, oldest, series, one, other, which, x):
    """Covariance in a window: that within its rows, and that of the rows' means, of the views ``one`` and ``other``."""
    mean_a, mean_b = _window(sums, oldest, series, one, x), _window(sums, oldest, series, other, x)
    value = _window(sums, oldest, series, which, x)
    for row in range(_RING):
        tap = _OUTER if row == 0 or row == 4 else _MIDDLE if row == 2 else _NEXT
        a = v.sub(_of_row(sums, oldest, series, one, row, x), mean_a)
        b = v.sub(_of_row(sums, oldest, series, other, row, x), mean_b)
        value = v.fma(v.mul(v.broadcast(tap), a), b, value)
    return value


@inner
def _gain(variance, floor):
    """One over a standard deviation."""
    return v.inverse_root(v.add(v.larger(variance, v.broadcast(ZERO)), v.broadcast(floor)))


@inner
def _score_two(sums, oldest, series, floors, used, scores):
    """Correlation of two views for a row of cells."""
    one, least = v.broadcast(ONE), v.broadcast(-ONE)
    for x in range(0, used, v.LANES):
        gains = v.mul(
            _gain(_joined(sums, oldest, series, 0, 0, 2, x), floors[0]),
            _gain(_joined(sums, oldest, series, 1, 1, 3, x), floors[1]),
        )
        score = v.mul(_joined(sums, oldest, series, 0, 1, 4, x), gains)
        v.store(scores, x, v.smaller(v.larger(score, least), one))


@inner
def _score_three(sums, oldest, series, floors, used, scores):
    """1 - sqrt(det) of the correlation matrix of three views for a row of cells."""
    one, least, nothing = v.broadcast(ONE), v.broadcast(-ONE), v.broadcast(ZERO)
    for x in range(0, used, v.LANES):
        ga = _gain(_joined(sums, oldest, series, 0, 0, 3, x), floors[0])
        gb = _gain(_joined(sums, oldest, series, 1, 1, 4, x), floors[1])
        gc = _gain(_joined(sums, oldest, series, 2, 2, 5, x), floors[2])
        ab = v.mul(_joined(sums, oldest, series, 0, 1, 6, x), v.mul(ga, gb))
        ac = v.mul(_joined(sums, oldest, series, 0, 2, 7, x), v.mul(ga, gc))
        bc = v.mul(_joined(sums, oldest, series, 1, 2, 8, x), v.mul(gb, gc))
        ab, ac, bc = (
            v.larger(v.smaller(ab, one), least),
            v.larger(v.smaller(ac, one), least),
            v.larger(v.smaller(bc, one), least),
        )
        both = v.mul(ac, bc)
        determinant = v.fnma(ab, v.sub(v.sub(ab, both), both), v.fnma(ac, ac, v.fnma(bc, bc, one)))
        v.store(scores, x, v.sub(one, v.root(v.larger(determinant, nothing))))

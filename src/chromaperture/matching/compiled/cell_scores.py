# mypy: disallow-untyped-defs=False
"""Correlations for cells of 2 x 2 px, compiled; ``readable/correlation.py`` explains what is computed.

Eight neighbouring cells are one vector. A thread takes bands of rows; for every layer it samples the views, sums their
products over windows along x, at every second px only, and then over the rows of a ring. Columns of even and of odd
number are kept apart, so that every second px is a neighbour in memory. Layers whose samples lie at the same sub-pixel
phase follow each other and share them.

Light counts in whole units, so that sums are exact, whatever their order (`integer_light.py`); only the last step, from
covariances to a score, rounds.

Memory: 2 bytes a score and 0.5 MB a thread at 1280 px width.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.compiled.layout import BLOCK, ONE, SCORE_SCALE, START, ZERO, whole_vectors
from chromaperture.matching.compiled.workspace import Workspace
from chromaperture.matching.integer_light import whole_taps
from chromaperture.matching.readable.correlation import (
    CELL_TAPS,
    CONTRARY,
    LEAST_PRODUCT,
    SAMPLING,
    SCORE_PARTS,
    cell_variance_floor,
)
from chromaperture.matching.views import Views, view_pairs
from chromaperture.settings.stages import CorrelationConfig
from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.threads import in_parallel

# Divisions and roots as IEEE 754 rounds them, as other executions do: not by estimates.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"nsz"}}
kernel = compiled(**_OPTIONS)
inner = inlined(**_OPTIONS)
_BAND_ROWS = 24  # of cells: the window's four rows more cost 8 %, and the samples, 0.4 MB, stay in the cache
_RING = len(CELL_TAPS)  # rows of a window
_REACH = _RING // 2  # px of a window's taps
_ROUNDER = np.float32(1.5 * 2**23)  # added to a number below 2^22 it leaves a whole one, halves to even
_LEAST = np.float32(LEAST_PRODUCT)
_CONTRARY = np.float32(SCORE_PARTS * CONTRARY)
_TWO, _EIGHT, _NINE, _NINTH = np.float32(2), np.float32(8), np.float32(9), np.float32(1 / 9)
assert CELL_TAPS == (1, 2, 3, 2, 1)  # written out below
assert SCORE_PARTS == SCORE_SCALE


class _Plan(NamedTuple):
    """How layers find their samples, in the order in which they are computed."""

    order: np.ndarray  # (D,) int: layers
    fresh: np.ndarray  # (D, K) bool: sampled anew for this layer, not left from the one before
    taps: np.ndarray  # (D, K, 2, 4) float32: along x, along y
    whole: np.ndarray  # (D, K, 2) int: px along x, along y
    pairs: np.ndarray  # (P, 2) int
    floors: np.ndarray  # (K,) float32: added to variances, so that even areas score 0
    scale: np.float32  # from light to whole units
    rounder: np.float32  # added and taken off again it rounds samples to whole units; 0 where there are none
    margin: int  # px of the samples beyond the picture


def cell_scores(views: Views, layers_px: np.ndarray, memory: Workspace, *, config: CorrelationConfig) -> np.ndarray:
    """Score all layers of every cell; int16, flat, see ``layout.py``.

    ``layers_px`` (D,) float, px; ``config``: its ``cell_px`` is 2.
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
        _split_columns(planes, plan.scale, plan.margin, halves, top, bottom)

    in_parallel(split, height)

    def score(_: int, first: int, last: int) -> None:
        samples = np.zeros((count, 2 * _BAND_ROWS + 2 * _REACH, 2, length), np.float32)
        sums = np.zeros((_RING * series + 1, wide + v.LANES), np.float32)
        for top in range(first, last, _BAND_ROWS):
            _score_band(halves, plan, samples, sums, top, min(top + _BAND_ROWS, last), columns, rows, volume)

    in_parallel(score, rows)
    return volume


def _plan(views: Views, layers_px: np.ndarray, config: CorrelationConfig) -> _Plan:
    layers = np.asarray(layers_px, float)
    directions = np.asarray(views.directions, float)
    samples = _samples(layers.tobytes(), directions.tobytes(), len(directions), config.sampling)
    pairs = np.array(view_pairs(len(directions)))
    scale, rounder = (np.float32(1 / views.unit), _ROUNDER) if views.unit else (ONE, ZERO)
    return _Plan(*samples[:4], pairs, cell_variance_floor(views), scale, rounder, samples[4])


@lru_cache(maxsize=4)  # a millisecond, for every picture alike
def _samples(
    layers: bytes, directions: bytes, count: int, sampling: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
    """``order``, ``fresh``, ``taps``, ``whole`` and ``margin`` of a plan; layers and directions as bytes of float64."""
    offsets = np.frombuffer(layers)[:, None, None] * np.frombuffer(directions).reshape(count, 2)  # (D, K, 2)
    whole = np.floor(offsets + 1e-9)  # 1e-9: a whole shift but for rounding is whole
    phases = np.round(np.maximum(offsets - whole, 0), 9)
    whole = whole.astype(np.int64)
    keys = [tuple((*phases[s].ravel(), *whole[s, :, 1])) for s in range(len(phases))]
    order = np.array(sorted(range(len(keys)), key=lambda s: keys[s]))
    fresh = np.ones((len(order), count), np.bool_)
    for i in range(1, len(order)):
        now, last = order[i], order[i - 1]
        for k in range(count):
            same = (phases[now, k] == phases[last, k]).all() and whole[now, k, 1] == whole[last, k, 1]
            fresh[i, k] = not same
    unique, places = np.unique(phases, return_inverse=True)
    taps = np.array([whole_taps(SAMPLING[sampling](t)) for t in unique], np.float32)
    taps = taps[places.reshape(phases.shape)]
    # Whole vectors: the first and the last one of a row are not sampled.
    margin = v.LANES * (2 + math.ceil((np.abs(whole[..., 0]).max() + _REACH + 3) / v.LANES))
    return order, fresh, taps, whole, margin


@kernel
def _split_columns(planes, scale, margin, halves, top, bottom):
    """Put the even and the odd columns of rows side by side in whole units, the picture continued by its borders."""
    count, _, width = planes.shape
    for k in range(count):
        for y in range(top, bottom):
            row, even, odd = planes[k, y], halves[k, 0, y], halves[k, 1, y]
            for i in range(len(even)):
                x = 2 * i - margin
                even[i] = scale * row[min(max(x, 0), width - 1)]
                odd[i] = scale * row[min(max(x + 1, 0), width - 1)]


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
                _sample(halves[k], plan.taps[layer, k], plan.whole[layer, k, 1], plan.rounder, samples[k], first, last)
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
                volume[at + (x // BLOCK) * rows * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES] = 0
    if count == 2:
        for row in range(top, bottom):
            for x in range(columns):
                at = ((x // BLOCK) * rows + row) * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES
                _count_by_own_sign(volume, at, slabs)


@inner
def _count_by_own_sign(volume, at, slabs):
    """Turn the signs of a cell's scores where its strongest one is negative, as `readable.correlation.of_own_sign`."""
    least = v.load_shorts(volume, at)
    most = least
    end = at + slabs * BLOCK * v.LANES
    for i in range(at + BLOCK * v.LANES, end, BLOCK * v.LANES):
        scores = v.load_shorts(volume, i)
        least, most = v.smaller(least, scores), v.larger(most, scores)
    lowest = v.lane(v.least_lane(least), 0)
    if lowest < -_CONTRARY and lowest < v.lane(v.least_lane(v.sub(v.broadcast(ZERO), most)), 0):
        for i in range(at, end, BLOCK * v.LANES):
            v.put_shorts(volume, i, v.sub(v.broadcast(ZERO), v.load_shorts(volume, i)))


@inner
def _sample(halves, taps, down, rounder, samples, first, last):
    """Read a view at a sub-pixel phase: rows of px from ``first`` to before ``last``, moved by ``down`` whole rows."""
    whole = v.broadcast(rounder)
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
                value = v.fma(b3, v.load(view, r3 + i), v.fma(b2, v.load(view, r2 + i), value))
                v.store(line, i, v.sub(v.add(value, whole), whole))
        out = samples[y - first]
        to_even, to_odd = out[0], out[1]
        for i in range(v.LANES, length - v.LANES, v.LANES):
            before, here, beside = v.load(odd, i - 1), v.load(even, i), v.load(odd, i)
            after, later = v.load(even, i + 1), v.load(odd, i + 1)
            at_even = v.fma(a3, after, v.fma(a2, beside, v.fma(a1, here, v.mul(a0, before))))
            at_odd = v.fma(a3, later, v.fma(a2, after, v.fma(a1, beside, v.mul(a0, here))))
            v.store(to_even, i, v.sub(v.add(at_even, whole), whole))
            v.store(to_odd, i, v.sub(v.add(at_odd, whole), whole))


@inner
def _sum_two(samples, row, ends, sums, ring, used):
    """Nine times the mean, 81 times variance and covariance of two views in a row of every second window.

    Of differences from the middle, which are small: so their sums are exact.
    """
    size = samples.shape[1] * samples.shape[2] * samples.shape[3]
    line = row * samples.shape[2] * samples.shape[3]
    a0, a1 = line + ends[0, 0], line + ends[0, 1]
    b0, b1 = size + line + ends[1, 0], size + line + ends[1, 1]
    two, eight, nine = v.broadcast(_TWO), v.broadcast(_EIGHT), v.broadcast(_NINE)
    pitch = sums.shape[1]
    out = ring * pitch
    for x in range(0, used, v.LANES):
        middle_a, middle_b = v.load(samples, a0 + x), v.load(samples, b0 + x)
        a, b = v.sub(v.load(samples, a0 + x - 1), middle_a), v.sub(v.load(samples, b0 + x - 1), middle_b)
        sa, sb, saa, sbb, sab = a, b, v.mul(a, a), v.mul(b, b), v.mul(a, b)
        a, b = v.sub(v.load(samples, a0 + x + 1), middle_a), v.sub(v.load(samples, b0 + x + 1), middle_b)
        sa, sb = v.add(sa, a), v.add(sb, b)
        saa, sbb, sab = v.fma(a, a, saa), v.fma(b, b, sbb), v.fma(a, b, sab)
        a, b = v.sub(v.load(samples, a1 + x - 1), middle_a), v.sub(v.load(samples, b1 + x - 1), middle_b)
        wa, wb = v.mul(two, a), v.mul(two, b)
        sa, sb = v.add(sa, wa), v.add(sb, wb)
        saa, sbb, sab = v.fma(wa, a, saa), v.fma(wb, b, sbb), v.fma(wa, b, sab)
        a, b = v.sub(v.load(samples, a1 + x), middle_a), v.sub(v.load(samples, b1 + x), middle_b)
        wa, wb = v.mul(two, a), v.mul(two, b)
        sa, sb = v.add(sa, wa), v.add(sb, wb)
        saa, sbb, sab = v.fma(wa, a, saa), v.fma(wb, b, sbb), v.fma(wa, b, sab)
        v.store(sums, out + x, v.fma(nine, middle_a, sa))
        v.store(sums, out + pitch + x, v.fma(nine, middle_b, sb))
        v.store(sums, out + 2 * pitch + x, v.fnma(sa, sa, v.fma(eight, saa, saa)))
        v.store(sums, out + 3 * pitch + x, v.fnma(sb, sb, v.fma(eight, sbb, sbb)))
        v.store(sums, out + 4 * pitch + x, v.fnma(sa, sb, v.fma(eight, sab, sab)))


@inner
def _sum_three(samples, row, ends, sums, ring, used):
    """As `_sum_two`, of three views."""
    size = samples.shape[1] * samples.shape[2] * samples.shape[3]
    line = row * samples.shape[2] * samples.shape[3]
    pitch = sums.shape[1]
    out = ring * pitch
    nothing, eight, nine = v.broadcast(ZERO), v.broadcast(_EIGHT), v.broadcast(_NINE)
    for x in range(0, used, v.LANES):
        sa, sb, sc, saa, sbb, scc = nothing, nothing, nothing, nothing, nothing, nothing
        sab, sac, sbc = nothing, nothing, nothing
        middle_a = v.load(samples, line + x + ends[0, 0])
        middle_b = v.load(samples, size + line + x + ends[1, 0])
        middle_c = v.load(samples, 2 * size + line + x + ends[2, 0])
        for tap in range(4):
            odd = 1 if tap == 1 or tap == 2 else 0
            at = line + x + (-1 if tap < 2 else 0 if tap == 2 else 1)
            weight = v.broadcast(_TWO if odd == 1 else ONE)
            a = v.sub(v.load(samples, at + ends[0, odd]), middle_a)
            b = v.sub(v.load(samples, size + at + ends[1, odd]), middle_b)
            c = v.sub(v.load(samples, 2 * size + at + ends[2, odd]), middle_c)
            wa, wb, wc = v.mul(weight, a), v.mul(weight, b), v.mul(weight, c)
            sa, sb, sc = v.add(sa, wa), v.add(sb, wb), v.add(sc, wc)
            saa, sbb, scc = v.fma(wa, a, saa), v.fma(wb, b, sbb), v.fma(wc, c, scc)
            sab, sac, sbc = v.fma(wa, b, sab), v.fma(wa, c, sac), v.fma(wb, c, sbc)
        v.store(sums, out + x, v.fma(nine, middle_a, sa))
        v.store(sums, out + pitch + x, v.fma(nine, middle_b, sb))
        v.store(sums, out + 2 * pitch + x, v.fma(nine, middle_c, sc))
        v.store(sums, out + 3 * pitch + x, v.fnma(sa, sa, v.fma(eight, saa, saa)))
        v.store(sums, out + 4 * pitch + x, v.fnma(sb, sb, v.fma(eight, sbb, sbb)))
        v.store(sums, out + 5 * pitch + x, v.fnma(sc, sc, v.fma(eight, scc, scc)))
        v.store(sums, out + 6 * pitch + x, v.fnma(sa, sb, v.fma(eight, sab, sab)))
        v.store(sums, out + 7 * pitch + x, v.fnma(sa, sc, v.fma(eight, sac, sac)))
        v.store(sums, out + 8 * pitch + x, v.fnma(sb, sc, v.fma(eight, sbc, sbc)))


@inner
def _of_row(sums, oldest, series, which, row, x):
    """Load one of the series of a row of the ring, of which ``oldest`` is the first.

    Series and row are ``START`` and what is added: compiled for every pair of literals this takes half of all time.
    """
    return v.load(sums, (((oldest + row) % _RING) * series + which) * sums.shape[1] + x)


@inner
def _apart(sums, oldest, series, which, x):
    """How far the means of a window's rows lie from the whole number next to their mean, and the weighted sum of that.

    From there they are small, and so exact are their products.
    """
    r0, r1 = _of_row(sums, oldest, series, which, START, x), _of_row(sums, oldest, series, which, START + 1, x)
    r2, r3 = _of_row(sums, oldest, series, which, START + 2, x), _of_row(sums, oldest, series, which, START + 3, x)
    r4 = _of_row(sums, oldest, series, which, START + 4, x)
    total = v.fma(v.broadcast(_TWO), v.add(v.add(r1, r3), r2), v.add(v.add(r0, r4), r2))
    rounder = v.broadcast(_ROUNDER)
    middle = v.sub(v.add(v.mul(v.broadcast(_NINTH), total), rounder), rounder)
    left = v.fnma(v.broadcast(_NINE), middle, total)
    return v.sub(r0, middle), v.sub(r1, middle), v.sub(r2, middle), v.sub(r3, middle), v.sub(r4, middle), left


@inner
def _joined(sums, oldest, series, a, b, which, x):
    """6561 times the covariance in a window: that within its rows, and that of the rows' means ``a`` and ``b``.

    Products are exact here; sums above 2^24 are rounded, in the same order by every execution.
    """
    a0, a1, a2, a3, a4, left_a = a
    b0, b1, b2, b3, b4, left_b = b
    ends = v.add(_of_row(sums, oldest, series, which, START, x), _of_row(sums, oldest, series, which, START + 4, x))
    inside = v.add(
        _of_row(sums, oldest, series, which, START + 1, x), _of_row(sums, oldest, series, which, START + 3, x)
    )
    ends, inside = v.fma(a4, b4, v.fma(a0, b0, ends)), v.fma(a3, b3, v.fma(a1, b1, inside))
    middle = v.fma(a2, b2, _of_row(sums, oldest, series, which, START + 2, x))
    value = v.fma(v.broadcast(_TWO), v.add(inside, middle), v.add(ends, middle))
    return v.fnma(left_a, left_b, v.fma(v.broadcast(_EIGHT), value, value))


@inner
def _raised(variance, floor):
    return v.add(v.larger(variance, v.broadcast(ZERO)), v.broadcast(floor))


@inner
def _correlation(covariance, one, other):
    """Correlation in [-1, 1] by the covariance and both variances."""
    value = v.div(covariance, v.root(v.larger(v.mul(one, other), v.broadcast(_LEAST))))
    return v.smaller(v.larger(value, v.broadcast(-ONE)), v.broadcast(ONE))


@inner
def _score_two(sums, oldest, series, floors, used, scores):
    """Correlation of two views for a row of cells."""
    for x in range(0, used, v.LANES):
        a, b = _apart(sums, oldest, series, START, x), _apart(sums, oldest, series, START + 1, x)
        aa = _raised(_joined(sums, oldest, series, a, a, START + 2, x), floors[0])
        bb = _raised(_joined(sums, oldest, series, b, b, START + 3, x), floors[1])
        v.store(scores, x, _correlation(_joined(sums, oldest, series, a, b, START + 4, x), aa, bb))


@inner
def _score_three(sums, oldest, series, floors, used, scores):
    """1 - sqrt(det) of the correlation matrix of three views for a row of cells."""
    one, nothing = v.broadcast(ONE), v.broadcast(ZERO)
    for x in range(0, used, v.LANES):
        a, b = _apart(sums, oldest, series, START, x), _apart(sums, oldest, series, START + 1, x)
        c = _apart(sums, oldest, series, START + 2, x)
        aa = _raised(_joined(sums, oldest, series, a, a, START + 3, x), floors[0])
        bb = _raised(_joined(sums, oldest, series, b, b, START + 4, x), floors[1])
        cc = _raised(_joined(sums, oldest, series, c, c, START + 5, x), floors[2])
        ab = _correlation(_joined(sums, oldest, series, a, b, START + 6, x), aa, bb)
        ac = _correlation(_joined(sums, oldest, series, a, c, START + 7, x), aa, cc)
        bc = _correlation(_joined(sums, oldest, series, b, c, START + 8, x), bb, cc)
        # Of a part that is left, not of sums that cancel: (1 - ab^2) (1 - ac^2) - (bc - ab ac)^2.
        # Not fused: a shader cannot ask for it.
        apart = v.sub(bc, v.mul(ab, ac))
        left = v.mul(v.sub(one, v.mul(ab, ab)), v.sub(one, v.mul(ac, ac)))
        determinant = v.sub(left, v.mul(apart, apart))
        v.store(scores, x, v.sub(one, v.root(v.larger(determinant, nothing))))

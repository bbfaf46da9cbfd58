# mypy: disallow-untyped-defs=False
"""First half of the compiled matcher: a band of rows from the views to scores filtered along x.

Everything along a row is a recursion, so eight layers of one pixel sit in a vector and the row is walked pixel by
pixel. Rows are addressed in flat arrays by (start, step per px): a view that moves along x by 1/n px a layer is kept
n times up-sampled, so that eight neighbouring layers of a pixel are eight neighbours in memory (stored backwards if
the view moves backwards); views that move otherwise are rearranged row by row with `_spread_rows`.

Recursions are kept without their gains, f = x + a f; the product of the gains is made good once, in the gains of the
views. A band is a picture of its own: it starts ``halo`` rows early and ends as many rows late, and there it is
continued by its last row as the reference continues the picture.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from chromaperture.disparity import simd as v

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}, "nogil": True}
compiled = njit(cache=True, **_OPTIONS)
# Called by compiled functions only: without the wrappers that Python would need they compile twice as fast.
inner = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **_OPTIONS)  # type: ignore[call-overload]

GROUP = 4  # rows walked together: four independent recursions fill the pipeline
BLOCK = 16  # columns that are neighbours in the volume
SCORE_SCALE = np.float32(32000)  # of a score in [-1, 1] in int16

_ONE = np.float32(1)
_ZERO = np.float32(0)


class Pictures(NamedTuple):
    """Maps of the whole picture, float32."""

    views: np.ndarray  # (K, H, W)
    noise: np.ndarray  # (K, H, W) or (K, 1, 1) where even
    covariance: np.ndarray  # (P, H, W) or (P, 1, 1) where even
    mask: np.ndarray  # (H, W)
    guide: np.ndarray  # (H, W)


class Samplings(NamedTuple):
    """How the views are sampled: one entry for every sub-pixel phase of every view.

    The samples of an entry at (row i, column x from ``-margin``) are at ``i * row_length + start + step * x`` of the
    flat arrays.
    """

    owner: np.ndarray  # (E,) int: the view it samples
    taps_x: np.ndarray  # (E, 4) float32
    taps_y: np.ndarray  # (E, 4) float32
    start: np.ndarray  # (E,) int
    step: np.ndarray  # (E,) int
    still: np.ndarray  # (K,) int: the entry of each view without any shift
    row_length: int
    margin: int


class Layers(NamedTuple):
    """Where a layer finds its samples."""

    direct: np.ndarray  # (K,) bool: layers are neighbours in memory
    start: np.ndarray  # (K,) int: of layer 0 at x = 0, where direct
    step: np.ndarray  # (K,) int: per px, where direct
    entry: np.ndarray  # (K, D8) int, elsewhere
    whole: np.ndarray  # (K, D8, 2) int: whole px (x, y) of each layer's shift, elsewhere
    overlap: np.ndarray  # (P * D8,) float32: share of the noise covariance left, debiasing included
    ceiling: np.ndarray  # (D8,) float32: 1, and -1 for the layers that only fill the last vector
    pairs: np.ndarray  # (P, 2) int


class Numbers(NamedTuple):
    """Parameters, float32 where not said otherwise."""

    decay: np.float32
    debias: np.float32
    weighting: bool
    near: np.float32  # link weight on an even guide
    epsilon: np.ndarray  # (K,)
    min_share: np.float32
    min_weight: np.float32


class RowMaps(NamedTuple):
    """What the filter along x needs of each row and leaves for the filter along y, float32."""

    weights: np.ndarray  # (H, W)
    links: np.ndarray  # (H, W + 1): of each pixel to its left neighbour
    links_y: np.ndarray  # (H, W16): of each pixel to its upper neighbour
    share: np.ndarray  # (H, W16): the weights, filtered along x
    scale: np.ndarray  # (H, W): from filtered scores to int16


class Scratch(NamedTuple):
    """Flat float32 arrays of one thread."""

    value: np.ndarray  # samples of all entries
    gain: np.ndarray  # 1 / standard deviation, of the same samples' windows
    mean_gain: np.ndarray  # mean times gain
    grain: np.ndarray  # noise variance
    ring: np.ndarray  # windows of the layers, above the current row
    carry: np.ndarray  # rows of the ring for the next band
    state: np.ndarray  # the same, below the current row
    lanes: np.ndarray  # rearranged rows
    scores: np.ndarray  # one row of scores
    line: np.ndarray  # a row of the picture


@compiled
def score_band(pictures, samplings, layers, numbers, pad, halo, top, bottom, begin, scratch, volume, maps):
    """Fill a band of the volume of scores, filtered along x, and what the filter along y needs to know.

    Parameters
    ----------
    pad : (x, y) px beyond which every shifted view is constant
    halo : int, rows after which the window has forgotten
    top, bottom : int; the rows from ``top`` to before ``bottom``
    begin : bool; False where the band above was the last to use ``scratch``
    scratch : Scratch
    volume : (blocks, H, D8 / 8, BLOCK, 8) int16, flat; written
    maps : RowMaps; written
    """
    height, width = pictures.mask.shape
    pad_x, pad_y = pad
    # Rows of the cross terms; beyond pad_y rows outside the picture everything is constant. A band that follows
    # another takes over its windows and starts without a halo.
    first = max(top - halo, -pad_y) if begin else top
    last = min(bottom + halo, height + pad_y + 1)  # one row too many: below it the recursion only ends
    last += -(last - first) % GROUP
    # Rows of the samples: the layers look pad_y rows further.
    first_sample = first - pad_y
    sample_rows = last + pad_y - first_sample
    sample_rows += -sample_rows % GROUP
    _sample(pictures, samplings, first_sample, sample_rows, scratch)
    _standardise(
        pictures, samplings, numbers, pad, first_sample, sample_rows, top, bottom, begin, scratch, maps.weights
    )
    for y in range(top, bottom):
        _weigh_row(pictures.mask[y], numbers.min_weight, len(pictures.views), maps.weights[y])
        _links_along_x(pictures.guide[y], numbers.near, maps.links[y])
        _share_row(maps.weights[y], numbers.near, maps.links[y], maps.share[y])
        for x in range(width):
            maps.scale[y, x] = SCORE_SCALE / maps.share[y, x]
            maps.links_y[y, x] = fading(pictures.guide[y, x] - pictures.guide[max(y - 1, 0), x], numbers.near)

    padded = width + 2 * pad_x
    row_size = padded * v.LANES
    layer_count, pair_count = len(layers.ceiling), len(layers.pairs)
    slabs = layer_count // v.LANES
    windows = (len(samplings.owner) + 3) // 4  # carried by `_standardise`
    ring_size = (last - first + 1) * row_size
    places = np.empty((len(layers.direct), 2), np.int64)
    for slab in range(slabs):
        lane0 = slab * v.LANES
        for row in range(first, last, GROUP):
            for k in range(len(layers.direct)):
                if not layers.direct[k]:
                    for j in range(GROUP):
                        _spread_row(
                            scratch.value, samplings, layers, k, lane0, row + j - first_sample, pad_x, padded,
                            scratch.lanes, (k * GROUP + j) * row_size,
                        )  # fmt: skip
            for p in range(pair_count):
                k, m = layers.pairs[p]
                at = p * ring_size + (row - first + 1) * row_size
                carried = (windows + slab * pair_count + p) * row_size
                if row == first and not begin:
                    _copy(scratch.carry, carried, scratch.ring, at - row_size, row_size)
                sample_row = (row - first_sample) * samplings.row_length
                at_k = sample_row + layers.start[k] + lane0 - layers.step[k] * pad_x
                at_m = sample_row + layers.start[m] + lane0 - layers.step[m] * pad_x
                step_k, step_m = layers.step[k], layers.step[m]
                down_k, down_m = samplings.row_length, samplings.row_length
                from_k = scratch.value if layers.direct[k] else scratch.lanes
                from_m = scratch.value if layers.direct[m] else scratch.lanes
                if not layers.direct[k]:
                    at_k, step_k, down_k = k * GROUP * row_size, v.LANES, row_size
                if not layers.direct[m]:
                    at_m, step_m, down_m = m * GROUP * row_size, v.LANES, row_size
                _window_rows(
                    from_k, at_k, step_k, down_k, from_m, at_m, step_m, down_m,
                    scratch.ring, at, padded, numbers.decay, begin and row == first,
                )  # fmt: skip
        for p in range(pair_count):
            at = p * ring_size + row_size
            carried = (windows + slab * pair_count + p) * row_size
            below = at + (bottom - first) * row_size
            _copy(scratch.ring, below - row_size, scratch.carry, carried, row_size)
            _window_end(scratch.ring, at, last - first, padded, numbers.decay, scratch.state, p * row_size)
            for row in range(last - 2, bottom - 1, -1):
                _window_up(
                    scratch.ring, at + (row - first) * row_size, padded, numbers.decay, scratch.state, p * row_size
                )
        for row in range(bottom - 1, top - 1, -1):
            _locate_row(samplings, layers, lane0, row, first_sample, pad_x, padded, scratch, places)
            at = (row - first + 1) * row_size
            if pair_count == 1:
                _score_two(pictures, layers, numbers, row, lane0, pad_x, padded, at, places, scratch, maps)
            else:
                _score_three(
                    pictures, layers, numbers, row, lane0, pad_x, padded, at, ring_size, places, scratch, maps
                )
            _filter_back(
                scratch.scores, maps.links[row], maps.scale[row], numbers.near,
                volume, (row * slabs + slab) * BLOCK * v.LANES, height * slabs * BLOCK * v.LANES,
            )  # fmt: skip
    v.fence()


@inner
def _copy(source, at, target, to, count):
    for i in range(0, count, v.LANES):
        v.store(target, to + i, v.load(source, at + i))


@inner
def _sample(pictures, samplings, first_sample, rows, scratch):
    """Interpolate every entry of every row."""
    even = pictures.noise.shape[1] == 1
    for i in range(rows):
        for e in range(len(samplings.owner)):
            k = samplings.owner[e]
            at = i * samplings.row_length + samplings.start[e]
            _sample_row(pictures.views[k], samplings, e, first_sample + i, scratch.line, scratch.value, at)
            if not even or i == 0:
                _sample_row(pictures.noise[k], samplings, e, first_sample + i, scratch.line, scratch.grain, at)


@inner
def _sample_row(picture, samplings, e, y, line, out, at):
    """Sample one row of an entry, x from -margin on; the picture is continued beyond its border."""
    height, width = picture.shape
    margin, step = samplings.margin, samplings.step[e]
    reach = margin + 2
    a, b = picture[min(max(y - 1, 0), height - 1)], picture[min(max(y, 0), height - 1)]
    c, d = picture[min(max(y + 1, 0), height - 1)], picture[min(max(y + 2, 0), height - 1)]
    t0, t1, t2, t3 = samplings.taps_y[e]
    if t1 == _ONE:
        for x in range(width):
            line[reach + x] = b[x]
    else:
        for x in range(width):
            line[reach + x] = t0 * a[x] + t1 * b[x] + t2 * c[x] + t3 * d[x]
    count = width + 2 * margin
    for x in range(reach):
        line[x] = line[reach]
    for x in range(reach + width, count + 4):
        line[x] = line[reach + width - 1]
    t0, t1, t2, t3 = samplings.taps_x[e]
    skip = 2
    if t1 != _ONE:
        # In place from the left: sample x needs none before x + 1.
        skip = 0
        for x in range(count):
            line[x] = t0 * line[x + 1] + t1 * line[x + 2] + t2 * line[x + 3] + t3 * line[x + 4]
    for x in range(skip, count + skip):
        v.put(out, at, line[x])
        at += step


@inner
def _standardise(
    pictures, samplings, numbers, pad, first_sample, rows, top, bottom, begin, scratch, weights_out
):  # fmt: skip
    """Window means and gains of all samples, and the share of signal in the unshifted views.

    Four entries at a time: lanes 0 to 3 window the samples, lanes 4 to 7 their squares.
    """
    pad_x, pad_y = pad
    padded = pictures.mask.shape[1] + 2 * pad_x
    row_size = padded * v.LANES
    entries = len(samplings.owner)
    length, start, step = samplings.row_length, samplings.start, samplings.step
    lanes, ring, state = scratch.lanes, scratch.ring, scratch.state
    from_row, to_row = top - pad_y - first_sample, bottom + pad_y - first_sample
    unity = GROUP * row_size
    v.store(lanes, unity, v.spread(_ONE))
    for y in range(top, bottom):
        for x in range(weights_out.shape[1]):
            weights_out[y, x] = _ONE
    inset = samplings.margin - pad_x
    at = np.empty(4, np.int64)
    for e in range(0, entries, 4):
        # The last group may be short; it then repeats its last entry.
        e1, e2, e3 = min(e + 1, entries - 1), min(e + 2, entries - 1), min(e + 3, entries - 1)
        s0, s1, s2, s3 = step[e], step[e1], step[e2], step[e3]
        at[0], at[1] = start[e] + s0 * inset, start[e1] + s1 * inset
        at[2], at[3] = start[e2] + s2 * inset, start[e3] + s3 * inset
        carried = e // 4 * row_size
        if not begin:
            _copy(scratch.carry, carried, ring, 0, row_size)
        for row in range(0, rows, GROUP):
            for j in range(GROUP):
                down = (row + j) * length
                i0, i1, i2, i3 = at[0] + down, at[1] + down, at[2] + down, at[3] + down
                for target in range(j * row_size, (j + 1) * row_size, v.LANES):
                    v.store(lanes, target, v.four_and_squares(scratch.value, i0, i1, i2, i3))
                    i0, i1, i2, i3 = i0 + s0, i1 + s1, i2 + s2, i3 + s3
            _window_rows(
                lanes, 0, v.LANES, row_size, lanes, unity, 0, 0,
                ring, (row + 1) * row_size, padded, numbers.decay, begin and row == 0,
            )  # fmt: skip
        # The next band's samples start pad_y rows above its top.
        below = (bottom - pad_y - first_sample + 1) * row_size
        _copy(ring, below - row_size, scratch.carry, carried, row_size)
        _window_end(ring, row_size, rows, padded, numbers.decay, state, 0)
        for row in range(rows - 2, to_row - 1, -1):
            _window_up(ring, (row + 1) * row_size, padded, numbers.decay, state, 0)
        for row in range(to_row - 1, from_row - 1, -1):
            _standardise_row(pictures, samplings, numbers, e, at, row, padded, scratch)
            y = row + first_sample
            if numbers.weighting and top <= y < bottom:
                for k in range(len(pictures.views)):
                    i = samplings.still[k] - e
                    if 0 <= i < 4:
                        for x in range(weights_out.shape[1]):
                            weights_out[y, x] *= lanes[(pad_x + x) * 4 + i]


@inner
def _standardise_row(pictures, samplings, numbers, e, at, row, padded, scratch):
    """Gains of four entries in a row; leaves their shares of signal in ``lanes``, four a px."""
    entries = len(samplings.owner)
    e1, e2, e3 = min(e + 1, entries - 1), min(e + 2, entries - 1), min(e + 3, entries - 1)
    s0, s1, s2, s3 = samplings.step[e], samplings.step[e1], samplings.step[e2], samplings.step[e3]
    down = row * samplings.row_length
    i0, i1, i2, i3 = at[0] + down, at[1] + down, at[2] + down, at[3] + down
    even = pictures.noise.shape[1] == 1
    floors = np.empty(v.LANES, np.float32)
    for i in range(v.LANES):
        floors[i] = numbers.epsilon[samplings.owner[min(e + i % 4, entries - 1)]]
    floor, nothing = v.load(floors, 0), v.spread(_ZERO)
    decay, debias, min_share = v.spread(numbers.decay), v.spread(numbers.debias), v.spread(numbers.min_share)
    window_gain = v.spread((_ONE - numbers.decay) ** np.float32(4))
    ring, state, lanes, grain = scratch.ring, scratch.state, scratch.lanes, scratch.grain
    gains, mean_gains = scratch.gain, scratch.mean_gain
    noise = v.four_and_squares(grain, at[0], at[1], at[2], at[3])
    noise = v.halves_low(noise, noise)
    at_ring = (row + 1) * padded * v.LANES
    # Two px at a time, so that means, variances and gains fill all lanes.
    for x in range(0, padded, 2):
        i = x * v.LANES
        here = v.fma(decay, v.load(state, i), v.load(ring, at_ring + i))
        v.store(state, i, here)
        more = i + (v.LANES if x + 1 < padded else 0)
        after = v.fma(decay, v.load(state, more), v.load(ring, at_ring + more)) if more > i else here
        v.store(state, more, after)
        mean = v.mul(window_gain, v.halves_low(here, after))
        variance = v.fnma(mean, mean, v.mul(window_gain, v.halves_high(here, after)))
        if not even:
            n0 = v.four_and_squares(grain, i0, i1, i2, i3)
            n1 = v.four_and_squares(grain, i0 + s0, i1 + s1, i2 + s2, i3 + s3)
            noise = v.halves_low(n0, n1)
        signal = v.larger(v.sub(variance, noise), nothing)
        v.store(lanes, x * 4, v.div(signal, v.add(signal, v.add(noise, floor))))
        clean = v.larger(v.larger(v.fnma(debias, noise, variance), v.mul(min_share, variance)), nothing)
        gain = v.inverse_root(v.add(clean, floor))
        mean_gain = v.mul(mean, gain)
        v.put_lane(gains, i0, gain, 0)
        v.put_lane(gains, i1, gain, 1)
        v.put_lane(gains, i2, gain, 2)
        v.put_lane(gains, i3, gain, 3)
        v.put_lane(mean_gains, i0, mean_gain, 0)
        v.put_lane(mean_gains, i1, mean_gain, 1)
        v.put_lane(mean_gains, i2, mean_gain, 2)
        v.put_lane(mean_gains, i3, mean_gain, 3)
        i0, i1, i2, i3 = i0 + s0, i1 + s1, i2 + s2, i3 + s3
        v.put_lane(gains, i0, gain, 4)
        v.put_lane(gains, i1, gain, 5)
        v.put_lane(gains, i2, gain, 6)
        v.put_lane(gains, i3, gain, 7)
        v.put_lane(mean_gains, i0, mean_gain, 4)
        v.put_lane(mean_gains, i1, mean_gain, 5)
        v.put_lane(mean_gains, i2, mean_gain, 6)
        v.put_lane(mean_gains, i3, mean_gain, 7)
        i0, i1, i2, i3 = i0 + s0, i1 + s1, i2 + s2, i3 + s3


@inner
def _weigh_row(mask, min_weight, views, weights):
    """Finish the weights of a row: geometric mean of the views' shares of signal, nothing where unusable."""
    if views == 2:
        for x in range(len(weights)):
            weights[x] = max(np.sqrt(weights[x]) * mask[x], min_weight)
    else:
        for x in range(len(weights)):
            weights[x] = max(weights[x] ** np.float32(1 / 3) * mask[x], min_weight)


@inner
def fading(difference, near):
    """Give near exp(-|difference|): a power series of a 64th, squared six times, which plain vectors can do."""
    y = abs(difference) * np.float32(1 / 64)
    series = _ONE + y * (_ONE + y * (np.float32(1 / 2) + y * (np.float32(1 / 6) + y * np.float32(1 / 24))))
    series *= series
    series *= series
    series *= series
    series *= series
    series *= series
    series *= series
    return near / series


@inner
def _links_along_x(guide, near, links):
    """Weight with which each pixel of a row hears its left neighbour; 0 at both ends."""
    for x in range(1, len(guide)):
        links[x] = fading(guide[x] - guide[x - 1], near)
    links[0] = links[len(guide)] = _ZERO


@inner
def _share_row(weights, near, links, out):
    """Both recursions along a row of weights, without their gain: a sample at an end counts 1 / gain."""
    end = len(weights) - 1
    gain = _ONE - near
    state = weights[end] / gain
    out[end] = state
    for x in range(end - 1, 0, -1):
        state = weights[x] + links[x + 1] * state
        out[x] = state
    out[0] = weights[0] + links[1] * state
    state = weights[0] / gain
    out[0] += state
    for x in range(1, end):
        state = weights[x] + links[x] * state
        out[x] += state
    out[end] += weights[end] + links[end] * state


@inner
def _spread_row(source, samplings, layers, k, slab, sample_row, pad_x, padded, out, target):
    """Rearrange the rows of eight layers so that the layers of a pixel are neighbours: transpositions of 8 x 8."""
    at = np.empty(v.LANES, np.int64)
    for lane in range(v.LANES):
        e = layers.entry[k, slab + lane]
        dx, dy = layers.whole[k, slab + lane]
        at[lane] = (sample_row + dy) * samplings.row_length + samplings.start[e] + samplings.margin - pad_x + dx
    i0, i1, i2, i3, i4, i5, i6, i7 = at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7]
    for x in range(0, padded, v.LANES):
        a, b = v.load(source, i0 + x), v.load(source, i1 + x)
        c, d = v.load(source, i2 + x), v.load(source, i3 + x)
        e, f = v.load(source, i4 + x), v.load(source, i5 + x)
        g, h = v.load(source, i6 + x), v.load(source, i7 + x)
        a, b, c, d = v.singles_low(a, b), v.singles_high(a, b), v.singles_low(c, d), v.singles_high(c, d)
        e, f, g, h = v.singles_low(e, f), v.singles_high(e, f), v.singles_low(g, h), v.singles_high(g, h)
        a, b, c, d = v.pairs_low(a, c), v.pairs_high(a, c), v.pairs_low(b, d), v.pairs_high(b, d)
        e, f, g, h = v.pairs_low(e, g), v.pairs_high(e, g), v.pairs_low(f, h), v.pairs_high(f, h)
        # The last step may pass the row's end by up to seven px; the next row or the array's slack takes them.
        v.store(out, target, v.halves_low(a, e))
        v.store(out, target + 8, v.halves_low(b, f))
        v.store(out, target + 16, v.halves_low(c, g))
        v.store(out, target + 24, v.halves_low(d, h))
        v.store(out, target + 32, v.halves_high(a, e))
        v.store(out, target + 40, v.halves_high(b, f))
        v.store(out, target + 48, v.halves_high(c, g))
        v.store(out, target + 56, v.halves_high(d, h))
        target += v.LANES * v.LANES


@inner
def _window_rows(a, ia, step_a, down_a, b, ib, step_b, down_b, ring, at, width, decay, begin):
    """Window the products of four rows: along x both ways, along y downwards from the rows above in the ring."""
    fade = v.spread(decay)
    endless = v.spread(_ONE / (_ONE - decay))
    last_x = v.spread(decay / ((_ONE + decay) * (_ONE - decay) * (_ONE - decay)))
    last_f = v.spread(_ONE / ((_ONE + decay) * (_ONE - decay)))
    down = width * v.LANES
    a1, a2, a3, b1, b2, b3 = down_a, 2 * down_a, 3 * down_a, down_b, 2 * down_b, 3 * down_b
    r1, r2, r3 = down, 2 * down, 3 * down
    f0 = v.mul(endless, v.mul(v.load(a, ia), v.load(b, ib)))
    f1 = v.mul(endless, v.mul(v.load(a, ia + a1), v.load(b, ib + b1)))
    f2 = v.mul(endless, v.mul(v.load(a, ia + a2), v.load(b, ib + b2)))
    f3 = v.mul(endless, v.mul(v.load(a, ia + a3), v.load(b, ib + b3)))
    v.store(ring, at, f0)
    v.store(ring, at + r1, f1)
    v.store(ring, at + r2, f2)
    v.store(ring, at + r3, f3)
    for _ in range(width - 1):
        ia, ib, at = ia + step_a, ib + step_b, at + v.LANES
        f0 = v.fma(fade, f0, v.mul(v.load(a, ia), v.load(b, ib)))
        f1 = v.fma(fade, f1, v.mul(v.load(a, ia + a1), v.load(b, ib + b1)))
        f2 = v.fma(fade, f2, v.mul(v.load(a, ia + a2), v.load(b, ib + b2)))
        f3 = v.fma(fade, f3, v.mul(v.load(a, ia + a3), v.load(b, ib + b3)))
        v.store(ring, at, f0)
        v.store(ring, at + r1, f1)
        v.store(ring, at + r2, f2)
        v.store(ring, at + r3, f3)
    f0 = v.fma(last_f, f0, v.mul(last_x, v.mul(v.load(a, ia), v.load(b, ib))))
    f1 = v.fma(last_f, f1, v.mul(last_x, v.mul(v.load(a, ia + a1), v.load(b, ib + b1))))
    f2 = v.fma(last_f, f2, v.mul(last_x, v.mul(v.load(a, ia + a2), v.load(b, ib + b2))))
    f3 = v.fma(last_f, f3, v.mul(last_x, v.mul(v.load(a, ia + a3), v.load(b, ib + b3))))
    for x in range(width):
        if x > 0:
            f0 = v.fma(fade, f0, v.load(ring, at))
            f1 = v.fma(fade, f1, v.load(ring, at + r1))
            f2 = v.fma(fade, f2, v.load(ring, at + r2))
            f3 = v.fma(fade, f3, v.load(ring, at + r3))
        column = v.mul(endless, f0) if begin else v.fma(fade, v.load(ring, at - down), f0)
        v.store(ring, at, column)
        column = v.fma(fade, column, f1)
        v.store(ring, at + r1, column)
        column = v.fma(fade, column, f2)
        v.store(ring, at + r2, column)
        column = v.fma(fade, column, f3)
        v.store(ring, at + r3, column)
        at -= v.LANES


@inner
def _window_end(ring, at, rows, width, decay, state, at_state):
    """Start the upward recursion at the last row, which continues for ever."""
    fade = v.spread(decay)
    last_x = v.spread(decay / ((_ONE + decay) * (_ONE - decay) * (_ONE - decay)))
    last_f = v.spread(_ONE / ((_ONE + decay) * (_ONE - decay)))
    below = at + (rows - 1) * width * v.LANES
    above = below - width * v.LANES
    for i in range(0, width * v.LANES, v.LANES):
        f = v.load(ring, below + i)
        x = v.fnma(fade, v.load(ring, above + i), f)
        v.store(state, at_state + i, v.fma(last_f, f, v.mul(last_x, x)))


@inner
def _window_up(ring, at, width, decay, state, at_state):
    """Carry the upward recursion past one row."""
    fade = v.spread(decay)
    for i in range(0, width * v.LANES, v.LANES):
        v.store(state, at_state + i, v.fma(fade, v.load(state, at_state + i), v.load(ring, at + i)))


@inner
def _locate_row(samplings, layers, slab, row, first_sample, pad_x, padded, scratch, places):
    """Say where the gains of a row's layers start and how far apart their pixels are; rearrange them if need be."""
    spread_size = (padded + v.LANES) * v.LANES
    for k in range(len(layers.direct)):
        if layers.direct[k]:
            places[k, 0] = (row - first_sample) * samplings.row_length + layers.start[k] + slab
            places[k, 1] = layers.step[k]
        else:
            target = 2 * k * spread_size
            _spread_row(
                scratch.gain, samplings, layers, k, slab, row - first_sample, pad_x, padded, scratch.lanes, target
            )
            _spread_row(
                scratch.mean_gain, samplings, layers, k, slab, row - first_sample, pad_x, padded,
                scratch.lanes, target + spread_size,
            )  # fmt: skip
            places[k, 0] = target + pad_x * v.LANES
            places[k, 1] = v.LANES


@inner
def _score_two(pictures, layers, numbers, row, slab, pad_x, padded, at, places, scratch, maps):
    """Correlation of two views for one row of eight layers, weighted and filtered rightwards."""
    width = pictures.mask.shape[1]
    covariance = pictures.covariance[0, row if pictures.covariance.shape[1] > 1 else 0]
    even = len(covariance) == 1
    ring, state, scores = scratch.ring, scratch.state, scratch.scores
    direct = layers.direct
    gain0, mean0 = (scratch.gain, scratch.mean_gain) if direct[0] else (scratch.lanes, scratch.lanes)
    gain1, mean1 = (scratch.gain, scratch.mean_gain) if direct[1] else (scratch.lanes, scratch.lanes)
    # Rearranged means follow their gains in the same array.
    apart = (padded + v.LANES) * v.LANES
    m0, m1 = 0 if direct[0] else apart, 0 if direct[1] else apart
    fade = v.spread(numbers.decay)
    window_gain = v.spread((_ONE - numbers.decay) ** np.float32(4))
    overlap = v.load(layers.overlap, slab)
    noise = v.mul(overlap, v.spread_at(covariance, 0))
    ceiling, floor = v.load(layers.ceiling, slab), v.spread(-_ONE)
    weights, links = maps.weights[row], maps.links[row]
    endless = v.spread(_ONE / (_ONE - numbers.near))
    ahead = v.spread(_ZERO)
    at += pad_x * v.LANES
    at_state = pad_x * v.LANES
    (i0, step0), (i1, step1) = places[0], places[1]
    for x in range(width):
        window = v.fma(fade, v.load(state, at_state), v.load(ring, at))
        v.store(state, at_state, window)
        if not even:
            noise = v.mul(overlap, v.spread_at(covariance, x))
        both = v.mul(v.load(gain0, i0), v.load(gain1, i1))
        means = v.mul(v.load(mean0, i0 + m0), v.load(mean1, i1 + m1))
        score = v.sub(v.mul(v.sub(v.mul(window, window_gain), noise), both), means)
        weighted = v.mul(v.smaller(v.larger(score, floor), ceiling), v.spread_at(weights, x))
        ahead = v.fma(v.spread_at(links, x), ahead, weighted) if x > 0 else v.mul(endless, weighted)
        v.store(scores, x * v.LANES, ahead)
        i0, i1, at, at_state = i0 + step0, i1 + step1, at + v.LANES, at_state + v.LANES


@inner
def _score_three(pictures, layers, numbers, row, slab, pad_x, padded, at, ring_size, places, scratch, maps):
    """1 - sqrt(det) of the correlation matrix of three views, weighted and filtered as in `_score_two`."""
    width = pictures.mask.shape[1]
    covariance = pictures.covariance[:, row if pictures.covariance.shape[1] > 1 else 0]
    even = 0 if covariance.shape[1] == 1 else 1
    ring, state, scores = scratch.ring, scratch.state, scratch.scores
    direct = layers.direct
    gain0, mean0 = (scratch.gain, scratch.mean_gain) if direct[0] else (scratch.lanes, scratch.lanes)
    gain1, mean1 = (scratch.gain, scratch.mean_gain) if direct[1] else (scratch.lanes, scratch.lanes)
    gain2, mean2 = (scratch.gain, scratch.mean_gain) if direct[2] else (scratch.lanes, scratch.lanes)
    # Rearranged means follow their gains in the same array.
    apart = (padded + v.LANES) * v.LANES
    m0, m1, m2 = 0 if direct[0] else apart, 0 if direct[1] else apart, 0 if direct[2] else apart
    fade = v.spread(numbers.decay)
    window_gain = v.spread((_ONE - numbers.decay) ** np.float32(4))
    count = len(layers.ceiling)
    overlap01, overlap02 = v.load(layers.overlap, slab), v.load(layers.overlap, slab + count)
    overlap12 = v.load(layers.overlap, slab + 2 * count)
    ceiling, floor, one, nothing = v.load(layers.ceiling, slab), v.spread(-_ONE), v.spread(_ONE), v.spread(_ZERO)
    weights, links = maps.weights[row], maps.links[row]
    endless = v.spread(_ONE / (_ONE - numbers.near))
    ahead = v.spread(_ZERO)
    at += pad_x * v.LANES
    at_state = pad_x * v.LANES
    next_state = padded * v.LANES
    (i0, step0), (i1, step1), (i2, step2) = places[0], places[1], places[2]
    for x in range(width):
        a = v.fma(fade, v.load(state, at_state), v.load(ring, at))
        b = v.fma(fade, v.load(state, at_state + next_state), v.load(ring, at + ring_size))
        c = v.fma(fade, v.load(state, at_state + 2 * next_state), v.load(ring, at + 2 * ring_size))
        v.store(state, at_state, a)
        v.store(state, at_state + next_state, b)
        v.store(state, at_state + 2 * next_state, c)
        a = v.fnma(overlap01, v.spread_at(covariance[0], even * x), v.mul(a, window_gain))
        b = v.fnma(overlap02, v.spread_at(covariance[1], even * x), v.mul(b, window_gain))
        c = v.fnma(overlap12, v.spread_at(covariance[2], even * x), v.mul(c, window_gain))
        g0, g1, g2 = v.load(gain0, i0), v.load(gain1, i1), v.load(gain2, i2)
        q0, q1, q2 = v.load(mean0, i0 + m0), v.load(mean1, i1 + m1), v.load(mean2, i2 + m2)
        a = v.larger(v.smaller(v.fnma(q0, q1, v.mul(a, v.mul(g0, g1))), one), floor)
        b = v.larger(v.smaller(v.fnma(q0, q2, v.mul(b, v.mul(g0, g2))), one), floor)
        c = v.larger(v.smaller(v.fnma(q1, q2, v.mul(c, v.mul(g1, g2))), one), floor)
        bc = v.mul(b, c)
        determinant = v.fnma(a, v.sub(v.sub(a, bc), bc), v.fnma(b, b, v.fnma(c, c, one)))
        score = v.sub(one, v.root(v.larger(determinant, nothing)))
        weighted = v.mul(v.smaller(score, ceiling), v.spread_at(weights, x))
        ahead = v.fma(v.spread_at(links, x), ahead, weighted) if x > 0 else v.mul(endless, weighted)
        v.store(scores, x * v.LANES, ahead)
        i0, i1, i2, at, at_state = i0 + step0, i1 + step1, i2 + step2, at + v.LANES, at_state + v.LANES


@inner
def _filter_back(scores, links, scales, near, volume, at, stride):
    """Add the leftwards recursion to the rightwards one of a row and file the sum, scaled, as int16."""
    end = len(scales) - 1
    endless, gain = v.spread(_ONE / (_ONE - near)), v.spread(_ONE - near)
    here = v.load(scores, end * v.LANES)
    # The weighted score is what the forward result has more than its link to the one before.
    before = v.load(scores, (end - 1) * v.LANES)
    state = v.mul(endless, v.fnma(v.spread_at(links, end), before, here))
    place = at + (end // BLOCK) * stride + (end % BLOCK) * v.LANES
    v.store_shorts(volume, place, v.mul(v.add(here, state), v.spread_at(scales, end)))
    for x in range(end - 1, 0, -1):
        here, before = before, v.load(scores, (x - 1) * v.LANES)
        weighted = v.fnma(v.spread_at(links, x), before, here)
        state = v.fma(v.spread_at(links, x + 1), state, weighted)
        place = at + (x // BLOCK) * stride + (x % BLOCK) * v.LANES
        v.store_shorts(volume, place, v.mul(v.add(here, state), v.spread_at(scales, x)))
    state = v.fma(v.spread_at(links, 1), state, v.mul(gain, before))
    v.store_shorts(volume, at, v.mul(v.add(before, state), v.spread_at(scales, 0)))

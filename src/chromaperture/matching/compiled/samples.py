# mypy: disallow-untyped-defs=False
"""Sub-pixel samples of the views for the compiled matcher, their window means and gains."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.compiled.layout import GROUP, ONE, START, ZERO, inner
from chromaperture.matching.compiled.windows import copy, window_end, window_rows, window_up


@inner
def sample(pictures, samplings, first_sample, rows, scratch):
    """Interpolate every entry of every row."""
    even = pictures.noise.shape[1] == 1
    for i in range(rows):
        for e in range(len(samplings.owner)):
            k = samplings.owner[e]
            at = i * samplings.row_length + samplings.start[e]
            _sample_row(pictures.views[k], samplings, e, first_sample + i, scratch.line, scratch.value, at)
            if not even or i == 0:
                _sample_row(pictures.noise[k], samplings, e, first_sample + i, scratch.line, scratch.noise_sample, at)


@inner
def _sample_row(picture, samplings, e, y, line, out, at):
    """Sample one row of an entry, x from -margin on; the picture is continued beyond its border."""
    height, width = picture.shape
    margin, step = samplings.margin, samplings.step[e]
    reach = margin + 2
    a, b = picture[min(max(y - 1, 0), height - 1)], picture[min(max(y, 0), height - 1)]
    c, d = picture[min(max(y + 1, 0), height - 1)], picture[min(max(y + 2, 0), height - 1)]
    inside = line[reach : reach + width]  # indices from 0 on: others LLVM must suspect of being negative
    t0, t1, t2, t3 = samplings.taps_y[e]
    if t1 == ONE:
        for x in range(width):
            inside[x] = b[x]
    else:
        for x in range(width):
            inside[x] = t0 * a[x] + t1 * b[x] + t2 * c[x] + t3 * d[x]
    count = width + 2 * margin
    for x in range(reach):
        line[x] = line[reach]
    for x in range(reach + width, count + 4):
        line[x] = line[reach + width - 1]
    t0, t1, t2, t3 = samplings.taps_x[e]
    skip = 2
    if t1 != ONE:
        # In place from the left: sample x needs none before x + 1.
        skip = 0
        for x in range(count):
            line[x] = t0 * line[x + 1] + t1 * line[x + 2] + t2 * line[x + 3] + t3 * line[x + 4]
    for x in range(skip, count + skip):
        v.put(out, at, line[x])
        at += step


@inner
def standardise(pictures, plan, band, first_sample, rows, scratch, weights_out):
    """Window means and gains of all samples, and the fraction of signal in the unshifted views.

    Four entries at a time: lanes 0 to 3 window the samples, lanes 4 to 7 their squares.
    """
    samplings, numbers, pad_x, pad_y = plan.samplings, plan.numbers, plan.pad_x, plan.pad_y
    top, bottom, begin = band.top, band.bottom, band.begin
    padded = pictures.mask.shape[1] + 2 * pad_x
    row_size = padded * v.LANES
    entries = len(samplings.owner)
    length, start, step = samplings.row_length, samplings.start, samplings.step
    lanes, ring, state = scratch.lanes, scratch.ring, scratch.state
    from_row, to_row = top - pad_y - first_sample, bottom + pad_y - first_sample
    unity = GROUP * row_size
    v.store(lanes, unity, v.broadcast(ONE))
    for y in range(top, bottom):
        for x in range(weights_out.shape[1]):
            weights_out[y, x] = ONE
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
            copy(scratch.carry, carried, ring, START, row_size)
        for row in range(0, rows, GROUP):
            for j in range(GROUP):
                down = (row + j) * length
                i0, i1, i2, i3 = at[0] + down, at[1] + down, at[2] + down, at[3] + down
                for target in range(j * row_size, (j + 1) * row_size, v.LANES):
                    v.store(lanes, target, v.four_and_squares(scratch.value, i0, i1, i2, i3))
                    i0, i1, i2, i3 = i0 + s0, i1 + s1, i2 + s2, i3 + s3
            window_rows(
                lanes, START, v.LANES, row_size, lanes, unity, START, START,
                ring, (row + 1) * row_size, padded, numbers.decay, begin and row == 0,
            )  # fmt: skip
        # The next band's samples start pad_y rows above its top.
        below = (bottom - pad_y - first_sample + 1) * row_size
        copy(ring, below - row_size, scratch.carry, carried, row_size)
        window_end(ring, row_size, rows, padded, numbers.decay, state, START)
        for row in range(rows - 2, to_row - 1, -1):
            window_up(ring, (row + 1) * row_size, padded, numbers.decay, state, START)
        for row in range(to_row - 1, from_row - 1, -1):
            _standardise_row(pictures, samplings, numbers, e, at, row, padded, scratch)
            y = row + first_sample
            if numbers.weighting and top <= y < bottom:
                for k in range(len(pictures.views)):
                    i = samplings.still[k] - e
                    if 0 <= i < 4:
                        weights = weights_out[y]
                        for x in range(len(weights)):
                            weights[x] *= v.get(lanes, (pad_x + x) * 4 + i)


@inner
def _standardise_row(pictures, samplings, numbers, e, at, row, padded, scratch):
    """Gains of four entries in a row; leaves their fractions of signal in ``lanes``, four a px."""
    entries = len(samplings.owner)
    e1, e2, e3 = min(e + 1, entries - 1), min(e + 2, entries - 1), min(e + 3, entries - 1)
    s0, s1, s2, s3 = samplings.step[e], samplings.step[e1], samplings.step[e2], samplings.step[e3]
    down = row * samplings.row_length
    i0, i1, i2, i3 = at[0] + down, at[1] + down, at[2] + down, at[3] + down
    even = pictures.noise.shape[1] == 1
    floors = np.empty(v.LANES, np.float32)
    for i in range(v.LANES):
        floors[i] = numbers.epsilon[samplings.owner[min(e + i % 4, entries - 1)]]
    floor, nothing = v.load(floors, 0), v.broadcast(ZERO)
    decay, debias = v.broadcast(numbers.decay), v.broadcast(numbers.debias)
    min_fraction = v.broadcast(numbers.min_fraction)
    window_gain = v.broadcast((ONE - numbers.decay) ** np.float32(4))
    ring, state, lanes, noise_sample = scratch.ring, scratch.state, scratch.lanes, scratch.noise_sample
    gains, mean_gains = scratch.gain, scratch.mean_gain
    noise = v.four_and_squares(noise_sample, at[0], at[1], at[2], at[3])
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
            n0 = v.four_and_squares(noise_sample, i0, i1, i2, i3)
            n1 = v.four_and_squares(noise_sample, i0 + s0, i1 + s1, i2 + s2, i3 + s3)
            noise = v.halves_low(n0, n1)
        signal = v.larger(v.sub(variance, noise), nothing)
        v.store(lanes, x * 4, v.div(signal, v.add(signal, v.add(noise, floor))))
        clean = v.larger(v.larger(v.fnma(debias, noise, variance), v.mul(min_fraction, variance)), nothing)
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
def transpose_rows(source, samplings, layers, k, slab, sample_row, pad_x, padded, out, target):
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

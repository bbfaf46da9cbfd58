# mypy: disallow-untyped-defs=False
"""From windowed products to correlations: one row of eight layers at a time, already filtered rightwards."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.compiled.layout import BLOCK, ONE, SCORE_SCALE, ZERO, inner
from chromaperture.matching.compiled.samples import transpose_rows


@inner
def locate_row(samplings, layers, slab, row, first_sample, pad_x, padded, scratch, places):
    """Find where the gains of a row's layers start and how far apart their pixels are; transpose them if need be."""
    row_size = (padded + v.LANES) * v.LANES
    for k in range(len(layers.direct)):
        if layers.direct[k]:
            places[k, 0] = (row - first_sample) * samplings.row_length + layers.start[k] + slab
            places[k, 1] = layers.step[k]
        else:
            target = 2 * k * row_size
            transpose_rows(
                scratch.gain, samplings, layers, k, slab, row - first_sample, pad_x, padded, scratch.lanes, target
            )
            transpose_rows(
                scratch.mean_gain, samplings, layers, k, slab, row - first_sample, pad_x, padded,
                scratch.lanes, target + row_size,
            )  # fmt: skip
            places[k, 0] = target + pad_x * v.LANES
            places[k, 1] = v.LANES


@inner
def score_two(
    pictures, layers, numbers, row, slab, pad_x, padded, at, places, scratch, maps, volume, at_volume, stride
):
    """Correlation of two views for one row of eight layers, weighted and filtered rightwards.

    Where nothing is filtered (``plain``) it goes to the volume at once; ``stride`` leads from block to block.
    """
    width = pictures.mask.shape[1]
    covariance = pictures.covariance[0, row if pictures.covariance.shape[1] > 1 else 0]
    even = len(covariance) == 1
    ring, state, scores = scratch.ring, scratch.state, scratch.scores
    direct = layers.direct
    gain0, mean0 = (scratch.gain, scratch.mean_gain) if direct[0] else (scratch.lanes, scratch.lanes)
    gain1, mean1 = (scratch.gain, scratch.mean_gain) if direct[1] else (scratch.lanes, scratch.lanes)
    # Transposed means follow their gains in the same array.
    apart = (padded + v.LANES) * v.LANES
    m0, m1 = 0 if direct[0] else apart, 0 if direct[1] else apart
    decay8 = v.broadcast(numbers.decay)
    window_gain = v.broadcast((ONE - numbers.decay) ** np.float32(4))
    overlap = v.load(layers.overlap, slab)
    noise = v.mul(overlap, v.broadcast_at(covariance, 0))
    ceiling, floor = v.load(layers.ceiling, slab), v.broadcast(-ONE)
    weights, links = maps.weights[row], maps.links[row]
    plain, unit = numbers.plain, v.broadcast(SCORE_SCALE)
    border_gain = v.broadcast(ONE / (ONE - numbers.even_link))
    ahead = v.broadcast(ZERO)
    at += pad_x * v.LANES
    at_state = pad_x * v.LANES
    (i0, step0), (i1, step1) = places[0], places[1]
    for x in range(width):
        window = v.fma(decay8, v.load(state, at_state), v.load(ring, at))
        v.store(state, at_state, window)
        if not even:
            noise = v.mul(overlap, v.broadcast_at(covariance, x))
        both = v.mul(v.load(gain0, i0), v.load(gain1, i1))
        means = v.mul(v.load(mean0, i0 + m0), v.load(mean1, i1 + m1))
        score = v.sub(v.mul(v.sub(v.mul(window, window_gain), noise), both), means)
        score = v.smaller(v.larger(score, floor), ceiling)
        if plain:
            v.store_kept(volume, at_volume + (x // BLOCK) * stride + (x % BLOCK) * v.LANES, v.mul(score, unit))
        else:
            weighted = v.mul(score, v.broadcast_at(weights, x))
            ahead = v.fma(v.broadcast_at(links, x), ahead, weighted) if x > 0 else v.mul(border_gain, weighted)
            v.store(scores, x * v.LANES, ahead)
        i0, i1, at, at_state = i0 + step0, i1 + step1, at + v.LANES, at_state + v.LANES


@inner
def score_three(
    pictures, layers, numbers, row, slab, pad_x, padded, at, ring_size, places, scratch, maps, volume, at_volume, stride
):
    """1 - sqrt(det) of the correlation matrix of three views, weighted and filtered as in `score_two`."""
    width = pictures.mask.shape[1]
    covariance = pictures.covariance[:, row if pictures.covariance.shape[1] > 1 else 0]
    even = 0 if covariance.shape[1] == 1 else 1
    ring, state, scores = scratch.ring, scratch.state, scratch.scores
    direct = layers.direct
    gain0, mean0 = (scratch.gain, scratch.mean_gain) if direct[0] else (scratch.lanes, scratch.lanes)
    gain1, mean1 = (scratch.gain, scratch.mean_gain) if direct[1] else (scratch.lanes, scratch.lanes)
    gain2, mean2 = (scratch.gain, scratch.mean_gain) if direct[2] else (scratch.lanes, scratch.lanes)
    # Transposed means follow their gains in the same array.
    apart = (padded + v.LANES) * v.LANES
    m0, m1, m2 = 0 if direct[0] else apart, 0 if direct[1] else apart, 0 if direct[2] else apart
    decay8 = v.broadcast(numbers.decay)
    window_gain = v.broadcast((ONE - numbers.decay) ** np.float32(4))
    count = len(layers.ceiling)
    overlap01, overlap02 = v.load(layers.overlap, slab), v.load(layers.overlap, slab + count)
    overlap12 = v.load(layers.overlap, slab + 2 * count)
    ceiling, floor, one, nothing = v.load(layers.ceiling, slab), v.broadcast(-ONE), v.broadcast(ONE), v.broadcast(ZERO)
    weights, links = maps.weights[row], maps.links[row]
    plain, unit = numbers.plain, v.broadcast(SCORE_SCALE)
    border_gain = v.broadcast(ONE / (ONE - numbers.even_link))
    ahead = v.broadcast(ZERO)
    at += pad_x * v.LANES
    at_state = pad_x * v.LANES
    next_state = padded * v.LANES
    (i0, step0), (i1, step1), (i2, step2) = places[0], places[1], places[2]
    for x in range(width):
        a = v.fma(decay8, v.load(state, at_state), v.load(ring, at))
        b = v.fma(decay8, v.load(state, at_state + next_state), v.load(ring, at + ring_size))
        c = v.fma(decay8, v.load(state, at_state + 2 * next_state), v.load(ring, at + 2 * ring_size))
        v.store(state, at_state, a)
        v.store(state, at_state + next_state, b)
        v.store(state, at_state + 2 * next_state, c)
        a = v.fnma(overlap01, v.broadcast_at(covariance[0], even * x), v.mul(a, window_gain))
        b = v.fnma(overlap02, v.broadcast_at(covariance[1], even * x), v.mul(b, window_gain))
        c = v.fnma(overlap12, v.broadcast_at(covariance[2], even * x), v.mul(c, window_gain))
        g0, g1, g2 = v.load(gain0, i0), v.load(gain1, i1), v.load(gain2, i2)
        q0, q1, q2 = v.load(mean0, i0 + m0), v.load(mean1, i1 + m1), v.load(mean2, i2 + m2)
        a = v.larger(v.smaller(v.fnma(q0, q1, v.mul(a, v.mul(g0, g1))), one), floor)
        b = v.larger(v.smaller(v.fnma(q0, q2, v.mul(b, v.mul(g0, g2))), one), floor)
        c = v.larger(v.smaller(v.fnma(q1, q2, v.mul(c, v.mul(g1, g2))), one), floor)
        bc = v.mul(b, c)
        determinant = v.fnma(a, v.sub(v.sub(a, bc), bc), v.fnma(b, b, v.fnma(c, c, one)))
        score = v.sub(one, v.root(v.larger(determinant, nothing)))
        score = v.smaller(score, ceiling)
        if plain:
            v.store_kept(volume, at_volume + (x // BLOCK) * stride + (x % BLOCK) * v.LANES, v.mul(score, unit))
        else:
            weighted = v.mul(score, v.broadcast_at(weights, x))
            ahead = v.fma(v.broadcast_at(links, x), ahead, weighted) if x > 0 else v.mul(border_gain, weighted)
            v.store(scores, x * v.LANES, ahead)
        i0, i1, i2, at, at_state = i0 + step0, i1 + step1, i2 + step2, at + v.LANES, at_state + v.LANES

# mypy: disallow-untyped-defs=False
"""Scores of layers to log-likelihoods of labels, a row at a time: the first part of `path_costs.py`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.compiled.layout import BLOCK, ONE, SCORE_SCALE, ZERO, inner
from chromaperture.matching.readable.four_paths import LEAST_DETERMINANT, NAT_PARTS

_LEAST_DETERMINANT = np.float32(LEAST_DETERMINANT)
NATS = np.float32(NAT_PARTS)  # a nat of log-likelihood in int16
_HALF = np.float32(0.5)
_TWO, _THREE, _SIX = np.float32(2), np.float32(3), np.float32(6)
_INNER, _MIDDLE, _OUTER = np.float32(1 / 12), np.float32(1 / 24), np.float32(1 / 120)  # of Lagrange's polynomials
BASE = 2 * v.LANES  # where a pixel's layers start in a scratch
_STEEP = np.float32(1e6)  # a label is beyond the last layer by a millionth of a layer, or not at all


class Layers(NamedTuple):
    """What was scored: the first layer and their distance, px; ``between``: labels lie between them."""

    first: np.float32
    step: np.float32
    number: int
    between: bool


@inner
def address(y, x, height, slabs):
    """Where the first layer of a pixel lies in the volume."""
    return ((x // BLOCK) * height + y) * slabs * BLOCK * v.LANES + (x % BLOCK) * v.LANES


@inner
def likelihoods(volume, slabs, mask, y, height, two_views):
    """One row of scores to log-likelihoods in place: -ln(1 - s^2) / 2 of two views, -ln(1 - s) of three, nats."""
    nats = -_HALF * NATS
    for x in range(len(mask)):
        factor = v.broadcast(nats * mask[x])
        at = address(y, x, height, slabs)
        for i in range(at, at + slabs * BLOCK * v.LANES, BLOCK * v.LANES):
            v.put_shorts(volume, i, v.mul(factor, _log_determinant(_unexplained(volume, i), two_views)))


@inner
def _unexplained(scores, i):
    """Read what eight scores leave of 1: of whole numbers, so that next to a score of 1 nothing is rounded off."""
    return v.mul(v.sub(v.broadcast(SCORE_SCALE), v.load_shorts(scores, i)), v.broadcast(ONE / SCORE_SCALE))


@inner
def _log_determinant(unexplained, two_views):
    """Logarithm of the determinant of the views' correlations, by what is left of 1 by the score."""
    unexplained = v.larger(v.smaller(unexplained, v.broadcast(ONE)), v.broadcast(ZERO))  # polynomials overshoot
    determinant = v.mul(unexplained, v.sub(v.broadcast(_TWO), unexplained) if two_views else unexplained)
    return v.logarithm(v.larger(determinant, v.broadcast(_LEAST_DETERMINANT)))


@inner
def read_at_labels(
    scores, volume, slabs, labels, map_row, many, mask, y, height, layers, settings, here, at_labels, two_views
):
    """One row of scores to log-likelihoods of labels, interpolated through six layers; 0 beyond them.

    ``here`` holds lane numbers, then from `BASE` on a pixel's layers, at its end room for a vector.
    """
    count = layers.number
    own_slabs = (count + v.LANES - 1) // v.LANES
    nats = -_HALF * NATS
    parts = np.int64(np.rint(layers.step / settings.step))
    for x in range(len(mask)):
        at = address(y, x, height, own_slabs)
        for s in range(own_slabs):
            v.store(here, BASE + s * v.LANES, _unexplained(scores, at + s * BLOCK * v.LANES))
        for end in range(BASE, BASE - 2, -1):  # as `four_paths.continued`
            here[end - 1] = _THREE * (here[end] - here[end + 1]) + here[end + 2]
        for end in range(BASE + count - 1, BASE + count + 1):
            here[end + 1] = _THREE * (here[end] - here[end - 1]) + here[end - 2]
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
        at = address(y, x, height, slabs)
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
        at = BASE + first + np.int64(ahead)
        t = v.fma(v.load(here, 0), v.broadcast(scale - ONE), v.broadcast(low - np.floor(low)))
        # Lagrange's polynomial through the layers at -2 to 3: pairs of them share all factors but one.
        one, two, three = v.broadcast(ONE), v.broadcast(_TWO), v.broadcast(_THREE)
        low0, high0 = v.load(here, at), v.load(here, at + 1)
        inner_pair = v.fma(t, v.sub(high0, low0), low0)
        middle_pair = v.fma(v.sub(two, t), v.load(here, at - 1), v.mul(v.add(one, t), v.load(here, at + 2)))
        outer_pair = v.fma(v.sub(three, t), v.load(here, at - 2), v.mul(v.add(two, t), v.load(here, at + 3)))
        a = v.mul(t, v.sub(t, one))
        b, c = v.sub(a, two), v.sub(a, v.broadcast(_SIX))
        inside_four = v.fnma(
            v.mul(a, v.broadcast(_MIDDLE)), middle_pair, v.mul(v.mul(b, v.broadcast(_INNER)), inner_pair)
        )
        value = v.fma(c, inside_four, v.mul(v.mul(a, v.mul(b, v.broadcast(_OUTER))), outer_pair))
        if high <= np.float32(count - 1):
            return value
        room = v.fnma(v.broadcast(scale), v.load(here, 0), v.broadcast(np.float32(count - 1) - low))
        inside = v.fma(room, v.broadcast(_STEEP), v.broadcast(ONE))  # 1 up to the last layer, 0 beyond
        inside = v.larger(v.smaller(inside, one), v.broadcast(ZERO))
        return v.fma(inside, v.sub(value, one), one)
    spill = len(here) - v.LANES
    for i in range(v.LANES):
        place = low + scale * np.float32(i)
        below = min(max(np.int64(place), 0), count - 2)
        t = place - np.float32(below)
        at = BASE + below
        inner_pair = here[at] + t * (here[at + 1] - here[at])
        middle_pair = (_TWO - t) * here[at - 1] + (ONE + t) * here[at + 2]
        outer_pair = (_THREE - t) * here[at - 2] + (_TWO + t) * here[at + 3]
        a = t * (t - ONE)
        b, c = a - _TWO, a - _SIX
        value = c * (b * _INNER * inner_pair - a * _MIDDLE * middle_pair) + a * b * _OUTER * outer_pair
        v.put(here, spill + i, value if ZERO <= t <= ONE and place >= ZERO else ONE)
    return v.load(here, spill)

# mypy: disallow-untyped-defs=False
"""Log-likelihood of layers by correlations, compiled; ``readable/pair_evidence.py`` explains what is computed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.compiled.paths import FAST
from chromaperture.matching.readable.pair_evidence import CONTRARY, MAX_CORRELATION2_OF_BANDS, Fallback
from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.threads import in_parallel


def pair_evidence(
    correlation: np.ndarray, places: np.ndarray, *, primary: int, band_weights: Sequence[float], fallback: Fallback
) -> np.ndarray:
    """Return what correlations earn at every layer, as `readable.pair_evidence`; (H, W, D) float32."""
    out = np.empty((*correlation.shape[3:], places.shape[1]), np.float32)
    places = np.ascontiguousarray(places, np.int64)
    weights, counts = np.asarray(band_weights, np.float32), tuple(map(np.float32, fallback))
    in_parallel(lambda _, first, last: _rows(correlation, places, primary, weights, counts, first, last, out), len(out))
    return out


@compiled(fastmath=FAST, error_model="numpy")
def _rows(correlation, places, primary, band_weights, fallback, first, last, out):
    """Rows from ``first`` to before ``last``; within, a row of pixels is what becomes vectors."""
    _, pairs, bands, _, width = correlation.shape
    count = places.shape[1]
    padded = (width + v.LANES - 1) // v.LANES * v.LANES
    seconds = np.zeros((pairs, bands, (count + 1) // 2, padded), np.float32)
    fourths = np.zeros(((count + 3) // 4, padded), np.float32)
    here, rest = np.zeros((pairs, padded), np.float32), np.ones(padded, np.float32)
    nats = np.empty((2, count, padded), np.float32)
    for y in range(first, last):
        for pair in range(pairs):
            of_pair = places[0 if pair < primary else 1]
            for band in range(bands):
                _every_second(correlation[:, pair, band, y], of_pair[::2], fourths, seconds[pair, band])
        nats[:] = 0
        for layer in range(count):
            for band in range(bands):
                for pair in range(pairs):
                    place = places[0 if pair < primary else 1, layer]
                    if layer % 2 == 0:
                        _copy(seconds[pair, band, layer // 2], here[pair])
                    elif place >= 0:
                        _copy(correlation[place, pair, band, y], here[pair])
                    else:
                        _midpoint(seconds[pair, band], layer // 2, here[pair])
                for pair in range(pairs):
                    _unexplained(here, pair, rest)
                    group = 0 if pair < primary else 1
                    alike = primary if pair < primary else pairs - primary
                    _add_logarithm(rest, np.float32(-0.5) * band_weights[band] / np.float32(alike), nats[group, layer])
        _joined(nats, fallback, out[y])


@inlined()
def _copy(values, out):
    """Put values at the beginning of an array; Numba makes eight times as much code of an assignment of arrays."""
    for i in range(len(values)):
        out[i] = values[i]


@inlined(fastmath=FAST, error_model="numpy")
def _every_second(computed, places, fourths, out):
    """Correlations of even layers; where they are not computed, between every fourth."""
    between = False
    for k in range(len(places)):
        if places[k] >= 0:
            _copy(computed[places[k]], out[k])
            if k % 2 == 0:
                _copy(computed[places[k]], fourths[k // 2])
        else:
            between = True
    if between:
        for k in range(1, len(places), 2):
            if places[k] < 0:
                _midpoint(fourths[: (len(places) + 1) // 2], k // 2, out[k])


@inlined(fastmath=FAST, error_model="numpy")
def _midpoint(rows, k, out):
    """Halfway between rows k and k + 1 by a polynomial through six; beyond the ends they are mirrored at these."""
    last = len(rows) - 1
    a, b, c, d = rows[max(k - 1, 0)], rows[k], rows[k + 1], rows[min(k + 2, last)]
    far, beyond = rows[max(k - 2, 0)], rows[min(k + 3, last)]
    left, right = rows[min(1, last)], rows[max(last - 1, 0)]
    two_left, two_right = rows[min(2, last)], rows[max(last - 2, 0)]
    two, three, twentyfive = np.float32(2), np.float32(3), np.float32(25)
    for x in range(len(out)):
        before = a[x] if k >= 1 else two * b[x] - left[x]
        first = far[x] if k >= 2 else two * rows[0, x] - (left[x] if k == 1 else two_left[x])
        after = d[x] if k + 2 <= last else two * c[x] - right[x]
        final = beyond[x] if k + 3 <= last else two * rows[last, x] - (right[x] if k + 2 == last else two_right[x])
        inner = np.float32(150) * (b[x] + c[x]) - twentyfive * (before + after)
        out[x] = (inner + three * (first + final)) / np.float32(256)


@inlined(fastmath=FAST, error_model="numpy")
def _unexplained(correlation, pair, out):
    """Share of variance that a pair leaves, of all pairs' correlations at a layer."""
    own, nothing, one = correlation[pair], np.float32(0), np.float32(1)
    most, scale = np.float32(MAX_CORRELATION2_OF_BANDS), np.float32(-1 / CONTRARY)
    if len(correlation) == 3:
        first, second = correlation[(pair + 1) % 3], correlation[(pair + 2) % 3]
        for x in range(len(out)):
            contrary = min(max(first[x] * second[x] * scale, nothing), one)
            up, down = max(own[x], nothing), min(own[x], nothing)
            out[x] = one - min(up * up + contrary * down * down, most)
    else:
        for x in range(len(out)):
            up = max(own[x], nothing)
            out[x] = one - min(up * up, most)


@inlined(fastmath=FAST, error_model="numpy")
def _add_logarithm(values, scale, out):
    factor = v.broadcast(scale)
    for x in range(0, len(values), v.LANES):
        v.store(out, x, v.fma(factor, v.logarithm(v.load(values, x)), v.load(out, x)))


@inlined(fastmath=FAST, error_model="numpy")
def _joined(nats, fallback, out):
    """Add what secondary pairs count where primary ones find little; (W, D)."""
    weight, nats_of_weight = fallback
    for x in range(len(out)):
        most = np.float32(0)
        for layer in range(out.shape[1]):
            most = max(most, nats[0, layer, x])
        share = weight * np.exp(-most / nats_of_weight)
        for layer in range(out.shape[1]):
            out[x, layer] = max(nats[0, layer, x] + share * nats[1, layer, x], np.float32(0))  # logarithms are rounded

"""Every vector function against NumPy, lane by lane."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from chromaperture.matching.compiled import simd as v

A = np.array([3.0, -1.5, 0.25, 7.0, -8.0, 0.5, 2.0, -0.125], np.float32)
B = np.array([-2.0, 4.0, 0.5, 7.5, -9.0, 0.25, -3.0, 1.0], np.float32)
C = np.array([1.0, 2.0, -4.0, 0.5, 8.0, -0.5, 16.0, 0.0], np.float32)
# All values are small multiples of powers of two: sums and products are exact, with or without a fused operation.


def applied(function, *vectors):
    out = np.zeros(v.LANES, np.float32)
    if len(vectors) == 1:
        njit(lambda a, out: v.store(out, 0, function(v.load(a, 0))))(*vectors, out)
    elif len(vectors) == 2:
        njit(lambda a, b, out: v.store(out, 0, function(v.load(a, 0), v.load(b, 0))))(*vectors, out)
    else:
        njit(lambda a, b, c, out: v.store(out, 0, function(v.load(a, 0), v.load(b, 0), v.load(c, 0))))(*vectors, out)
    return out


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (v.add, A + B),
        (v.sub, A - B),
        (v.mul, A * B),
        (v.div, A / B),
        (v.smaller, np.minimum(A, B)),
        (v.larger, np.maximum(A, B)),
        (v.halves_larger, np.concatenate([np.maximum(A[:4], A[4:]), np.maximum(B[:4], B[4:])])),
    ],
)
def test_functions_of_two_vectors(function, expected):
    np.testing.assert_array_equal(applied(function, A, B), expected)


def test_multiply_and_add():
    np.testing.assert_array_equal(applied(v.fma, A, B, C), A * B + C)
    np.testing.assert_array_equal(applied(v.fnma, A, B, C), C - A * B)


def test_roots():
    np.testing.assert_array_equal(applied(v.root, np.abs(A)), np.sqrt(np.abs(A)))
    # An estimate and one Newton step where the processor has one: a few 1e-7.
    np.testing.assert_allclose(applied(v.inverse_root, np.abs(A)), 1 / np.sqrt(np.abs(A)), rtol=1e-6)


def test_lanes_are_joined():
    np.testing.assert_array_equal(applied(v.least_lane, A), np.full(8, A.min()))
    np.testing.assert_array_equal(applied(v.sum_lanes, A), np.full(8, A.sum()))  # exact in any order


def test_logarithm():
    values = np.array([1e-5, 0.003, 0.2, 0.999, 1.0, 1.5, 2.0, 60.0], np.float32)
    # The polynomial is good to 2e-5.
    np.testing.assert_allclose(applied(v.logarithm, values), np.log(values), atol=3e-5)


def test_exponential():
    values = np.array([0.0, -1e-6, -0.3, -0.7, -1.0, -20.5, -86.0, -500.0], np.float32)
    # The polynomial is good to 2e-7, float32 exponents of up to 124 to 4e-6; the last is the least normal float.
    expected = np.maximum(np.exp(values.astype(float)), np.finfo(np.float32).tiny)
    np.testing.assert_allclose(applied(v.exponential, values), expected, rtol=1e-5)
    least = applied(v.exponential, np.full(8, -np.inf, np.float32))
    np.testing.assert_allclose(least, np.finfo(np.float32).tiny, rtol=1e-5)  # as above


def test_largest_lane_of_four_vectors():
    rows = np.stack([A, B, C, -A])
    work = njit(_largest)
    out = np.zeros(v.LANES, np.float32)
    work(rows.ravel(), out)
    np.testing.assert_array_equal(out[:4], rows.max(axis=1))


def _largest(rows, out):
    ab = v.halves_larger(v.load(rows, 0), v.load(rows, 8))
    cd = v.halves_larger(v.load(rows, 16), v.load(rows, 24))
    four = v.quarters_larger(ab, cd)
    v.store(out, 0, v.eighths_larger(four, four))


def test_tags_replace_the_low_bits():
    keep = np.full(8, ~np.int32(31)).view(np.float32)
    tags = np.arange(8, dtype=np.int32).view(np.float32)
    bits = applied(v.tagged, A, keep, tags).view(np.int32)
    np.testing.assert_array_equal(bits & 31, np.arange(8))
    np.testing.assert_array_equal(bits & ~31, A.view(np.int32) & ~31)


def test_shorts_are_rounded_and_read_back():
    values = np.array([0.4, 0.6, -0.4, -0.6, 32000.0, -32000.0, 1.5, -7.0], np.float32)
    raw = np.zeros(64 + 16, np.uint8)
    start = -raw.ctypes.data % 16
    shorts = raw[start : start + 16].view(np.int16)
    out = np.zeros(v.LANES, np.float32)
    njit(_through_shorts)(values, shorts, out)
    np.testing.assert_array_equal(shorts, np.rint(values).astype(np.int16))
    np.testing.assert_array_equal(out, shorts.astype(np.float32))


def _through_shorts(values, shorts, out):
    v.store_kept(shorts, 0, v.load(values, 0))
    v.fence()
    v.store(out, 0, v.load_shorts(shorts, 0))


def test_single_elements():
    array, out = np.arange(16, dtype=np.float32), np.zeros(40, np.float32)
    njit(_elements)(array, out)
    np.testing.assert_array_equal(out[:8], np.full(8, 3))
    np.testing.assert_array_equal(out[8:16], np.full(8, 2.5))
    np.testing.assert_array_equal(out[16:24], [5, 4, 3, 2, 25, 16, 9, 4])
    np.testing.assert_array_equal(out[24:32], [25, 16, 9, 4, 5, 4, 3, 2])
    np.testing.assert_array_equal(out[32:35], [9, 3, 7])


def _elements(array, out):
    v.prefetch(array, 0)
    v.store(out, 0, v.broadcast_at(array, 3))
    v.store(out, 8, v.broadcast(np.float32(2.5)))
    four = v.four_and_squares(array, 5, 4, 3, 2)
    v.store(out, 16, four)
    v.store(out, 24, v.swapped(four))
    v.put_lane(out, 32, four, 6)
    v.put(out, 33, v.lane(four, 2))
    v.put(out, 34, v.get(array, 7))


def test_eight_by_eight_is_transposed():
    rows = np.arange(64, dtype=np.float32)
    out = np.zeros(64, np.float32)
    njit(_transpose)(rows, out)
    np.testing.assert_array_equal(out.reshape(8, 8), rows.reshape(8, 8).T)


def _transpose(rows, out):
    a, b, c, d = v.load(rows, 0), v.load(rows, 8), v.load(rows, 16), v.load(rows, 24)
    e, f, g, h = v.load(rows, 32), v.load(rows, 40), v.load(rows, 48), v.load(rows, 56)
    a, b, c, d = v.singles_low(a, b), v.singles_high(a, b), v.singles_low(c, d), v.singles_high(c, d)
    e, f, g, h = v.singles_low(e, f), v.singles_high(e, f), v.singles_low(g, h), v.singles_high(g, h)
    a, b, c, d = v.pairs_low(a, c), v.pairs_high(a, c), v.pairs_low(b, d), v.pairs_high(b, d)
    e, f, g, h = v.pairs_low(e, g), v.pairs_high(e, g), v.pairs_low(f, h), v.pairs_high(f, h)
    v.store(out, 0, v.halves_low(a, e))
    v.store(out, 8, v.halves_low(b, f))
    v.store(out, 16, v.halves_low(c, g))
    v.store(out, 24, v.halves_low(d, h))
    v.store(out, 32, v.halves_high(a, e))
    v.store(out, 40, v.halves_high(b, f))
    v.store(out, 48, v.halves_high(c, g))
    v.store(out, 56, v.halves_high(d, h))

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

"""The readable recursive bilateral filter against closed forms and a matrix of its weights."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.readable.bilateral import recursive_bilateral


def test_bilateral_of_an_even_guide_is_a_two_sided_exponential():
    sigma = 5.0
    decay = np.exp(-np.sqrt(2) / sigma)
    score = np.zeros((41, 51, 1))
    score[20, 25] = 1.0
    found = recursive_bilateral(score, np.zeros((41, 51)), np.ones((41, 51)), sigma)[..., 0]

    def profile(n):  # two one-sided recursions, each of sum 1, which both count the pixel itself
        return (1 - decay) * decay ** np.abs(n) * np.where(n == 0, 2, 1) / 2

    y, x = np.mgrid[-20:21, -25:26]
    np.testing.assert_allclose(found, profile(y) * profile(x), atol=1e-15, rtol=1e-11)  # float64


def test_bilateral_of_one_row_weights_by_the_product_of_links_on_the_way(rng):
    n, sigma = 30, 6.0
    guide, weights, score = rng.normal(0, 0.5, n), rng.uniform(0.1, 1, n), rng.normal(0, 1, n)
    steps = np.exp(-np.sqrt(2) / sigma - np.abs(np.diff(guide)))
    gain = np.full(n, 1 - np.exp(-np.sqrt(2) / sigma))
    kernel = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            way = steps[min(i, j) : max(i, j)].prod()
            at_end = j in (0, n - 1) and (i != j)  # a recursion starts with its first sample whole
            kernel[i, j] = way * (1 if at_end else gain[j])
            if i == j:
                kernel[i, j] = 2 * gain[j] if 0 < j < n - 1 else 1 + gain[j]
    expected = kernel @ (weights * score) / (kernel @ weights)
    found = recursive_bilateral(score[None, :, None], guide[None], weights[None], sigma)[0, :, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)  # float64

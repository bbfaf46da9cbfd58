"""The readable correlation of shifted views against direct sums, eigenvalues and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.matching.readable.correlation import (
    SAMPLING,
    correlate,
    exponential_window,
    shift,
    smoothed_cubic_taps,
    texture_weights,
    three_view_score,
)
from chromaperture.matching.views import ViewNoise, Views, smooth
from chromaperture.settings.stages import CorrelationConfig


def window_weights(decay, reach):
    weights = decay ** np.abs(np.arange(-reach, reach + 1.0))
    return weights / weights.sum()


# ---- window


@pytest.mark.parametrize("decay", [0.05, 0.5, 0.8, 0.9])
@pytest.mark.parametrize("shape", [(40, 60), (1, 30), (25, 1), (2, 3)])
def test_exponential_window_is_the_direct_sum_over_the_endless_picture(rng, decay, shape):
    maps = rng.normal(0, 1, shape)
    reach = int(np.ceil(np.log(1e-15) / np.log(decay)))  # the tail left out is below 1e-14
    weights = window_weights(decay, reach)
    padded = np.pad(maps, reach, mode="edge")
    rows = np.apply_along_axis(np.convolve, 1, padded, weights, mode="valid")
    direct = np.apply_along_axis(np.convolve, 0, rows, weights, mode="valid")
    np.testing.assert_allclose(exponential_window(maps, decay), direct, atol=1e-12)  # float64 recursions


# ---- shift


@given(dx=st.floats(-3, 3), dy=st.floats(-3, 3))
def test_shift_is_exact_for_parabolas(dx, dy):
    def picture(x, y):
        return 0.3 + 0.02 * x - 0.01 * y + 0.003 * x * y + 0.001 * x**2 - 0.002 * y**2

    x, y = np.meshgrid(np.arange(30.0), np.arange(24.0))
    inner = (slice(6, -6), slice(6, -6))  # the border is replicated, not continued as a parabola
    found = shift(picture(x, y), np.array([dx, dy]))
    np.testing.assert_allclose(found[inner], picture(x + dx, y + dy)[inner], atol=1e-12)  # float64


@given(st.floats(0, 1, exclude_max=True), st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_smoothing_weights_smooth_cubics_as_a_gaussian_does(phase, variance, seed):
    cubic = np.polynomial.Polynomial(np.random.default_rng(seed).normal(0, 1, 4))
    nodes, weights = np.polynomial.hermite_e.hermegauss(4)  # exact up to the seventh degree
    expected = weights @ cubic(phase + np.sqrt(variance) * nodes) / weights.sum()
    found = np.dot(smoothed_cubic_taps(phase, variance_px2=variance), cubic(np.arange(-1, 3)))
    assert found == pytest.approx(expected, abs=1e-13)  # float64, values up to 40


def displacement_found(taps, phase):
    """Px by which weights displace a texture of 1/f behind a Gaussian of 0.4 px, read off by least squares."""
    frequency = np.linspace(0.005, np.pi, 2000)
    kernel = np.exp(-1j * np.outer(np.arange(-1, 3), frequency))
    still, moved = taps(0.0) @ kernel, taps(phase) @ kernel
    # Of power 1 / f^2 in the plane a line along x has 1 / f; a displacement d changes a wave by f d.
    power = np.exp(-((0.4 * frequency) ** 2)) / frequency * np.abs(still)
    turned = np.imag(moved * np.exp(1j * frequency * phase))
    return phase - np.sum(power * frequency * turned) / np.sum(power * frequency**2 * np.abs(still))


@pytest.mark.parametrize("phase", [0.1, 0.25, 0.4, 0.5, 0.75])
def test_smoothing_displaces_texture_by_what_it_is_asked_for(phase):
    found = displacement_found(lambda t: np.array(SAMPLING["smoothed-cubic"](t)), phase)
    # .0023 px at worst; the cubic B-spline's .0128 locked flat boards to the layers (`benchmarks/locking.py`)
    assert found == pytest.approx(phase, abs=0.003)


# ---- score


@given(st.integers(0, 2**32 - 1))
def test_three_view_score_is_one_minus_the_root_of_the_product_of_eigenvalues(seed):
    rng = np.random.default_rng(seed)
    samples = rng.normal(0, 1, (3, 6)) + rng.normal(0, rng.uniform(0, 3), 6)  # anything from unlike to alike
    r = np.corrcoef(samples)
    product = np.prod(np.linalg.eigvalsh(r))
    score = three_view_score(r[0, 1], r[0, 2], r[1, 2])
    # squared, because a root at 0 would magnify the rounding of the determinant
    assert (1 - score) ** 2 == pytest.approx(product, abs=1e-12)


def views_of(pictures, directions, *, noise_variance=None):
    """Views without a mask; noise, where it is given, is of equal variance and covariance."""
    height, width, count = pictures.shape
    noise = None
    if noise_variance is not None:
        pairs = count * (count - 1) // 2
        maps = (np.full((height, width, n), noise_variance, np.float32) for n in (count, pairs))
        noise = ViewNoise(*maps, presmooth_sigma_px=0.7)
    even = np.zeros((height, width), np.float32)
    return Views(pictures.astype(np.float32), np.array(directions, float), even, even + 1, noise)


@pytest.mark.parametrize("directions", [[(-1, 0), (1, 0)], [(1, 0), (0, -1), (-1, 0)]])
def test_score_is_the_weighted_correlation_of_the_displaced_views(rng, directions):
    """Against NumPy's weighted covariance, pixel by pixel, at layers of whole pixels and at the border."""
    decay, reach = 0.5, 50
    views = np.stack([smooth(rng.normal(0, 1, (20, 24)), 1.0) for _ in directions], axis=-1).astype(np.float32)
    layers = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    config = CorrelationConfig(window_decay=decay, sampling="catmull-rom")  # reads whole pixels as they are
    volume = correlate(views_of(views, directions), layers, config=config)
    weights = np.outer(window_weights(decay, reach), window_weights(decay, reach)).ravel()
    for row, column, s in ((0, 0, 0), (10, 12, 4), (19, 3, 1), (7, 23, 2)):
        y, x = np.mgrid[row - reach : row + reach + 1, column - reach : column + reach + 1]
        seen = []
        for k, (ux, uy) in enumerate(directions):
            at_x = np.clip(x + int(layers[s]) * ux, 0, 23)
            at_y = np.clip(y + int(layers[s]) * uy, 0, 19)
            seen.append(views[at_y, at_x, k].ravel())
        covariance = np.cov(np.array(seen, float), aweights=weights, ddof=0)
        deviation = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(deviation, deviation)
        expected = correlation[0, 1] if len(directions) == 2 else 1 - np.sqrt(np.linalg.det(correlation))
        # the variance floor of 1e-6 lowers scores by about as much
        assert volume[row, column, s] == pytest.approx(expected, abs=1e-5)


def test_known_noise_is_taken_out_of_the_correlation(rng):
    """Identical noise in both views correlates at zero shift; debiasing gives back the texture's correlation."""
    views = smooth(rng.normal(0, 1, (200, 200, 2)).astype(np.float32), 1.5)
    noise = smooth(rng.normal(0, 0.1, (200, 200, 1)).astype(np.float32), 0.7)
    directions, layers = [(-1, 0), (1, 0)], np.zeros(1)
    plain, debiased = (CorrelationConfig(window_decay=0.9, noise_debiasing=on) for on in (False, True))
    clean = correlate(views_of(views, directions), layers, config=plain).mean()
    noisy = views_of(views + noise, directions, noise_variance=noise.var())
    error_before = correlate(noisy, layers, config=plain).mean() - clean
    error_after = correlate(noisy, layers, config=debiased).mean() - clean
    assert error_before > 0.02  # 0.04 is found: else there is nothing to undo
    assert abs(error_after) < 0.1 * error_before  # 0.014 is found


def test_unusable_pixels_have_next_to_no_weight(rng):
    views = views_of(smooth(rng.normal(0, 1, (20, 24, 2)).astype(np.float32), 1.0), [(-1, 0), (1, 0)])
    mask = views.mask.copy()
    mask[3, 4] = 0
    weights = texture_weights(replace(views, mask=mask), config=CorrelationConfig())
    assert weights[3, 4] < 1e-3  # ten times MIN_WEIGHT
    assert weights[10, 10] > 0.99  # noiseless texture has its full weight

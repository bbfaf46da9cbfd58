"""Parts of the reference matcher against direct sums, eigenvalues and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chromaperture.disparity.reference import (
    exponential_window,
    recursive_bilateral,
    score_volume,
    shift,
    texture_weights,
    three_view_score,
)
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.config import MatcherConfig
from chromaperture.disparity.views import MatchInputs, smooth
from chromaperture.disparity.winner import parabola_winner


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
    np.testing.assert_allclose(exponential_window(maps, decay), direct, atol=1e-12)


def test_exponential_window_treats_every_view_alike(rng):
    maps = rng.normal(0, 1, (12, 17, 3))
    each = np.stack([exponential_window(maps[..., k], 0.8) for k in range(3)], axis=-1)
    np.testing.assert_array_equal(exponential_window(maps, 0.8), each)


# ---- shift


@pytest.mark.parametrize("offset", [(0, 0), (3, 0), (-2, 0), (0, 4), (-1, -5), (40, 0)])
def test_shift_by_whole_pixels_picks_pixels(rng, offset):
    view = rng.normal(0, 1, (15, 20))
    x, y = np.meshgrid(np.arange(20) + offset[0], np.arange(15) + offset[1])
    expected = view[np.clip(y, 0, 14), np.clip(x, 0, 19)]
    np.testing.assert_array_equal(shift(view, np.array(offset, float)), expected)


@given(dx=st.floats(-3, 3), dy=st.floats(-3, 3))
def test_shift_is_exact_for_parabolas(dx, dy):
    def picture(x, y):
        return 0.3 + 0.02 * x - 0.01 * y + 0.003 * x * y + 0.001 * x**2 - 0.002 * y**2

    x, y = np.meshgrid(np.arange(30.0), np.arange(24.0))
    inner = (slice(6, -6), slice(6, -6))  # the border is replicated, not continued as a parabola
    found = shift(picture(x, y), np.array([dx, dy]))
    np.testing.assert_allclose(found[inner], picture(x + dx, y + dy)[inner], atol=1e-12)


def test_shift_of_band_limited_texture_has_the_error_of_cubic_convolution():
    """Catmull-Rom is of third order: twice as many samples a period, an eighth of the error."""

    def worst_error(period_px):
        x = np.arange(240.0)
        wave = np.tile(np.sin(2 * np.pi * x / period_px), (3, 1))
        found = shift(wave, np.array([0.3, 0.0]))[:, 20:-20]
        return np.abs(found - np.sin(2 * np.pi * (x + 0.3) / period_px)[20:-20]).max()

    errors = np.array([worst_error(period) for period in (8.0, 16.0, 32.0, 64.0)])
    assert errors[1] < 3e-3
    np.testing.assert_allclose(np.log2(errors[1:-1] / errors[2:]), 3, atol=0.15)


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


def inputs_of(views, directions, layers_px):
    height, width, count = views.shape
    pairs = count * (count - 1) // 2
    return MatchInputs(
        views=views.astype(np.float32),
        directions=np.array(directions, float),
        layers_px=np.array(layers_px, float),
        guide=np.zeros((height, width), np.float32),
        mask=np.ones((height, width), np.float32),
        noise_variance=np.zeros((height, width, count), np.float32),
        noise_covariance=np.zeros((height, width, pairs), np.float32),
        noise_overlap=np.ones((len(layers_px), pairs), np.float32),
    )


@pytest.mark.parametrize("directions", [[(-1, 0), (1, 0)], [(1, 0), (0, -1), (-1, 0)]])
def test_score_is_the_weighted_correlation_of_the_displaced_views(rng, directions):
    """Against NumPy's weighted covariance, pixel by pixel, at layers of whole pixels and at the border."""
    decay, reach = 0.5, 50
    config = MatcherConfig(window_decay=decay, noise_debiasing=False)
    views = np.stack([smooth(rng.normal(0, 1, (20, 24)), 1.0) for _ in directions], axis=-1).astype(np.float32)
    layers = [-2.0, -1.0, 0.0, 1.0, 2.0]
    volume = score_volume(inputs_of(views, directions, layers), config)
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
    size = noise.var()
    config = MatcherConfig(window_decay=0.9)
    clean = score_volume(inputs_of(views, [(-1, 0), (1, 0)], [0.0]), config)
    spoilt_inputs = inputs_of(views + noise, [(-1, 0), (1, 0)], [0.0])
    known = replace(
        spoilt_inputs,
        noise_variance=np.full((200, 200, 2), size, np.float32),
        noise_covariance=np.full((200, 200, 1), size, np.float32),
    )
    biased = score_volume(known, replace(config, noise_debiasing=False)).mean() - clean.mean()
    debiased = score_volume(known, config).mean() - clean.mean()
    assert biased > 0.02
    assert abs(debiased) < 0.1 * biased


# ---- recursive bilateral filter


def test_bilateral_of_an_even_guide_is_a_two_sided_exponential():
    sigma = 5.0
    decay = np.exp(-np.sqrt(2) / sigma)
    score = np.zeros((41, 51, 1))
    score[20, 25] = 1.0
    found = recursive_bilateral(score, np.zeros((41, 51)), np.ones((41, 51)), sigma)[..., 0]

    def profile(n):  # two one-sided recursions, each of sum 1, which both hear the pixel itself
        return (1 - decay) * decay ** np.abs(n) * np.where(n == 0, 2, 1) / 2

    y, x = np.mgrid[-20:21, -25:26]
    np.testing.assert_allclose(found, profile(y) * profile(x), atol=1e-15, rtol=1e-11)


def test_bilateral_of_one_row_weighs_by_the_product_of_links_on_the_way(rng):
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
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)


def test_bilateral_keeps_constants(rng):
    guide, weights = rng.normal(0, 2, (20, 30)), rng.uniform(1e-4, 1, (20, 30))
    score = np.broadcast_to(np.array([0.3, -0.7]), (20, 30, 2))
    np.testing.assert_allclose(recursive_bilateral(score, guide, weights, 14.0), score, rtol=1e-12)


def test_bilateral_does_not_leak_across_a_large_step_of_the_guide(rng):
    guide = np.zeros((20, 30))
    guide[:, 15:] = 40.0
    score = rng.normal(0, 1, (20, 30, 1))
    other = score.copy()
    other[:, 15:] += 100.0
    args = (guide, np.ones((20, 30)), 14.0)
    change = recursive_bilateral(other, *args) - recursive_bilateral(score, *args)
    assert np.abs(change[:, :15]).max() < 1e-12  # exp(-40) * 100
    np.testing.assert_allclose(change[:, 15:], 100.0, rtol=1e-12)


def test_bilateral_listens_to_pixels_by_their_weight():
    score = np.zeros((9, 9, 1))
    score[4, 5:] = 1.0
    weights = np.ones((9, 9))
    weights[:, 5:] = 1e-9
    assert recursive_bilateral(score, np.zeros((9, 9)), weights, 14.0)[4, 4, 0] < 1e-8


def test_unusable_pixels_weigh_next_to_nothing(rng):
    inputs = inputs_of(smooth(rng.normal(0, 1, (20, 24, 2)).astype(np.float32), 1.0), [(-1, 0), (1, 0)], [0.0])
    mask = inputs.mask.copy()
    mask[3, 4] = 0
    weights = texture_weights(replace(inputs, mask=mask), MatcherConfig())
    assert weights[3, 4] < 1e-3
    assert weights[10, 10] > 0.99  # noiseless texture counts in full


# ---- sub-pixel


@given(peak_at=st.floats(-2.9, 2.9), height=st.floats(0.1, 1), bend=st.floats(0.01, 0.5), costs=st.booleans())
def test_a_parabola_is_found_exactly(peak_at, height, bend, costs):
    layers = np.arange(-4, 4.5, 0.5)
    score = (height - bend * (layers - peak_at) ** 2)[None, None, :]
    winner = parabola_winner(-score if costs else score, layers, lower_is_better=costs)
    assert winner.disparity_px[0, 0] == pytest.approx(peak_at, abs=1e-6)  # float32
    assert winner.peak[0, 0] == pytest.approx(height, abs=1e-6)
    assert winner.curvature[0, 0] == pytest.approx(2 * bend, rel=1e-5)


@pytest.mark.parametrize("best", [0, 8])
def test_a_winner_at_an_end_of_the_range_is_unknown(best):
    layers = np.arange(-2, 2.5, 0.5)
    winner = parabola_winner(-np.abs(np.arange(9.0) - best)[None, None], layers)
    assert np.isnan(winner.disparity_px).all()


def test_a_flat_score_gives_finite_numbers():
    winner = parabola_winner(np.zeros((1, 1, 5)) + np.array([0, 1.0, 1.0, 1.0, 0]), np.arange(5.0))
    assert np.isfinite(winner.peak).all()
    assert (winner.curvature >= 0).all()

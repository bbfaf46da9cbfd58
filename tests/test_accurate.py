"""Quality "accurate" and its error bar: a world of two noisy views, asked back."""

from dataclasses import replace

import numpy as np
import pytest

from chromaperture.config import MatcherConfig, OptimiserConfig
from chromaperture.disparity import reference, semiglobal, semiglobal_kernels
from chromaperture.disparity.error_bar import disparity_sigma
from chromaperture.disparity.optimise import log_likelihood, match, optimise_volume, relative_scale, with_halves
from chromaperture.disparity.reference import three_view_score
from chromaperture.disparity.semiglobal import even_field, layer_field
from chromaperture.disparity.views import MatchInputs
from chromaperture.disparity.winner import Winner
from chromaperture.errors import InputError

LAYERS_PX = np.arange(-3.0, 3.01, 0.5)


def correlation_volume(rng, truth, *, peak=0.6, noise=0.15):
    """Correlations that fall off with the distance from the truth, with noise common to 3 x 3 px."""
    error = rng.normal(0, noise, (truth.shape[0] // 3 + 1, truth.shape[1] // 3 + 1, len(LAYERS_PX)))
    error = error.repeat(3, 0).repeat(3, 1)[: truth.shape[0], : truth.shape[1]]
    return np.clip(peak * np.exp(-((LAYERS_PX - truth[..., None]) ** 2)) + error, -1, 1)


def wall(shape=(45, 60)):
    return -0.3 + 0.015 * np.mgrid[: shape[0], : shape[1]][1]


def test_likelihood_is_that_of_gaussian_views():
    """The mean log density ratio of correlated against independent Gaussian pairs, over drawn samples."""
    rng = np.random.default_rng(1)
    for rho in (0.3, 0.8):
        x, y = rng.multivariate_normal([0, 0], [[1, rho], [rho, 1]], 200_000).T
        together = (x**2 - 2 * rho * x * y + y**2) / (1 - rho**2) + np.log(1 - rho**2)
        alone = x**2 + y**2
        gain = (alone - together).mean() / 2
        assert log_likelihood(np.array(rho), view_count=2) == pytest.approx(gain, abs=0.01)  # sampling error
    # Three views of which only two are related know no more than those two: det R = 1 - rho^2 for both.
    pair = log_likelihood(np.array(0.5), view_count=2)
    score = three_view_score(np.array(0.5), np.array(0.0), np.array(0.0))
    assert log_likelihood(score, view_count=3) == pytest.approx(pair, rel=1e-6)


def test_anticorrelation_is_no_evidence_and_certainty_is_finite():
    values = log_likelihood(np.array([-1.0, -0.2, 0.0, 1.0]), view_count=2)
    np.testing.assert_array_equal(values[:3], 0)
    assert np.isfinite(values[3])


@pytest.mark.parametrize("backend", ["numba", "reference"])
def test_surface_comes_back_with_an_error_bar(backend):
    rng = np.random.default_rng(2)
    truth = wall((18, 24)) if backend == "reference" else wall()
    likelihood = log_likelihood(correlation_volume(rng, truth), view_count=2)
    config = OptimiserConfig(slope_penalty=1.5, jump_penalty=3)
    winner = optimise_volume(likelihood, np.zeros(truth.shape), LAYERS_PX, config=config, backend=backend)
    alone = np.abs(LAYERS_PX[likelihood.argmax(axis=2)] - truth).mean()
    assert np.isfinite(winner.disparity_px).all()
    assert np.abs(winner.disparity_px - truth).mean() < 0.1 < alone
    assert (winner.spread_px > 0).all()
    assert np.median(winner.peak) == pytest.approx(0.6, abs=0.15)  # the correlation put in; noise is 0.15


def test_backends_agree():
    rng = np.random.default_rng(3)
    truth = wall((14, 17))
    likelihood = log_likelihood(correlation_volume(rng, truth), view_count=2)
    config = OptimiserConfig(coupling_rounds=5, variation_iterations=10)
    guide = rng.uniform(0, 1, truth.shape)
    fast, slow = (
        optimise_volume(likelihood, guide, LAYERS_PX, config=config, backend=name)
        for name in ("numba", "reference")
    )
    for one, other in zip(fast, slow, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-3)  # float32 against float64 paths of tens of nats


def test_answer_at_the_end_of_the_range_is_unknown():
    truth = np.full((20, 20), LAYERS_PX[-1] + 0.3)
    likelihood = log_likelihood(correlation_volume(np.random.default_rng(4), truth, noise=0.02), view_count=2)
    winner = optimise_volume(likelihood, np.zeros(truth.shape), LAYERS_PX, config=OptimiserConfig())
    assert np.isnan(winner.disparity_px).all()
    assert np.isnan(disparity_sigma(winner, MatcherConfig(), 2)).all()


def test_spread_of_a_quadratic_cost_is_that_of_a_gaussian():
    """exp(-(d - m)^2 / 2 s^2) on fine layers has the standard deviation s; the answer's own error adds."""
    layers = np.arange(-4, 4.01, 0.1)
    middle, sigma = 0.03, 0.6
    cost = np.tile((layers - middle) ** 2 / (2 * sigma**2) * 7.0, (3, 4, 1)).astype(np.float32)
    for module in (semiglobal, semiglobal_kernels):
        out = module.spread(np.full((3, 4), middle), cost, layers, temperature=7.0)
        # Sum over layers for the integral; beyond the last, at 6 sigma, nothing is left.
        np.testing.assert_allclose(out, sigma, rtol=1e-4)
        moved = module.spread(np.full((3, 4), middle + 0.8), cost, layers, temperature=7.0)
        np.testing.assert_allclose(moved, np.hypot(sigma, 0.8), rtol=1e-4)


def test_error_bar_knows_a_rival():
    layers = np.arange(-3, 3.01, 0.25)
    alone = np.minimum(8 * (layers - 1) ** 2, 20.0)
    rival = np.minimum(alone, 8 * (layers + 1.5) ** 2 + 1)
    cost = np.stack([alone, rival])[None].astype(np.float32)
    sure, unsure = semiglobal_kernels.spread(np.ones((1, 2)), cost, layers, temperature=2.0)[0]
    assert sure < 0.4
    assert unsure > 1.0


def test_sigma_takes_the_optimisers_spread_and_caps_it():
    one = np.ones((2, 2), np.float32)
    winner = Winner(np.array([[0, 1], [np.nan, 2]], np.float32), one, one, np.array([[0.2, 0.3], [0.1, 99]]))
    sigma = disparity_sigma(winner, MatcherConfig(), 2)
    np.testing.assert_allclose(sigma[0], [0.2, 0.3], rtol=1e-6)
    assert np.isnan(sigma[1, 0])
    assert 2 < sigma[1, 1] < 99


def test_mismatched_shapes_are_named():
    with pytest.raises(InputError, match="does not fit"):
        optimise_volume(np.zeros((4, 5, 6)), np.zeros((4, 5)), LAYERS_PX, config=OptimiserConfig())


def half_pupil_views(rng, disparity_px, *, noise):
    """Left and right half views of a random texture on a wall of one disparity, sampled by Fourier shifts."""
    shape = (40, 48)
    spectrum = np.fft.fft2(rng.normal(size=shape))
    frequency = np.fft.fftfreq(shape[1])
    spectrum *= np.exp(-8 * (frequency**2 + np.fft.fftfreq(shape[0])[:, None] ** 2))
    views = [
        np.fft.ifft2(spectrum * np.exp(2j * np.pi * frequency * -disparity_px * u)).real for u in (-1, 1)
    ]
    return np.stack(views, -1) + rng.normal(0, noise, (*shape, 2))


def inputs_of(views, scale=1.0):
    config = MatcherConfig(min_disparity_px=-2.5, max_disparity_px=2.5)
    shape = views.shape[:2]
    return config, MatchInputs(
        views=views.astype(np.float32),
        directions=np.array([[-1.0, 0], [1, 0]]) * scale,
        layers_px=config.layers_px,
        guide=np.zeros(shape, np.float32),
        mask=np.ones(shape, np.float32),
        noise_variance=np.zeros((*shape, 2), np.float32),
        noise_covariance=np.zeros((*shape, 1), np.float32),
        noise_overlap=np.zeros((len(config.layers_px), 1), np.float32),
    )


def test_two_colour_spaces_of_different_scale_are_matched_as_one():
    rng = np.random.default_rng(5)
    truth, scale = 1.5, 0.7
    config, first = inputs_of(half_pupil_views(rng, truth, noise=0.1))
    _, second = inputs_of(half_pupil_views(rng, truth * scale, noise=0.1), scale)
    winner = match([first, second], config, OptimiserConfig(), score_volume=reference.score_volume)
    # A layer itself: there interpolation has no bias, and what the noise does is smoothed away.
    assert np.abs(winner.disparity_px - truth).max() < 0.03
    torn = replace(second, directions=first.directions)
    apart = match([first, torn], config, OptimiserConfig(), score_volume=reference.score_volume)
    assert np.abs(apart.disparity_px - truth).mean() > 0.05


def test_saturated_pixels_give_no_evidence():
    rng = np.random.default_rng(6)
    config, inputs = inputs_of(half_pupil_views(rng, 1.0, noise=0.02))
    spoilt = inputs.views.copy()
    spoilt[10:20, 10:30] = half_pupil_views(rng, -2.0, noise=0.02)[10:20, 10:30]
    inputs.mask[6:24, 4:36] = 0
    inputs = replace(inputs, views=spoilt)
    winner = match([inputs], config, OptimiserConfig(), score_volume=reference.score_volume)
    assert np.abs(winner.disparity_px - 1.0).max() < 0.1


def test_scale_between_two_colour_spaces_is_found():
    rng = np.random.default_rng(7)
    truth = np.linspace(-2.5, 2.5, 60) * np.ones((45, 1))
    likelihood = log_likelihood(correlation_volume(rng, 0.84 * truth), view_count=2)
    disparity = truth.copy()
    disparity[:5] = np.nan
    candidates = np.arange(0.6, 1.21, 0.04)
    found = relative_scale(disparity, likelihood, LAYERS_PX, candidates=candidates)
    assert found == pytest.approx(0.84, abs=0.041)  # the step of the candidates


def curved_field(shape):
    """A and B of a lens with field curvature and vignetting: a flat wall bends by more than two layers."""
    y, x = (np.mgrid[: shape[0], : shape[1]] - np.array(shape)[:, None, None] / 2) / shape[1]
    return 4 - 5 * (x**2 + y**2), 8000 * (1 - 0.3 * (x**2 + y**2))


def test_field_labels_are_the_disparities_of_the_reference_pixel():
    a, b = curved_field((30, 40))
    field = layer_field(a, b, reference=(4.0, 8000.0))
    for z_mm in (1000.0, 3000.0):
        label = 4.0 - 8000.0 / z_mm
        # float32 fields of order 10
        np.testing.assert_allclose(field.offset_px + field.scale * label, a - b / z_mm, atol=3e-6)


def test_both_implementations_read_the_same_labels():
    rng = np.random.default_rng(8)
    volume = rng.uniform(0, 1, (11, 13, len(LAYERS_PX))).astype(np.float32)
    a, b = curved_field((11, 13))
    field = layer_field(2 * a - 4, b, reference=(4.0, 8000.0))
    slow = semiglobal.at_labels(volume, LAYERS_PX, with_halves(LAYERS_PX), field, factors=1.5)
    fast = semiglobal_kernels.at_labels(volume, LAYERS_PX, with_halves(LAYERS_PX), field, factors=1.5)
    np.testing.assert_allclose(fast, slow, atol=1e-4)  # float32 shares: 1e-7 of what a cubic may make small
    assert (slow == 0).any()  # beyond the volume there is no evidence
    same = semiglobal.at_labels(volume, LAYERS_PX, LAYERS_PX, even_field(11, 13))
    np.testing.assert_allclose(same, volume, atol=1e-6)


def test_a_flat_wall_behind_a_curved_field_is_found_flat():
    rng = np.random.default_rng(9)
    shape = (45, 60)
    a, b = curved_field(shape)
    truth = a - b / 2200.0
    config, inputs = inputs_of(np.zeros((*shape, 2)))
    volume = np.clip(
        0.3 * np.exp(-((inputs.layers_px - truth[..., None]) ** 2))
        + rng.normal(0, 0.25, (*shape, len(inputs.layers_px))),
        -1, 1,
    )  # fmt: skip
    errors = []
    for fields in (None, [layer_field(a, b, reference=(4.0, 8000.0))]):
        winner = match([inputs], config, OptimiserConfig(), score_volume=lambda *_: volume, fields=fields)
        errors.append(np.abs(winner.disparity_px - truth).mean())
    assert errors[1] < 0.05  # a tenth of a layer
    assert errors[0] > 2 * errors[1]

"""The error bar of quality "paper" against known errors, and the confidence made of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from chromaperture.matching.error_bar import confidence, effective_samples, peak_sigma, sigma_of_range
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.labels import Winner
from chromaperture.settings.methods import PaperConfig, preset
from chromaperture.settings.stages import BilateralConfig, CorrelationConfig
from worlds import LAYOUT, NARROW, capture, measured, texture


@pytest.mark.parametrize("decay", [0.3, 0.8, 0.9])
def test_effective_samples_is_what_averaging_white_noise_leaves(decay):
    weights = decay ** np.abs(np.arange(-400, 401.0))
    along_one_axis = weights.sum() ** 2 / (weights**2).sum()
    assert effective_samples(decay) == pytest.approx(along_one_axis**2, rel=1e-9)  # rounding


@pytest.mark.parametrize("debiasing", [True, False])
@pytest.mark.parametrize("design", sorted(LAYOUT))
def test_the_error_bar_is_as_long_as_the_error(rng, design, debiasing):
    """Texture to noise between 4 and 10, no aggregation, which the error bar does not count."""
    noise, truth = 0.015, -1.3
    config = replace(
        NARROW, bilateral=BilateralConfig(sigma_px=0.0), correlation=CorrelationConfig(noise_debiasing=debiasing)
    )
    scene = capture(texture(rng, 160, 200), design, truth)
    found, sigma = measured((scene + rng.normal(0, noise, scene.shape)).astype(np.float32), design, config, noise)
    score = (found - truth) / sigma
    # The formula is first order and the window's samples are few (N = 200 with correlated neighbours); the frame
    # itself holds about 60 independent windows, which determine a standard deviation to 10 %.
    assert 0.7 < np.nanstd(score) < 1.4


def test_less_light_gives_a_longer_error_bar(rng):
    scene = capture(texture(rng), "cy_halves", 0.8)
    sigmas = []
    for noise in (0.005, 0.02, 0.05):
        image = (scene + rng.normal(0, noise, scene.shape)).astype(np.float32)
        sigmas.append(np.nanmedian(measured(image, "cy_halves", NARROW, noise)[1]))
    assert sigmas[0] < sigmas[1] / 2 < sigmas[2] / 4


@pytest.mark.parametrize("view_count", [2, 3])
def test_what_is_unknown_has_no_error_bar_and_no_confidence(view_count):
    peak, curvature = np.full((1, 2), 0.9, np.float32), np.ones((1, 2), np.float32)
    winner = Winner(np.array([[0.5, np.nan]], np.float32), peak, curvature)
    sigma = peak_sigma(winner, PaperConfig(), view_count, np.ones((1, 2), np.float32))
    assert np.isfinite(sigma[0, 0])
    assert np.isnan(sigma[0, 1])
    trust = confidence(sigma, winner.peak)
    assert 0 < trust[0, 0] <= 1
    assert trust[0, 1] == 0


def test_a_flat_or_negative_peak_gives_a_long_but_finite_error_bar():
    peak = np.array([[-0.5, 0.0, 1.0, 1.2]], np.float32)
    winner = Winner(np.zeros((1, 4), np.float32), peak, np.zeros((1, 4), np.float32))
    for view_count in (2, 3):
        sigma = peak_sigma(winner, PaperConfig(), view_count, np.full((1, 4), 1e-4, np.float32))
        assert np.isfinite(sigma).all()
        assert (sigma > 1).all()


NOISY_DESIGNS = ["cy_halves", "rgb_squares", "cmy_circles"]


def of_noise(quality, design, seed, *, blank=False):
    """What is found in noise of every channel, or in a blank wall whose noise is known, and the settings."""
    rng, shape = np.random.default_rng(seed), (120, 160, 3)
    image, variance = rng.uniform(0.1, 0.9, shape), None
    if blank:
        image, variance = 0.5 + rng.normal(0, 0.01, shape), np.full(shape, 0.01**2, np.float32)
    config = preset(quality).with_range(-4.0, 4.0)
    return estimate_disparity(image.astype(np.float32), aperture=design, config=config, noise_variance=variance), config


@pytest.mark.parametrize(("quality", "most_known"), [("paper", 0.72), ("real-time", 0.1), ("accurate", 0.01)])
def test_what_is_known_no_better_than_the_range_is_unknown(quality, most_known):
    # No disparity is right. Known fractions found: .70, .08, 0; without the rule .75, .9, .91. The local peaks of
    # `paper` have no posterior over the range.
    found, config = of_noise(quality, "cy_halves", 5)
    known = np.isfinite(found.value_px)
    np.testing.assert_array_equal(known, np.isfinite(found.sigma_px))
    assert known.mean() < most_known
    floor = getattr(config, "floor_px", 0.0)  # added in quadrature afterwards
    limit = np.hypot(sigma_of_range(config.layers.values_px), floor) * (1 + 1e-6)  # float32
    if quality == "accurate":
        # A small plane may be known by chance. The error of an answer at an end of the range, with the truth anywhere
        # in it, has a root mean square of range / sqrt(3): twice the limit.
        limit *= 2
    assert (found.sigma_px[known] <= limit).all()
    assert not found.confidence[~known].any()


@pytest.mark.parametrize("design", NOISY_DESIGNS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_pure_noise_leaves_known_has_wide_error_bars(design, seed):
    found, _ = of_noise("real-time", design, seed)
    known = np.isfinite(found.value_px)
    truth = np.random.default_rng(seed + 10).uniform(-4.0, 4.0, known.shape)  # of nothing in the picture
    # Found: .90 to 1. At the ends of the range the error exceeds two sigmas of the range for a sixth of all truths.
    if known.any():
        assert (np.abs(found.value_px - truth) <= 2 * found.sigma_px)[known].mean() > 5 / 6
    assert known.mean() < 0.2  # 0 to .11


@pytest.mark.parametrize("design", NOISY_DESIGNS)
@pytest.mark.parametrize("blank", [True, False], ids=["blank wall", "noise"])
@pytest.mark.parametrize("seed", [0, 1])
def test_noise_alone_is_unknown_to_accurate_or_as_wide_as_the_range(design, blank, seed):
    found, config = of_noise("accurate", design, seed, blank=blank)
    known = np.isfinite(found.value_px)
    # Three views of noise agree somewhere by chance, so that the posterior is a little narrower than the range: bars of
    # .85 of the range's standard deviation hold half of the truths that lie anywhere in it (.88 is found, .92 and more
    # in the median).
    assert (found.sigma_px[known] >= 0.85 * sigma_of_range(config.layers.values_px)).all()

from __future__ import annotations

import numpy as np
import pytest

from chromaperture.color.noise import estimate_noise_variance, fit_photon_noise, noise_samples, photon_noise_variance


def test_photon_noise_is_that_of_counted_electrons(rng):
    full_well, read = 8000.0, 12.0
    level = np.array([0.02, 0.3, 0.9])
    electrons = rng.poisson(level * full_well, (600, 600, 3)) + rng.normal(0, read, (600, 600, 3))
    image = (electrons / full_well).astype(np.float32)
    predicted = photon_noise_variance(image, full_well_electrons=full_well, read_noise_electrons=read)
    assert predicted.shape == image.shape
    assert predicted.dtype == np.float32
    # 360 000 draws know a variance to 0.24 %
    np.testing.assert_allclose(predicted.mean(axis=(0, 1)), image.var(axis=(0, 1)), rtol=0.01)


def test_photon_noise_does_not_follow_the_noise_of_the_single_pixel(rng):
    image = np.full((64, 64, 3), 0.2, np.float32)
    image[32, 32] = 0.9  # a hot pixel is no 4.5 times brighter scene
    variance = photon_noise_variance(image, full_well_electrons=8000, read_noise_electrons=0)
    assert variance[32, 32, 0] < 1.2 * variance[0, 0, 0]  # 1.14 is found; of its own brightness it would be 4.5


def test_negative_values_after_the_black_level_do_not_give_negative_variance():
    variance = photon_noise_variance(
        np.full((16, 16, 3), -0.01, np.float32), full_well_electrons=8000, read_noise_electrons=8
    )
    np.testing.assert_allclose(variance, (8 / 8000) ** 2, rtol=1e-6)  # float32


@pytest.mark.parametrize("sigma", [0.001, 0.01, 0.05])
def test_noise_is_found_on_a_slope(rng, sigma):
    """Immerkaer's kernel does not see planes, so shading is not taken for noise."""
    y, x = np.mgrid[0:300, 0:400]
    sigmas = sigma * np.array([1.0, 0.5, 2.0])
    image = (0.2 + 0.001 * x + 0.0005 * y)[..., None] + rng.normal(0, sigmas, (300, 400, 3))
    found = estimate_noise_variance(image)
    # the median of 120 000 correlated samples: about 0.5 %
    np.testing.assert_allclose(np.sqrt(found[0, 0]), sigmas, rtol=0.02)
    assert found.shape == image.shape


def test_edges_of_a_few_objects_are_not_noise(rng):
    image = rng.normal(0.3, 0.01, (300, 400, 3))
    image[50:120, 60:200] += 0.4
    image[::30, :] += 0.3
    # 7 % of the rows respond to the lines; the median moves by about twice that share
    np.testing.assert_allclose(np.sqrt(estimate_noise_variance(image)[0, 0]), 0.01, rtol=0.2)


def test_one_bad_pixel_does_not_spoil_the_frame(rng):
    image = rng.normal(0.3, 0.01, (200, 200, 3)).astype(np.float32)
    image[20, 30, 1] = np.nan
    image[90, 30, 2] = np.inf
    # Standard error of the median over the frame: 1 %.
    np.testing.assert_allclose(np.sqrt(estimate_noise_variance(image)[0, 0]), 0.01, rtol=0.03)


def test_a_frame_without_a_finite_pixel_has_no_noise_estimate():
    assert (estimate_noise_variance(np.full((16, 16, 3), np.nan)) == 0).all()


def counted(rng, level, full_well=6000.0, read=5.0):
    return ((rng.poisson(level * full_well) + rng.normal(0, read, level.shape)) / full_well).astype(np.float32)


def test_the_sensor_is_found_from_sheets_at_a_few_levels(rng):
    colours = ((0.05, 0.7, 0.8), (0.75, 0.7, 0.06), (0.9, 0.88, 0.85))
    shading = 1 - 0.3 * np.linspace(-1, 1, 320)[None, :, None] ** 2
    sheets = [counted(rng, np.broadcast_to(np.array(c) * shading, (240, 320, 3))) for c in colours]
    samples = [noise_samples(sheet) for sheet in sheets]
    full_well, read = fit_photon_noise(*(np.concatenate(part) for part in zip(*samples, strict=True)))
    # 630 blocks of 8.6 % know a slope to about 0.5 %; read noise is a seventh of the darkest blocks' variance
    assert full_well == pytest.approx(6000, rel=0.02)
    assert read == pytest.approx(5, rel=0.3)


def test_texture_in_most_blocks_does_not_hide_the_noise(rng):
    y, x = np.mgrid[0:640, 0:640] / 640
    level = np.clip(0.45 + 0.4 * np.sin(5 * x + [[[0]], [[1]], [[2]]] + 4 * y), 0.05, 0.95).transpose(1, 2, 0)
    textured = (x < 0.6)[..., None]
    level = level * (1 + 0.1 * textured * rng.uniform(-1, 1, level.shape))
    full_well, _ = fit_photon_noise(*noise_samples(counted(rng, level)))
    assert full_well == pytest.approx(6000, rel=0.05)  # fewer usable blocks than above


def test_without_noise_or_without_levels_nothing_is_claimed(rng):
    flat = np.full((320, 320, 3), 0.5)
    assert fit_photon_noise(*noise_samples(counted(rng, flat))) is None
    ramp = np.linspace(0.05, 0.9, 320)[None, :, None].repeat(320, 0).repeat(3, 2).astype(np.float32)
    assert fit_photon_noise(*noise_samples(ramp)) is None
    assert fit_photon_noise(*noise_samples(np.full((64, 64, 3), np.nan))) is None
    assert fit_photon_noise(*noise_samples(np.ones((64, 64, 3), np.float32))) is None

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from chromaperture.color.noise import (
    estimate_noise_variance,
    exposure_to_restore,
    fit_photon_noise,
    noise_ratio,
    noise_samples,
    photon_noise_of_sheets,
    photon_noise_variance,
    snr_db,
)
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear
from chromaperture.system.errors import InputError


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


SHADING = 1 - 0.3 * np.linspace(-1, 1, 640)[None, :, None] ** 2
SHEETS = ((0.05, 0.7, 0.8), (0.75, 0.7, 0.06), (0.9, 0.88, 0.85), (0.4, 0.35, 0.4))


def sheets(rng):
    return [counted(rng, np.broadcast_to(np.array(c) * SHADING, (480, 640, 3))) for c in SHEETS]


def as_jpeg(image, quality=95):
    """Through a JPEG file without chroma subsampling, and back to linear light."""
    file = io.BytesIO()
    levels = np.rint(255 * linear_to_srgb(np.clip(image, 0, 1).astype(np.float32))).astype(np.uint8)
    Image.fromarray(levels).save(file, "JPEG", quality=quality, subsampling=0)
    return srgb_to_linear((np.asarray(Image.open(file)) / 255).astype(np.float32))


def as_mosaic(image):
    """Of every pixel one colour, the others interpolated bilinearly."""
    known = np.zeros(image.shape, np.float32)
    known[::2, ::2, 0] = known[1::2, 1::2, 2] = known[::2, 1::2, 1] = known[1::2, ::2, 1] = 1
    cross = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32)
    return cv2.filter2D(known * image, -1, cross) / cv2.filter2D(known, -1, cross)


def test_linear_sheets_are_looked_at_pixel_by_pixel(rng):
    """There the noise is known best."""
    linear = sheets(rng)
    samples = [noise_samples(sheet) for sheet in linear]
    assert photon_noise_of_sheets(linear) == fit_photon_noise(*map(np.concatenate, zip(*samples, strict=True)))
    assert photon_noise_of_sheets([]) is None


@pytest.mark.parametrize(("developed", "least", "most"), [(as_jpeg, 0.8, 1.4), (as_mosaic, 0.8, 3)])
def test_sheets_of_developed_files_show_the_noise_in_coarser_detail(rng, developed, least, most):
    """Means of red and blue have four times the noise in a mosaic, those of green twice; the line is the lower edge."""
    files = [developed(sheet) for sheet in sheets(rng)]
    samples = [noise_samples(sheet) for sheet in files]
    finest, _ = fit_photon_noise(*map(np.concatenate, zip(*samples, strict=True)))
    assert finest > 4 * 6000  # what was taken for the sensor's: a quarter of the noise or less
    full_well, read = photon_noise_of_sheets(files)
    variance = 0.5 / full_well + (read / full_well) ** 2
    assert least < variance / (0.5 / 6000 + (5 / 6000) ** 2) < most


@pytest.fixture(scope="module")
def texture():
    """Grey detail as sharp as pixels on the left, blurred and of other colours on the right."""
    rng = np.random.default_rng(5)
    fine = rng.uniform(0.2, 0.6, (480, 640, 1)).repeat(3, axis=2)
    soft = cv2.GaussianBlur(rng.uniform(0, 1, (480, 640, 3)), (0, 0), 3)
    soft = 0.4 + (soft - soft.mean()) * 2
    return np.where(np.arange(640)[:, None] < 400, fine, soft).astype(np.float32)


@pytest.mark.parametrize("times", [1, 2, 4, 16])
def test_the_noise_of_a_photograph_is_told_from_its_texture(rng, texture, times):
    expected = photon_noise_variance(texture, full_well_electrons=6000, read_noise_electrons=5)
    noisy = texture + np.sqrt(times * expected) * rng.standard_normal(texture.shape).astype(np.float32)
    # Percentiles of 1200 blocks of 256 samples scatter by 2 %; the softest texture adds up to a tenth.
    assert noise_ratio(noisy, expected) == pytest.approx(times, rel=0.12)
    assert noise_ratio(noisy, 100 * expected) == 1  # less noise than expected is none of its business


@pytest.mark.parametrize("developed", [as_jpeg, as_mosaic])
def test_developed_photographs_show_their_noise_too(rng, developed):
    level = np.broadcast_to(0.5 * SHADING, (480, 640, 3))
    full_well, read = photon_noise_of_sheets([developed(sheet) for sheet in sheets(rng)])
    noisy = developed(counted(rng, level, full_well=6000 / 4))
    expected = photon_noise_variance(noisy, full_well_electrons=full_well, read_noise_electrons=read)
    assert 2 < noise_ratio(noisy, expected) < 7  # of an ISO four times as high; the least of channels that differ
    usual = developed(counted(rng, level))
    assert noise_ratio(usual, expected) == 1


@settings(max_examples=40, deadline=None)
@given(shape=st.tuples(st.integers(1, 70), st.integers(1, 70)), value=st.sampled_from([np.nan, np.inf, 0.0, 1.0, 0.4]))
def test_pictures_without_noise_or_pixels_have_no_ratio(shape, value):
    image = np.full((*shape, 3), value, np.float32)
    assert noise_ratio(image, np.full(image.shape, 1e-4, np.float32)) == 1
    assert noise_ratio(image, np.zeros(image.shape, np.float32)) == 1
    assert photon_noise_of_sheets([image]) is None


# ---- noise and exposure of white sheets

FULL_WELL = 20000.0


def white(rng, light, read=0.0):
    electrons = rng.poisson(FULL_WELL * light, (240, 360, 3)) + read * rng.normal(size=(240, 360, 3))
    return (electrons / FULL_WELL).astype(np.float32)


@pytest.mark.parametrize("frames", [1, 2])
def test_photon_noise_gives_the_root_of_the_electrons(rng, frames):
    light = 0.6
    pictures = [white(rng, light) for _ in range(frames)]
    # SNR of N electrons is sqrt(N); 1 % of sigma from 30 000 px is 0.1 dB
    for found in snr_db(*pictures):
        np.testing.assert_allclose(found, 10 * np.log10(FULL_WELL * light), atol=0.15)


def test_border_and_middle_are_told_apart(rng):
    light = np.full((240, 360, 1), 0.2)
    light[40:200, 60:300] = 0.8
    central, border = snr_db(white(rng, light), white(rng, light))
    # The standard error of sigma over 40 000 px is 0.4 %, 0.03 dB.
    np.testing.assert_allclose(central, 10 * np.log10(FULL_WELL * 0.8), atol=0.15)
    np.testing.assert_allclose(border, 10 * np.log10(FULL_WELL * 0.2), atol=0.15)  # as above


def test_a_textured_sheet_spoils_one_frame_not_two(rng):
    paper = 0.6 * (1 + 0.02 * rng.normal(size=(240, 360, 1)))
    pair = white(rng, paper), white(rng, paper)
    two, _ = snr_db(*pair)
    one, _ = snr_db(pair[0])
    np.testing.assert_allclose(two, 10 * np.log10(FULL_WELL * 0.6), atol=0.15)  # as above
    assert np.all(one < two - 5)


@pytest.mark.parametrize(
    ("transmission", "read"), [(0.86, 0.0), (0.55, 0.0), (0.055, 0.0), (0.055, 30.0), (0.55, 60.0)]
)
def test_the_expected_loss_is_the_measured_one(rng, transmission, read):
    bare, coded = (snr_db(white(rng, light, read), white(rng, light, read))[0] for light in (0.8, 0.8 * transmission))
    ratio = read**2 / (0.8 * FULL_WELL)  # variance of the read noise over that of the shot noise at full light
    expected = 20 * np.log10(np.sqrt((transmission + ratio) / (1 + ratio)) / transmission)
    np.testing.assert_allclose(bare - coded, expected, atol=0.2)  # two such figures


def test_a_longer_exposure_restores_the_ratio(rng):
    bare = snr_db(white(rng, 0.4), white(rng, 0.4))[0].mean()
    coded = snr_db(white(rng, 0.22), white(rng, 0.22))[0].mean()
    longer = 0.22 * exposure_to_restore(float(bare - coded)).shot
    again = snr_db(white(rng, longer), white(rng, longer))[0].mean()
    assert again == pytest.approx(bare, abs=0.15)  # dB, of such figures as above; 0.02 is found
    # The paper's 2.3 dB: both readings
    both = exposure_to_restore(2.3)
    assert both.shot == pytest.approx(both.amplitude**2)  # rounding
    assert both.amplitude == pytest.approx(1.30, abs=0.005)  # 10^(2.3 / 20) = 1.303; the paper has three digits


def test_what_cannot_be_compared_says_so(rng):
    with pytest.raises(InputError, match="size"):
        snr_db(white(rng, 0.5), white(rng, 0.5)[1:])
    with pytest.raises(InputError, match="brightness"):
        snr_db(white(rng, 0.5), white(rng, 0.6))

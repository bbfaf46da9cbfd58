"""Point-spread functions: centroids and moments in closed form, orientation, and wave against ray optics."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from chromaperture.optics.aperture import DESIGNS, centroids, made_of
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.psf import defocus_um, diffraction_psf, geometric_otf, geometric_psf
from chromaperture.system.errors import InputError

PHONE = PupilCamera(64, 64, 4.0 / 0.0014, 0.9, 400.0, 3.0, 0.0014)


def moments(psf, oversampling=1):
    """Centroid (x, y) of each channel, px."""
    x = (np.arange(psf.shape[-1]) - psf.shape[-1] // 2) / oversampling
    total = psf.sum(axis=(1, 2))
    return np.stack([(psf.sum(axis=1) * x).sum(axis=1), (psf.sum(axis=2) * x).sum(axis=1)], -1) / total[:, None]


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(["rgb_circles", "cy_halves", "cy_open", "cmy_circles"]), st.floats(-9, 9))
@example("rgb_circles", 0.125)
def test_centroid_is_radius_times_pupil_centroid(name, radius):
    psf = geometric_psf(DESIGNS[name], radius, 21, oversampling=9)
    np.testing.assert_allclose(psf.sum(axis=(1, 2)), 1, atol=1e-9)  # rounding
    # Light is counted in the middle of ninths of a pixel, half of which is all that one of them can be off by; what
    # reaches over five of them averages that.
    atol = 0.01 if abs(radius) > 0.3 else 1 / 18
    np.testing.assert_allclose(moments(psf, 9), radius * centroids(DESIGNS[name]), atol=atol)  # derived above


def test_near_points_are_seen_through_the_aperture_turned_by_180_degrees():
    for name in ("rgb_circles", "cy_halves", "cmy_squares"):
        far, near = geometric_psf(DESIGNS[name], 5.0, 15), geometric_psf(DESIGNS[name], -5.0, 15)
        np.testing.assert_allclose(near, far[:, ::-1, ::-1], atol=1e-12)  # rounding of float64


def test_a_disc_has_the_transfer_function_of_a_disc():
    from scipy.special import j1

    radius, size = 4.0, 64
    otf = geometric_otf(DESIGNS["open"], radius, (size, size))[1]
    argument = 2 * np.pi * radius * np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None])
    argument[0, 0] = 1e-9
    np.testing.assert_allclose(otf, 2 * j1(argument) / argument, atol=2e-4)  # 128 cells across the disc


@pytest.mark.parametrize("name", ["cy_open", "rgb_circles"])  # the discs lie off the axis in x and in y
def test_transfer_function_and_kernel_are_one_blur(name):
    aperture = made_of(DESIGNS[name], "real")
    psf = geometric_psf(aperture, 3.3, 15, oversampling=9)
    padded = np.zeros((3, 288, 288))  # 32 px of 9 samples
    padded[:, :135, :135] = psf
    spectrum = np.fft.rfft2(np.roll(padded, (-67, -67), axis=(1, 2)))
    otf = geometric_otf(aperture, 3.3, (32, 32))
    # Samples of a ninth of a pixel: their own transfer function is 0.998 at the highest frequency compared.
    np.testing.assert_allclose(spectrum[:, :10, :10], otf[:, :10, :10], atol=3e-3)


def test_in_focus_nothing_is_blurred():
    np.testing.assert_allclose(geometric_otf(DESIGNS["cy_halves"], 0.0, (16, 16)), 1, atol=1e-6)  # complex64
    psf = geometric_psf(DESIGNS["cy_halves"], 0.0, 3)
    assert psf[:, 1, 1] == pytest.approx(1)  # rounding


@pytest.mark.parametrize("depth", [300.0, 1000.0])
def test_diffraction_leaves_the_centroid_where_it_is(depth):
    aperture = DESIGNS["cy_halves"]
    psf = diffraction_psf(aperture, PHONE, depth, size=81)
    # A finite square cuts the slow 1/x^2 tails of a straight edge: 1 to 2 % of the light, evenly.
    np.testing.assert_allclose(moments(psf) / PHONE.blur_radius_px(depth), centroids(aperture), atol=6e-3)
    assert (psf.sum(axis=(1, 2)) > 0.98).all()


def test_short_waves_are_rays():
    aperture, depth = DESIGNS["cy_halves"], 1000.0
    rays = geometric_psf(aperture, float(PHONE.blur_radius_px(depth)), 21)
    errors = [
        np.abs(diffraction_psf(aperture, PHONE, depth, size=21, wavelengths_um=(w,) * 3) - rays).sum()
        for w in (1.6, 0.4, 0.1)
    ]
    # A Fresnel edge blurs over sqrt(lambda): each step of 4 halves the error.
    assert errors[0] / errors[1] == pytest.approx(2, abs=0.8)
    assert errors[1] / errors[2] == pytest.approx(2, abs=0.8)


def test_in_focus_the_open_pupil_gives_the_airy_disc():
    """Light within the first dark ring, 1.22 lambda F / D, is 83.8 % by Rayleigh's closed form."""
    wave = 0.55
    camera = replace(PHONE, focal_px=4.0 / 0.0002, pixel_pitch_mm=0.0002)
    psf = diffraction_psf(DESIGNS["open"], camera, camera.focus_mm, size=61, wavelengths_um=(wave,) * 3)[1]
    ring_px = 1.22 * wave * 1e-3 * camera.f_number / camera.pixel_pitch_mm
    fine = (np.arange(610) + 0.5) / 10 - 30.5  # the circle's rim counts by area
    share = (np.hypot(fine[:, None], fine[None]) < ring_px).reshape(61, 10, 61, 10).mean(axis=(1, 3))
    # Airy: 83.8 %, three digits; the disc is sampled by pixels.
    assert (psf * share).sum() == pytest.approx(0.838, abs=3e-3)


def test_wavefront_defocus_and_blur_have_one_sign():
    assert defocus_um(PHONE, 300.0) < 0 < defocus_um(PHONE, 1000.0)
    # r mu = 2 F W20 / R
    back = 2 * PHONE.image_distance_mm * defocus_um(PHONE, 1000.0) * 1e-3 / PHONE.pupil_radius_mm
    assert back == pytest.approx(float(PHONE.blur_radius_px(1000.0)) * PHONE.pixel_pitch_mm)  # rounding


def test_what_cannot_be_asked():
    with pytest.raises(InputError, match="odd kernel"):
        geometric_psf(DESIGNS["open"], 9.0, 11)
    with pytest.raises(InputError, match="odd size"):
        diffraction_psf(DESIGNS["open"], PHONE, 500.0, size=10)
    big = PupilCamera(64, 64, 1600.0, 12.0, 2000.0, 50.0, 0.031)
    with pytest.raises(InputError, match="hundreds of waves"):
        diffraction_psf(DESIGNS["open"], big, 500.0, size=31, wavelengths_um=(0.1,) * 3)
    with pytest.raises(InputError, match="behind the entrance pupil"):
        PHONE.blur_radius_px(2.0)
    with pytest.raises(InputError, match="closer than a scale of 1:1"):
        PupilCamera(64, 64, 4.0 / 0.0014, 0.9, 6.0, 3.0, 0.0014)
    assert np.isnan(PHONE.blur_radius_px(np.array([math.nan]))).all()
    far = PupilCamera(64, 64, 4.0 / 0.0014, 0.9, math.inf, 3.0, 0.0014)
    assert float(far.blur_radius_px(math.inf)) == 0 > float(far.blur_radius_px(1000.0))

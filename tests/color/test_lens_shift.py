"""What a fitted blur tells alignment and restoration: kernels, displacements, pictures."""

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.lens_shift import LensShift, least_fringes
from chromaperture.depth.conversion import DepthModel
from chromaperture.effects.layered_model import LensTransfer, ThinLensBlur
from chromaperture.effects.restore import focus_radius, restore
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.lens_blur import BlurModel, ChannelRays, traced
from worlds import halves_camera, lens_blur, texture

W, H = 192, 128
THIN = BlurModel(10.0, 20000.0)  # in focus at 2 m from the pupil
REAL = replace(
    THIN, lateral_red_px=1.2, lateral_blue_px=-0.8, curvature_px=1.0, spherical_px=3.0, spherical5_px=-3.5,
    front_rim_radius=1.05, front_rim_shift=0.4,
)  # fmt: skip


def lens_shift(model, design="cy_halves"):
    return LensShift(lens_blur(model, W, H, design), near_mm=1000.0, far_mm=6000.0)


@pytest.mark.parametrize("radius", [-6.0, 0.0, 4.0])
@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares"])
def test_a_thin_lens_s_kernels_are_the_aperture_s_shadow(design, radius):
    by_rays = LensTransfer(lens_shift(THIN, design))(radius, (64, 80))
    by_mask = ThinLensBlur(DESIGNS[design])(radius, (64, 80))
    fy, fx = np.fft.fftfreq(64)[:, None], np.fft.rfftfreq(80)[None]
    shown = np.hypot(fy, fx) < 0.45  # at the pixels' own frequency a kernel must be cut off somehow
    # 1500 rays sample a filter's area, 100 of them its rim, to about two percent.
    np.testing.assert_allclose(by_rays[:, shown], by_mask[:, shown], atol=0.02)


def test_shifted_copies_are_found_exactly(rng):
    places = rng.uniform(-4, 4, (300, 2))
    light = np.full(300, 1 / 300)
    true = np.array([[1.2, -0.4], [0.0, 0.0], [-2.0, 0.7]])
    found = least_fringes([ChannelRays(places + t, light) for t in true])
    np.testing.assert_allclose(found - found[1], true, atol=1e-6)  # Gauss-Newton in complex64


@pytest.mark.slow
def test_no_other_displacement_leaves_less_of_a_fringe(rng):
    """Half discs are no copies of a disc: a search over displaced pictures must end at the same place."""
    shift = lens_shift(REAL)
    rays = traced(shift.blur, (150.0, 100.0), float(shift.inverse_mm(-5.0)))
    found = least_fringes(rays)
    spectrum = np.fft.rfft2(rng.normal(size=(256, 256)))
    fy, fx = np.fft.fftfreq(256)[:, None], np.fft.rfftfreq(256)[None]
    f = np.hypot(fy, fx)
    scene = np.where(f < 0.25, spectrum / np.maximum(f, 1 / 35), 0)

    def seen(k, shift_px):
        otf = np.zeros(f.shape, complex)
        for (px, py), light in zip(rays[k].points_px[::2], rays[k].weights[::2], strict=True):
            otf += light * np.exp(-2j * np.pi * (fx * (px - shift_px[0]) + fy * (py - shift_px[1])))
        return np.fft.irfft2(scene * otf / rays[k].weights[::2].sum())

    green = seen(1, found[1])
    best = min(
        (float(np.square(seen(0, found[0] + step) - green).sum()), step) for step in product((-0.4, 0.0, 0.4), repeat=2)
    )
    assert best[1] == (0.0, 0.0)


@pytest.mark.slow
def test_between_the_computed_places_it_is_interpolated():
    shift = lens_shift(REAL)
    radius = np.linspace(-8, 5, W * H, dtype=np.float32).reshape(H, W)
    moved = shift(radius)
    for x, y in ((0, 0), (31, 77), (100, 50), (160, 120)):
        direct = least_fringes(traced(shift.blur, (x, y), float(shift.inverse_mm(float(radius[y, x])))))
        # Linear between radii 2 px apart; the soft rims bend the rest. In px.
        np.testing.assert_allclose(moved[:, :, y, x], direct, atol=0.06)


def calibrated(model):
    """A camera whose blur is known, with the depth curve of its layers."""
    curve = DepthModel(*lens_blur(model, W, H).reference, 50.0)
    return halves_camera(curve, W, H, blur=model, near_mm=1050.0, far_mm=6050.0)


def captured(blur, wall, inverse_mm):
    """A wall through the lens: blocks of 16 px, each with the matcher's own kernels of its middle."""
    image = np.empty((H, W, 3), np.float32)
    wide = cv2.copyMakeBorder(wall, 32, 32, 32, 32, cv2.BORDER_REFLECT)
    for y, x in product(range(0, H, 16), range(0, W, 16)):
        tile = wide[y : y + 80, x : x + 80].transpose(2, 0, 1)
        otf = blur.transfer(x + 7.5, y + 7.5, inverse_mm, 80)
        seen = np.fft.irfft2(np.fft.rfft2(tile) * otf)
        image[y : y + 16, x : x + 16] = seen[:, 32:48, 32:48].transpose(1, 2, 0)
    return image


@pytest.mark.slow
def test_the_calibrated_blur_restores_what_a_thin_lens_cannot(rng):
    calibration = calibrated(REAL)
    grey = texture(rng, H, W, blur_px=1.5)
    wall = (0.5 * grey[..., None] * np.array([1.0, 0.8, 0.6])).astype(np.float32)
    radius = -4.0
    blur = calibration.field_blur()
    inverse_mm = (REAL.infinity_px - radius) / REAL.scale_px_mm
    image = captured(blur, wall, inverse_mm)
    image += (0.002 * rng.normal(size=image.shape)).astype(np.float32)
    camera = CodedApertureCamera(calibration, default_config(calibration, "accurate"))
    at_infinity, scale = blur.reference
    disparity = np.full((H, W), at_infinity - scale * inverse_mm, np.float32)
    inner = np.s_[16:-16, 16:-16]
    error = {}
    for sharpness in ("aligned", "fast", "full"):
        made = restore(image, disparity, camera, sharpness=sharpness)
        thin = restore(image, disparity, camera, sharpness=sharpness, blur=ThinLensBlur(calibration.aperture))
        np.testing.assert_allclose(made.radius_px, radius, atol=1e-3)  # float32 of tens of px
        error[sharpness] = [float(np.sqrt(np.mean((p.color - wall)[inner] ** 2))) for p in (made, thin)]
    # The blur takes most of the texture; knowing its shape brings back what the aperture's shadow alone cannot.
    assert error["full"][0] < 0.7 * error["aligned"][0]
    assert error["full"][0] < 0.8 * error["full"][1]
    assert error["fast"][0] < 0.8 * error["fast"][1]


def test_the_focus_surface_is_where_the_radius_vanishes():
    camera = CodedApertureCamera(calibrated(REAL), None)
    assert focus_radius(camera, 2050.0) == pytest.approx(0, abs=1e-6)  # rounding
    assert focus_radius(camera, 1050.0) == pytest.approx(-10.0)
    real_time = CodedApertureCamera(calibrated(THIN))
    accurate = CodedApertureCamera(calibrated(THIN), default_config(calibrated(THIN), "accurate"))
    d = np.full((H, W), -1.0, np.float32)
    # One curve for all qualities here: the matchers must agree on the radius.
    np.testing.assert_allclose(real_time.alignment.blur_radius_px(d), accurate.alignment.blur_radius_px(d), atol=1e-5)


def test_without_a_fitted_blur_nothing_is_known_of_the_lens():
    camera = CodedApertureCamera(Calibration.uncalibrated("cy_halves", width_px=W, height_px=H))
    assert camera.alignment.lens_shift is None
    assert camera.alignment.blur_radius_px(np.zeros((H, W))) is None

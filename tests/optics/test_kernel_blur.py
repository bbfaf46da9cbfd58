"""Blur from measured kernels: paint the kernels of a known lens at one distance, and ask for its blur at others."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.fft
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.matching.estimate import estimate_disparity
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.kernel_blur import blur_from_kernels
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil, traced
from chromaperture.settings.methods import AccurateConfig
from chromaperture.system.errors import InputError
from worlds import kernel_places, painted_kernels

W, H = 240, 160
FOCUS_MM, MEASURED_MM = 1000.0, 4000.0
EDGE_PX = 8.0  # of the pupil's edge at MEASURED_MM
SCALE = EDGE_PX / (1 / FOCUS_MM - 1 / MEASURED_MM)
FINER = 4  # samples of a kernel a px: painting it blurs by a sixth of a sample squared
SIDE = 4 * 20 + 1  # samples
# Rims that cut three tenths of the pupil's light in the corners.
MODEL = BlurModel(SCALE / FOCUS_MM, SCALE, front_rim_radius=1.1, front_rim_shift=0.5, rear_rim_radius=1.1)
SIZE = {"width_px": W, "height_px": H}
DISTANCES = {"focus_mm": FOCUS_MM, "measured_mm": MEASURED_MM}
PLACES = kernel_places(W, H)
MEASURED = SIZE | DISTANCES | {"spacing_px": 1 / FINER}


def lens(model=MODEL, design="cy_halves"):
    return LensBlur(model, sample_pupil(DESIGNS[design]), W, H)


def painted(blur, distance_mm=MEASURED_MM):
    return painted_kernels(blur, distance_mm, side=SIDE, finer=FINER)


@pytest.mark.parametrize("distance_mm", [600.0, 1400.0, 8000.0])
@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares"])
def test_kernels_of_one_distance_tell_the_blur_of_others(distance_mm, design):
    blur = lens(design=design)
    found = blur_from_kernels(painted(blur), **MEASURED)
    for x, y in (PLACES[0][0], PLACES[2][3], PLACES[3][5]):
        # All channels move with the centroid of their light, which rims push aside.
        expected, got = (of.transfer(x, y, 1 / distance_mm, 64) for of in (blur, found))
        apart = [channels * channels[1:2].conj() for channels in (expected, got)]
        np.testing.assert_allclose(*apart, atol=0.02)  # samples of a quarter px, stretched by 2.2 at 600 mm: .015 there


def test_a_half_disc_has_its_edge_and_its_centroids():
    kernels = painted(lens(BlurModel(SCALE / FOCUS_MM, SCALE)))
    found = blur_from_kernels(kernels, **MEASURED)
    assert found.edge_px == pytest.approx(EDGE_PX, rel=0.01)
    assert found.reach == pytest.approx(4 / (3 * np.pi), rel=0.01)
    assert found.reference[0] / found.reference[1] == pytest.approx(1 / FOCUS_MM, rel=1e-9)
    assert found.pairs == ((0, 2),)


def test_kernels_nearer_than_the_focus_are_turned():
    blur = lens(BlurModel(SCALE / FOCUS_MM, SCALE))
    near_mm = 1 / (2 / FOCUS_MM - 1 / MEASURED_MM)  # as much blur as at MEASURED_MM, on the other side
    near = blur_from_kernels(painted(blur, distance_mm=near_mm), **(MEASURED | {"measured_mm": near_mm}))
    far = blur_from_kernels(painted(blur), **MEASURED)
    assert near.edge_px == pytest.approx(-far.edge_px, rel=1e-3)
    expected, got = (of.transfer(100.0, 70.0, 1 / 2500, 64) for of in (far, near))
    np.testing.assert_allclose(got, expected, atol=1e-3)


def test_light_between_the_middles_of_cells_is_interpolated():
    found = blur_from_kernels(painted(lens()), **MEASURED)
    (x, y), (beyond, _) = PLACES[1][2:4]
    here, there, between, corner = (
        found.light_at(found.frame_position(*place)) for place in ((x, y), (beyond, y), ((x + beyond) / 2, y), (0, 0))
    )
    np.testing.assert_allclose(between, (here + there) / 2, atol=1e-12)
    np.testing.assert_allclose(here, found.light[1, 2], atol=1e-12)
    np.testing.assert_allclose(corner, found.light[0, 0], atol=1e-12)


def test_kernels_that_lie_off_their_middle_are_moved():
    kernels = painted(lens())
    moved = np.roll(kernels, (3, -2), axis=(-2, -1))
    one, other = (blur_from_kernels(part, **MEASURED) for part in (kernels, moved))
    for x, y in ((20.0, 30.0), (200.0, 140.0)):
        np.testing.assert_allclose(*(of.transfer(x, y, 1 / 2000, 64) for of in (one, other)), atol=1e-6)


@given(st.floats(1e-6, 1e6), st.integers(1, 3), st.integers(1, 3))
def test_brightness_and_spacing_are_units(brightness, rows, columns):
    kernels = np.random.default_rng(rows).random((rows, columns, 3, 7, 7))
    one = blur_from_kernels(kernels, **SIZE, **DISTANCES)
    other = blur_from_kernels(kernels * brightness, **SIZE, **DISTANCES, spacing_px=0.5)
    assert other.edge_px == pytest.approx(one.edge_px / 2, rel=1e-9)
    np.testing.assert_allclose(other.pupil.points, one.pupil.points, atol=1e-9)
    np.testing.assert_allclose(other.light, one.light, rtol=1e-9)


@pytest.mark.parametrize("kind", ["kernels", "half pixels"])
def test_kernels_of_the_restoration_are_as_far_apart_as_the_views_of_a_place(kind):
    if kind == "kernels":
        blur = blur_from_kernels(painted(lens()), **MEASURED)
    else:
        blur = lens(replace(MODEL, contrast_fall=1.5))  # ramps a third as steep at the sides
        leaking = blur.pupil._replace(light=0.5 + 0.4 * (blur.pupil.light - 0.5))  # no ramp falls below 0
        blur = replace(blur, pupil=leaking)
    apart = []
    for x, y in ((120.0, 80.0), (10.0, 140.0)):
        rays = traced(blur, (x, y), 1 / 600)
        centres = [channel.weights @ channel.points_px for channel in rays]
        at_infinity, scale = blur.half_disparity(x, y)
        apart.append(float((centres[0] - centres[2]) @ blur.axis / 2))
        assert apart[-1] == pytest.approx(at_infinity - scale / 600, rel=0.01)  # rays of a thousandth are left out
    assert abs(apart[1] / apart[0] - 1) > 0.05  # the frame's corner differs from its middle


@pytest.mark.parametrize("distance_mm", [700.0, 2500.0])
def test_a_wall_is_found_where_it_is(distance_mm):
    blur = lens(BlurModel(SCALE / FOCUS_MM, SCALE))  # no rims: one transfer function for the whole picture
    rng = np.random.default_rng(4)
    texture = scipy.fft.fft2(rng.normal(size=(H, W)))
    whole = scipy.fft.fft2(_kernel_picture(blur, distance_mm), axes=(1, 2))
    picture = 0.5 + 0.1 * scipy.fft.ifft2(texture * whole, axes=(1, 2)).real.transpose(1, 2, 0)
    picture += rng.normal(0, 0.002, picture.shape)
    found_blur = blur_from_kernels(painted(blur), **MEASURED)
    at_infinity, scale = found_blur.reference
    expected = at_infinity - scale / distance_mm
    config = AccurateConfig.for_blur(found_blur.reach, one_pair=True).with_range(-4.0, 4.0)
    found = estimate_disparity(picture.astype(np.float32), aperture="cy_halves", config=config, blur=found_blur)
    assert np.nanmedian(found.value_px) == pytest.approx(expected, abs=0.05)  # a third of a label, here .13 px
    assert np.mean(np.abs(found.value_px - expected) < 0.2) > 0.95


def _kernel_picture(blur, distance_mm):
    small = scipy.fft.irfft2(blur.transfer(W / 2, H / 2, 1 / distance_mm, 64), s=(64, 64))
    out = np.zeros((3, H, W))
    out[:, :64, :64] = scipy.fft.fftshift(small, axes=(1, 2))
    return np.roll(out, (-32, -32), axis=(1, 2))


GOOD = np.ones((2, 2, 3, 5, 5))


@pytest.mark.parametrize(
    ("kernels", "changes", "message"),
    [
        (GOOD[0], {}, "shape"),
        (GOOD[..., :4], {}, "shape"),
        (GOOD[:, :0], {}, "shape"),
        (np.where(np.arange(5) == 2, np.nan, GOOD), {}, "finite"),
        (GOOD * np.array([1, 0, 1])[:, None, None], {}, "light"),
        (-GOOD, {}, "light"),
        (GOOD, {"measured_mm": FOCUS_MM}, "differ"),
        (GOOD, {"focus_mm": 0.0}, "positive"),
        (GOOD, {"focus_mm": float("nan")}, "positive"),
        (GOOD, {"spacing_px": 0.0}, "positive"),
        (GOOD, {"width_px": 0}, "positive"),
    ],
)
def test_bad_kernels_are_refused_in_one_line(kernels, changes, message):
    with pytest.raises(InputError, match=message) as error:
        blur_from_kernels(kernels, **(SIZE | DISTANCES | changes))
    assert "\n" not in str(error.value)


def test_matching_with_the_blur_needs_one():
    config = AccurateConfig.for_blur(0.4).with_range(-2, 2)
    picture = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    with pytest.raises(InputError, match="measured kernels"):
        estimate_disparity(picture, aperture="cy_halves", config=config)

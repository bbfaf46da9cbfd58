"""The oracle of this file is geometry: rays traced through lenses, never the formula under test."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.depth.conversion import (
    DepthModel,
    PaperParameters,
    depth_to_disparity,
    disparity_to_depth,
    disparity_to_inverse_depth,
    model_to_paper,
    paper_to_model,
)
from chromaperture.system.errors import InputError

# A 50 mm f/1.8 lens on a 1920 px wide picture, complementary halves, focused at about 2 m.
FOCAL_MM, PITCH_MM = 51.62, 0.0116
PAPER = PaperParameters(in_focus_mm=1985.0, baseline_mm=11.79, sensor_to_pupil_mm=50.0, focal_length_mm=FOCAL_MM)
MODEL = paper_to_model(PAPER, pixel_pitch_mm=PITCH_MM)


def paper_depth(disparity_px, paper):
    """Eq. (9), or (10) where the parameters are maps, as the paper prints it."""
    b, f, delta = paper.baseline_mm, paper.focal_length_mm, paper.sensor_to_pupil_mm
    swing = 2 * PITCH_MM * disparity_px * (paper.in_focus_mm - delta - f)
    return (b * f * paper.in_focus_mm - swing * delta) / (b * f - swing)


class Element(NamedTuple):
    """A thin lens at a place on the axis, mm; light travels towards + (the test's z is not the package's)."""

    place_mm: float
    focal_mm: float


def refracted(height, slope, focal_mm):
    return height, slope - height / focal_mm


def travelled(height, slope, distance_mm):
    return height + slope * distance_mm, slope


def trace(height, slope, start_mm, elements, end_mm):
    """Trace a paraxial ray from ``start_mm`` through the elements to ``end_mm``; its height there."""
    place = start_mm
    for element in elements:
        height, slope = travelled(height, slope, element.place_mm - place)
        height, slope = refracted(height, slope, element.focal_mm)
        place = element.place_mm
    return travelled(height, slope, end_mm - place)[0]


def crossing(elements, start_mm):
    """Where two rays from the axial point at ``start_mm`` meet again behind the elements."""
    last = elements[-1].place_mm
    at_lens, later = (trace(0.0, 1e-3, start_mm, elements, last + extra) for extra in (0.0, 1.0))
    return last - at_lens / (later - at_lens)


def test_eq_7_is_where_two_rays_through_the_sub_apertures_come_from():
    lens = [Element(0.0, FOCAL_MM)]
    sensor_mm = crossing(lens, -2000.0)
    centroid_mm = 11.79 / 2
    for distance_mm in (700.0, 1500.0, 1999.0, 2001.0, 4000.0, 30000.0):
        axis_point = -distance_mm
        upper, lower = (trace(0.0, y / distance_mm, axis_point, lens, sensor_mm) for y in (centroid_mm, -centroid_mm))
        # The picture is upside down on the sensor, and the disparity is half of the two spots' distance.
        disparity_px = -(upper - lower) / 2 / PITCH_MM
        thin = paper_to_model(PaperParameters(2000.0, 11.79, 0.0, FOCAL_MM), pixel_pitch_mm=PITCH_MM)
        found = 1 / disparity_to_inverse_depth(disparity_px, thin)
        # 1e-9: (f - F) cancels four digits of 1e-16 in the trace, and z / |z - z_of| three more
        assert found == pytest.approx(distance_mm, rel=1e-9)
        assert np.sign(disparity_px) == np.sign(distance_mm - 2000.0)


def test_any_lens_is_exactly_linear_in_inverse_depth_from_its_entrance_pupil():
    """A lens with its stop far from the principal planes: pupils and principal planes fall apart."""
    front, back = Element(0.0, 80.0), Element(30.0, 120.0)
    stop_mm = 22.0
    # Entrance pupil: where the stop seems to be through the front element. A ray through the stop's centre,
    # traced backwards out of the front element and continued straight, meets the axis there.
    height, slope = travelled(0.0, 1e-3, -(stop_mm - front.place_mm))
    _, slope = height, slope + height / front.focal_mm  # refraction, backwards
    pupil_mm = front.place_mm - height / slope
    assert trace(0.0, 1.0, pupil_mm, [front], stop_mm) == pytest.approx(0.0, abs=1e-12)  # they are conjugate

    focus_mm = pupil_mm - 1500.0
    sensor_mm = crossing([front, back], focus_mm)
    centroid_mm = 4.0  # of one channel, in the entrance pupil
    # Pinhole camera in the entrance pupil: slope of the chief ray in, height on the sensor out.
    image_mm = trace(0.0, 1.0, pupil_mm, [front, back], sensor_mm)
    scale = 2 * centroid_mm * image_mm / (2 * PITCH_MM)
    model = DepthModel(scale / 1500.0, scale, sensor_mm - pupil_mm)

    distances_mm = np.array([300.0, 800.0, 1499.0, 1501.0, 2500.0, 20000.0])
    disparity_px = [
        -trace(0.0, centroid_mm / z, pupil_mm - z, [front, back], sensor_mm) / PITCH_MM for z in distances_mm
    ]
    depth_mm = 1 / disparity_to_inverse_depth(np.array(disparity_px), model) + model.sensor_to_pupil_mm
    # 1e-8: next to infinity A - d has lost one to two digits, the trace about four
    np.testing.assert_allclose(depth_mm, distances_mm + (sensor_mm - pupil_mm), rtol=1e-8)
    # and the example is not a thin lens in disguise: pupil and front principal plane are far apart
    power = 1 / front.focal_mm + 1 / back.focal_mm - 30.0 / (front.focal_mm * back.focal_mm)
    principal_mm = 30.0 / (back.focal_mm * power)
    assert abs(pupil_mm - principal_mm) > 5


@pytest.mark.parametrize("disparity_px", [-15.0, -3.2, -0.01, 0.0, 0.01, 2.0, 7.1, 13.0])
def test_eqs_7_to_9_and_the_linear_form_are_one_curve(disparity_px):
    z = 1 / disparity_to_inverse_depth(disparity_px, MODEL)
    thin = 11.79 * FOCAL_MM * 1935.0 / (11.79 * FOCAL_MM - 2 * PITCH_MM * disparity_px * (1935.0 - FOCAL_MM))  # Eq. (7)
    # 1e-9: near infinity b f - swing and A - d have lost two digits each
    assert z == pytest.approx(thin, rel=1e-9)  # Eq. (7) from the pupil is Eq. (8)
    assert z + 50.0 == pytest.approx(paper_depth(disparity_px, PAPER), rel=1e-9)


def test_eq_10_is_the_linear_form_in_every_pixel(rng):
    in_focus = 1985.0 + rng.normal(0, 20, (5, 7))
    baseline = 11.79 + rng.normal(0, 0.2, (5, 7))
    disparity = rng.uniform(-10, 10, (5, 7))
    maps = PaperParameters(in_focus, baseline, 50.0, FOCAL_MM)
    model = paper_to_model(maps, pixel_pitch_mm=PITCH_MM)
    found = 1 / disparity_to_inverse_depth(disparity, model) + 50.0
    np.testing.assert_allclose(found, paper_depth(disparity, maps), rtol=1e-9)  # as above


def test_zero_disparity_is_the_focus_surface():
    depth_mm, _ = disparity_to_depth(np.zeros((2, 3)), MODEL)
    np.testing.assert_allclose(depth_mm, 1985.0, rtol=1e-7)  # float32
    assert MODEL.in_focus_mm == pytest.approx(1985.0, rel=1e-12)


def test_depth_is_unknown_beyond_the_disparity_of_infinity():
    at_infinity = float(MODEL.infinity_disparity_px)
    # an object 10 times farther is 10 times closer to the disparity of infinity
    near, far = (1 / disparity_to_inverse_depth(at_infinity - gap, MODEL) for gap in (1e-3, 1e-4))
    assert far == pytest.approx(10 * near, rel=1e-9)  # rounding of 1e-16 over the gap of 1e-4
    assert depth_to_disparity(np.inf, MODEL) == at_infinity
    disparity = np.array([[at_infinity, np.nextafter(at_infinity, 99), at_infinity + 3.0, np.nan]])
    depth_mm, sigma_mm = disparity_to_depth(disparity, MODEL, np.full((1, 4), 0.1))
    assert np.isnan(depth_mm).all()
    assert np.isnan(sigma_mm).all()


def test_depth_beyond_the_limit_is_unknown():
    disparity = depth_to_disparity(np.array([9_990.0, 10_010.0]), MODEL)
    depth_mm, _ = disparity_to_depth(disparity, MODEL, max_depth_mm=10_000.0)
    assert np.isfinite(depth_mm[0])
    assert np.isnan(depth_mm[1])
    with pytest.raises(InputError, match="max_depth_mm"):
        disparity_to_depth(disparity, MODEL, max_depth_mm=40.0)
    with pytest.raises(InputError, match="max_depth_mm"):
        disparity_to_depth(disparity, MODEL, max_depth_mm=np.inf)


def test_objects_at_and_behind_the_pupil_have_no_disparity():
    assert np.isnan(depth_to_disparity(np.array([50.0, 20.0, -5.0]), MODEL)).all()


# Gaps to the disparity of infinity over nine decades: hypothesis alone would rarely look next to the pole.
@given(gap_exponent=st.floats(-6, 3), a=st.floats(-20, 20), b=st.floats(1e2, 1e6), delta=st.floats(-20, 200))
def test_disparity_to_depth_and_back(gap_exponent, a, b, delta):
    model = DepthModel(a, b, delta)
    z = b / 10**gap_exponent
    disparity = depth_to_disparity(z + delta, model)
    # z + delta is rounded at 1e-16 of itself, d at 1e-16 of |A| + gap: the pole magnifies the latter
    tolerance = 1e-14 * (1 + (abs(a) + 10**gap_exponent) / 10**gap_exponent + (z + abs(delta)) / z)
    assert 1 / disparity_to_inverse_depth(disparity, model) == pytest.approx(z, rel=tolerance)  # derived above


@given(in_focus=st.floats(200, 1e5), baseline=st.floats(0.05, 60), delta=st.floats(-20, 100))
def test_paper_parameters_to_model_and_back(in_focus, baseline, delta):
    there = paper_to_model(PaperParameters(in_focus, baseline, delta, FOCAL_MM), pixel_pitch_mm=PITCH_MM)
    image_mm = 2 * PITCH_MM * there.scale_px_mm / baseline
    assert 1 / image_mm + 1 / (in_focus - delta) == pytest.approx(1 / FOCAL_MM, rel=1e-12)  # Eq. (2)
    back = model_to_paper(there, image_distance_mm=image_mm, pixel_pitch_mm=PITCH_MM)
    assert back.in_focus_mm == pytest.approx(in_focus, rel=1e-12)  # rounding
    assert back.baseline_mm == pytest.approx(baseline, rel=1e-12)
    assert back.focal_length_mm == pytest.approx(FOCAL_MM, rel=1e-12)
    assert back.sensor_to_pupil_mm == delta


def test_a_lens_focused_at_infinity_sees_everything_in_front_of_focus():
    model = paper_to_model(PaperParameters(np.inf, 11.79, 50.0, FOCAL_MM), pixel_pitch_mm=PITCH_MM)
    assert model.infinity_disparity_px == 0
    # A point at distance z blurs over b f / z between the centroids when the sensor is in the focal plane.
    far_image = [trace(0.0, y / 3000.0, -3000.0, [Element(0.0, FOCAL_MM)], FOCAL_MM) for y in (-5.895, 5.895)]
    half_px = (far_image[0] - far_image[1]) / 2 / PITCH_MM
    assert depth_to_disparity(3050.0, model) == pytest.approx(half_px, rel=1e-9)  # rounding
    assert half_px < 0
    back = model_to_paper(model, image_distance_mm=FOCAL_MM, pixel_pitch_mm=PITCH_MM)
    assert back.in_focus_mm == np.inf
    assert back.focal_length_mm == pytest.approx(FOCAL_MM, rel=1e-12)  # rounding


@pytest.mark.parametrize("disparity_px", [-12.0, 0.0, 6.0])
def test_sigma_matches_random_draws_of_disparity_and_model(rng, disparity_px):
    # Correlations of a real fit: A and B rise together, delta against them.
    sigmas = np.array([0.027, 0.004 * MODEL.scale_px_mm, 3.5])
    correlation = np.array([[1, 0.9, -0.8], [0.9, 1, -0.95], [-0.8, -0.95, 1]])
    covariance = correlation * np.outer(sigmas, sigmas)
    model = DepthModel(MODEL.infinity_disparity_px, MODEL.scale_px_mm, 50.0, covariance)
    _, sigma_mm = disparity_to_depth(disparity_px, model, 0.02)

    mean = [model.infinity_disparity_px, model.scale_px_mm, 50.0]
    a, b, delta = rng.multivariate_normal(mean, covariance, 400_000).T
    disparity = disparity_px + rng.normal(0, 0.02, 400_000)
    depth_mm = 1 / disparity_to_inverse_depth(disparity, DepthModel(a, b, delta)) + delta
    # 400 000 draws know a standard deviation to 0.11 %; second order adds (sigma_d / (A - d))^2 ~ 1e-5
    assert sigma_mm == pytest.approx(depth_mm.std(), rel=0.006)


def test_the_offset_of_the_pupil_alone_moves_every_depth_by_as_much():
    model = DepthModel(MODEL.infinity_disparity_px, MODEL.scale_px_mm, 50.0, np.diag([0, 0, 4.0]))
    _, sigma_mm = disparity_to_depth(np.array([-5.0, 0.0, 5.0]), model, 0.0)
    np.testing.assert_allclose(sigma_mm, 2.0, rtol=1e-6)  # float32


def test_per_pixel_covariance_is_each_pixels_own(rng):
    roots = rng.normal(0, 0.01, (4, 6, 3, 3))
    covariance = roots @ np.swapaxes(roots, -1, -2)
    disparity = rng.uniform(-5, 5, (4, 6))
    a, b = float(MODEL.infinity_disparity_px), float(MODEL.scale_px_mm)
    _, whole = disparity_to_depth(disparity, DepthModel(a, b, 50.0, covariance), np.full((4, 6), 0.02))
    for i, j in ((0, 0), (3, 5), (2, 1)):
        _, one = disparity_to_depth(disparity[i, j], DepthModel(a, b, 50.0, covariance[i, j]), 0.02)
        assert whole[i, j] == one


def test_results_are_float32_and_sigma_is_unknown_without_a_sigma_of_the_disparity():
    depth_mm, sigma_mm = disparity_to_depth(np.zeros((2, 3), np.float32), MODEL)
    assert depth_mm.dtype == sigma_mm.dtype == np.float32
    assert np.isnan(sigma_mm).all()


def test_what_cannot_be_a_model_is_refused():
    with pytest.raises(InputError, match="positive"):
        DepthModel(10.0, np.array([[2.0, -1.0]]), 50.0)
    with pytest.raises(InputError, match="3x3"):
        DepthModel(10.0, 2e4, 50.0, np.zeros(3))
    field = DepthModel(np.full((4, 6), 10.0), 2e4, 50.0)
    with pytest.raises(InputError, match="calibrated"):
        disparity_to_depth(np.zeros((5, 6)), field)
    with pytest.raises(InputError, match="focal length"):
        paper_to_model(PaperParameters(90.0, 11.79, 50.0, FOCAL_MM), pixel_pitch_mm=PITCH_MM)

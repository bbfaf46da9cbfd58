"""The first-order camera against two traced rays of a thin lens: one through the lens centre, one through its rim."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.optics.pinhole import PupilCamera

PITCH_MM = 0.01
lengths = st.floats(4.0, 200.0)
far = st.floats(2.1, 200.0)  # object distance in focal lengths; nearer than 2 the image would be magnified


def traced_crossing(z_o, f, height):
    """Distance behind the lens where a ray from an axis point through the lens at ``height``, meets the axis.

    A thin lens turns a ray by -height / f; nothing else of it is used.
    """
    slope = height / z_o - height / f
    return -height / slope


def traced_rim(z_od, z_if, f, radius):
    """Height in the upright picture (so minus that on the sensor) of an axis point's rim ray."""
    return -(radius + (radius / z_od - radius / f) * z_if)


def thin_lens_camera(f, z_of, radius):
    """A thin lens, which is its own entrance pupil, as a camera; distances count from the sensor."""
    z_if = traced_crossing(z_of, f, radius)
    return PupilCamera(9, 9, z_if / PITCH_MM, radius, z_of + z_if, z_if, PITCH_MM)


@given(lengths, far, far, st.floats(0.5, 20.0))
def test_blur_is_the_height_of_the_rim_ray(f, od, of, radius):
    """Eqs. (2) to (5)."""
    camera = thin_lens_camera(f, of * f, radius)
    expected = traced_rim(od * f, camera.image_distance_mm, f, radius)
    found = PITCH_MM * camera.blur_radius_px(od * f + camera.sensor_to_pupil_mm)
    assert float(found) == pytest.approx(expected, rel=1e-8, abs=1e-9)  # differences of distances lose digits


@given(lengths, far, far, st.floats(0.05, 1.0))
def test_disparity_is_the_half_distance_of_two_centroid_rays(f, od, of, beta):
    """Eq. (6)."""
    camera = thin_lens_camera(f, of * f, f / 4)
    radius = beta * camera.pupil_radius_mm
    upper, lower = (traced_rim(od * f, camera.image_distance_mm, f, h) for h in (radius, -radius))
    found = camera.disparity_px(od * f + camera.sensor_to_pupil_mm, beta)
    assert 2 * float(found) == pytest.approx((upper - lower) / PITCH_MM, rel=1e-8, abs=1e-6)  # as above


def test_beyond_focus_is_positive_and_infinity_is_finite():
    camera = thin_lens_camera(50.0, 2000.0, 12.5)
    offset = camera.sensor_to_pupil_mm
    near, beyond, infinity = (float(camera.disparity_px(z + offset, 0.42)) for z in (1000.0, 4000.0, math.inf))
    assert near < 0 < beyond < infinity < 30
    assert float(camera.disparity_px(2000.0 + offset, 0.42)) == pytest.approx(0, abs=1e-9)  # rounding

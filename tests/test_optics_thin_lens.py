"""The thin lens against two traced rays: one through the lens centre, one through its rim."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.errors import InputError
from chromaperture.optics import thin_lens

lengths = st.floats(4.0, 200.0)
far = st.floats(1.5, 200.0)  # object distance in focal lengths


def traced_crossing(z_o, f, height):
    """Distance behind the lens where a ray from an axis point through the lens at ``height``, meets the axis.

    A thin lens turns a ray by -height / f; nothing else of it is used.
    """
    slope = height / z_o - height / f
    return -height / slope


def traced_rim(z_od, z_if, f, radius):
    """Height in the upright picture (so minus that on the sensor) of an axis point's rim ray."""
    return -(radius + (radius / z_od - radius / f) * z_if)


@given(lengths, far, st.floats(0.1, 5.0))
def test_the_sharp_image_lies_where_rays_cross(f, distance, height):
    z_i = thin_lens.object_to_image_distance(distance * f, f)
    assert z_i == pytest.approx(traced_crossing(distance * f, f, height), rel=1e-12)
    assert thin_lens.image_to_object_distance(z_i, f) == pytest.approx(distance * f, rel=1e-9)


@given(lengths, far, far, st.floats(0.5, 20.0))
def test_blur_is_the_distance_of_the_rim_rays(f, od, of, radius):
    z_od, z_of = od * f, of * f
    z_if = traced_crossing(z_of, f, radius)
    z_id = traced_crossing(z_od, f, radius)
    expected = 2 * traced_rim(z_od, z_if, f, radius)
    assert thin_lens.object_to_blur_diameter(z_od, z_of, f, 2 * radius) == pytest.approx(
        expected, rel=1e-9, abs=1e-9
    )
    assert thin_lens.defocus_to_blur_diameter(z_id, z_if, 2 * radius) == pytest.approx(
        expected, rel=1e-9, abs=1e-9
    )


@given(lengths, far, far, st.floats(0.05, 1.0), st.floats(0.001, 0.05))
def test_disparity_is_the_half_distance_of_two_centroid_rays(f, od, of, beta, pitch):
    z_od, z_of, radius = od * f, of * f, f / 4
    z_if = traced_crossing(z_of, f, 1.0)
    upper = traced_rim(z_od, z_if, f, beta * radius)
    lower = traced_rim(z_od, z_if, f, -beta * radius)
    d = thin_lens.object_to_disparity(z_od, z_of, f, 2 * radius, beta=beta, pixel_pitch=pitch)
    assert 2 * d == pytest.approx((upper - lower) / pitch, rel=1e-9, abs=1e-9)
    back = thin_lens.disparity_to_object(d, z_of, f, baseline=2 * beta * radius, pixel_pitch=pitch)
    assert back == pytest.approx(z_od, rel=1e-6)


def test_beyond_focus_is_positive_and_infinity_is_finite():
    f, z_of = 50.0, 2000.0
    near, focus, beyond, infinity = (
        thin_lens.object_to_disparity(z, z_of, f, 25.0, beta=0.42, pixel_pitch=0.03)
        for z in (1000.0, z_of, 4000.0, math.inf)
    )
    assert near < focus == 0 < beyond < infinity < 10


def test_impossible_distances():
    with pytest.raises(InputError, match="beyond f"):
        thin_lens.object_to_image_distance(49.0, 50.0)
    with pytest.raises(InputError, match="inside the focal length"):
        thin_lens.image_to_object_distance(49.0, 50.0)
    assert thin_lens.image_to_object_distance(50.0, 50.0) == math.inf
    with pytest.raises(InputError, match="infinity"):
        thin_lens.disparity_to_object(100.0, 2000.0, 50.0, baseline=10.0, pixel_pitch=0.03)

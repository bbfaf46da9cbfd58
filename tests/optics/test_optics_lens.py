"""Traced lenses against published first-order data, closed forms of geometry, and their paraxial limit."""

import math
from dataclasses import replace

import numpy as np
import pytest

from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.pinhole import focused_at, paraxial, pupil_camera
from chromaperture.optics.prescription import (
    Prescription,
    Surface,
    checked_lens,
    lens_from_dict,
    lens_names,
    load_lens,
    with_filter_at,
)
from chromaperture.optics.ray_table import lens_rays, pinhole_rays, trace
from chromaperture.system.errors import InputError

WAVES = (0.605, 0.540, 0.465)

# A widely published sample, a double Gauss of f = 100 mm, at half size; radius, thickness, index and Abbe
# number at d.
SAMPLE = [
    (56.20238, 8.75, 1.62230, 53.1),
    (152.28580, 0.5, 1, math.inf),
    (37.68262, 12.5, 1.60738, 56.65),
    (math.inf, 3.8, 1.60342, 38.03),
    (24.23130, 16.369445, 1, math.inf),
    (math.inf, 13.747957, 1, math.inf),
    (-28.37731, 3.8, 1.60342, 38.03),
    (math.inf, 11, 1.62041, 60.32),
    (-37.92546, 0.5, 1, math.inf),
    (177.41176, 7, 1.62041, 60.32),
    (-79.41143, 0, 1, math.inf),
]


def sample_double_gauss():
    surfaces = tuple(
        Surface(r / 2, t / 2, n, v, 5.0 if i == 5 else math.inf, role="stop" if i == 5 else "")
        for i, (r, t, n, v) in enumerate(SAMPLE)
    )
    return Prescription("sample", "", "", surfaces, 35.0, WAVES)


def thin_lens(f=50.0, radius=10.0, z_of=2000.0, offset=0.0):
    """As near to a thin lens as glass gets: an almost flat, very dense pair of paraboloids at its stop."""
    n = 20.0
    curvature = 1 / (2 * f * (n - 1))
    surfaces = (
        Surface(thickness_mm=1e-6 + offset, semi_diameter_mm=radius, role="stop"),
        Surface(1 / curvature, 1e-6, n, conic=-1.0),
        Surface(-1 / curvature, conic=-1.0),
    )
    return focused_at(Prescription("thin", "", "", surfaces, 1.0, WAVES), z_of)


def test_first_order_data_agree_with_two_independent_packages():
    """Figures for this sample from optiland 0.6.3 and rayoptics 0.9.8 (EPD 25)."""
    data = paraxial(sample_double_gauss(), wavelength_um=0.5876)
    # The glasses are entered by index and Abbe number to five digits, the packages took them from a
    # catalogue.
    assert data.focal_length_mm == pytest.approx(50.00187, abs=5e-4)
    assert data.entrance_pupil_mm == pytest.approx(28.956, abs=1e-3)
    assert data.front_principal_mm == pytest.approx(35.3415, abs=1e-3)
    # Four figures are published.
    assert data.exit_diameter_mm / data.entrance_diameter_mm == pytest.approx(28.660 / 25, abs=1e-4)
    infinity = sum(t for _, t, _, _ in SAMPLE) / 2 + data.back_focus_mm
    assert data.exit_pupil_mm - infinity == pytest.approx(-57.322, abs=1e-3)  # the glasses are entered to five digits


def test_the_patent_double_gauss_is_the_lens_of_the_captures():
    data = paraxial(load_lens("double_gauss_50"))
    assert data.focal_length_mm == pytest.approx(50.3422, abs=1e-4)  # the value rounds at the last figure
    assert data.sensor_to_entrance_pupil_mm == pytest.approx(49.5001, abs=1e-4)  # as above


@pytest.mark.parametrize("name", lens_names())
def test_rays_near_the_axis_agree_with_the_paraxial_trace(name):
    lens = load_lens(name)
    data = paraxial(lens)
    height = 1e-4
    rays = trace(lens, [[0.0, height, -10.0]], [[0.0, 0.0, 1.0]], wavelength_um=lens.wavelengths_um[1])
    slope = rays.direction[0, 1] / rays.direction[0, 2]
    assert -height / slope == pytest.approx(data.focal_length_mm, rel=1e-6)  # what is left is third order
    crossing = rays.position[0, 2] - rays.position[0, 1] / slope
    assert crossing == pytest.approx(lens.vertices_mm[-1] + data.back_focus_mm, rel=1e-6)  # third order, as above


@pytest.mark.parametrize("name", lens_names())
def test_light_runs_back_the_way_it_came(name):
    lens = load_lens(name)
    rng = np.random.default_rng(0)
    radius = 0.3 * paraxial(lens).entrance_diameter_mm
    start = np.column_stack([rng.uniform(-radius, radius, (200, 2)), np.full(200, -5.0 * radius)])
    aim = np.column_stack([rng.uniform(-0.05, 0.05, (200, 2)), np.ones(200)])
    there = trace(lens, start, aim, wavelength_um=0.54)
    back = trace(lens, there.position, -there.direction, wavelength_um=0.54, from_sensor=True)
    home = back.position + back.direction * ((start[:, 2] - back.position[:, 2]) / back.direction[:, 2])[:, None]
    assert there.clear.mean() > 0.8  # else the comparison means little
    through = there.clear
    np.testing.assert_allclose(home[through], start[through], atol=1e-8)  # Newton stops at 1e-11 mm a surface
    np.testing.assert_allclose(back.at_stop[through], there.at_stop[through], atol=1e-8)


def test_a_paraboloid_mirrorless_singlet_focuses_without_spherical_aberration():
    """A plano-hyperbolic lens, conic -n^2, brings every axial ray to one point: the closed form."""
    n, f = 1.5, 50.0
    surfaces = (
        Surface(thickness_mm=5.0, index_d=n, semi_diameter_mm=15.0, role="stop"),
        Surface(-f * (n - 1), conic=-(n**2)),
    )
    lens = Prescription("hyperbola", "", "", surfaces, f, WAVES)
    heights = np.linspace(1, 14, 14)
    rays = trace(
        lens,
        np.column_stack([heights * 0, heights, heights * 0 - 1]),
        np.tile([0.0, 0, 1], (14, 1)),
        wavelength_um=0.54,
    )
    crossing = rays.position[:, 2] - rays.position[:, 1] * rays.direction[:, 2] / rays.direction[:, 1]
    np.testing.assert_allclose(crossing, 5.0 + f, atol=1e-9)  # Newton stops at 1e-11 mm


def test_even_asphere_coefficients_continue_the_conic():
    """A sphere written as a paraboloid plus its r^4 ... r^12 terms must bend rays alike."""
    r = 30.0
    terms = (1 / (8 * r**3), 1 / (16 * r**5), 5 / (128 * r**7), 7 / (256 * r**9), 21 / (1024 * r**11))
    sphere = Surface(r, 0.0, 1.0, semi_diameter_mm=6.0)
    series = replace(sphere, conic=-1.0, coefficients=terms)

    def through(surface):
        stop = Surface(thickness_mm=1.0, index_d=1.6, semi_diameter_mm=6.0, role="stop")
        lens = Prescription("x", "", "", (stop, surface), 40.0, WAVES)
        rays = trace(lens, [[1.0, 5.0, -1.0]], [[0.02, -0.03, 1.0]], wavelength_um=0.54)
        return np.hstack([rays.position, rays.direction])

    np.testing.assert_allclose(through(series), through(sphere), atol=1e-9)  # the next term is 33/2048 r^14/R^13


def blur_at(table, depth_mm, image_distance_mm, j=1, i=1):
    """Where the rays of a table's image point (j, i) miss an object point at a depth, (3, S, 2) mm, and their light.

    Upright picture, on the image plane of a pinhole: without the lens's distortion.
    """
    z = depth_mm - table.z_mm
    missed = table.origin[:, j, i] + z * (table.slope[:, j, i] - table.chief[j, i, 2:])
    return -missed * image_distance_mm / z, table.weight[:, j, i]


def moments(offset, light):
    """Light's mean offset, (3, 2), and the root mean square distance from it, (3,)."""
    mass = light.sum(axis=1)
    centroid = (light[..., None] * offset).sum(axis=1) / mass[:, None]
    distance2 = ((offset - centroid[:, None]) ** 2).sum(axis=-1)
    return centroid, np.sqrt((light * distance2).sum(axis=1) / mass)


def small_table(lens, aperture, *, pitch_mm=0.05, cells=40):
    return lens_rays(lens, aperture, width_px=3, height_px=3, pixel_pitch_mm=pitch_mm, cells=cells, nodes=3)


def test_a_thin_lens_of_glass_blurs_as_equation_5_says():
    """Sign and size of every channel's shift, near, in focus and far, from rays alone."""
    table = small_table(thin_lens(radius=1.0), DESIGNS["cy_halves"])
    for depth in (1000.0, 2000.0, 4000.0):
        offset, light = blur_at(table, depth, table.z_mm)
        centroid, rms = moments(offset, light)
        z_of, z_od = 2000.0 - table.z_mm, depth - table.z_mm
        c = 50.0 * 2.0 * (z_od - z_of) / (z_od * (z_of - 50.0))  # Eq. (5)
        # The glass has a spherical aberration of 5e-5 mm in the centroid; the largest shift here is 0.012 mm.
        half = 4 / (3 * math.pi) * c / 2
        np.testing.assert_allclose(centroid[:, 0], [half, 0, -half], atol=1e-4)  # derived above
        np.testing.assert_allclose(centroid[:, 1], 0, atol=1e-6)  # by symmetry; float32
        # 40 cells across the pupil, and spherical aberration.
        assert rms[1] == pytest.approx(abs(c) / 2 / math.sqrt(2), rel=5e-3, abs=2e-4)


def test_first_order_camera_and_traced_lens_hold_the_same_rays():
    """Paraxial table against traced table of the near-thin lens, middle of the image."""
    lens = thin_lens(radius=2.0)
    camera = pupil_camera(lens, width_px=21, height_px=13, pixel_pitch_mm=0.05)
    traced = lens_rays(lens, DESIGNS["cy_halves"], width_px=21, height_px=13, pixel_pitch_mm=0.05, cells=12, nodes=5)
    ideal = pinhole_rays(camera, DESIGNS["cy_halves"], cells=12)
    assert traced.z_mm == pytest.approx(ideal.z_mm)  # rounding
    np.testing.assert_allclose(traced.chief[[0, -1]][:, [0, -1]], ideal.chief, atol=1e-6)  # float32 tables
    np.testing.assert_allclose(
        traced.weight.sum(axis=3)[:, 1, 2],
        ideal.weight.sum(axis=3)[:, 0, 0],
        atol=2e-3,  # cells that the rim cuts
    )
    # All rays of the middle pixel meet in the focus plane on the axis.
    meet = traced.origin[1, 1, 2] + (camera.focus_mm - traced.z_mm) * traced.slope[1, 1, 2]
    np.testing.assert_allclose(meet[traced.weight[1, 1, 2] > 0], 0, atol=0.08)  # the rim errs by 0.06


def test_focusing_makes_the_distance_sharp():
    lens = load_lens("double_gauss_50")
    for distance in (700.0, 2000.0, 20000.0):
        data = paraxial(focused_at(lens, distance))
        focus_mm = data.focus_from_pupil_mm + data.sensor_to_entrance_pupil_mm
        assert focus_mm == pytest.approx(distance, rel=1e-9)  # rounding
    assert paraxial(focused_at(lens, math.inf)).focus_from_pupil_mm == math.inf


def test_the_phone_lens_is_what_it_claims():
    lens = load_lens("phone_4")
    data = paraxial(lens)
    assert data.focal_length_mm == pytest.approx(4.0, abs=0.005)  # a title of two figures
    assert data.focal_length_mm / data.entrance_diameter_mm == pytest.approx(2.4, abs=0.02)
    table = small_table(focused_at(lens, 2000.0), DESIGNS["open"], pitch_mm=1.4)  # the corner is 26 degrees off axis
    places = ((1, 1), (1, 2), (0, 1), (0, 0))
    rms = [moments(*blur_at(table, 2000.0, data.pinhole_distance_mm, j, i))[1] for j, i in places]
    assert np.max(rms) < 7e-3  # 1 to 5 um for the focus it was designed at


def test_the_corner_darkens_and_the_halves_are_mirror_images():
    light = small_table(load_lens("double_gauss_50"), DESIGNS["cy_halves"], pitch_mm=9.0).weight.sum(axis=-1)
    assert 1.01 > light[1, 1, 1] > light[1, 1, 2] > light[1, 2, 2] > 0.3  # 1.00, 0.70 and 0.54 are found
    # Red and blue darken alike on opposite sides, and differently on the same.
    assert light[0, 1, 0] == pytest.approx(light[2, 1, 2], rel=1e-3)  # another wavelength
    assert light[0, 1, 0] != pytest.approx(light[0, 1, 2], rel=1e-2)


def test_an_unvignetted_lens_darkens_by_the_fourth_power_of_the_cosine():
    lens = thin_lens(radius=0.5)
    table = small_table(lens, DESIGNS["open"], pitch_mm=12.0)
    x, y = 12.0 * (table.x_px - 1), 12.0 * (table.y_px - 1)[:, None]
    cosine2 = table.z_mm**2 / (table.z_mm**2 + x**2 + y**2)
    # The bundle's width, a hundredth of the distance, averages the law over a few angles.
    np.testing.assert_allclose(table.weight[1].sum(axis=-1), cosine2**2, rtol=2e-3)


def test_a_filter_off_the_stop_splits_the_light_unevenly_as_its_geometry_says():
    """Film t behind the stop is met by an oblique bundle t tan(theta) aside: it splits at h = t tan / R."""
    radius, t = 2.0, 4.0
    lens = thin_lens(radius=radius, offset=10.0)
    table = small_table(with_filter_at(lens, t), DESIGNS["cy_halves"], pitch_mm=10.0)
    # Looking back, the bundle leans against its picture side behind the stop.
    h = t * -table.chief[1, 2, 2] / radius
    area = (math.acos(-h) + h * math.sqrt(1 - h * h)) / math.pi  # part of the disc with x > -h
    light = table.weight[:, 1, 2].sum(axis=1)
    # Red passes yellow, on the right. The bundle is not quite parallel inside the camera: 2 %.
    assert light[0] / light[1] == pytest.approx(area, abs=0.02)
    assert abs(light[0] / light[1] - 0.5) > 0.08


GOOD = {
    "sensor_gap_mm": 50.0,
    "surface": [
        {"radius_mm": 50.0, "thickness_mm": 3.0, "index_d": 1.5},
        {"radius_mm": -50.0, "clear_diameter_mm": 10.0, "stop": True},
    ],
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"surface": GOOD["surface"][:1]}, "0 stops"),
        ({"surface": [*GOOD["surface"], {"stop": True, "clear_diameter_mm": 1.0}]}, "2 stops"),
        ({"surface": [GOOD["surface"][0], {"stop": True}]}, "clear_diameter_mm"),
        ({"surface": [{"radius_mm": 0.0}, GOOD["surface"][1]]}, "not physical"),
        ({"surface": [{"radius": 5.0}, GOOD["surface"][1]]}, "surface 1; did you mean 'radius_mm'"),
        ({"surface": [GOOD["surface"][0], GOOD["surface"][1] | {"index_d": 1.5}]}, "must be air"),
        ({"sensor_gap_mm": -1.0}, "sensor_gap_mm"),
        ({"sensor_gap_mm": "50"}, "sensor_gap_mm must be a number, is '50'"),
        ({"surface": [{"radius_mm": [5.0]}, GOOD["surface"][1]]}, "surface 1: radius_mm must be a number"),
        ({"surface": [{"conic": math.nan}, GOOD["surface"][1]]}, "surface 1: conic must be a finite number"),
        ({"surface": [{"thickness_mm": 1e300}, GOOD["surface"][1]]}, "not physical"),
        ({"surface": GOOD["surface"] * 101}, "at most 200"),
        ({"surface": 5}, "surface must be a list, is 5"),
        ({"title": "n" * 300}, "title"),
        ({"wavelengths_um": [0.5]}, "wavelengths_um 2 is missing"),
    ],
)
def test_prescriptions_that_cannot_be(change, message):
    with pytest.raises(InputError, match=message):
        lens_from_dict(GOOD | change, name="mine")


def test_lenses_that_cannot_take_pictures():
    lens = load_lens("double_gauss_50")
    with pytest.raises(InputError, match="unknown lens"):
        load_lens("double_gaus")
    with pytest.raises(InputError, match="nearest is"):
        focused_at(lens, 150.0)
    with pytest.raises(InputError, match="inside the focus"):
        paraxial(replace(lens, sensor_gap_mm=20.0))
    hollow = (Surface(-50.0, 2.0, 1.5, role="stop", semi_diameter_mm=5.0), Surface(50.0))
    diverging = Prescription("d", "", "", hollow, 40.0, WAVES)
    with pytest.raises(InputError, match="does not collect"):
        paraxial(diverging)
    wide = replace(lens, surfaces=tuple(replace(s, semi_diameter_mm=20.0) if s.role else s for s in lens.surfaces))
    with pytest.raises(InputError, match="larger than its glass"):
        lens_rays(wide, DESIGNS["open"], width_px=9, height_px=9, pixel_pitch_mm=0.5, cells=8)
    single = (Surface(50.0, 1e-6, 1.5), Surface(-50.0, 50.0), Surface(role="stop", semi_diameter_mm=4.0))
    with pytest.raises(InputError, match="cannot be reached"):
        paraxial(checked_lens(Prescription("t", "", "", single, 10.0, (0.605, 0.5876, 0.465))))
    with pytest.raises(InputError, match="inside or behind the glass"):
        with_filter_at(lens, 6.0)

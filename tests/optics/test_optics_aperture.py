"""Apertures: closed forms of the masks, the paper's figures, and what a design file can get wrong."""

import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import chromaperture as cap
from chromaperture.cli.apertures import design_table
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.optics.aperture import (
    DESIGNS,
    aperture_figures,
    channel_transmission,
    film_unmixing,
    made_of,
    open_band,
    open_disc,
)
from chromaperture.optics.pinhole import PupilCamera, thin_lens_camera
from chromaperture.optics.printing.aperture_file import aperture_from_dict, load_aperture
from chromaperture.optics.simulator.layer_renderer import render_layers
from chromaperture.optics.simulator.sensor import SensorModel, develop, expose
from chromaperture.optics.simulator.textures import noise
from chromaperture.system.errors import InputError

# Areas and centroids below are closed forms of discs, squares and circle segments, in pupil radii. The grid
# of 1000^2 midpoints is good to 4e-4.
TOLERANCE = 1e-3
TANGENT = 2 * math.sqrt(3) - 3  # radius of three discs touching each other inside the unit disc


def segment(h):
    """Area share and first moment / pi of the cap x > h of the unit disc."""
    return (math.acos(h) - h * math.sqrt(1 - h * h)) / math.pi, 2 / 3 * (1 - h * h) ** 1.5 / math.pi


@pytest.mark.parametrize(
    ("name", "transmission"),
    [
        ("rgb_circles", (0.09, 0.09, 0.09)),
        ("rgb_squares", (0.5 / math.pi,) * 3),
        ("cmy_squares", (1 / math.pi,) * 3),
        ("cmy_circles", (2 * TANGENT**2,) * 3),
        ("cy_halves", (0.5, 1, 0.5)),
        ("magenta_annulus", (1, 0.59**2, 1)),
        ("cy_open_disc", ((1 + 0.835**2) / 2, 1, (1 + 0.835**2) / 2)),
        ("open", (1, 1, 1)),
    ],
)
def test_light_of_each_design_is_the_area_of_its_shapes(name, transmission):
    figures = aperture_figures(DESIGNS[name])
    np.testing.assert_allclose(figures.channel_transmission, transmission, atol=TOLERANCE)
    assert figures.efficiency_mean == pytest.approx(np.mean(transmission), abs=TOLERANCE)


@pytest.mark.parametrize(
    ("name", "red", "green", "blue"),
    [
        ("rgb_circles", (0, -0.6), (-0.3 * math.sqrt(3), 0.3), (0.3 * math.sqrt(3), 0.3)),
        ("rgb_squares", (0.5, 0), (0, -0.5), (-0.5, 0)),
        ("cmy_squares", (-0.25, -0.25), (0, 0), (0.25, -0.25)),
        ("cy_halves", (4 / (3 * math.pi), 0), (0, 0), (-4 / (3 * math.pi), 0)),
        ("magenta_annulus", (0, 0), (0, 0), (0, 0)),
    ],
)
def test_centroids_in_sensor_colours(name, red, green, blue):
    np.testing.assert_allclose(aperture_figures(DESIGNS[name]).centroids, [red, green, blue], atol=TOLERANCE)


def test_open_band_has_the_centroids_of_a_circle_without_a_segment():
    area, moment = segment(0.582)
    figures = aperture_figures(open_band(0.582))
    assert figures.beta == pytest.approx(moment / (1 - area), abs=TOLERANCE)
    np.testing.assert_allclose(figures.channel_transmission, [1 - area, 1, 1 - area], atol=TOLERANCE)
    # Unmixing two of cyan and yellow: C = (2B + G - R) / 3, so the band weighs 2/3 in the cyan view and its
    # cap 1.
    unmixed = aperture_figures(open_band(0.582), film_unmixing(open_band(0.582)))
    assert unmixed.beta == pytest.approx(moment / (area + 2 / 3 * (1 - 2 * area)), abs=TOLERANCE)
    assert unmixed.beta > 1.35 * figures.beta


def test_half_a_ring_of_film_around_an_open_disc():
    radius = 0.835
    # Red sees all but the cyan half ring, whose first moment is that of the half discs' difference.
    moment = 4 / (3 * math.pi) * (1 - radius**3) / 2
    assert aperture_figures(open_disc(radius)).beta == pytest.approx(moment / ((1 + radius**2) / 2), abs=TOLERANCE)


def test_unmixing_doubles_the_baseline_of_complementary_discs():
    design = DESIGNS["cmy_circles"]
    plain, unmixed = aperture_figures(design), aperture_figures(design, film_unmixing(design))
    assert plain.beta == pytest.approx((1 - TANGENT) / 2, abs=TOLERANCE)
    assert unmixed.beta == pytest.approx(1 - TANGENT, abs=TOLERANCE)


def test_efficiencies_rise_in_the_order_of_figure_11():
    order = [
        "rgb_circles",
        "rgb_squares",
        "cmy_squares",
        "cmy_circles",
        "cy_halves",
        "magenta_annulus",
        "cy_open",
        "open",
    ]
    light = [aperture_figures(DESIGNS[name]).efficiency_mean for name in order]
    assert light == sorted(light)
    assert aperture_figures(DESIGNS["cy_halves"]).efficiency_mean > 0.65  # section 2.1


def test_real_film_reproduces_table_1_and_the_integral_efficiencies():
    low_high = {
        "cy_open": [(0.84, 0.97), (0.90, 0.98), (0.78, 0.89)],
        "cy_halves": [(0.46, 0.54), (0.72, 0.76), (0.34, 0.41)],
    }
    for name, ranges in low_high.items():
        for value, (low, high) in zip(channel_transmission(made_of(DESIGNS[name], "real")), ranges, strict=True):
            assert low <= value <= high
    # 86, 55 and 5.5 % of section 4.1, to the percent the film values themselves are good to.
    for name, percent in (("cy_open", 86), ("cy_halves", 55), ("rgb_circles", 5.5)):
        assert 100 * aperture_figures(made_of(DESIGNS[name], "real")).efficiency_mean == pytest.approx(percent, abs=1)


def test_yellow_lies_right_in_every_two_filter_design():
    """A swapped half would turn the sign of every disparity."""
    for name in ("cy_halves", "cy_open", "cy_open_disc"):
        red, _, blue = aperture_figures(DESIGNS[name]).centroids
        assert red[0] > 0.1 > -0.1 > blue[0]  # 0.10, 0.13 and 0.42 are found: signs, not figures


@settings(max_examples=20, deadline=None)
@given(st.floats(0.05, 0.5), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_a_disc_anywhere_has_its_centre_for_centroid(radius, x, y):
    assume(np.hypot(x, y) + radius <= 1)  # the pupil cuts off what lies outside it
    part = {"filter": "red", "disc": {"center": [x, y], "radius": radius}}
    figures = aperture_figures(aperture_from_dict({"part": [part]}, name="one"))
    # A small disc holds fewer grid cells: 0.05 pupil radii are 25 cells, whose rim errs by a few hundredths
    # of one.
    np.testing.assert_allclose(figures.centroids[0], (x, y), atol=TOLERANCE)
    assert figures.channel_transmission[0] == pytest.approx(radius**2, rel=0.03)


TWO_DISCS = """
title = "Two discs"
film = "real"
remainder = "clear"
[filters.teal]
transmission = [0.05, 0.5, 0.5]
[[part]]
filter = "teal"
disc = { center = [-0.5, 0.0], radius = 0.4 }
[[part]]
filter = "yellow"
polygon = [[0.2, -0.4], [0.8, -0.4], [0.8, 0.4], [0.2, 0.4]]
"""


def test_a_toml_design_keeps_its_own_filters(tmp_path):
    (tmp_path / "two.toml").write_text(TWO_DISCS)
    design = load_aperture(tmp_path / "two.toml")
    assert design.views == ("teal", "yellow")
    assert design.filter_named("yellow").transmission[0] == 0.92
    expected = 1 - 0.16 * (1 - 0.05) - 0.48 / math.pi * (1 - 0.92)
    assert channel_transmission(design)[0] == pytest.approx(expected, abs=TOLERANCE)


def test_a_drawing_gives_the_same_aperture_as_its_description(tmp_path):
    """Circle, rect, polygon and a curved path; the right half circle out of two quarter curves."""
    k = 4 / 3 * (math.sqrt(2) - 1)  # the Bezier handle of a quarter circle, off by 3e-4 of the radius
    path = f"M 50 10 c {40 * k} 0 40 {40 - 40 * k} 40 40 C 90 {50 + 40 * k} {50 + 40 * k} 90 50 90 Z"
    (tmp_path / "half.svg").write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg"><circle id="pupil" cx="50" cy="50" r="40"/>'
        f'<path fill="yellow" d="{path}"/><rect data-filter="cyan" fill="none" x="0" y="0" width="50" '
        'height="100"/></svg>'
    )
    drawn, known = (aperture_figures(load_aperture(tmp_path / "half.svg")), aperture_figures(DESIGNS["cy_halves"]))
    np.testing.assert_allclose(drawn.centroids, known.centroids, atol=TOLERANCE)
    np.testing.assert_allclose(drawn.channel_transmission, known.channel_transmission, atol=TOLERANCE)


DISC = {"filter": "red", "disc": {"radius": 0.5}}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"part": [DISC, {"filter": "blue", "disc": {"center": [0.3, 0], "radius": 0.5}}]}, "overlap"),
        ({"part": [{"filter": "red", "disc": {"center": [1.6, 0], "radius": 0.5}}]}, "outside the pupil"),
        ({"part": [DISC | {"filter": "mauve"}]}, "unknown filter 'mauve'"),
        ({"part": [DISC], "film": "best"}, "unknown film"),
        ({"part": [DISC], "remainder": "red"}, "remainder"),
        ({"part": [DISC], "views": ["blue"]}, "no 'blue' filter"),
        ({"part": [{"filter": "red"}]}, "a part needs"),
        ({"part": [{"filter": "red", "polygon": [[0, 0], [1, 0]]}]}, "polygon: the list should have at least 3"),
        ({"part": [{"filter": "red", "disc": {"size": 1}}]}, "unknown key 'size' in part 1: disc"),
        ({"part": [], "remainder": "opaque"}, "no light"),
        ({"parts": [DISC]}, "unknown key 'parts'; did you mean 'part'"),
        ({"part": [DISC], "filters": {"dark": {"transmission": [0, 0, 2]}}}, "between 0 and 1"),
        ({"part": [DISC], "filters": {"dark": {"transmision": [0, 0, 1]}}}, "did you mean 'transmission'"),
        ({"part": [DISC], "filters": {"dark": 3}}, "filters.dark must be a table"),
        ({"part": [{"filter": "red", "disc": {"radius": "wide"}}]}, "part 1: disc.radius must be a number, is 'wide'"),
        ({"part": [{"filter": "red", "disc": {"radius": 1e300}}]}, "disc.radius must be less than"),
        ({"part": [{"filter": 3, "disc": {}}]}, "part 1: filter must be text"),
        ({"part": 65 * [DISC]}, "part: .*at most 64"),
    ],
)
def test_bad_designs_say_what_is_wrong(data, message):
    with pytest.raises(InputError, match=message):
        aperture_from_dict(data, name="mine")


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('<circle cx="0" cy="0" r="1" fill="red"/>', "pupil"),
        ('<circle id="pupil" r="10"/><path fill="red" d="M0 0 A 5 5 0 0 1 3 3 Z"/>', "arcs"),
        ('<circle id="pupil" r="10"/><circle r="3" fill="red" transform="scale(2)"/>', "transform"),
        ('<circle id="pupil" r="10"/><circle r="3"/>', "data-filter"),
        ('<circle id="pupil" r="10"/><path fill="red" d="M0 0 L3 0 3 3 M1 1 L2 2"/>', "more than one loop"),
        ('<circle id="pupil" r="10"/><path fill="red" d="M0 0 L3 0 3"/>', "lacks numbers"),
        ('<circle id="pupil" r="10"/><path fill="red" d="M0 0 L1e999 0 3 3"/>', "not finite"),
        ('<circle id="pupil" r="10"/><path fill="red" d="M0 0' + 100_000 * " 1 1" + '"/>', "simplify"),
        ('<circle id="pupil" r="10"/><polygon fill="red" points="0,0 1,1"/>', "fewer than three corners"),
        ('<circle id="pupil" r="10"/><path fill="red" d="M0 0 L3 0 3 3 Z 5"/>', "too many, after Z"),
        ('<circle id="pupil" r="10"/><path fill="red" d="3 0 L3 3"/>', "begin with M"),
        ('<circle id="pupil" r="10"/>' + 65 * '<rect fill="red" width="1" height="1"/>', "more than 64 pieces"),
        ('<circle id="pupil" r="10"/>' + 10_000 * "<g/>", "elements"),
        ('<circle id="pupil" r="10"/><rect fill="red" x="nan" width="1" height="1"/>', "not finite"),
        ('<circle id="pupil" r="10"/><circle fill="red" cx="1e8" r="1"/>', "far outside"),
        ('<circle id="pupil" r="10"/><circle fill="red" r="1e8"/>', "radius"),
        ('<circle id="pupil" r="1cm"/>', "not a plain number"),
        ("<circle", "not valid SVG"),
    ],
)
def test_bad_drawings_say_what_is_wrong(tmp_path, body, message):
    (tmp_path / "bad.svg").write_text(f"<svg>{body}</svg>")
    with pytest.raises(InputError, match=message):
        load_aperture(tmp_path / "bad.svg")


def test_unknown_names_and_files(tmp_path):
    with pytest.raises(InputError, match="unknown aperture design"):
        load_aperture("cy_halfs")
    with pytest.raises(InputError, match="no aperture file"):
        load_aperture(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("part = [")
    with pytest.raises(InputError, match="not valid TOML"):
        load_aperture(tmp_path / "bad.toml")


def test_a_drawing_in_another_encoding_is_read_where_it_names_it(tmp_path):
    path = tmp_path / "drawing.svg"
    drawing = '<svg><!-- Ränder --><circle id="pupil" r="10"/><circle r="5" fill="red"/></svg>'
    path.write_bytes(drawing.encode("latin-1"))
    with pytest.raises(InputError, match="not valid SVG"):
        load_aperture(path)
    path.write_bytes(b'<?xml version="1.0" encoding="ISO-8859-1"?>' + drawing.encode("latin-1"))
    assert load_aperture(path).views == ("red",)
    path.write_bytes(b'<?xml version="1.0" encoding="klingon"?>' + drawing.encode())
    with pytest.raises(InputError, match="not valid SVG"):
        load_aperture(path)


@pytest.mark.parametrize("name", ["aperture.toml", "aperture.svg"])
def test_what_is_no_file_is_refused(tmp_path, name):
    os.mkfifo(tmp_path / name)  # nobody writes into it: opening it would wait for ever
    with pytest.raises(InputError, match="not a regular file"):
        load_aperture(tmp_path / name)
    with pytest.raises(InputError, match="no aperture file"):
        load_aperture("n" * 5000 + name)
    with pytest.raises(InputError, match="no aperture file"):
        load_aperture("zero\0" + name)


def test_the_printed_baseline_is_that_of_equation_6():
    """Twice the distance of the circles' centres from the middle, not that of two circles, 1.73 times it."""
    camera = PupilCamera(720, 480, 1600.0, 12.0, 2000.0, 50.0, 0.031)
    (row,) = design_table([DESIGNS["rgb_circles"]], camera, [2500.0])
    assert row["baseline_mm"] == pytest.approx(2 * 0.6 * 12.0, abs=24 * TOLERANCE)


# ---- what a lens of focal length, f-number and pixel is worth


def foretold(focal_length_mm, f_number, pixel_um, focus_mm, distances_mm, film="real"):
    """The row that `chromaperture apertures` prints for halves in a thin lens."""
    pixels = {"width_px": 720, "height_px": 480, "pixel_pitch_mm": pixel_um / 1000}
    camera = thin_lens_camera(focal_length_mm, f_number, focus_mm, **pixels)
    (row,) = design_table([made_of(DESIGNS["cy_halves"], film)], camera, distances_mm)
    return row


def test_a_thin_lens_is_in_focus_where_it_says():
    camera = thin_lens_camera(50.0, 2.0, 2000.0, width_px=720, height_px=480, pixel_pitch_mm=0.03)
    image = camera.image_distance_mm
    assert 1 / image + 1 / (2000 - image) == pytest.approx(1 / 50, rel=1e-12)  # Eq. (2)
    assert (camera.sensor_to_pupil_mm, 2 * camera.pupil_radius_mm) == (image, 25.0)


def test_disparities_foretold_are_those_that_boards_of_this_lens_have():
    # A camera that was calibrated on boards, ray traced through the prescription of a 50 mm lens at f/2.
    known = cap.load_camera(cap.sample_camera("still_life_cy_halves")).calibration
    distances = [900.0, 1200.0, 1500.0, 2500.0, 5200.0]
    row = foretold(50.0, 2.0, 1000 * known.sensor.pixel_pitch_mm, known.in_focus_mm, distances)
    curve = depth_to_disparity(np.array(distances), known.on_axis("paper"))
    # 2 % of 9.4 px between the ends: f-number and focal length are rounded to a percent, vignetting takes another.
    assert np.ptp(curve) > 6
    np.testing.assert_allclose(row["disparity_px"], curve, atol=0.02 * np.ptp(curve))
    assert row["baseline_mm"] == pytest.approx(known.baseline_mm, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("distance_mm", [1500.0, 2500.0])
def test_depth_errors_foretold_are_the_error_bars_of_a_calibrated_camera(distance_mm):
    eye = cap.load_camera(cap.sample_camera("still_life_cy_halves"), quality="real-time", device="cpu")
    known = eye.calibration
    focal_px, pitch_mm = float(known.lens.camera_matrix[0, 0]), known.sensor.pixel_pitch_mm
    delta = float(known.on_axis("paper").sensor_to_pupil_mm)
    lens = PupilCamera(720, 480, focal_px, 12.5, known.in_focus_mm, delta, pitch_mm)
    color = np.repeat(noise((480, 720), exponent=1.0, seed=5)[..., None], 3, axis=2)
    depth_mm = np.full((480, 720), distance_mm)
    film, layer_px = made_of(DESIGNS["cy_halves"], "real"), abs(float(lens.blur_radius_px(distance_mm)))
    picture = render_layers(color, depth_mm, camera=lens, aperture=film, pitch_px=layer_px)
    image = develop(expose(picture.image, SensorModel(), seed=5), SensorModel()).astype(np.float32)
    sigma_mm = np.median(eye.measure(image).sigma_mm[160:320, 240:480])  # few pixels of a border's windows
    row = foretold(50.0, 2.0, 1000 * pitch_mm, known.in_focus_mm, [900.0, distance_mm, 5200.0])
    # One constant stands for bars that depend on blur and texture: 0.060 to 0.071 px of half disparity were seen from
    # 1.2 to 3.5 m, and other textures have other bars.
    assert 0.6 < sigma_mm / row["depth_error_mm"][1] < 1.4
    assert row["depth_sigma_mm"][1] < sigma_mm
    assert row["depth_error_percent"][1] == pytest.approx(100 * row["depth_error_mm"][1] / distance_mm, abs=1e-3)


def test_range_and_working_pixels():
    row = foretold(50.0, 2.0, 31.0, 2000.0, [1500.0])
    ends = foretold(50.0, 2.0, 31.0, 2000.0, [row["near_mm"]])
    # The search is from -8 to 7.5 px in steps of 0.5; the ends are unknown. Infinity, 4.7 px, lies within.
    assert (ends["disparity_px"], row["far_mm"]) == ([pytest.approx(-7.5, abs=0.01)], None)
    row = foretold(50.0, 2.0, 10.0, 2000.0, [1500.0])
    ends = foretold(50.0, 2.0, 10.0, 2000.0, [row["near_mm"], row["far_mm"]])
    assert ends["disparity_px"] == pytest.approx([-7.5, 7.0], abs=0.01)
    # Finer pixels than blur needs gain nothing. At 900 mm the rim is displaced by F R (1/z_f - 1/z), 12.5 mm times
    # F = 51.3 mm times 1/1949 - 1/849, 0.427 mm or 42.7 px of 10 um.
    coarse, fine = (foretold(50.0, 2.0, pixel_um, 2000.0, [900.0, 2500.0]) for pixel_um in (10.0, 5.0))
    assert fine["working_scale"] == pytest.approx(2 * coarse["working_scale"], abs=2e-3)
    assert coarse["working_scale"] == pytest.approx(42.7 / 13.5, rel=0.002)
    assert fine["depth_error_mm"] == pytest.approx(coarse["depth_error_mm"], rel=1e-3)


def test_the_table_of_the_page_is_what_the_command_prints():
    page = (Path(__file__).parents[2] / "docs" / "machine-vision.md").read_text(encoding="utf-8")
    lines = re.findall(r"^\| (\d+) mm f/([\d.]+) \|(.*)\|$", page, flags=re.MULTILINE)
    assert len(lines) == 5
    for focal_mm, number, rest in lines:
        cells = [[float(value) for value in cell.split(",")] for cell in rest.split("|")]
        (focus_mm,), (baseline_mm,), distances_mm, errors_mm, percent = cells
        row = foretold(float(focal_mm), float(number), 6.9, focus_mm, distances_mm)
        assert row["baseline_mm"] == pytest.approx(baseline_mm, abs=0.05)
        assert row["depth_error_mm"] == pytest.approx(errors_mm, rel=0.03)  # two digits
        assert row["depth_error_percent"] == pytest.approx(percent, abs=0.051)


@pytest.mark.parametrize(
    ("options", "words"),
    [("--f-number 2", "together"), ("--focal-length-mm 9 --f-number 2 --pixel-um 3 --lens phone_4", "no --lens"),
     ("--focal-length-mm 9 --f-number 0 --pixel-um 3", "positive"), ("--sigma-px nan", "--sigma-px"),
     ("--focal-length-mm 50 --f-number 2 --pixel-um 3 --focus-mm 150", "nearest is 200 mm")],
)  # fmt: skip
def test_lenses_that_cannot_be_are_refused(run, options, words):
    result = run("apertures", "cy_halves", *options.split())
    assert (result.returncode, result.stdout, len(result.stderr.splitlines())) == (2, "", 1)
    assert words in result.stderr

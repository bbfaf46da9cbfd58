"""Simulated sessions are laid out as the calibration reads them, and hold the world they claim to."""

import csv
import json
import math
import re
import tomllib
from xml.etree import ElementTree

import cv2
import matplotlib
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from chromaperture.calibration.session import read_session
from chromaperture.cli.apertures import apertures
from chromaperture.cli.simulate import simulate, simulate_rgbd
from chromaperture.optics.aperture import DESIGNS, USUAL_FILM, centroids, channel_transmission, made_of
from chromaperture.optics.depth_error_bound import Texture, expected_accuracy
from chromaperture.optics.pinhole import PupilCamera, focused_at, pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.printing.aperture_file import load_aperture
from chromaperture.optics.printing.template import outline, write_template
from chromaperture.optics.simulator import session as session_module
from chromaperture.optics.simulator.sensor import SensorModel
from chromaperture.optics.simulator.session import SessionPlan
from chromaperture.system.errors import InputError

CAMERA = PupilCamera(96, 64, 400.0, 12.0, 2000.0, 50.0, 0.12)


def app():
    made = typer.Typer()
    made.command()(apertures)
    made.command()(simulate)
    made.command()(simulate_rgbd)
    return made


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    root = tmp_path_factory.mktemp("session")
    scene = root / "wall.toml"
    scene.write_text('[[plane]]\ncenter_mm = [0, 0, 3000]\nwidth_mm = 4000\ntexture = "plain"\n')
    options = ["--width", "240", "--height", "160", "--step-mm", "2000", "--nearest-mm", "1500", "--tilts", "1"]
    result = CliRunner().invoke(
        app(), ["simulate", str(root / "cy_halves"), "--thin", "--cells", "8", "--scene", str(scene), "-q", *options]
    )
    assert result.exit_code == 0, result.output
    assert {path.name for path in root.iterdir()} == {"cy_halves", "wall.toml"}  # nothing beside the session
    return root / "cy_halves"


def test_ctrl_c_leaves_a_session_of_what_was_finished(tmp_path, monkeypatch):
    options = ["--width", "120", "--height", "80", "--step-mm", "500", "--farthest-mm", "3000", "--tilts", "1"]
    expose = session_module.expose
    shots = []

    def interrupted(*args, **keywords):
        shots.append(1)
        if len(shots) == 7:  # two sheets, sheets of two filters, two boards
            raise KeyboardInterrupt
        return expose(*args, **keywords)

    monkeypatch.setattr(session_module, "expose", interrupted)
    result = CliRunner().invoke(app(), ["simulate", str(tmp_path / "s"), "--thin", "--cells", "4", "-q", *options])
    assert result.exit_code != 0
    boards = read_session(tmp_path / "s").boards
    assert sorted(path.name for path in boards) == ["1000.png", "1500.png"]
    assert sorted(path.name for path in (tmp_path / "s" / "board").iterdir()) == ["1000.png", "1500.png"]
    shots[:] = [1] * 6  # before the first board
    result = CliRunner().invoke(app(), ["simulate", str(tmp_path / "t"), "--thin", "--cells", "4", "-q", *options])
    assert list((tmp_path / "t").rglob("*")) == []


def linear(path):
    return (cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1].astype(float) - 16) / 1000


def test_a_session_has_every_file_the_calibration_reads(session):
    facts = tomllib.loads((session / "session.toml").read_text())
    assert facts["design"] == "cy_halves"
    assert (facts["sensor"]["width_px"], facts["sensor"]["height_px"]) == (240, 160)
    assert facts["board"] == {"inner_corners": [9, 6], "square_mm": 30.0, "ruler_error_mm": 3.0}
    rows = list(csv.DictReader((session / "distances.csv").read_text().splitlines()))
    assert [row["ruler_mm"] for row in rows] == ["1500", "3500"]
    truth = json.loads((session / "truth" / "camera.json").read_text())
    for row in rows:
        assert linear(session / row["file"]).shape == (160, 240, 3)
        assert abs(truth["board_mm"][row["file"]] - float(row["ruler_mm"])) <= 3.0  # ruler_error_mm
    for name in ("tilt/00", "scene/wall", "white/open", "white/sheet_c", "white/sheet_y"):
        assert (session / f"{name}.png").is_file()


def phone(**changes):
    facts = {"width_px": 720, "height_px": 480, "pixel_pitch_mm": 0.005}
    camera = pupil_camera(focused_at(load_lens("phone_4"), 300.0), **facts)
    return SessionPlan(distances_mm=(150.0, 600.0), **changes), camera


def test_boards_and_rulers_are_scaled_to_the_frame():
    plan, camera = phone()
    fitted = plan.for_camera(camera)
    # 480 px at 144 mm before the pupil are 86 mm: nine squares with the margin, in whole millimetres.
    assert fitted.square_mm == 9.0
    assert fitted.ruler_error_mm == pytest.approx(0.45)
    facts = {"width_px": 720, "height_px": 480, "pixel_pitch_mm": 22.3 / 720}
    photographic = pupil_camera(focused_at(load_lens("double_gauss_50"), 2000.0), **facts)
    default = SessionPlan().for_camera(photographic)
    assert (default.square_mm, default.ruler_error_mm) == (30.0, 3.0)
    assert phone(square_mm=20.0)[0].for_camera(camera).square_mm == 20.0
    with pytest.raises(InputError, match="at every distance"):
        phone(square_mm=60.0)[0].for_camera(camera)


def test_tilts_that_leave_the_frame_are_not_made(tmp_path):
    """One board near enough for its squares, and the camera focused so near that a tilted one does not fit."""
    out = tmp_path / "session"
    common = ["--thin", "--cells", "8", "--width", "120", "--height", "80", "-q", "--nearest-mm", "2000"]
    common += ["--farthest-mm", "2000", "--focus-mm", "700", "--tilts", "4"]
    result = CliRunner().invoke(app(), ["simulate", str(out), *common])
    assert result.exit_code == 0, result.output
    assert not (out / "tilt").exists()
    out = tmp_path / "small squares"
    result = CliRunner().invoke(app(), ["simulate", str(out), *common, "--square-mm", "10"])
    assert result.exit_code == 0, result.output
    assert len(list((out / "tilt").iterdir())) == 4


def test_white_sheets_show_film_and_exposure(session):
    bare, coded = linear(session / "white" / "open.png"), linear(session / "white" / "cy_halves.png")
    assert bare.mean() == pytest.approx(0.9, abs=2e-3)  # noise of 38400 pixels is far below
    film = channel_transmission(made_of(DESIGNS["cy_halves"], USUAL_FILM))
    # 1e-4 is found, noise of 38400 px.
    np.testing.assert_allclose(coded.mean(axis=(0, 1)) / bare.mean(axis=(0, 1)), film, atol=5e-3)
    cyan = linear(session / "white" / "sheet_c.png").mean(axis=(0, 1)) / 0.9
    np.testing.assert_allclose(cyan, (0.11, 0.42, 0.69), atol=5e-3)  # counts are 1e-3 apart, and the pupil has 8 cells
    relative = tomllib.loads((session / "session.toml").read_text())["exposure"]["relative_to_open"]
    assert relative == pytest.approx(1 / film.max(), rel=5e-3)  # as above


def test_the_boards_corners_lie_where_the_pinhole_puts_them(session):
    """In green, whose pupil is centred; an upside-down or mirrored picture would fail the corner order."""
    truth = json.loads((session / "truth" / "camera.json").read_text())
    image = linear(session / "board" / "1500.png")[..., 1]
    grey = np.clip(image * 300, 0, 255).astype(np.uint8)
    found, corners = cv2.findChessboardCornersSB(grey, (9, 6))
    assert found
    corners = corners.reshape(-1, 2)
    corners = corners if corners[0, 1] < corners[-1, 1] else corners[::-1]
    pitch = 30.0 * truth["focal_px"] / (truth["board_mm"]["board/1500.png"] - truth["sensor_to_entrance_pupil_mm"])
    grid = np.mgrid[:9, :6].T.reshape(-1, 2) - np.array([4.0, 2.5])
    np.testing.assert_allclose(corners, grid * pitch + (119.5, 79.5), atol=0.25)  # corner detection in noise
    assert grey[int(79.5 - 2.9 * pitch), int(119.5 - 4.5 * pitch)] < 60  # the black corner square is top left


def test_true_depth_of_a_scene(session):
    depth = cv2.imread(str(session / "truth" / "wall.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    np.testing.assert_array_equal(depth, 30000)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--cells", "7"], "even"),
        (["--step-mm", "0"], "step-mm"),
        (["--lens", "pinhole"], "unknown lens"),
        (["--design", "none"], "unknown aperture"),
        (["--film", "none"], "unknown film"),
        (["--focus-mm", "100"], "nearest is"),
    ],
)
def test_options_that_make_no_camera(tmp_path, arguments, message):
    result = CliRunner().invoke(app(), ["simulate", str(tmp_path / "s"), *arguments])
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)
    assert not (tmp_path / "s").exists()


def test_the_bound_of_two_shifted_views_is_the_textbook_one():
    """Two views of one texture: var d = var(view 1 - view 2) / (4 sum (dI/dx)^2)."""
    camera = PupilCamera(96, 64, 400.0, 12.0, 2000.0, 50.0, 0.12)
    sensor, texture = SensorModel(full_well_electrons=1e4, read_noise_electrons=50.0), Texture(window_px2=100.0)
    got = expected_accuracy(DESIGNS["cy_halves"], camera, np.array([2000.0]), sensor=sensor, texture=texture)
    # Ideal film in focus: C = (2B + G - R)/3 and Y = (2R + G - B)/3, light .5, 1, .5 and noise from each
    # channel.
    variance = np.array([0.5, 1.0, 0.5]) * texture.mean / 1e4 + (50 / 1e4) ** 2
    rows = np.array([[-1, 1, 2], [2, 1, -1]]) / 3
    noise = rows @ np.diag(variance) @ rows.T
    # Both views carry half the light: I/2 (x -+ d). Difference of the views: variance v1 + v2 - 2 cov.
    frequency = np.hypot(np.fft.fftfreq(512)[:, None], np.fft.rfftfreq(512)[None])
    frequency[0, 0] = np.inf
    phase = np.fft.rfft2(np.random.default_rng(0).normal(size=(512, 512)))
    x = np.fft.irfft2(phase / np.abs(phase) / frequency, (512, 512))  # exact amplitudes, random phases
    x *= texture.contrast / x.std()
    spectrum = np.fft.fft2(x)
    fx, fy = np.fft.fftfreq(512)[None], np.fft.fftfreq(512)[:, None]
    pixel = np.sinc(fx) * np.sinc(fy)
    gradient = np.abs(spectrum * pixel * 2 * np.pi * fx) ** 2
    gradient[:, np.abs(fx[0]) == 0.5] = 0  # the last frequency has no direction
    slope2 = gradient.sum() / 512**4 / 4
    expected = (noise[0, 0] + noise[1, 1] - 2 * noise[0, 1]) / (4 * slope2 * 100.0)
    # 128 frequencies stand for 512, and the last one is counted by one side only: a few percent.
    assert got.sigma_px[0] ** 2 == pytest.approx(expected, rel=0.06)


def test_more_light_less_blur_and_more_baseline_measure_better():
    z = np.array([1400.0, 1800.0])
    halves = expected_accuracy(DESIGNS["cy_halves"], CAMERA, z)
    assert halves.sigma_px[0] > halves.sigma_px[1]
    bright = expected_accuracy(DESIGNS["cy_halves"], CAMERA, z, exposure=4.0)
    assert (bright.sigma_px < halves.sigma_px).all()
    opened = expected_accuracy(DESIGNS["cy_open"], CAMERA, z)
    assert (opened.sigma_mm > halves.sigma_mm).all()
    assert np.isinf(expected_accuracy(DESIGNS["open"], CAMERA, z).sigma_mm).all()


def test_the_table_says_what_the_functions_say():
    result = CliRunner().invoke(app(), ["apertures", "cy_halves", "open", "--json", "--at-mm", "4000"])
    assert result.exit_code == 0, result.output
    halves, bare = json.loads(result.output)
    assert halves["efficiency_mean"] == pytest.approx(0.465, abs=1e-3)  # three figures in docs/optics.md
    # The grid over the pupil is good to 4e-4, of 21 mm.
    assert halves["baseline_mm"] == pytest.approx(8 / (3 * math.pi) * 12.4186, abs=0.02)
    assert halves["disparity_px"][0] > 1
    for name in ("baseline_mm", "disparity_px", "disparity_px_per_mm", "depth_sigma_mm"):
        assert bare[name] is None  # without film there is nothing to measure
    assert "cy_halves" in CliRunner().invoke(app(), ["apertures", "cy_halves"], env={"COLUMNS": "200"}).output


def test_the_design_of_the_least_bound_is_recommended():
    bounds = {design.name: expected_accuracy(design, CAMERA, np.array([1000.0, 3000.0])).sigma_mm
              for design in (made_of(known, USUAL_FILM) for known in DESIGNS.values())}  # fmt: skip
    best = min(bounds, key=lambda name: np.log(bounds[name]).mean())
    output = CliRunner().invoke(app(), ["apertures", "--at-mm", "1000", "--at-mm", "3000"]).output
    assert f"Recommended of these: {best}," in output
    assert "Recommended" not in CliRunner().invoke(app(), ["apertures", "open"]).output


@pytest.mark.parametrize("name", [name for name, design in DESIGNS.items() if design.parts])
def test_outlines_enclose_the_area_of_their_shapes(name):
    x, y = np.meshgrid(*[(np.arange(400) + 0.5) / 200 - 1] * 2)
    for part in DESIGNS[name].parts:
        area = 0.0
        for loop in outline(part.shape):
            (x0, y0), (x1, y1) = loop.T, np.roll(loop, -1, axis=0).T
            area += 0.5 * np.sum(x0 * y1 - y0 * x1)  # signed: the hole of a ring must run the other way round
        expected = (part.shape.contains(x, y) & (np.hypot(x, y) < 1)).mean() * 4
        assert abs(area) == pytest.approx(expected, abs=5e-3)  # 400 cells across


@pytest.fixture(scope="module")
def template_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("template") / "cut.svg"
    write_template(path, DESIGNS["rgb_circles"], pupil_diameter_mm=20.0)
    return path


def drawn_path(root, gid):
    """Path data of a drawn element, in points from the page's top-left corner."""
    (group,) = (element for element in root.iter() if element.get("id") == gid)
    (path,) = (element for element in group.iter() if element.tag.endswith("path"))
    return path.get("d")


def numbers(text):
    return np.array([float(v) for v in re.findall(r"-?[0-9.]+", text)])


def test_a_template_is_drawn_at_its_true_size(template_file):
    root = ElementTree.parse(template_file).getroot()
    page_points = np.array([210.0, 297.0]) * 72 / 25.4
    # Matplotlib writes six decimals of a point.
    np.testing.assert_allclose(numbers(root.get("viewBox"))[2:], page_points, atol=1e-5)
    np.testing.assert_allclose([float(root.get(side).removesuffix("pt")) for side in ("width", "height")], page_points,
                               atol=1e-5)  # fmt: skip
    x, y = numbers(drawn_path(root, "assembled-pupil")).reshape(-1, 2).T * 25.4 / 72
    # Outermost points of the circle's Bezier curves; their knots lie on the axes.
    np.testing.assert_allclose([np.ptp(x), np.ptp(y)], 20.0, atol=1e-4)
    np.testing.assert_allclose([x.min(), y.min()], [10 + 38 / 2 - 10, 40 + 44 / 2 - 10], atol=1e-4)


def test_the_pdf_has_the_page_and_the_scale_of_the_svg(tmp_path):
    with matplotlib.rc_context({"pdf.compression": 0}):
        write_template(tmp_path / "cut.pdf", DESIGNS["rgb_circles"], pupil_diameter_mm=20.0)
    content = (tmp_path / "cut.pdf").read_bytes().decode("latin-1")
    # Six decimals of a point are written.
    page = numbers(re.search(r"/MediaBox \[([^\]]+)\]", content)[1])
    np.testing.assert_allclose(page * 25.4 / 72, [0, 0, 210, 297], atol=1e-5)  # as written
    bar = numbers(re.search(r"\n([\d. ]+ m\n[\d. ]+) l\n\nS", content)[1]) * 25.4 / 72  # the first line drawn
    np.testing.assert_allclose(bar, [10, 297 - 32, 60, 297 - 32], atol=1e-5)


def test_a_template_read_back_is_the_aperture(tmp_path, template_file):
    """The printed page is itself a drawing: its assembled pieces give the design again."""
    root = ElementTree.parse(template_file).getroot()
    x, y = numbers(drawn_path(root, "assembled-pupil")).reshape(-1, 2).T
    pupil = f'<circle id="pupil" cx="{(x.min() + x.max()) / 2}" cy="{(y.min() + y.max()) / 2}" r="{np.ptp(x) / 2}"/>'
    pieces = [
        f'<path fill="{colour}" d="{drawn_path(root, f"assembled-{i}")}"/>'
        for i, colour in enumerate(("red", "green", "blue"))
    ]
    (tmp_path / "back.svg").write_text(f"<svg>{pupil}{''.join(pieces)}</svg>")
    again, design = load_aperture(tmp_path / "back.svg"), DESIGNS["rgb_circles"]
    # The grid that integrates the pupil is good to 4e-4 on either side.
    np.testing.assert_allclose(channel_transmission(again), channel_transmission(design), atol=1e-3)
    np.testing.assert_allclose(centroids(again), centroids(design), atol=1e-3)


def test_templates_and_figures_are_written(tmp_path):
    runner = CliRunner()
    files = [tmp_path / name for name in ("cut.pdf", "cut.svg", "designs.png")]
    for file, option in zip(files, ("--template", "--template", "--figure"), strict=True):
        result = runner.invoke(app(), ["apertures", "cy_open_disc", option, str(file), "-q"])
        assert result.exit_code == 0, result.output
    assert files[0].read_bytes().startswith(b"%PDF")
    assert cv2.imread(str(files[2])).std() > 10
    with pytest.raises(InputError, match=r"\.svg or \.pdf"):
        write_template(tmp_path / "cut.txt", DESIGNS["open"], pupil_diameter_mm=10)
    with pytest.raises(InputError, match="does not fit"):
        write_template(tmp_path / "cut.svg", DESIGNS["open"], pupil_diameter_mm=300)
    both = runner.invoke(app(), ["apertures", "cy_halves", "open", "--template", str(files[1])])
    assert "exactly one" in str(both.exception)


def test_an_rgbd_picture_is_photographed(tmp_path):
    """A wall beyond focus with one bright spot: red moves right, blue left, by r times the centroid."""
    color = np.zeros((64, 96, 3), np.uint8)
    color[30:33, 46:49] = 255
    depth = np.full((64, 96), 4000, np.uint16)
    depth[:5] = 0  # unknown takes its neighbour's depth
    cv2.imwrite(str(tmp_path / "color.png"), color)
    cv2.imwrite(str(tmp_path / "depth.png"), depth)
    files = [str(tmp_path / name) for name in ("color.png", "depth.png", "coded.png")]
    result = CliRunner().invoke(app(), ["simulate-rgbd", *files, "--focal-px", "800", "--film", "ideal"])
    assert result.exit_code == 0, result.output
    light = np.maximum(linear(tmp_path / "coded.png") - 0.01, 0)
    x = (light * (np.arange(96) - 47.0)[None, :, None]).sum(axis=(0, 1)) / light.sum(axis=(0, 1))
    shift = 4 / (3 * math.pi) * 800 * 12.5 * (1 / 1950 - 1 / 4000)
    np.testing.assert_allclose(x, [shift, 0, -shift], atol=0.1)  # the noise floor is cut off


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (np.ones((8, 8), np.uint8), "16 bits"),
        (np.ones((8, 9), np.uint16), "differ in size"),
        (np.zeros((8, 8), np.uint16), "no depth at all"),
    ],
)
def test_rgbd_pictures_that_cannot_be(tmp_path, depth, message):
    cv2.imwrite(str(tmp_path / "color.png"), np.zeros((8, 8, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "depth.png"), depth)
    files = [str(tmp_path / name) for name in ("color.png", "depth.png", "coded.png")]
    result = CliRunner().invoke(app(), ["simulate-rgbd", *files, "--focal-px", "800"])
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)
    missing = CliRunner().invoke(app(), ["simulate-rgbd", "none.png", *files[1:], "--focal-px", "800"])
    assert "cannot read none.png" in str(missing.exception)

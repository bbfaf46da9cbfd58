"""Dual-pixel cameras from boards to millimetres by the command line: flat boards, a prescription, chessboards."""

import json
import shutil

import cv2
import numpy as np
import pytest
import tifffile

from chromaperture.calibration.flat_boards import calibrate_flat_boards
from chromaperture.calibration.session import read_session
from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.capture.open import open_source
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.dual_pixel_rays import HalfPixels, half_pixel_rays
from chromaperture.optics.pinhole import PupilCamera, focused_at, pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays, pinhole_rays
from chromaperture.settings.methods import AccurateConfig
from chromaperture.system.errors import InputError
from chromaperture.tasks import calibrate
from worlds import write_pair_session

CAMERA = PupilCamera(192, 128, 500.0, 12.0, 1000.0, 50.0, 0.1)
HALVES = HalfPixels(slope=0.5, half_slope_px=200.0)
NEAR, FAR = 600.0, 1600.0
# Px of half disparity, px mm: F R / mu times the centroid s / 4 of the ramps, in the middle of the frame
SCALE_PX_MM = 500.0 * 12.0 * HALVES.slope / 4


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    """A session of two flat boards through a thin lens."""
    folder = tmp_path_factory.mktemp("flat") / "session"
    rays = half_pixel_rays(pinhole_rays(CAMERA, DESIGNS["open"], cells=10), HALVES, pupil_radius_mm=12.0)
    write_pair_session(folder, rays, CAMERA, (NEAR, FAR))
    return folder


@pytest.fixture(scope="module")
def camera(flat, tmp_path_factory):
    path = tmp_path_factory.mktemp("camera") / "flat.asdf"
    calibrate(flat).save(path)
    return path


@pytest.fixture
def photographs(flat, tmp_path):
    """A folder with a copy of both boards' pairs."""
    return shutil.copytree(flat / "board", tmp_path / "photographs")


def test_flat_boards_give_millimetres_by_the_command_line(flat, photographs, run, tmp_path):
    made = run("calibrate", flat, "--out", tmp_path / "camera.asdf")
    assert made.returncode == 0, made.stderr
    assert "left and right are what they are called" in " ".join(made.stdout.split())
    out = tmp_path / "out"
    for _ in range(2):  # the second finds the results of the first
        found = run("depth", photographs, "--camera", tmp_path / "camera.asdf", "--out", out, "--quality", "accurate",
                    "--write", "depth,json")  # fmt: skip
        assert found.returncode == 0, found.stderr
    assert "Complete before" in found.stdout
    assert sorted(path.name for path in out.iterdir()) == [
        "0600.depth.tiff", "0600.json", "1600.depth.tiff", "1600.json",
    ]  # fmt: skip
    for ruler in (NEAR, FAR):
        depth = tifffile.imread(out / f"{ruler:04.0f}.depth.tiff")
        # From the sensor plane; pixel-locking of a curve through two boards stays within 2 %.
        assert np.nanmedian(depth) == pytest.approx(ruler, rel=0.02)
    assert json.loads((out / "0600.json").read_text())["image"] == "0600_left.png"


def test_the_curve_is_that_of_the_ramps(camera):
    found = Calibration.load(camera)
    curve = found.on_axis("accurate")
    # Texture of windows of 15 px sees the mean of ramps that fall towards the sides: 1 / (1 + (x / 200)^2).
    assert float(curve.scale_px_mm) == pytest.approx(SCALE_PX_MM, rel=0.1)
    assert found.in_focus_mm == pytest.approx(1000.0, rel=0.02)
    assert found.sensor.dual_pixel == "left-right"
    assert found.board is None
    assert found.pupil_title.startswith("halves of a dual-pixel")
    assert "0600_right.png" in str(sorted(found.provenance["files"]))


def test_explicit_halves_are_measured_as_those_found_by_name(photographs, camera, run, tmp_path):
    left, right = tmp_path / "one.png", tmp_path / "other.png"
    shutil.copy(photographs / "0600_left.png", left)
    shutil.copy(photographs / "0600_right.png", right)
    done = run("depth", "--left", left, "--right", right, "--camera", camera, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    eye = load_camera(camera, device="cpu")
    by_name = eye.measure(photographs / "0600_left.png")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out" / "one.depth.tiff"), by_name.depth_mm)
    np.testing.assert_array_equal(eye.measure(eye.read(left, right=right)).depth_mm, by_name.depth_mm)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--left", "0600_right.png", "--right", "0600_left.png"], "exchange the two"),
        (["--left", "0600_left.png"], "give the left and the right picture"),
        (["0600_left.png", "--left", "1600_left.png", "--right", "1600_right.png"], "and no others"),
        (["0600_right.png"], "give the left one"),
        (["alone_left.png"], "is missing"),
        (["single.png"], "is one picture, but this camera is a dual-pixel one"),
    ],
)
def test_what_is_no_pair_is_refused_in_one_line(photographs, camera, run, tmp_path, arguments, says):
    shutil.copy(photographs / "0600_left.png", photographs / "alone_left.png")
    cv2.imwrite(str(photographs / "single.png"), np.zeros((128, 192, 3), np.uint8))
    given = [photographs / name if name.endswith(".png") else name for name in arguments]
    done = run("depth", *given, "--camera", camera, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert says in " ".join(done.stderr.split())
    assert not list((tmp_path / "out").glob("*"))


def test_a_camera_with_film_takes_no_pair(photographs, session, calibrated_session, run, tmp_path):
    film = tmp_path / "film.asdf"
    calibrated_session.camera.save(film)
    pair = ["--left", photographs / "0600_left.png", "--right", photographs / "0600_right.png"]
    done = run("depth", *pair, "--camera", film)
    assert done.returncode == 2
    assert "this camera has film" in " ".join(done.stderr.split())


def test_halves_by_name_and_content_are_refused_by_a_camera_with_film(session, calibrated_session, tmp_path):
    shown = sorted((session / "board").iterdir())
    eye = CodedApertureCamera(calibrated_session.camera)
    for side, board in (("left", shown[0]), ("right", shown[0])):
        shutil.copy(board, tmp_path / f"a_{side}.png")
    with pytest.raises(InputError, match="look like the halves"):
        eye.read(tmp_path / "a_left.png")
    rows = cv2.imread(str(shown[-1]), cv2.IMREAD_UNCHANGED)  # two views of a thing may be called so
    darker = (rows * np.linspace(0.3, 1, len(rows))[:, None, None]).astype(rows.dtype)
    cv2.imwrite(str(tmp_path / "a_right.png"), darker)
    assert eye.read(tmp_path / "a_left.png").shape == (108, 144, 3)


def test_a_changed_right_half_is_measured_again(photographs, camera, run, tmp_path):
    command = ["depth", photographs, "--camera", camera, "--out", tmp_path / "out", "--write", "json"]
    run(*command)
    right = photographs / "1600_right.png"
    cv2.imwrite(str(right), np.roll(cv2.imread(str(right), cv2.IMREAD_UNCHANGED), 1, axis=0))
    again = run(*command)
    assert "0600_left.png" in again.stdout.split("Complete before")[1]
    assert "1600_left.png" not in again.stdout.split("Complete before")[1]


def test_an_older_program_refuses_the_camera_file(camera, calibrated_session, tmp_path):
    assert b"format_version: 2" in camera.read_bytes()
    calibrated_session.camera.save(tmp_path / "film.asdf")
    assert b"format_version: 1" in (tmp_path / "film.asdf").read_bytes()


def test_exchanged_files_are_found_by_the_boards(flat, camera, photographs, tmp_path):
    session = shutil.copytree(flat, tmp_path / "session")
    for left in (session / "board").glob("*_left.png"):
        right = left.with_name(left.name.replace("_left", "_right"))
        left.rename(tmp_path / "kept.png")
        right.rename(left)
        (tmp_path / "kept.png").rename(right)
    found = calibrate_flat_boards(read_session(session))
    assert found.camera.sensor.dual_pixel == "right-left"
    assert "exchanged" in found.notes[0]
    known = Calibration.load(camera)
    for quality in known.depth:
        np.testing.assert_allclose(
            found.camera.depth[quality].scale_px_mm, known.depth[quality].scale_px_mm, rtol=1e-6
        )


def test_boards_that_tell_no_curve_are_refused(flat, tmp_path):
    session = shutil.copytree(flat, tmp_path / "session")
    table = session / "distances.csv"
    table.write_text("file,ruler_mm\nboard/0600_left.png,600\n")
    with pytest.raises(InputError, match="two distances are needed"):
        calibrate(session)
    shutil.copy(session / "board/0600_left.png", session / "board/again_left.png")
    shutil.copy(session / "board/0600_right.png", session / "board/again_right.png")
    table.write_text("file,ruler_mm\nboard/0600_left.png,600\nboard/again_left.png,1600\n")
    with pytest.raises(InputError, match="same parallax"):
        calibrate(session)
    table.write_text("file,ruler_mm\nboard/0600_left.png,1600\nboard/1600_left.png,600\n")
    found = calibrate_flat_boards(read_session(session))
    assert found.camera.sensor.dual_pixel == "right-left"  # mistaken distances look like exchanged files


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("flat = true", "", "either square_mm"),
        ("flat = true", "flat = true\nsquare_mm = 30", "either square_mm"),
        ('dual_pixel = "left-right"', "", "either design"),
        ("[sensor]", 'design = "cy_halves"\n[sensor]', "either design"),
        ('dual_pixel = "left-right"', 'dual_pixel = "left"', "dual_pixel"),
        ("flat = true", 'square_mm = 30\nmeasured_from = "pupil"', "need flat = true"),
        ("[board]", "[depth]\nnear_mm = 900\nfar_mm = 500\n[board]", "near_mm must be below"),
        ("[board]", 'prescription = "no_such_lens"\n[board]', "unknown lens"),
    ],
)
def test_sessions_that_contradict_themselves_are_refused(flat, tmp_path, old, new, says):
    session = shutil.copytree(flat, tmp_path / "session")
    settings = session / "session.toml"
    settings.write_text(settings.read_text().replace(old, new))
    with pytest.raises(InputError, match=says):
        calibrate(session)


def test_distances_from_the_pupil_count_from_the_sensor_in_the_camera_file(flat, camera, tmp_path):
    session = shutil.copytree(flat, tmp_path / "session")
    settings, known = session / "session.toml", Calibration.load(camera)
    settings.write_text(settings.read_text() + 'measured_from = "pupil"\n[depth]\nnear_mm = 400\nfar_mm = 9000\n')
    pupil_mm = known.depth["accurate"].sensor_to_pupil_mm
    table = session / "distances.csv"
    table.write_text("".join(
        line if not line.endswith("0\n") else f"{line.split(',')[0]},{float(line.split(',')[1]) - pupil_mm}\n"
        for line in table.read_text().splitlines(keepends=True)
    ))  # fmt: skip
    found = calibrate(session)
    np.testing.assert_allclose(found.depth["accurate"].scale_px_mm, known.depth["accurate"].scale_px_mm, rtol=1e-6)
    assert found.in_focus_mm == pytest.approx(known.in_focus_mm, rel=1e-6)
    assert (found.near_mm, found.far_mm) == (400, 9000)


def test_a_prescription_gives_the_blur_and_the_boards_the_crosstalk(tmp_path):
    size = {"width_px": 192, "height_px": 128, "pixel_pitch_mm": 0.125}
    lens = focused_at(load_lens("double_gauss_50"), 1000.0)
    pupil = pupil_camera(lens, **size)
    table = lens_rays(lens, DESIGNS["open"], **size, cells=12)
    rays = half_pixel_rays(table, HALVES, pupil_radius_mm=pupil.pupil_radius_mm)
    between = 800.0
    write_pair_session(tmp_path, rays, pupil, (NEAR, between, FAR), lens="double_gauss_50")
    rows = (tmp_path / "distances.csv").read_text().splitlines()
    (tmp_path / "distances.csv").write_text("\n".join(row for row in rows if "0800" not in row) + "\n")
    found = calibrate_flat_boards(read_session(tmp_path), qualities=("accurate",))
    assert found.corrections is not None
    # Leaking film of the same centroid stands for the ramps: its blur has another shape, which the slope makes up for.
    x = np.arange(192) - 95.5
    mean = HALVES.slope_at(x).mean()
    assert found.corrections.halves.slope_at(x).mean() == pytest.approx(mean, rel=0.3)
    assert found.corrections.focus_mm == pytest.approx(found.corrections.designed_focus_mm, rel=0.04)
    assert found.camera.lens.focal_length_mm == pytest.approx(50.0, rel=0.05)
    path = tmp_path / "camera.asdf"
    found.camera.save(path)
    eye = load_camera(path, quality="accurate", device="cpu")
    assert isinstance(eye.config.matcher, AccurateConfig)
    assert eye.config.matcher.spectral.dual_pixel
    depth = eye.measure(tmp_path / f"board/{between:04.0f}_left.png").depth_mm
    assert np.nanmedian(depth) == pytest.approx(between, rel=0.03)


def test_chessboards_of_pairs_calibrate_and_check(tmp_path, run):
    rays = half_pixel_rays(pinhole_rays(CAMERA, DESIGNS["open"], cells=8), HALVES, pupil_radius_mm=12.0)
    session, camera = tmp_path / "session", tmp_path / "camera.asdf"
    write_pair_session(session, rays, CAMERA, (550.0, 650.0, 800.0, 1050.0, 1500.0, 2400.0), tilts=6)
    done = run("calibrate", session, "--out", camera, "--no-report")
    assert done.returncode == 0, done.stderr + done.stdout
    found = Calibration.load(camera)
    assert found.blur is None
    assert found.board is not None
    assert found.in_focus_mm == pytest.approx(1000.0, rel=0.03)
    near = session / "board" / "0550_left.png"
    assert run("check", near, "--camera", camera).returncode == 0
    turned = run("check", "--left", shutil.copy(session / "board" / "0550_right.png", tmp_path / "a.png"),
                 "--right", shutil.copy(near, tmp_path / "b.png"), "--camera", camera)  # fmt: skip
    assert turned.returncode == 1
    assert "exchanged" in " ".join(turned.stdout.replace("│", " ").split())


def test_streams_have_no_halves(camera):
    encoding = Calibration.load(camera).sensor.encoding
    with pytest.raises(InputError, match="takes two"):
        open_source("webcam:0", camera_encoding=encoding)

"""Photographs by cameras that were changed since their calibration; the thin-lens simulator takes them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from chromaperture.capture.exif import Exif, read_exif
from chromaperture.depth.conversion import DepthModel
from chromaperture.evaluation.checks import is_healthy, measure_tint
from chromaperture.evaluation.health import check_camera, outcome
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import Board
from chromaperture.optics.aperture import DESIGNS, centroids, made_of
from chromaperture.optics.pinhole import PupilCamera, focused_at
from chromaperture.optics.prescription import load_lens, with_filter_at
from chromaperture.optics.ray_table import lens_rays, pinhole_rays
from chromaperture.optics.simulator.render import render
from chromaperture.optics.simulator.scene import plane
from chromaperture.optics.simulator.session import wall
from chromaperture.system.errors import InputError
from worlds import halves_camera

WIDTH, HEIGHT = 300, 200
CAMERA = PupilCamera(WIDTH, HEIGHT, 700.0, 12.5, 2000.0, 52.0, 0.0743)
DESIGN = DESIGNS["cy_halves"]
BOARD = Board((9, 6), 30.0)
NEAR_MM = 1300.0


@pytest.fixture(scope="module")
def calibration():
    """The camera as it was, from its geometry alone: the centroid of a half disc lies 4 / (3 pi) off the middle."""
    reach = 4 / (3 * np.pi)
    # The grid of the pupil is good to 1e-3.
    assert np.abs(centroids(DESIGN)[:, 0]).max() == pytest.approx(reach, abs=0.01)
    scale = reach * CAMERA.focal_px * CAMERA.pupil_radius_mm
    model = DepthModel(scale / (CAMERA.focus_mm - CAMERA.sensor_to_pupil_mm), scale, CAMERA.sensor_to_pupil_mm)
    camera = halves_camera(model, WIDTH, HEIGHT, focal_px=CAMERA.focal_px, pixel_pitch_mm=CAMERA.pixel_pitch_mm,
                           far_mm=4000.0)  # fmt: skip
    film = replace(camera.film, aperture=np.array([0.5, 1.0, 0.5]))
    return replace(camera, lens=replace(camera.lens, f_number=2.1), film=film)


def photographed(camera, distance_mm=NEAR_MM, *, turned=False):
    picture = render(pinhole_rays(camera, DESIGN, cells=10), wall(camera, (0, 0, distance_mm), (0, 0, 0)))
    picture = np.asarray(picture, np.float32)
    picture = 0.9 * picture / picture.max()
    picture = picture + np.random.default_rng(5).normal(0, 0.003, picture.shape)
    # Cyan and yellow change places with red and blue: the film is turned by 180 degrees.
    return picture[..., ::-1].astype(np.float32).copy() if turned else picture.astype(np.float32)


@pytest.fixture(scope="module")
def near():
    return photographed(CAMERA)


def by_name(checks):
    return {check.name: check for check in checks}


def test_the_camera_as_calibrated_is_healthy(near, calibration):
    checks = by_name(check_camera(near, calibration, board=BOARD))
    assert is_healthy(list(checks.values()))
    seen = checks["board distance"]
    assert seen.verdict == "ok"
    # Corners of squares of 17 px behind 2.5 px of blur: 0.1 px in a square is 0.6 % of the distance.
    assert seen.figures["pose_mm"] == pytest.approx(NEAR_MM, rel=0.006)
    assert checks["filter orientation"].verdict == "ok"
    assert checks["tint over the frame"].verdict == "ok"


@pytest.mark.parametrize("focus_mm", [1600.0, 2800.0])
def test_a_refocused_camera_warns_and_says_where_the_focus_is(calibration, focus_mm):
    image = photographed(replace(CAMERA, focus_mm=focus_mm))
    checks = by_name(check_camera(image, calibration, board=BOARD))
    seen = checks["board distance"]
    assert seen.verdict == "warn"
    # 0.08 px, the blur's bias of disparity, move a focus at 2.8 m by 0.08 z^2 / B = 170 mm, one at 1.6 m by 53 mm.
    tolerance = 0.08 * focus_mm**2 / float(calibration.on_axis("real-time").scale_px_mm)
    assert seen.figures["in_focus_if_refocused_mm"] == pytest.approx(focus_mm, abs=tolerance)  # derived above
    assert "calibrate again" in seen.advice


def test_a_closed_iris_warns_and_says_by_how_much(calibration):
    image = photographed(replace(CAMERA, pupil_radius_mm=8.0))
    seen = by_name(check_camera(image, calibration, board=BOARD))["board distance"]
    assert seen.verdict == "warn"
    # 0.08 px of bias in the 1.0 px that are left
    assert seen.figures["scale_if_aperture_changed"] == pytest.approx(8.0 / 12.5, abs=0.08)


def test_a_turned_filter_is_told_from_a_moved_focus(calibration):
    checks = by_name(check_camera(photographed(CAMERA, turned=True), calibration, board=BOARD))
    assert checks["filter orientation"].verdict == "warn"
    assert "180" in checks["filter orientation"].advice
    assert not is_healthy(list(checks.values()))


def test_a_wrong_square_is_named(near, calibration):
    """Corners are believed 25/30 as far; the calibration's square makes them agree with the disparity."""
    kept = replace(calibration, board=BOARD)
    seen = by_name(check_camera(near, kept, board=Board((9, 6), 25.0)))["board distance"]
    assert seen.verdict == "warn"
    # 0.08 px of the blur's bias in the 2.5 px that a board at this distance has from infinity: 3 %.
    assert seen.figures["square_if_another_mm"] == pytest.approx(30.0, rel=0.03)
    assert "--square-mm 30" in seen.advice
    assert "focus" not in seen.advice
    unknown = by_name(check_camera(near, calibration, board=Board((9, 6), 25.0)))["board distance"]
    assert "squares have another size" in unknown.advice


def test_a_distance_that_is_too_far_to_be_measured_is_not_a_number(near, calibration):
    """By this curve the disparity of the near board is 0.02 px from that of infinity: 370 m."""
    true = calibration.on_axis("real-time")
    scale, delta = float(true.scale_px_mm), float(true.sensor_to_pupil_mm)
    infinity = float(true.infinity_disparity_px) - scale / (NEAR_MM - delta) + 0.02
    other = halves_camera(
        DepthModel(infinity, scale, delta), WIDTH, HEIGHT, focal_px=CAMERA.focal_px,
        pixel_pitch_mm=CAMERA.pixel_pitch_mm, far_mm=4000.0,
    )  # fmt: skip
    seen = by_name(check_camera(near, replace(other, film=calibration.film), board=BOARD))["board distance"]
    assert seen.verdict == "warn"
    # The tolerance is 6 % of the 4.0 px that were expected, and B 3710 px mm: 15.4 m. Two digits are said.
    assert " beyond 15000 mm by its disparity;" in seen.finding
    assert np.isinf(seen.figures["depth_mm"])
    assert "squares have another size" not in seen.advice


def test_a_photograph_with_a_gamma_curve_is_not_taken_for_a_moved_focus(near, calibration):
    seen = by_name(check_camera(near, calibration, board=BOARD))["linear light"]
    assert seen.verdict == "ok"
    assert seen.figures["rms_exponent_error"] < 0.1
    encoded = np.clip(near, 0, 1) ** np.float32(1 / 2.2)
    checks = by_name(check_camera(encoded, calibration, board=BOARD))
    assert checks["linear light"].verdict == "warn"
    assert "powers" in checks["linear light"].finding
    others = [c for c in checks.values() if c.verdict == "warn" and c.name != "linear light"]
    assert all(c.advice == "see the linear light first" for c in others)
    in_focus = photographed(CAMERA, CAMERA.focus_mm)
    assert by_name(check_camera(in_focus, calibration, board=BOARD))["linear light"].verdict == "cannot tell"


def test_another_film_is_named_instead_of_the_focus(calibration):
    table = pinhole_rays(CAMERA, made_of(DESIGNS["cy_open"], "real"), cells=10)
    picture = np.asarray(render(table, wall(CAMERA, (0, 0, NEAR_MM), (0, 0, 0))), np.float32)
    checks = by_name(check_camera(0.9 * picture / picture.max(), calibration, board=BOARD))
    assert checks["film"].verdict == "warn"
    assert checks["board distance"].advice == "see the film first"


def test_without_a_board_nothing_is_certain(near, calibration):
    blank = check_camera(np.full_like(near, 0.3), calibration, board=BOARD)
    assert "no board" in by_name(blank)["board distance"].finding
    assert outcome(blank) == 2
    assert outcome(check_camera(np.full_like(near, 1.0), calibration, board=BOARD)) == 1  # saturated: it warns


def test_near_the_focus_the_orientation_cannot_be_told(calibration):
    checks = by_name(check_camera(photographed(CAMERA, 1950.0), calibration, board=BOARD))
    assert checks["board distance"].verdict == "ok"
    assert checks["filter orientation"].verdict == "cannot tell"


@pytest.mark.parametrize(("offset_mm", "tinted"), [(0.0, False), (4.0, True), (-25.0, True)])
def test_a_filter_off_the_stop_tints_a_white_sheet(calibration, offset_mm, tinted):
    lens = focused_at(load_lens("double_gauss_50"), 2000)
    lens = with_filter_at(lens, offset_mm) if offset_mm else lens
    table = lens_rays(lens, DESIGN, width_px=WIDTH, height_px=HEIGHT, pixel_pitch_mm=22.3 / WIDTH, cells=12)
    sheet = [plane(np.ones((2, 2, 3), np.float32), center_mm=(0, 0, 500.0), width_mm=4000)]
    image = np.asarray(render(table, sheet), np.float32)
    check = by_name(check_camera(0.8 * image / image.max(), calibration))["tint over the frame"]
    assert check.verdict == ("warn" if tinted else "ok")


def test_the_ramp_of_a_tint_comes_back(rng):
    x = np.linspace(-1, 1, 240)[None, :, None]
    image = 0.5 * np.exp(x * np.array([0.2, 0.0, -0.1])) * np.exp(rng.normal(0, 0.05, (160, 240, 1)))
    tint = measure_tint(image.astype(np.float32))
    assert tint.ramp == pytest.approx(np.expm1(0.3), rel=0.05)  # red against blue: 0.2 + 0.1; cells are 1/12 wide


def test_a_coloured_scene_is_not_called_tinted(rng, calibration):
    blocks = rng.uniform(0.1, 0.8, (8, 12, 3)).astype(np.float32)
    image = cv2.resize(blocks, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
    assert by_name(check_camera(image, calibration))["tint over the frame"].verdict == "cannot tell"


def test_another_resolution_is_named_and_the_rest_left_open(near, calibration):
    small = cv2.resize(near, (WIDTH // 2, HEIGHT // 2), interpolation=cv2.INTER_AREA)
    checks = by_name(check_camera(small, calibration, board=BOARD))
    assert checks["resolution"].verdict == "warn"
    assert checks["board distance"].verdict == "cannot tell"
    turned = by_name(check_camera(np.swapaxes(near, 0, 1).copy(), calibration))
    assert "turned" in turned["resolution"].advice


def test_exposure(near, calibration):
    assert by_name(check_camera(np.minimum(3 * near, 1), calibration))["exposure"].verdict == "warn"
    assert by_name(check_camera(0.02 * near, calibration))["exposure"].verdict == "warn"


@pytest.mark.parametrize(
    ("exif", "verdicts"),
    [
        (Exif(), ["cannot tell"] * 3),
        (Exif(50.0, 2.1, 2000.0), ["ok"] * 3),
        (Exif(35.0, 2.8, 1500.0), ["warn"] * 3),
        (Exif(focal_length_mm=50.0, f_number=2.8), ["ok", "warn", "cannot tell"]),
    ],
)
def test_settings_from_the_file(near, calibration, exif, verdicts):
    checks = by_name(check_camera(near, calibration, exif=exif))
    assert [checks[f"{n} (EXIF)"].verdict for n in ("focal length", "aperture", "focus")] == verdicts


def test_a_camera_that_was_never_calibrated_is_refused(near):
    with pytest.raises(InputError, match="calibrate"):
        check_camera(near, Calibration.uncalibrated("cy_halves", width_px=WIDTH, height_px=HEIGHT))


def jpeg(path, image, *, subsampling, tags=None):
    exif = Image.Exif()
    exif.get_ifd(0x8769).update(tags or {})
    Image.fromarray((255 * np.clip(image, 0, 1) ** (1 / 2.2)).astype(np.uint8)).save(
        path, quality=95, subsampling=subsampling, exif=exif
    )


def test_exif_is_read(tmp_path, near):
    jpeg(tmp_path / "a.jpg", near, subsampling=0, tags={37386: 50.0, 33437: 2.0, 37382: 2.5})
    assert read_exif(tmp_path / "a.jpg") == Exif(50.0, 2.0, 2500.0)
    jpeg(tmp_path / "b.jpg", near, subsampling=0, tags={37382: 0.0})  # 0 stands for unknown
    assert read_exif(tmp_path / "b.jpg") == Exif()
    (tmp_path / "c.jpg").write_bytes(b"not a picture")
    assert read_exif(tmp_path / "c.jpg") == Exif()


def test_the_exit_code_tells(run, tmp_path, near, calibration):
    calibration.save(tmp_path / "camera.asdf")
    counts = np.clip(near * 65535, 0, 65535).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "good.png"), counts[..., ::-1])
    common = ("--camera", tmp_path / "camera.asdf", "--square-mm", "30")
    result = run("check", tmp_path / "good.png", *common)
    assert result.returncode == 0
    assert "board distance" in result.stdout
    result = run("check", tmp_path / "good.png", "--camera", tmp_path / "camera.asdf")
    assert result.returncode == 2
    assert "Cannot tell" in result.stdout
    replace(calibration, board=BOARD).save(tmp_path / "with_board.asdf")
    result = run("check", tmp_path / "good.png", "--camera", tmp_path / "with_board.asdf", "--json")
    assert result.returncode == 0
    assert '"exit_code": 0' in result.stdout
    jpeg(tmp_path / "bad.jpg", near, subsampling=2)
    result = run("check", tmp_path / "bad.jpg", *common, "--json")
    assert result.returncode == 1
    assert '"ok": false' in result.stdout
    assert "4:2:0" in result.stdout
    for wrong in (("--board", "nine"), ("--square-mm", "0"), ("--camera", tmp_path / "none.asdf")):
        result = run("check", tmp_path / "good.png", *common, *wrong)
        assert result.returncode == 2
        assert result.stderr.count("\n") == 1

"""A session of simulated boards comes back as the camera that took it."""

import contextlib
import hashlib
import shutil
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.calibration.chessboard import board_points, fit_intrinsics
from chromaperture.calibration.curves import curve_without_blur, weaknesses
from chromaperture.calibration.fit_fields import check_scale, fit_depth_model
from chromaperture.calibration.options import Cache, CalibrationConfig, silent
from chromaperture.calibration.place_boards import Pinhole, measure_pinhole, place_boards
from chromaperture.calibration.session import read_session
from chromaperture.calibration.white_sheets import FILM_ERROR, measure_white_sheets
from chromaperture.color.unmixing import own_film_unmixing
from chromaperture.depth.conversion import disparity_to_depth
from chromaperture.depth.field import DepthField
from chromaperture.evaluation import verdict
from chromaperture.matching.views import view_spaces
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import CameraSensor
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.settings.methods import preset
from chromaperture.system.errors import InputError
from worlds import INFINITY_PX, PUPIL_MM, RULERS_MM, SCALE_PX_MM, SESSION_TOML, render_boards

SHARP = CalibrationConfig(lens_blur=False)
calibrated = partial(calibrate_session, config=SHARP)  # these boards are shifted views, nothing blurred them
IN_FOCUS_MM = SCALE_PX_MM / INFINITY_PX + PUPIL_MM


def test_the_curve_comes_back(calibrated_session):
    result = calibrated_session
    for quality, fit in result.fits.items():
        # Pixels of one board share their texture: the middle's median is good to about 0.02 px, 3 mm at 1.5 m.
        assert np.abs(fit.residual_px).max() < 0.03, quality
        model = fit.model
        for z in (1200.0, 2000.0, 2800.0):
            true = INFINITY_PX - SCALE_PX_MM / (z - PUPIL_MM)
            found = model.infinity_disparity_px - model.scale_px_mm / (z - model.sensor_to_pupil_mm)
            assert found == pytest.approx(true, abs=0.03), quality  # as the residuals; 0.007 is found
    calibration = result.calibration
    assert calibration.in_focus_mm == pytest.approx(IN_FOCUS_MM, abs=12)  # 0.03 px there
    assert any("white sheet" in note for note in result.notes)
    assert any("intrinsics" in note for note in result.notes)
    assert any("how noise grows" in note for note in result.notes)  # these sheets have none


def copy_with(session, tmp_path, **files):
    folder = tmp_path / "copy"
    shutil.copytree(session, folder)
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(text)
    return folder


def distances(rulers_mm):
    """The table of a session whose boards were measured to be at these distances."""
    rows = (f"board/{name}.png,{ruler}" for name, ruler in zip(RULERS_MM, rulers_mm, strict=True))
    return "\n".join(("file,ruler_mm", *rows)) + "\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("files", "word"),
    [
        ({"session__toml": "design = 'cy_thirds'"}, "sensor is missing"),
        ({"session__toml": SESSION_TOML.replace("ruler_error_mm", "ruler_eror_mm")}, "did you mean 'ruler_error_mm'"),
        ({"session__toml": SESSION_TOML.replace("= 144", "= 144.0")}, "sensor.width_px must be a whole number"),
        ({"session__toml": SESSION_TOML.replace("= 144", "= 1" + 30 * "0")}, "sensor.width_px"),
        ({"session__toml": SESSION_TOML.replace("[9, 6]", "[9, '6']")}, "inner_corners 2 must be a whole number"),
        ({"session__toml": SESSION_TOML.replace("cy_halves", "n" * 300)}, "design"),
        ({"distances__csv": "file,ruler_mm\nboard/1150.png,nan\n"}, "must be positive"),
        ({"distances__csv": "file,ruler_mm\n" + "n" * 5000 + ",1000\n"}, "not there: nnn"),
        ({"distances__csv": "file,ruler_mm\n" + "n" * 200_000 + ",1000\n"}, "must have the columns"),
        ({"session__toml": SESSION_TOML.replace("cy_halves", "magenta_annulus")}, "no parallax|shifts no channel"),
        ({"session__toml": SESSION_TOML.replace("cy_halves", "cy_thirds")}, "cy_halves"),
        ({"session__toml": SESSION_TOML.replace("[lens]", "[lense]")}, "lens"),
        ({"session__toml": SESSION_TOML.replace("= 0.031", "= 'small'")}, "pixel_pitch_mm"),
        ({"session__toml": SESSION_TOML.replace("= 144", "= 145")}, "145x108"),
        ({"session__toml": SESSION_TOML.replace("= 1950", "= 60")}, "focal length"),
        ({"distances__csv": distances(r / 10 for r in RULERS_MM)}, "look like cm"),
        ({"distances__csv": distances(r / 1000 for r in RULERS_MM)}, "like m,"),
        ({"session__toml": "design = ["}, r"session\.toml"),
        ({"distances__csv": "file,ruler_cm\nboard/1150.png,115\n"}, "ruler_mm"),
        ({"distances__csv": "file,ruler_mm\nboard/1150.png,far\n"}, "'far' is no distance"),
        ({"distances__csv": "file,ruler_mm\nboard/9999.png,9999\n"}, r"9999\.png"),
        ({"distances__csv": "file,ruler_mm\nboard/1150.png,1150\nboard/1400.png,1400\n"}, "2 usable boards"),
        ({"distances__csv": distances(RULERS_MM[::-1])}, "swapped"),
    ],
)
def test_sessions_that_cannot_be_used_say_why(session, tmp_path, files, word):
    with pytest.raises(InputError, match=word):
        calibrated(copy_with(session, tmp_path, **files))


@pytest.mark.parametrize(("slope", "runs_away"), [(0.5, False), (0.95, True), (1.2, True)])
def test_a_field_that_runs_away_is_refused(slope, runs_away):
    """B = B0 (1 + slope x) with x from -1 to 1 over the frame: 0.05 B0 and less at one side is no lens."""
    field = DepthField(np.array([5.0, 0, 0, 0, 0, 0]), np.array([9000.0, 0, 0, 9000 * slope, 0, 0]), 50.0, np.eye(3))
    with pytest.raises(InputError, match=r"runs away|positive") if runs_away else contextlib.nullcontext():
        check_scale(field, (144, 108))


@pytest.mark.parametrize("mixed", ["sheet_c", "cy_halves"])
def test_white_sheets_that_were_mixed_up_are_named(session, tmp_path, mixed):
    """Film never brightens: the sheet through the open pupil is the brightest, at one exposure."""
    folder = copy_with(session, tmp_path)
    for name, level in (("open", 40_600), (mixed, 54_100)):
        sheet = np.full((108, 144, 3), level, np.uint16)
        cv2.imwrite(str(folder / "white" / f"{name}.png"), sheet)
    with pytest.raises(InputError, match=r"1\.33 times as bright .* mixed up"):
        measure_white_sheets(read_session(folder))


@pytest.mark.parametrize("clipped", [0, 2])
def test_a_saturated_white_sheet_is_refused(session, tmp_path, clipped):
    """In any channel, in the middle; a hot pixel is not that."""
    folder = copy_with(session, tmp_path)
    sheet = np.tile(np.array([30_000, 29_000, 28_000], np.uint16), (108, 144, 1))
    sheet[54, 72, 1] = 65_535
    for name in ("open", "cy_halves", "sheet_c", "sheet_y"):
        cv2.imwrite(str(folder / "white" / f"{name}.png"), sheet)
    measure_white_sheets(read_session(folder))
    sheet[..., clipped] = 65_535
    cv2.imwrite(str(folder / "white" / "open.png"), sheet)
    with pytest.raises(InputError, match=r"open\.png is saturated: photograph all"):
        measure_white_sheets(read_session(folder))


@pytest.mark.parametrize(
    "text",
    ["\ufefffile;ruler_mm\nboard/1150.png;1150,5\n", "file\truler_mm\nboard/1150.png\t1150.5\n",
     'file, ruler_mm\nboard/1150.png, "1150,5"\n'],
)  # fmt: skip
def test_tables_of_spreadsheets_are_read(session, tmp_path, text):
    boards = read_session(copy_with(session, tmp_path, distances__csv=text)).boards
    assert {path.name: ruler for path, ruler in boards.items()} == {"1150.png": 1150.5}


@pytest.mark.parametrize(
    ("row", "word"),
    [(",1150,5", "line 2 has more values than columns; write 1000.5"), (';"1,150"', "without a mark"),
     (",45 in", "'45 in' is no distance in mm")],
)  # fmt: skip
def test_numbers_that_may_mean_two_things_are_refused(session, tmp_path, row, word):
    text = f"file{row[0]}ruler_mm\nboard/1150.png{row}\n"
    with pytest.raises(InputError, match=word):
        read_session(copy_with(session, tmp_path, distances__csv=text))


def test_a_phone_that_changed_its_lens_is_named(session, tmp_path):
    folder = copy_with(session, tmp_path)
    names = [path.name for path in read_session(folder).boards]
    text = (folder / "distances.csv").read_text().replace(".png", ".jpg")
    (folder / "distances.csv").write_text(text)
    for name, focal_mm in zip(names, [6.9, 6.9, 2.2, 6.9, 6.9], strict=True):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0x920A] = focal_mm
        Image.new("RGB", (144, 108), (90, 120, 80)).save(folder / "board" / name.replace(".png", ".jpg"), exif=exif)
    with pytest.raises(InputError, match=r"focal length, mm, of 1800\.jpg is 2\.2, that of 1150\.jpg 6\.9"):
        read_session(folder)


def test_squares_that_were_counted_for_corners_are_said(session, tmp_path):
    text = SESSION_TOML.replace("[9, 6]", "[10, 7]")
    counted = read_session(copy_with(session, tmp_path, session__toml=text))
    board = np.full((108, 144), 40_000, np.uint16)
    board[12:96, 12:132] = np.kron(np.indices((7, 10)).sum(axis=0) % 2, np.full((12, 12), 35_000)) + 4000
    for path in counted.boards:
        assert cv2.imwrite(str(path), np.dstack([board, board - 3000, board - 1500]))
    with pytest.raises(InputError, match=r"inner_corners = \[9, 6\]"):
        measure_pinhole(counted, None, cache=Cache(None), progress=silent)


@pytest.mark.parametrize("printed", [1.0, 0.96])
def test_a_board_that_was_not_printed_at_its_size_is_said(session, rng, printed):
    """Tilted boards tell the focal length whatever the squares; rulers then tell the squares."""
    size, focal_px = (720, 480), 1650.0
    matrix = np.array([[focal_px, 0, 359.5], [0, focal_px, 239.5], [0, 0, 1]])
    stated = replace(
        read_session(session), sensor=CameraSensor(*size, 0.031, 0.0, 65535.0), square_mm=30.0,
        boards={Path(f"{mm}.png"): float(mm) for mm in (1200, 1600, 2100, 2800)},
        tilts=tuple(Path(f"t{i}.png") for i in range(10)),
    )  # fmt: skip
    grid = board_points(stated.inner_corners, 30.0 * printed)
    grid = grid - grid.mean(axis=0)

    def corners(turn, distance_mm):
        seen, _ = cv2.projectPoints(grid, np.array(turn), np.array([0.0, 0.0, distance_mm]), matrix, np.zeros(5))
        return (seen.reshape(-1, 2) + rng.normal(0, 0.05, (len(grid), 2))).astype(np.float32)

    found = {path: corners((0.35 * np.sin(i), 0.4 * np.cos(i), 0.1), 1700.0) for i, path in enumerate(stated.tilts)}
    found |= {path: corners((0.0, 0.0, 0.0), ruler - 50.0) for path, ruler in stated.boards.items()}  # from the pupil
    intrinsics = fit_intrinsics([found[path] for path in stated.tilts], size, stated.inner_corners, stated.square_mm)
    placed = place_boards(stated, Pinhole(intrinsics, found, ()), CalibrationConfig())
    assert placed.square_mm == pytest.approx(30.0 * printed, rel=0.01)  # the focal length is good to .3 %
    assert placed.intrinsics.camera_matrix[0, 0] == pytest.approx(focal_px, rel=0.01)
    assert any("your squares are 28.8 mm" in note for note in placed.notes) == (printed < 1)


@pytest.mark.slow
def test_film_without_a_sheet_is_in_the_error_bar_and_in_the_notes(session, tmp_path):
    folder = copy_with(session, tmp_path)
    (folder / "white" / "sheet_c.png").unlink()
    result = calibrated(folder)
    assert any("no sheet of cyan" in note for note in result.notes)
    model = result.calibration.depth["real-time"].on_axis(144, 108)
    disparity = np.array([-1.0, 1.0])
    depth, sigma = disparity_to_depth(disparity, model, np.zeros(2))
    slope = float(model.scale_px_mm) / (depth - float(model.sensor_to_pupil_mm)) ** 2  # px per mm
    assert (sigma >= FILM_ERROR * np.abs(disparity) / slope).all()  # of the film alone, beside that of the fit
    assert (sigma < 2 * FILM_ERROR * np.abs(disparity) / slope).all()


@pytest.mark.slow
@pytest.mark.parametrize(("board", "wrong_mm"), [(1800, 2060), (RULERS_MM[0], 1000)])
def test_a_board_off_its_ruler_is_named_and_left_out(session, tmp_path, board, wrong_mm):
    rows = distances(wrong_mm if r == board else r for r in RULERS_MM)
    result = calibrated(copy_with(session, tmp_path, distances__csv=rows))
    assert list(result.outliers) == [f"{board}.png"]
    assert any(f"{board}.png" in note and "off its ruler" in note for note in result.notes)
    assert result.evidence.used.sum() == len(RULERS_MM) - 1
    assert result.calibration.in_focus_mm == pytest.approx(IN_FOCUS_MM, abs=20)  # four boards are left
    used = [ruler for ruler in RULERS_MM if ruler != board]
    assert result.calibration.near_mm == min(used) * result.config.range_margin[0]
    assert result.calibration.far_mm == max(used) * result.config.range_margin[1]


@pytest.mark.slow
def test_a_lens_focused_at_infinity_is_calibrated(tmp_path):
    """Every board stands nearer than the focus, nothing can stand beyond it: no advice to photograph there."""
    camera = PupilCamera(192, 128, 450.0, 12.5, np.inf, 50.0, 0.1)
    rulers_mm = (1000, 1250, 1600, 2200, 3600)
    render_boards(tmp_path / "session", camera, rulers_mm, film="ideal")
    result = calibrated(tmp_path / "session")
    model = result.fits["real-time"].model
    # 0 is the truth; the nearest board has 450 px * 12.5 mm * 4 / (3 pi) / 950 mm = 2.5 px, of which shifted views of
    # blurred halves are known to 2 %; .033 is found.
    assert float(model.infinity_disparity_px) == pytest.approx(0, abs=0.05)
    assert np.abs(result.fits["real-time"].residual_mm / rulers_mm).max() < 0.02  # likewise; .013
    assert not [note for note in result.notes if "in-focus" in note]
    assert not [sentence for sentence in verdict.weaknesses(result) if "than the focus" in sentence.text]


def test_boards_on_one_side_of_the_focus_leave_it_weak(calibrated_session):
    whole = calibrated_session
    assert weaknesses(whole.evidence, whole.fits) == tuple(n for n in whole.notes if "in-focus" in n)
    far = replace(whole.evidence, used=np.array([r > 1970 for r in RULERS_MM]))
    near = replace(whole.evidence, used=np.array([r < 1900 for r in RULERS_MM]))
    assert any("beyond the focus" in text and "nearer" in text for text in weaknesses(far, whole.fits))
    assert any("nearer than the focus" in text for text in weaknesses(near, whole.fits))


def test_boards_on_both_sides_of_the_focus_are_no_weakness_of_a_short_baseline(calibrated_session):
    evidence, fits = calibrated_session.evidence, calibrated_session.fits
    scale = 0.2 / max(board.disparity_px["real-time"] for board in evidence.boards)  # as a phone's lens reads them
    small = [
        replace(board, disparity_px={q: scale * d for q, d in board.disparity_px.items()}) for board in evidence.boards
    ]
    assert not any("all boards" in text for text in weaknesses(replace(evidence, boards=small), fits))


@pytest.mark.slow
def test_an_interrupted_run_goes_on_where_it_stopped(session, calibrated_session, tmp_path):
    seen = []

    def interrupt(what, done, total):
        seen.append((what, done))
        if (what, done) == ("board disparity", 2):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        calibrated(session, progress=interrupt, keep_in=tmp_path / "kept")
    kept = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "kept").iterdir()}
    assert len(kept) == len(RULERS_MM) + 2  # corners of all boards, disparity of two
    damaged = tmp_path / "kept" / next(iter(kept))
    damaged.write_bytes(damaged.read_bytes()[:50])
    again = calibrated(session, keep_in=tmp_path / "kept")
    assert damaged.stat().st_size > 50  # measured again
    after = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "kept").iterdir()}
    assert len(after) == 2 * len(RULERS_MM)
    assert all(after[name] == stamp for name, stamp in kept.items() if name != damaged.name)
    # The same numbers, read from disk.
    assert again.calibration.in_focus_mm == pytest.approx(calibrated_session.calibration.in_focus_mm, rel=1e-9)


@pytest.mark.slow
def test_curves_free_at_every_place_stay_near_the_smooth_ones(session, calibrated_session):
    """This world's fields are flat: what is free must find nothing, within what its ridge and boards leave of noise."""
    smooth = calibrated_session.calibration.depth
    free = calibrated(session, config=replace(SHARP, per_pixel=True)).calibration.depth
    for quality in ("paper", "real-time"):
        assert smooth[quality].local is None
        local = free[quality].local
        sigma = np.sqrt(local.covariance[0, 0])
        assert 0 < np.std(local.infinity_disparity_px) < 2 * sigma


@pytest.mark.slow
def test_the_sensors_noise_is_read_from_the_sheets(session, tmp_path, rng):
    folder = copy_with(session, tmp_path)
    shutil.rmtree(folder / "white")
    (folder / "white").mkdir()
    ramp = np.linspace(0.8, 1, 144)[None, :, None]
    for name, colour in (("sheet_c", (0.02, 0.7, 0.75)), ("sheet_y", (0.75, 0.7, 0.02)), ("open", (0.8, 0.8, 0.8))):
        electrons = rng.poisson(np.broadcast_to(np.array(colour) * ramp, (108, 144, 3)) * 4000)
        tifffile.imwrite(folder / "white" / f"{name}.tif", (electrons * 15 + 100).astype(np.uint16))
    (folder / "white" / "holiday.jpg").write_bytes(b"no sheet")  # what is called otherwise is not looked at
    result = calibrated(folder)
    # 3 sheets of 108 blocks that are known to 8.6 %, seven in nine of them bright: .6 %
    assert result.calibration.sensor.full_well_electrons == pytest.approx(4000, rel=0.03)
    assert any("full well" in note for note in result.notes)


@pytest.mark.slow
def test_the_camera_file_records_what_made_it(session, calibrated_session, tmp_path):
    folder = copy_with(session, tmp_path)
    made = calibrated(folder, command="chromaperture calibrate 'my session' --no-blur").calibration.provenance
    assert made["command"] == "chromaperture calibrate 'my session' --no-blur"
    assert made["options"] == asdict(SHARP)
    assert set(made["versions"]) == {"chromaperture", "numpy", "numba", "opencv"}
    assert made["lens_from"] is None
    content = (folder / "board" / "1800.png").read_bytes()
    assert made["files"]["board/1800.png"] == hashlib.sha256(content).hexdigest()
    assert {"session.toml", "distances.csv", "white/sheet_c.png"} < set(made["files"])
    assert "holiday.png" not in made["files"]

    with (folder / "session.toml").open("a") as text:
        text.write("# a word more\n")
    other = calibrated(folder, lens_from=calibrated_session.calibration).calibration.provenance
    assert "command" not in other  # called from Python: there was none
    assert other["lens_from"]["design"] == "cy_halves"
    assert [name for name in made["files"] if other["files"][name] != made["files"][name]] == ["session.toml"]


@pytest.mark.parametrize("design", [name for name, aperture in DESIGNS.items() if aperture.views])
def test_accurate_takes_the_curve_of_the_quality_that_matches_its_views(design):
    rows = own_film_unmixing(made_of(DESIGNS[design], "real"))
    spaces = ("both", preset(curve_without_blur(design)).space)
    accurate, other = (view_spaces(DESIGNS[design], rows, space)[0].rows for space in spaces)
    np.testing.assert_array_equal(accurate, other)


@pytest.mark.parametrize(
    "wrong", [{"blur_tiles": 0}, {"rendered_boards": 2}, {"pupil_sigma_mm": 0.0}, {"range_margin": (1.1, 1.3)}]
)
def test_options_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        CalibrationConfig(**wrong)


def test_a_lens_of_another_resolution_is_refused(session):
    other = Calibration.uncalibrated("cy_halves", width_px=288, height_px=216)
    with pytest.raises(InputError, match="288x216"):
        calibrated(session, lens_from=other)


def test_a_folder_without_a_session_is_named(tmp_path):
    with pytest.raises(InputError, match=r"session\.toml"):
        calibrated(tmp_path)


def test_an_outlier_board_does_not_move_the_fit(rng):
    z = np.linspace(1000, 4000, 13)
    disparity = INFINITY_PX - SCALE_PX_MM / (z - PUPIL_MM) + rng.normal(0, 0.01, 13)
    disparity[4] += 0.6
    fit = fit_depth_model(
        z,
        disparity,
        disparity_sigma_px=np.full(13, 0.01),
        distance_sigma_mm=1.5,
        sensor_to_pupil_mm=50.0,
        sensor_to_pupil_sigma_mm=3.0,
    )
    assert np.argmax(np.abs(fit.residual_mm)) == 4
    # 0.007 is found, of 0.0099 that its own error bar says.
    assert fit.model.infinity_disparity_px == pytest.approx(INFINITY_PX, abs=0.03)
    assert np.sqrt(fit.model.covariance[0, 0]) < 0.03  # 0.0099 is found: 0.01 px a board, thirteen boards


@pytest.mark.parametrize(("center", "k2"), [((359.5, 239.5), 0.0), ((374.0, 231.0), 0.3)])
def test_the_principal_point_moves_only_where_the_corners_ask(center, k2):
    rng = np.random.default_rng(3)
    matrix = np.array([[700.0, 0, center[0]], [0, 700.0, center[1]], [0, 0, 1]])
    grid = board_points((9, 6), 30.0) - np.array([120, 75, 0], np.float32)
    views = []
    for _ in range(12):
        place = np.array([rng.uniform(-150, 150), rng.uniform(-90, 90), rng.uniform(450, 800)])
        turn = rng.uniform(-0.5, 0.5, 3)
        pixels = cv2.projectPoints(grid, turn, place, matrix, np.array([-0.2, k2, 0, 0, 0]))[0][:, 0]
        views.append((pixels + rng.normal(0, 0.05, pixels.shape)).astype(np.float32))
    found = fit_intrinsics(views, (720, 480), (9, 6), 30.0)
    # 1300 coordinates of 0.05 px fix a free centre to some tenths of a px; a fixed one does not move at all.
    assert found.camera_matrix[:2, 2] == pytest.approx(center, abs=1.0 if k2 else 1e-9)
    assert found.camera_matrix[0, 0] == pytest.approx(700, rel=0.002)
    assert found.rms_px < 0.08  # noise of 0.05 px in x and y: 0.071

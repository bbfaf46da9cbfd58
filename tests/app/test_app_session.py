"""The calibration assistant: each photograph is judged at once, and what it predicts comes true."""

from __future__ import annotations

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from apps import FACTS
from chromaperture.app.assistant import advice, best_gain, check_shot, frame_cells, lens_of, sheets_of, state
from chromaperture.app.assistant_routes import CalibrationJob
from chromaperture.app.forecast import curve_sigma
from chromaperture.app.session_folder import MOST_SHOTS, SessionFolder, Shot
from chromaperture.app.state import AppState
from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.evaluation.session_checks import Reading, edge_blur
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.products.samples import sample_camera
from chromaperture.system.errors import InputError

pytestmark = pytest.mark.extra("serve", "starlette")  # runs with the other extras, not in the README's test step

BOARDS_MM = (1000, 1500, 2000, 2500, 3000)
GREY = np.array([1, 0, 0], np.uint16)  # nearly: a picture that is grey to the last count is refused


def assisted(folder, rendered, *, boards=BOARDS_MM, tilts=5, sheets=True) -> SessionFolder:
    """A session that the assistant filled with the rendered photographs."""
    session = SessionFolder.create(folder, FACTS)
    for at in boards:
        keep(session, rendered / "board" / f"{at}.png", "board", ruler_mm=at)
    for i in range(tilts):
        keep(session, rendered / "tilt" / f"{i:02d}.png", "tilt")
    for sheet in sheets_of(session) if sheets else ():
        keep(session, rendered / "white" / f"{sheet}.png", "white", sheet=sheet)
    return session


def keep(session, path, kind, *, ruler_mm=None, sheet=""):
    found = check_shot(session, path, kind, ruler_mm=ruler_mm, sheet=sheet)
    assert found.is_usable, [c for c in found.checks if c.verdict == "warn"]
    session.keep(path, kind, found.reading, found.checks, sheet=sheet)


@pytest.fixture(scope="session")
def filled(tmp_path_factory, rendered):
    return assisted(tmp_path_factory.mktemp("assisted") / "bench", rendered)


def spoiled(tmp_path, path, change):
    """A photograph after a change of its counts."""
    target = tmp_path / path.name
    counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(target), np.ascontiguousarray(change(counts)))
    return target


def problems(session, path, **options):
    found = check_shot(session, path, options.pop("kind", "board"), **options)
    return {check.name for check in found.checks if check.verdict == "warn"}


# ---- blur


@pytest.mark.parametrize(("along_x", "along_y"), [(0.8, 0.8), (2.5, 2.5), (3.0, 1.0), (1.0, 3.0)])
def test_the_blur_of_edges_is_that_of_a_known_gaussian(along_x, along_y):
    square, columns, rows = 24, 5, 4
    y, x = np.mgrid[: (rows + 3) * square, : (columns + 3) * square]
    board = (((x // square) + (y // square)) % 2).astype(np.float32) * 0.7 + 0.1
    board = cv2.GaussianBlur(board, (0, 0), sigmaX=along_x, sigmaY=along_y)
    corners = np.array([[(i + 2) * square - 0.5, (j + 2) * square - 0.5] for j in range(rows) for i in range(columns)])
    found = edge_blur(board, corners, (columns, rows))
    # the edge's own px adds 1 / sqrt(12), its sampling a little
    np.testing.assert_allclose(found, np.hypot([along_x, along_y], 0.29), rtol=0.08)


# ---- checks


def test_good_photographs_are_good_and_move_the_advice_on(tmp_path, rendered):
    session = SessionFolder.create(tmp_path / "bench", FACTS)
    assert state(session)["next"]["ruler_mm"] == 2000  # at the focus first
    keep(session, rendered / "board" / "2000.png", "board", ruler_mm=2000)
    assert state(session)["next"]["ruler_mm"] == 1000
    keep(session, rendered / "board" / "1000.png", "board", ruler_mm=1000)
    assert state(session)["next"]["ruler_mm"] == 3000
    assert not state(session)["ready"]


def test_the_folder_is_an_ordinary_session(filled, rendered):
    assert (filled.folder / "distances.csv").read_text() == "file,ruler_mm\n" + "".join(
        f"board/{at:04d}.png,{at}\n" for at in BOARDS_MM
    )
    again = SessionFolder(filled.folder)
    assert [shot.file for shot in again.shots] == [shot.file for shot in filled.shots]
    np.testing.assert_array_equal(again.shots[0].reading.corners_px, filled.shots[0].reading.corners_px)
    assert state(again)["ready"]
    assert state(again)["boards_mm"] == list(BOARDS_MM)


def same(counts):
    return counts


def test_counts_of_fewer_bits_than_the_file_are_not_called_dark_light(tmp_path, rendered):
    """The rendered photographs are of a 10-bit camera; FACTS of this session do not state its white level."""
    facts = {name: value for name, value in FACTS.items() if name not in ("white_level", "black_level")}
    session = SessionFolder.create(tmp_path / "s", facts)
    found = check_shot(session, rendered / "board" / "2000.png", "board", ruler_mm=2000)
    advice = next(check.advice for check in found.checks if check.name == "exposure")
    assert "a camera of 10 bits? Then set white_level = 1023" in advice


@pytest.mark.parametrize(
    ("name", "change", "options", "problem"),
    [
        ("board/1000", lambda c: c[:, ::-1], {"ruler_mm": 1000}, "film orientation"),  # the film mirrored
        ("board/1000", lambda c: np.repeat(c[..., 1:2], 3, axis=2) + GREY, {"ruler_mm": 1000}, "film"),  # no film
        ("board/2000", lambda c: cv2.blur(c, (7, 1)), {"ruler_mm": 2000}, "motion"),
        ("board/1500", lambda c: cv2.GaussianBlur(c, (0, 0), 3), {"ruler_mm": 1500}, "sharpness"),
        ("board/1500", same, {"ruler_mm": 1900}, "ruler"),
        ("board/1500", same, {"ruler_mm": 150}, "ruler"),  # in cm
        ("board/1500", lambda c: np.minimum(c * 2, 1023).astype(np.uint16), {"ruler_mm": 1500}, "exposure"),
        ("board/1500", lambda c: (16 + (c - 16.0) / 30).astype(np.uint16), {"ruler_mm": 1500}, "exposure"),
        ("board/1500", lambda c: c * 0 + 300 + np.arange(3, dtype=np.uint16), {"ruler_mm": 1500}, "board"),
        ("tilt/00", same, {"ruler_mm": 1900}, "squareness"),
        ("board/1500", same, {"kind": "tilt"}, "tilt"),
        ("white/open", same, {"kind": "white", "sheet": "cy_halves"}, "film"),
        ("white/sheet_c", same, {"kind": "white", "sheet": "sheet_y"}, "film"),
        ("board/1000", same, {"kind": "white", "sheet": "open"}, "sheet"),
        ("white/open", lambda c: c * 0 + 1020, {"kind": "white", "sheet": "open"}, "exposure"),
    ],
)
def test_a_spoiled_photograph_is_named(tmp_path, filled, rendered, name, change, options, problem):
    found = problems(filled, spoiled(tmp_path, rendered / f"{name}.png", change), **options)
    assert problem in found
    if options.get("kind", "board") != "board" and not name.startswith("board/1000"):
        assert found == {problem}


@pytest.mark.parametrize("gels", ["118,101", "115,101", "141,768", "118,770", "068,015"])
def test_sheets_of_the_gels_that_are_advised_are_good_and_a_green_one_is_not(tmp_path, filled, rendered, gels):
    """Pairs of docs/optics.md."""
    halves = made_of(DESIGNS["cy_halves"], gels)
    cyan, yellow = (np.array(part.filter.transmission) for part in halves.parts)
    green = np.array(made_of(DESIGNS["magenta_annulus"], "139").parts[0].filter.transmission)

    def found(sheet, light):
        through = spoiled(tmp_path, rendered / "white" / "open.png",
                          lambda counts: np.rint(16 + (counts - 16.0) * light[::-1]).astype(np.uint16))  # fmt: skip
        return problems(filled, through, kind="white", sheet=sheet)

    for sheet, light in (("sheet_c", cyan), ("sheet_y", yellow), ("cy_halves", (cyan + yellow) / 2)):
        assert "film" not in found(sheet, light), sheet
    assert "film" in found("sheet_y", green)
    assert "film" in found("sheet_y", cyan)


def test_focus_that_moved_is_named_by_the_boards_before(tmp_path, filled, rendered):
    """The board of 1500 mm as a camera focused elsewhere sees it: red and blue moved by half a px each."""

    def refocused(counts):
        shift = np.array([[1, 0, 0.5], [0, 1, 0]])
        size = counts.shape[1::-1]
        blue = cv2.warpAffine(counts[..., 0], shift, size, borderMode=cv2.BORDER_REPLICATE)
        red = cv2.warpAffine(counts[..., 2], shift * [[1, 1, -1], [1, 1, 1]], size, borderMode=cv2.BORDER_REPLICATE)
        return np.stack([blue, counts[..., 1], red], axis=-1)

    path = spoiled(tmp_path, rendered / "board" / "1500.png", refocused)
    assert problems(filled, path, ruler_mm=1500) == {"focus"}


def test_a_photograph_of_another_size_or_kind_is_refused(tmp_path, filled, rendered):
    small = spoiled(tmp_path, rendered / "board" / "1500.png", lambda c: c[::2, ::2])
    with pytest.raises(InputError, match="180x120"):
        check_shot(filled, small, "board", ruler_mm=1500)
    with pytest.raises(InputError, match="not read"):
        check_shot(filled, tmp_path / "board.txt", "board", ruler_mm=1500)


# ---- names and numbers of the page


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"design": "../../etc"}, "unknown aperture"),
        ({"focal_length_mm": -1}, "focal_length_mm"),
        ({"focal_length_mm": "50"}, "focal_length_mm"),
        ({"focus_mm": 5000.0}, "must lie between"),
        ({"focus_mm": 90.0, "nearest_mm": 80.0}, "twice the focal length"),
        ({"inner_corners": [9, 1]}, "inner_corners"),
        ({"more": 1}, "more"),
    ],
)
def test_facts_that_make_no_sense_leave_no_folder(tmp_path, change, match):
    with pytest.raises(InputError, match=match):
        SessionFolder.create(tmp_path / "bench", FACTS | change)
    assert not (tmp_path / "bench").exists()


def test_ten_thousand_boards_are_not_kept(tmp_path, filled, rendered):
    folder = tmp_path / "many"
    shutil.copytree(filled.folder, folder)
    session = SessionFolder(folder)
    board = session.shots[0]
    session.shots = [Shot(board.file, "board", board.reading, [])] * MOST_SHOTS
    with pytest.raises(InputError, match="300 photographs already"):
        session.keep(rendered / "board" / "1500.png", "board", Reading(1500.0), [])


def test_a_deleted_photograph_is_gone_and_only_that(tmp_path, filled):
    folder = tmp_path / "less"
    shutil.copytree(filled.folder, folder)
    session = SessionFolder(folder)
    session.remove("board/1500.png")
    assert not (folder / "board" / "1500.png").exists()
    assert "1500" not in (folder / "distances.csv").read_text()
    for name in ("board/../session.toml", "session.toml", "../bench/board/1000.png", "board/1500.png"):
        with pytest.raises(InputError, match="no such photograph"):
            session.remove(name)
    assert (folder / "session.toml").exists()


# ---- what is predicted


def test_the_advised_board_takes_most_off_the_error_bar(filled):
    lens = lens_of(filled, filled.session())
    boards, candidates = [2000.0, 1000.0], np.linspace(1000, 3000, 9)
    gain = best_gain(lens, boards, 4, candidates)
    distance = np.linspace(1000, 3000, 25)
    worst = [(curve_sigma(lens, [*boards, at], 4, distance) / distance).max() for at in candidates]
    assert gain.at_mm == candidates[int(np.argmin(worst))]
    assert gain.after == pytest.approx(min(worst))
    assert gain.at_mm > 2000  # nothing stands beyond the focus yet


def test_every_board_and_poses_make_the_forecast_smaller(filled):
    lens, distance = lens_of(filled, filled.session()), np.linspace(1000, 3000, 9)
    sigmas = [curve_sigma(lens, BOARDS_MM[:n], 0, distance).max() for n in range(len(BOARDS_MM) + 1)]
    assert sigmas == sorted(sigmas, reverse=True)
    assert (curve_sigma(lens, BOARDS_MM, 5, distance) < curve_sigma(lens, BOARDS_MM, 0, distance)).all()


def test_the_forecast_is_the_covariance_that_the_calibration_finds(rendered, filled):
    """With the scatter that its boards have about the curve; to a factor of two, which their number allows."""
    result = calibrate_session(rendered, CalibrationConfig(lens_blur=False, min_field_boards=99))
    model = result.fits["real-time"].model
    lens = lens_of(filled, filled.session())
    lens = type(lens)(**{**vars(lens), "model": model})
    distance = np.linspace(1000, 3000, 9)
    z = distance - float(model.sensor_to_pupil_mm)
    rows = np.stack([np.ones(9), -1 / z, -float(model.scale_px_mm) / z**2], axis=1)
    found = np.sqrt(np.einsum("ni,ij,nj->n", rows, np.asarray(model.covariance), rows)) / np.abs(rows[:, 2])
    predicted = curve_sigma(type(lens)(**{**vars(lens), "board_sigma_px": 0.05}), BOARDS_MM, 5, distance)
    ratio = predicted / found
    assert 0.5 < ratio.min() < ratio.max() < 2


def test_sheets_and_tilts_are_asked_for_until_all_is_there(tmp_path, rendered, filled):
    some = assisted(tmp_path / "some", rendered, tilts=0, sheets=False)
    assert state(some)["next"]["kind"] == "tilt"
    assert frame_cells(some, some.session()).sum() == 0
    for i in range(4):
        keep(some, rendered / "tilt" / f"{i:02d}.png", "tilt")
    following = state(some)["next"]
    assert (following["kind"], following["sheet"]) == ("white", "open")
    everything = advice(filled, frame_cells(filled, filled.session()), None)
    assert everything["kind"] in ("tilt", "calibrate")


def test_a_stopped_calibration_leaves_no_camera(tmp_path, filled):
    job = CalibrationJob(filled.folder, tmp_path / "app.asdf", tmp_path / "app.report.html", lens_blur=False)
    job.stop()
    job.start()
    job.wait()
    assert job.as_shown()["error"].startswith("stopped")
    assert [p.name for p in tmp_path.iterdir() if p.suffix in (".asdf", ".html")] == []


def test_a_calibration_without_boards_is_one_sentence(tmp_path, rendered):
    session = SessionFolder.create(tmp_path / "bench", FACTS)
    keep(session, rendered / "board" / "2000.png", "board", ruler_mm=2000)
    job = CalibrationJob(session.folder, tmp_path / "app.asdf", tmp_path / "app.report.html", lens_blur=False)
    job.start()
    job.wait()
    assert "photograph the board" in job.error
    assert not (tmp_path / "app.asdf").exists()


@pytest.mark.parametrize(
    ("holding", "siting", "is_told"),
    [
        ({}, None, False),
        ({"angle_deg": 90}, "centre", False),
        ("upright", "left", False),
        ({"angle_deg": 45, "orientation": "landscape-primary"}, None, False),
        ({"angle_deg": 90, "orientation": "landscape-primary", "facing": "environment"}, None, True),
    ],
)
def test_what_a_camera_file_says_of_its_video_may_be_absent_or_nonsense(tmp_path, holding, siting, is_told):
    camera = replace(Calibration.load(sample_camera("still_life_cy_halves")), provenance={"holding": holding})
    camera = replace(camera, sensor=replace(camera.sensor, siting=siting))
    camera.save(tmp_path / "odd.asdf")
    (shown,) = AppState(tmp_path / "app", tmp_path / "odd.asdf", reserve_bytes=0).describe_cameras()
    assert (shown["siting"], shown["holding"]) == (siting or "left", holding if is_told else None)

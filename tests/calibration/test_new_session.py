"""``session new``: what it writes is a session once the photographs are there."""

from __future__ import annotations

import csv

import cv2
import numpy as np
import pytest
from PIL import Image

from chromaperture.calibration.chessboard import find_corners
from chromaperture.calibration.session import read_session
from chromaperture.color.encoding import Encoding
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.system.errors import InputError
from worlds import render_boards

CAMERA = PupilCamera(192, 128, 450.0, 12.5, 2000.0, 50.0, 0.1)
OPTIONS = ("--distances", 5, "--tilts", 4, "--farthest-mm", 3000, "--sensor-width-mm", 19.2)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Photographs at the distances that five boards from 1 to 3 m get."""
    folder = tmp_path_factory.mktemp("simulated") / "session"
    render_boards(folder, CAMERA, (1000, 1200, 1500, 2000, 3000), tilts=4, cells=4)
    return folder


def fill(folder, simulated, suffix=".png", convert=None):
    """Photograph every file of the list of shots, and answer every question of session.toml."""
    for path in simulated.glob("*/*.png"):
        if path.parent.name in ("board", "tilt", "white"):
            target = (folder / path.parent.name / path.name).with_suffix(suffix)
            target.write_bytes(path.read_bytes()) if convert is None else convert(path, target)
            assert f"`{target.relative_to(folder)}`" in (folder / "shots.md").read_text()
    settings = folder / "session.toml"
    text = settings.read_text()
    for entry, value in (("nominal_focal_length_mm", "50.0"), ("nominal_f_number", "2.0")):
        text = text.replace(f'{entry} = "?"', f"{entry} = {value}")
    settings.write_text(text)


def test_a_new_session_with_photographs_can_be_read(run, tmp_path, simulated):
    folder = tmp_path / "mine"
    result = run("session", "new", folder, *OPTIONS, "--photo", simulated / "board" / "1000.png")
    assert result.returncode == 0, result.stderr
    assert 'Replace 2 "?"' in result.stdout
    assert {p.name for p in folder.iterdir()} == {
        "session.toml", "distances.csv", "shots.md", "board", "tilt", "white", "scene",
    }  # fmt: skip
    rows = list(csv.DictReader((folder / "distances.csv").read_text().splitlines()))
    # Even in 1 / distance from 1 to 3 m: 1, 5/6, 2/3, 1/2, 1/3.
    assert [row["ruler_mm"] for row in rows] == ["1000", "1200", "1500", "2000", "3000"]
    with pytest.raises(InputError, match=r"lens\.nominal_focal_length_mm must be a number, is '\?'"):
        read_session(folder)
    fill(folder, simulated)
    text = (folder / "session.toml").read_text()
    levels = text.replace("# black_level = 512", "black_level = 16").replace(
        "# white_level = 16383", "white_level = 1016"
    )
    (folder / "session.toml").write_text(levels)
    board = folder / rows[0]["file"]
    photograph = board.read_bytes()
    board.unlink()
    with pytest.raises(InputError, match=f"photographs that are not there: .*{board.name}"):
        read_session(folder)
    board.write_bytes(photograph)
    session = read_session(folder)
    assert (session.design, session.inner_corners, session.square_mm) == ("cy_halves", (9, 6), 30.0)
    assert (session.sensor.width_px, session.sensor.height_px) == (192, 128)
    assert session.sensor.pixel_pitch_mm == pytest.approx(CAMERA.pixel_pitch_mm)
    assert (len(session.boards), len(session.tilts)) == (5, 4)
    assert set(session.sheets) == {"cy_halves", "open", "sheet_c", "sheet_y"}
    assert find_corners(session.read(session.tilts[0])[..., 1], session.inner_corners) is not None


def test_nothing_is_overwritten(run, tmp_path):
    folder = tmp_path / "mine"
    (folder / "board").mkdir(parents=True)
    (folder / "board" / "photo.png").write_bytes(b"x")
    assert run("session", "new", folder, "-q").returncode == 0
    assert (folder / "board" / "photo.png").read_bytes() == b"x"
    before = {path: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    for name in ("session.toml", "distances.csv", "shots.md"):
        other = tmp_path / name
        other.mkdir()
        (other / name).write_text("mine")
        for there in (folder, other):
            result = run("session", "new", there, "--design", "rgb_squares")
            assert (result.returncode, "not overwritten" in result.stderr) == (2, True)
        assert [path.name for path in other.iterdir()] == [name]
    assert before == {path: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_lens_focused_at_infinity_can_be_planned(run, tmp_path, simulated):
    folder = tmp_path / "mine"
    photo = simulated / "board" / "1000.png"
    assert run("session", "new", folder, *OPTIONS, "--photo", photo, "--focus-mm", "inf").returncode == 0
    fill(folder, simulated)
    assert read_session(folder).focuses_at_infinity
    assert "At about the focus" not in (folder / "shots.md").read_text()
    settings = folder / "session.toml"
    settings.write_text(settings.read_text().replace("= inf ", "= nan "))
    with pytest.raises(InputError, match="focused_at_about_mm"):
        read_session(folder)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--focus-mm", 5000), "both sides of the focus"),
        (("--distances", 1), "--distances"),
        (("--board", "nine"), "such as 9x6"),
        (("--design", "cy_thirds"), "cy_halves"),
        (("--photo", "none.png"), "none.png"),
    ],
)
def test_a_session_that_cannot_be_planned_says_why(run, tmp_path, options, word):
    result = run("session", "new", tmp_path / "s", *options)
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert word in result.stderr
    assert not (tmp_path / "s").exists()


def test_every_design_has_its_white_sheets(run, tmp_path):
    for design, names in (("rgb_squares", "rgb"), ("cmy_circles", "cmy")):
        assert run("session", "new", tmp_path / design, "--design", design, "-q").returncode == 0
        shots = (tmp_path / design / "shots.md").read_text()
        for name in (design, "open", *(f"sheet_{letter}" for letter in names)):
            assert f"`white/{name}.png`" in shots


def test_a_session_of_jpeg_files_is_read_as_light(run, tmp_path, simulated):
    """Files of 8 bits follow the sRGB curve, whatever the levels of session.toml default to."""

    def convert(path, target):
        counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]
        light = np.clip((counts.astype(np.float32) - 16) / 1000, 0, 1)
        Image.fromarray(np.rint(255 * linear_to_srgb(light)).astype(np.uint8)).save(target, quality=98, subsampling=0)

    folder = tmp_path / "mine"
    convert(simulated / "board" / "1000.png", tmp_path / "photo.jpg")
    assert run("session", "new", folder, *OPTIONS, "--photo", tmp_path / "photo.jpg", "-q").returncode == 0
    fill(folder, simulated, ".jpg", convert)
    session = read_session(folder)
    assert session.sensor.encoding == Encoding(0.0, 255.0, "srgb")
    sheet = session.white("open")  # without a warning: warnings are errors here
    # White paper through the open lens is exposed to 0.9; 8 bits of sRGB are 0.8 % apart there.
    np.testing.assert_allclose(sheet, 0.9, atol=0.01)

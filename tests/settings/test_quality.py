"""Depth quality: walls of known noise, tilt and error are judged as what they are; and a camera by its own session."""

from __future__ import annotations

import csv
import json
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from chromaperture.cli.main import app
from chromaperture.model.camera_file import Calibration
from chromaperture.system.errors import InputError
from chromaperture_paper.quality import ZONES, by_cell, cells, plane_quality
from chromaperture_paper.run import RESULT
from worlds import RULERS_MM

DELTA, B, TRUTH = 50.0, 8000.0, 2000.0
SHAPE = (120, 180)


def wall(rng, *, noise_px=0.0, tilt=0.0, error=0.0):
    """A wall whose disparity has the given noise; its depth is off by a share and leans by a share to either side."""
    x = np.linspace(-1, 1, SHAPE[1])[None]
    inverse = (1 + tilt * x) / (TRUTH * (1 + error) - DELTA) + rng.normal(0, noise_px / B, SHAPE)
    return 1 / inverse + DELTA


def judged(depth):
    return plane_quality(depth, TRUTH, sensor_to_pupil_mm=DELTA, scale_px_mm=B)


def test_noise_of_the_disparity_comes_back_in_px_and_in_depth(rng):
    found = judged(wall(rng, noise_px=0.1, tilt=0.05))
    # 21600 samples tell their standard deviation to 0.5 %; cutting at four of them takes 0.05 %.
    assert found.subpixel_rms_px == pytest.approx(0.1, rel=0.02)
    per_px = (TRUTH - DELTA) ** 2 / B  # mm that one px is worth there
    assert found.plane_rms == pytest.approx(0.1 * per_px / TRUTH, rel=0.02)
    assert found.fill == 1
    assert abs(found.accuracy) < 0.001
    assert found.outliers < 0.001


def test_an_error_of_all_pixels_is_accuracy_and_not_noise(rng):
    found = judged(wall(rng, error=0.03, noise_px=0.01))
    assert found.accuracy == pytest.approx(0.03, abs=2e-4)  # one px is worth 475 mm: 0.01 px of 21600 samples are 2e-5
    assert found.subpixel_rms_px == pytest.approx(0.01, rel=0.02)  # as above: 0.5 %


def test_holes_and_wild_pixels_are_counted_by_themselves(rng):
    depth = wall(rng, noise_px=0.05)
    depth[:30] = np.nan
    wild = rng.random(SHAPE) < 0.05
    depth[wild] *= 1.4
    found = judged(depth)
    assert found.fill == pytest.approx(0.75)  # 30 of 120 rows
    assert found.outliers == pytest.approx(wild[30:].mean(), abs=0.002)  # the noise alone makes no outlier
    assert found.subpixel_rms_px == pytest.approx(0.05, rel=0.03)  # as above, of 16200 samples
    assert abs(found.accuracy) < 0.002  # the median moves by a sixteenth of a standard deviation


def test_a_wall_that_was_not_seen_has_no_figures():
    found = judged(np.full(SHAPE, np.nan))
    assert found.fill == 0
    assert np.isnan([found.accuracy, found.plane_rms, found.subpixel_rms_px, found.outliers]).all()


def test_zones_tile_the_frame_and_tell_where_it_is_bad(rng):
    count = np.zeros(SHAPE, int)
    for cell in cells(*SHAPE, 3, 3):
        count[cell] += 1
    assert (count == 1).all()
    depth = wall(rng, noise_px=0.02)
    rows, columns = cells(*SHAPE, 3, 3)[ZONES.index("bottom left")]
    depth[rows, columns] *= 1.05
    found = by_cell(depth, TRUTH, sensor_to_pupil_mm=DELTA, scale_px_mm=np.full(SHAPE, B), rows=3, columns=3)
    accuracy = np.array([quality.accuracy for quality in found])
    assert ZONES[int(np.abs(accuracy).argmax())] == "bottom left"
    assert accuracy[ZONES.index("bottom left")] == pytest.approx(0.05, abs=1e-3)  # 0.02 px of 2400 samples: 1e-4
    assert np.abs(np.delete(accuracy, ZONES.index("bottom left"))).max() < 1e-3  # as above; 3e-4 is found


def run(folder, out, *more):
    options = ["-q", "--quick", "--data", str(folder), "--out", str(out), *more]
    return CliRunner().invoke(app, ["evaluate", "quality", *options])


def test_without_a_camera_file_each_board_is_judged_without_itself(session, tmp_path):
    result = run(session, tmp_path)
    assert result.exit_code == 0, result.output
    rows = list(csv.DictReader((tmp_path / "quality" / "distance.csv").read_text(encoding="utf-8").splitlines()))
    assert [float(row["distance, mm"]) for row in rows] == sorted(RULERS_MM)
    assert all(float(row["fill"].rstrip("%")) > 90 for row in rows)
    # The boards are shifted views of one texture: 0.03 px, which at 3 m is 1.1 %, and twice that at the ends, where
    # the curve without the board is extrapolated.
    assert all(abs(float(row["Z accuracy"].rstrip("%"))) < 2.5 for row in rows)
    assert len((tmp_path / "quality" / "position.csv").read_text(encoding="utf-8").splitlines()) == 1 + len(ZONES)
    assert "fitted without it" in json.loads((tmp_path / "quality" / RESULT).read_text(encoding="utf-8"))["source"]


def test_a_camera_file_is_used_as_it_is_and_that_it_knows_the_boards_is_said(session, calibrated_session, tmp_path):
    camera = tmp_path / "camera.asdf"
    calibrated_session.calibration.save(camera)
    parent = tmp_path / "data"
    shutil.copytree(session, parent / "cy_halves")  # a folder of sessions serves as well
    result = run(parent, tmp_path / "out", "--camera", str(camera))
    assert result.exit_code == 0, result.output
    source = json.loads((tmp_path / "out" / "quality" / RESULT).read_text(encoding="utf-8"))["source"]
    assert f"{len(RULERS_MM)} of them have names that it was calibrated on" in source
    assert Calibration.load(camera).design == "cy_halves"


def test_what_does_not_fit_is_told(session, tmp_path):
    (tmp_path / "empty").mkdir()
    empty = run(tmp_path / "empty", tmp_path / "out")
    assert empty.exit_code == 1
    assert "session.toml" in empty.output
    missing = run(session, tmp_path / "out", "--camera", str(tmp_path / "no.asdf"))
    assert isinstance(missing.exception, InputError)
    alone = CliRunner().invoke(app, ["evaluate", "quality", "--camera", str(tmp_path / "no.asdf")])
    assert "--data" in str(alone.exception)


def test_an_exact_plane_with_outliers_is_found(rng):
    depth = np.full(SHAPE, TRUTH, float)
    wild = rng.random(SHAPE) < 0.2
    depth[wild] *= 0.8  # all on one side: the first fit lies between the two
    found = judged(depth)
    assert found.outliers == pytest.approx(wild.mean())
    assert found.plane_rms < 1e-9  # rounding

"""A session of photographs of more pixels than blur needs: the same camera, in other pixels."""

from __future__ import annotations

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.calibration.session import read_session
from chromaperture.camera.method import default_config
from chromaperture.model.scale import at_scale, working_scale
from worlds import write_board_session

SCALE = 4


@pytest.fixture
def sessions(tmp_path, monkeypatch):
    """A session, and one whose photographs repeat every pixel of the first: their means are the first's pixels."""
    small, large = tmp_path / "a" / "small", tmp_path / "b" / "large"
    small.parent.mkdir()
    write_board_session(small)
    shutil.copytree(small, large)
    for path in large.rglob("*.png"):
        counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), counts.repeat(SCALE, axis=0).repeat(SCALE, axis=1))
    text = (large / "session.toml").read_text()
    for before, after in (("144", "576"), ("108", "432"), ("0.031", "0.00775")):
        text = text.replace(f"_px = {before}", f"_px = {after}").replace(f"_mm = {before}\n", f"_mm = {after}\n")
    (large / "session.toml").write_text(text)
    monkeypatch.setattr("chromaperture.calibration.session.LEAST_SIDE_PX", 100)
    monkeypatch.setattr("chromaperture.calibration.session._WIDEST_PX", 7.0)  # of these boards, at 1/4
    return small, large


def test_boards_are_matched_at_the_working_scale_and_the_camera_is_of_full_size(sessions, tmp_path):
    small, large = (calibrate_session(folder, CalibrationConfig(lens_blur=False)) for folder in sessions)
    assert (large.session.sensor.width_px, large.session.photograph_size_px) == (144, (576, 432))
    camera = large.camera
    assert (camera.sensor.width_px, camera.sensor.height_px) == (576, 432)
    back = at_scale(camera, SCALE)
    for quality, curve in small.camera.depth.items():
        found = back.depth[quality]
        # The means are computed in float32.
        np.testing.assert_allclose(found.scale_px_mm, curve.scale_px_mm, rtol=1e-4)
        np.testing.assert_allclose(found.infinity_disparity_px, curve.infinity_disparity_px, atol=1e-3)
        assert found.sensor_to_pupil_mm == pytest.approx(curve.sensor_to_pupil_mm, abs=0.01)
    assert camera.in_focus_mm == pytest.approx(small.camera.in_focus_mm, rel=1e-4)
    assert camera.sensor.pixel_pitch_mm == pytest.approx(0.00775)
    camera.save(tmp_path / "camera.asdf")
    camera = type(camera).load(tmp_path / "camera.asdf")
    assert working_scale(camera) == SCALE
    assert working_scale(at_scale(camera, 2)) == SCALE // 2
    assert default_config(camera, "real-time").scale == SCALE


def test_photographs_of_few_pixels_are_not_reduced(tmp_path):
    write_board_session(tmp_path / "session")
    session = read_session(tmp_path / "session")
    assert session.photograph_size_px == (session.sensor.width_px, session.sensor.height_px) == (144, 108)


def test_boards_are_decoded_once_as_far_as_memory_goes(sessions, monkeypatch):
    session = read_session(sessions[1])
    first, second, *_ = session.boards
    size = session.read(first).nbytes
    assert session.read(first) is session.read(first)
    monkeypatch.setattr("chromaperture.calibration.session._KEPT_BYTES", size)
    assert session.read(second) is not session.read(second)
    otherwise = session.decoded_as(replace(session.sensor, black_level=session.sensor.black_level + 100))
    assert otherwise.read(first).mean() < session.read(first).mean()

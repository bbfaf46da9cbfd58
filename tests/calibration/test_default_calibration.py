"""A small rendered session, calibrated with every step switched on, against the world it was rendered from."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from chromaperture.calibration.calibrate_session import calibrate_session, leave_one_out
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.evaluation.verdict import chosen_boards, depth_accuracy, with_accurate_noise
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.system.robust import robust_sigma
from worlds import render_boards

# A thin 50 mm f/2 lens on a frame as small as corners of boards at 3.2 m are found in.
CAMERA = PupilCamera(192, 128, 450.0, 12.5, 2000.0, 50.0, 0.06)
RULERS = (1000.0, 1250.0, 1600.0, 2200.0, 3200.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rendered") / "cy_halves"
    render_boards(folder, CAMERA, RULERS, tilts=4)
    return folder


@pytest.mark.slow
def test_the_default_calibration_finds_the_camera_that_took_the_session(folder, tmp_path):
    done = []
    result = calibrate_session(folder, progress=lambda what, number, total: done.append((what, number == total)))
    assert [what for what, last in done if last] == [
        "chessboards", "board disparity", "depth curves", "blur of the lens", "depth of the layers",
        "rendered boards", "nonlinearity of rendered boards", "depth curves",
    ]  # fmt: skip
    camera, distances = result.calibration, result.evidence.distances
    # Rulers err by up to 3 mm, 1.7 mm rms, over 2.2 m: their slope, and with it the focal length, by 0.1 %.
    assert camera.lens.camera_matrix[0, 0] == pytest.approx(CAMERA.focal_px, rel=0.004)
    image_mm = CAMERA.focal_px * CAMERA.pixel_pitch_mm
    focal_mm = 1 / (1 / image_mm + 1 / (CAMERA.focus_mm - CAMERA.sensor_to_pupil_mm))  # Eq. (2)
    assert camera.lens.focal_length_mm == pytest.approx(focal_mm, rel=0.004)
    assert abs(distances.sensor_to_pupil_mm - CAMERA.sensor_to_pupil_mm) < 3 * distances.sigma_mm < 15
    # B is 2400 px mm: 0.02 px, which boards of this size are read to, are 32 mm at the focus.
    assert camera.in_focus_mm == pytest.approx(CAMERA.focus_mm, abs=32)
    assert set(result.evidence.rendered) == {"paper", "real-time"}
    for quality, curve in result.evidence.rendered.items():
        assert curve.high_px > 0 > curve.low_px, quality  # boards on both sides of the focus
    assert result.layers.disagreement < result.layers.start_disagreement

    left_out = RULERS.index(1250.0)
    photograph = result.session.read(list(result.session.boards)[left_out])
    truth = json.loads((folder / "truth" / "camera.json").read_text())["board_mm"]["board/1250.png"]
    for quality in ("paper", "real-time", "accurate"):
        without = leave_one_out(result, left_out, [quality])
        depth = CodedApertureCamera(without, default_config(without, quality)).measure(photograph).depth_mm
        # 0.02 px are 12 mm at 1.25 m, and the ruler of a neighbour errs by 3 mm.
        assert np.nanmedian(depth) == pytest.approx(truth, abs=15), quality
        assert np.isfinite(depth).mean() > 0.9, quality  # a board is texture all over

    # The report's error bar of quality accurate: the scatter of its depth on a board, whole frame.
    assert with_accurate_noise(result, most_megapixels=0.05) is result  # three boards are 0.074 megapixels
    boards = []
    measured = with_accurate_noise(result, progress=lambda what, number, total: boards.append((number, total)))
    assert boards[-1] == (3, 3)
    chosen = chosen_boards(result)
    assert [RULERS[i] for i in chosen] == [1000.0, 2200.0, 3200.0]  # nearest, closest to the focus, farthest
    assert np.flatnonzero(np.isfinite(measured.pixel_sigma_px["accurate"])).tolist() == chosen
    found = depth_accuracy(measured, "accurate")
    eye = CodedApertureCamera(camera, default_config(camera, "accurate"))
    for i in (chosen[0], chosen[2]):
        depth = eye.measure(result.session.read(list(result.session.boards)[i])).depth_mm
        scatter = robust_sigma(depth[np.isfinite(depth)] - np.nanmedian(depth))
        bar = np.interp(RULERS[i], found.depth_mm, np.sqrt(found.pixel_sigma_mm**2 - found.curve_sigma_mm**2))
        # The grid has 1 of 36 pixels, neighbours have one error, and tails count more in px than in mm.
        assert bar == pytest.approx(scatter, rel=0.3), RULERS[i]

    camera.save(tmp_path / "camera.asdf")
    again = Calibration.load(tmp_path / "camera.asdf")
    assert again.blur == camera.blur
    options = again.provenance["options"]
    assert CalibrationConfig(**{k: tuple(v) if isinstance(v, list) else v for k, v in options.items()}) == result.config
    assert set(options) == set(asdict(CalibrationConfig()))
    white = {"open", "cy_halves", "sheet_c", "sheet_y"}
    assert set(again.provenance["files"]) == {
        "session.toml", "distances.csv", *(f"board/{ruler:.0f}.png" for ruler in RULERS),
        *(f"tilt/{i:02}.png" for i in range(4)), *(f"white/{name}.png" for name in white),
    }  # fmt: skip

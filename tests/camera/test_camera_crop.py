"""A part of a photograph, whose place in the frame is known, against the same part of the whole photograph."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.products.samples import SAMPLES, open_sample, sample_camera, sample_image
from chromaperture.system.errors import InputError

LEFT, TOP, WIDTH, HEIGHT = 210, 96, 390, 300
PART = np.s_[TOP : TOP + HEIGHT, LEFT : LEFT + WIDTH]
BORDER_PX = 24  # windows at the part's border see less than those of the whole


def cropping(camera, origin_px):
    return CodedApertureCamera(camera.calibration, replace(camera.config, crop_origin_px=origin_px))


@pytest.fixture(scope="module")
def whole():
    camera, image = open_sample(SAMPLES[0], quality="real-time")
    return camera, image, camera.measure(image), cropping(camera, (LEFT, TOP)).measure(image[PART])


def test_a_part_is_measured_as_in_the_whole_photograph(whole):
    _, image, frame, part = whole
    assert part.depth_mm.shape == part.image.shape[:2] == (HEIGHT, WIDTH)
    inside = np.s_[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
    off_px = np.abs(part.disparity_px - frame.disparity_px[PART])[inside]
    # Not equal: paths end at the part's border, and the guide's range is the part's own. Less than a layer, 0.5 px.
    # They differ by more than 1.25 bars in 1.4 % of the pixels, on surfaces that one of them gives to another layer.
    assert np.nanmedian(off_px) < 0.02
    assert (off_px <= 1.25 * frame.disparity_sigma_px[PART][inside]).sum() > 0.98 * np.isfinite(off_px).sum()
    same = off_px < 1e-3
    ratio = part.depth_mm[inside][same] / frame.depth_mm[PART][inside][same]
    np.testing.assert_allclose(ratio, 1, atol=2e-3)  # the curves of the part's own place in the frame
    np.testing.assert_array_equal(part.image, image[PART])
    assert np.isfinite(part.color).all()


def test_points_of_a_part_lie_on_the_rays_of_the_frame(whole):
    *_, frame, part = whole
    points = part.points(max_relative_sigma=np.inf).points_mm.astype(float)
    lens = frame.calibration.lens
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), lens.camera_matrix, lens.distortion)[0][:, 0]
    v, u = np.nonzero(np.isfinite(part.depth_mm) & np.isfinite(part.sigma_mm))
    np.testing.assert_allclose(pixels, np.stack([u + LEFT, v + TOP], axis=1), atol=5e-3)


@pytest.mark.parametrize(("origin", "shape"), [((400, 0), (200, 400)), ((0, 300), (200, 400)), ((0, 0), (490, 700))])
def test_a_part_beyond_the_frame_is_refused(whole, origin, shape):
    camera = cropping(whole[0], origin)
    with pytest.raises(InputError, match=r"does not lie in the camera's 720x480 px"):
        camera.measure(np.full((*shape, 3), (0.5, 0.45, 0.4), np.float32) * np.linspace(0.5, 1, shape[1])[:, None])


def test_the_command_line_measures_a_part(run, tmp_path):
    counts = cv2.imread(str(sample_image(SAMPLES[0])), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(tmp_path / "part.png"), counts[PART])
    command = ("depth", tmp_path / "part.png", "--camera", sample_camera(SAMPLES[0]), "--out", tmp_path / "out", "-q")
    command += ("--quality=real-time",)
    code, _, complaint = run(*command)
    assert (code, complaint.count("\n")) == (2, 1)
    assert "--crop-origin" in complaint
    assert run(*command, "--crop-origin", f"{LEFT},{TOP}").returncode == 0
    depth = cv2.imread(str(tmp_path / "out" / "part.depth.png"), cv2.IMREAD_UNCHANGED)
    assert depth.shape == (HEIGHT, WIDTH)
    assert 900 < np.median(depth[depth > 0]) < 4000
    for text in ("210", "a,b", "-1,0"):
        assert run(*command, "--crop-origin", text).returncode == 2
    design = ("depth", tmp_path / "part.png", "--design", "cy_halves", "--crop-origin", "0,0", "-q")
    assert "calibrated camera" in run(*design).stderr

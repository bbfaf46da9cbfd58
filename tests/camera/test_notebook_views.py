"""A camera and points as a notebook shows them."""

from __future__ import annotations

import base64
import re
import shutil

import cv2
import numpy as np
import pytest

import chromaperture as cap
from apps import chromium
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.depth.pointcloud import PointCloud
from chromaperture.frame.notebook import points_view
from chromaperture.model.camera_file import Calibration

SAMPLE = "still_life_cy_halves"


def picture_of(html: str) -> np.ndarray:
    data = base64.b64decode(re.search('base64,([^"]+)', html)[1])
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].astype(int)


def test_a_camera_shows_its_film_and_what_it_is_worth():
    camera = cap.load_camera(cap.sample_camera(SAMPLE), quality="real-time")
    html = camera._repr_html_()
    pupil = picture_of(html)
    left, right = pupil[60, 30], pupil[60, 90]
    assert left[0] < left[2]  # cyan, on the left
    assert right[2] < right[0]  # yellow
    assert (pupil[0, 0] == 255).all()  # outside the pupil
    worth = re.findall(r"(\d+) mm at (\d+) mm", html)
    assert len(worth) == 3
    curve = camera.calibration.on_axis("real-time")
    for millimetres, at in ((float(a), float(b)) for a, b in worth):
        ends = depth_to_disparity(np.array([at - millimetres / 2, at + millimetres / 2]), curve)
        assert np.diff(ends)[0] == pytest.approx(0.1, abs=0.006)  # both figures are rounded to millimetres


def test_a_camera_without_calibration_says_so():
    html = cap.CodedApertureCamera(Calibration.uncalibrated("rgb_squares", width_px=64, height_px=48))._repr_html_()
    assert "not calibrated" in html
    assert "worth" not in html


def test_points_need_points():
    with pytest.raises(cap.InputError, match="no point"):
        points_view(PointCloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)), most_points=9, height_px=9)


def test_a_page_of_points_holds_them_and_loads_nothing():
    rng = np.random.default_rng(0)
    points = rng.normal((0, 0, 2000), 100, (5000, 3)).astype(np.float32)
    cloud = PointCloud(points, rng.integers(0, 255, (5000, 3)).astype(np.uint8))
    view = points_view(cloud, most_points=1000, height_px=300)
    assert view.count == 1000
    assert "PointsView(1000 points)" in repr(view)
    assert not re.search(r"""(?:src|href)=["']https?:""", view.page)
    assert 'height="300"' in view._repr_html_()
    assert len(view.page) > len(points_view(cloud, most_points=10, height_px=300).page)  # the data is inside


@pytest.mark.extra("browser", "playwright")
@pytest.mark.skipif(shutil.which("chromium") is None, reason="Chromium is not installed: the page is NOT looked at")
@pytest.mark.slow
def test_a_notebook_turns_points(driver, rng):
    points = rng.normal((0, 0, 2000), 100, (5000, 3)).astype(np.float32)
    view = points_view(PointCloud(points, np.full((5000, 3), 200, np.uint8)), most_points=1000, height_px=300)
    with chromium(driver) as browser:
        page = browser.new_page()
        page.set_content(view._repr_html_())
        canvas = page.frame_locator("iframe").locator("#cloud")
        canvas.and_(page.frame_locator("iframe").locator("[data-drawn='1000']")).wait_for()
        before = canvas.screenshot()
        canvas.drag_to(canvas, source_position={"x": 100, "y": 100}, target_position={"x": 200, "y": 100})
        assert canvas.screenshot() != before

"""The page with cameras of the computer, and a sheet at two exposures."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
from PIL import Image

from apps import BROWSER_TESTS, FACTS, PHONE, chromium, pages, served
from chromaperture.app.camera_feed import CameraFeed
from chromaperture.system.errors import InputError
from test_app_page import FAULTS, begin, says

pytestmark = BROWSER_TESTS
NAME = "still_life_cy_halves"
ENCODED = {key: value for key, value in FACTS.items() if "level" not in key}


@pytest.fixture(scope="module")
def browser(driver):
    with chromium(driver) as started:
        yield started


def test_the_assistant_photographs_with_a_camera_of_the_computer(browser, tmp_path, pictures):
    levels = "black_level=16&white_level=1016"
    specs = f"{pictures}?{levels}", f"{pictures}?{levels}&loop=1", f"{tmp_path}/gone"
    feeds = [CameraFeed(spec) for spec in specs]
    with served(tmp_path / "app", feeds=feeds) as app, pages(browser, app.url) as opened:
        page = opened(PHONE, camera=None)
        begin(page, "bench", FACTS)
        page.select_option("#shot-from", label="bench camera")
        page.click("#shot-camera")
        page.wait_for_selector(".preview img[src]")
        page.wait_for_function("() => document.querySelector('.preview img').naturalWidth === 360")
        assert not page.is_visible("#shot-watch")  # looking again would take the next photograph
        assert page.evaluate(FAULTS) == []
        page.fill("#shot-ruler", "2000")
        page.click("#shot-camera")
        page.wait_for_selector("text=Kept as board/2000.png", timeout=60_000)
        page.click("#shot-next")
        page.wait_for_function("() => document.querySelector('.preview img')?.naturalWidth === 360")
        page.fill("#shot-ruler", "1000")
        page.click("#shot-camera")
        page.wait_for_selector("text=Kept as board/1000.png", timeout=60_000)
        page.click("#shot-next")
        page.click("#shot-next")
        says(page, "no more pictures")
        page.select_option("#shot-from", index=2)  # the same folder, played like a live camera
        page.click("#shot-camera")
        page.wait_for_selector(".preview img[src]")
        first = page.get_attribute(".preview img", "src")
        page.wait_for_function("(first) => document.querySelector('.preview img').src !== first", arg=first)
        assert page.is_visible("#shot-watch")
        page.select_option("#shot-from", label="gone")
        page.click("#shot-camera")
        says(page, "gone")
        assert not page.query_selector(".preview")
    kept = cv2.imread(str(tmp_path / "app" / "sessions" / "bench" / "board" / "2000.png"), cv2.IMREAD_UNCHANGED)
    delivered = cv2.imread(str(pictures / "0.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(kept, delivered)


def test_a_live_camera_that_is_taken_away_can_be_looked_at_again(browser, tmp_path, pictures):
    class Flaky(CameraFeed):
        is_there = True

        def next_frame(self):
            if not self.is_there:
                raise InputError("webcam:0 gives no picture; is it connected and switched on?")
            return super().next_frame()

    feed = Flaky(f"{pictures}?black_level=16&white_level=1016&loop=1")
    with served(tmp_path / "app", feeds=[feed]) as app, pages(browser, app.url) as opened:
        page = opened(PHONE, camera=None)
        begin(page, "bench", FACTS)
        page.select_option("#shot-from", index=1)
        page.click("#shot-camera")
        page.wait_for_selector(".preview img[src]")
        feed.is_there = False
        says(page, "gives no picture")
        page.wait_for_selector("#shot-next")
        feed.is_there = True
        page.click("#shot-next")
        page.wait_for_selector("#shot-next", state="detached")


def test_a_sheet_at_two_exposures_tells_the_tone_curve(browser, tmp_path):
    y, x = np.mgrid[:240, :360]
    light = 0.85 * np.exp(-2.5 * (((x - 180) / 360) ** 2 + ((y - 120) / 360) ** 2))[..., None] * [0.7, 1.0, 0.5]
    for name, factor in (("long", 1.0), ("short", 0.25)):
        encoded = np.rint(255 * (factor * light) ** (1 / 1.8)).astype(np.uint8)
        Image.fromarray(encoded).save(tmp_path / f"{name}.png")
    with served(tmp_path / "app") as app, pages(browser, app.url) as opened:
        page = opened(PHONE, camera=None)
        begin(page, "bench", ENCODED)

        def put(name, exposure_ms):
            page.select_option("#shot-kind", "tone")
            page.fill("#shot-exposure", exposure_ms)
            page.set_input_files("#shot-file", str(tmp_path / f"{name}.png"))

        put("long", "8")
        page.wait_for_selector("text=Kept as tone/00.png")
        put("short", "2")
        page.wait_for_selector("text=Kept as tone/01.png")
        assert "the curve is not sRGB" in page.inner_text(".checks")
        assert page.is_visible("#tone-title")
        label = page.get_attribute("[aria-label^='Powers']", "aria-label")
        powers = [float(v) for v in re.findall(r"\d+\.\d+", label)]
        assert 1.1 < powers[0] < powers[1] < 1.3  # sRGB's local power over 1.8
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        assert page.evaluate(FAULTS) == []
        assert "tone_error = 0." in (tmp_path / "app" / "sessions" / "bench" / "session.toml").read_text()

"""Photograph the app's page for app.md: ``python docs/app_pictures.py docs/images``."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

sys.path[:0] = [str(Path(__file__).parents[1] / "tests"), str(Path(__file__).parents[1] / "tests" / "app")]
from apps import DESKTOP, FACTS, PHONE, REC_709, WEBGPU, chromium, open_photo, pages, render_session, served, write_y4m  # noqa: E402
from chromaperture.app.camera_feed import CameraFeed  # noqa: E402
from chromaperture.color.srgb import linear_to_srgb_bytes  # noqa: E402
from chromaperture.products.samples import open_sample, sample_camera, sample_image  # noqa: E402
from test_app_page import begin, put  # noqa: E402

SAMPLE = "still_life_cy_halves"
SHARP = {"device_scale_factor": 1.5}  # sharper than a phone of that width in CSS px, and still a small file


def main(out: Path) -> None:
    """Take every picture; some minutes."""
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder, (_, image) = Path(name), open_sample(SAMPLE)
        doubled = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
        write_y4m(folder / "scene.y4m", doubled, shares=REC_709)
        cv2.imwrite(str(folder / "still_life.png"), linear_to_srgb_bytes(image)[..., ::-1])
        render_session(folder / "boards")
        with (
            served(folder / "app", camera=sample_camera(SAMPLE)) as app,
            chromium(driver, camera=folder / "scene.y4m", flags=WEBGPU) as browser,
            pages(browser, app.url) as opened,
        ):
            page = opened(PHONE, **SHARP)
            live(page, out / "app-live.png")
            points(page, folder / "still_life.png", out / "app-points.png")
            photo(page, out / "app-photo-phone.png")
            page = opened(DESKTOP)
            photo(page, out / "app-photo-desktop.png")
            assistant(page, folder / "boards", out)
            page = opened(PHONE, **SHARP)
            page.click("#tab-calibrate")
            page.click("#calibrate >> text=bench")
            page.wait_for_selector("#shot-file", state="attached")
            take(page, out / "app-assistant-phone.png", after_s=0.5)
        cameras_and_exposures(driver, folder, out)


def take(page: Any, path: Path, *, after_s: float = 0.0, whole: bool = False) -> None:
    """Photograph a page once what moves in it has come to rest."""
    time.sleep(after_s)
    page.screenshot(path=path, full_page=whole)


def touch(page: Any, viewer: str, x: float, y: float) -> None:
    """Touch a place of a picture, fractions of its sides."""
    box = page.locator(f"{viewer} .stage canvas").bounding_box()
    page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])


def live(page: Any, path: Path) -> None:
    """Measure the camera's frames by the rasteriser of Chromium, which is slow."""
    page.select_option("#where", "device")
    page.click("#live-start")
    page.wait_for_selector("#live-speed:has-text('frames/s')")
    touch(page, "#live-viewer", 0.6, 0.62)
    page.wait_for_selector("#live-viewer .reading:has-text('±'):not([aria-busy])")
    take(page, path, after_s=8)
    page.click("#live-start")


def points(page: Any, picture: Path, path: Path) -> None:
    """Turn the points of a photograph."""
    open_photo(page, picture)
    page.locator("#photo-viewer [data-view=points]").click()
    canvas = page.locator("#photo-viewer .turned canvas[aria-label*=points]")
    canvas.wait_for()
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 160, box["y"] + 115, steps=3)
    page.mouse.up()
    page.mouse.wheel(0, 250)
    take(page, path, after_s=1)
    page.locator("#photo-viewer [data-view=depth]").click()
    page.select_option("#where", "auto")


def photo(page: Any, path: Path) -> None:
    """Focus a photograph by a touch."""
    open_photo(page, sample_image(SAMPLE))
    page.locator("#photo-viewer [data-view=picture]").click()
    page.evaluate("() => { const f = document.getElementById('f-number'); f.value = -1.5; "
                  "f.dispatchEvent(new Event('input')); }")  # fmt: skip
    touch(page, "#photo-viewer", 0.38, 0.62)
    take(page, path, after_s=4)


def assistant(page: Any, boards: Path, out: Path) -> None:
    """Calibrate, with a board whose ruler was misread."""
    begin(page, "bench", FACTS)
    for at in (2000, 1000, 3000, 1500):
        put(page, "board", boards / "board" / f"{at}.png", ruler_mm=at)
    for i in range(3):
        put(page, "tilt", boards / "tilt" / f"{i:02d}.png")
    page.select_option("#shot-kind", "board")
    page.fill("#shot-ruler", "2900")
    page.set_input_files("#shot-file", str(boards / "board" / "2500.png"))
    page.wait_for_selector("text=Not kept")
    take(page, out / "app-assistant.png", whole=True)
    put(page, "board", boards / "board" / "2500.png", ruler_mm=2500)
    for i in (3, 4):
        put(page, "tilt", boards / "tilt" / f"{i:02d}.png")
    for sheet in ("open", "cy_halves", "sheet_c", "sheet_y"):
        put(page, "white", boards / "white" / f"{sheet}.png", sheet=sheet)
    page.uncheck("#lens-blur")
    page.click("#calibrate-start")
    page.wait_for_selector("#calibrated")
    take(page, out / "app-calibrated.png", after_s=1, whole=True)


def cameras_and_exposures(driver: Any, folder: Path, out: Path) -> None:
    """Use a camera of the computer, and a sheet at two exposures through the curve of video cameras."""
    sheet = cv2.imread(str(folder / "boards" / "white" / "open.png"), cv2.IMREAD_UNCHANGED)
    y, x = np.mgrid[-0.5 : 0.5 : 1j * sheet.shape[0], -0.5 : 0.5 : 1j * sheet.shape[1]]
    light = np.clip((sheet[..., ::-1] - 16.0) / 1000, 0, 1) * np.exp(-3 * (x**2 + y**2))[..., None]  # vignetting
    for name, factor in (("long", 1.0), ("short", 0.25)):
        dimmed = factor * light
        bt709 = np.where(dimmed < 0.018, 4.5 * dimmed, 1.099 * dimmed**0.45 - 0.099)  # ITU-R BT.709-6, item 1.2
        Image.fromarray(np.rint(255 * bt709).astype(np.uint8)).save(folder / f"{name}.png")
    feed = CameraFeed(f"{folder}/boards/board?black_level=16&white_level=1016&loop=1")
    with served(folder / "other", feeds=[feed]) as app, chromium(driver) as browser, pages(browser, app.url) as opened:
        page = opened(DESKTOP, camera=None)
        begin(page, "bench", FACTS)
        page.select_option("#shot-from", index=1)
        page.click("#shot-camera")
        page.wait_for_selector(".preview img[src]")
        page.fill("#shot-ruler", "2000")
        take(page, out / "app-computer-camera.png", after_s=1)
        page = opened(PHONE, camera=None, **SHARP)
        page.click("#tab-calibrate")
        page.click("text=Other session") if page.is_visible("text=Other session") else None
        begin(page, "phone", {key: value for key, value in FACTS.items() if "level" not in key})
        for i, (name, exposure_ms) in enumerate((("long", "8"), ("short", "2"))):
            page.select_option("#shot-kind", "tone")
            page.fill("#shot-exposure", exposure_ms)
            page.set_input_files("#shot-file", str(folder / f"{name}.png"))
            page.wait_for_selector(f"text=Kept as tone/0{i}")
        page.wait_for_selector("#message", state="hidden")
        page.evaluate("document.getElementById('tone-title').parentElement.scrollIntoView({ block: 'center' })")
        take(page, out / "app-tone-phone.png", after_s=0.5)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

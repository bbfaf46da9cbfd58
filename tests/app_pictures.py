"""Photograph the app's page for docs/app.md: ``python tests/app_pictures.py docs/images``."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

from apps import DESKTOP, FACTS, PHONE, REC_709, WEBGPU, chromium, render_session, served, write_y4m
from chromaperture.app.camera_feed import CameraFeed
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.products.samples import open_sample, sample_camera, sample_image
from test_app_page import begin, put

SAMPLE = "still_life_cy_halves"


def bt709(light: np.ndarray) -> np.ndarray:
    """Encode by ITU-R BT.709-6, item 1.2, the curve of video cameras."""
    light = np.clip(light, 0, 1)
    return np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099)


def main(out: Path) -> None:
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder = Path(name)
        _, image = open_sample(SAMPLE)
        doubled = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
        write_y4m(folder / "scene.y4m", doubled, shares=REC_709)
        cv2.imwrite(str(folder / "still_life.png"), linear_to_srgb_bytes(image)[..., ::-1])
        render_session(folder / "boards")
        with (
            served(folder / "app", camera=sample_camera(SAMPLE)) as app,
            chromium(driver, camera=folder / "scene.y4m", flags=WEBGPU) as browser,
        ):
            for size, label in ((PHONE, "phone"), (DESKTOP, "desktop")):
                # Sharper than a phone of that width in CSS px, and still a small file.
                context = browser.new_context(viewport=size, device_scale_factor=1.5 if size is PHONE else 1)
                context.grant_permissions(["camera"])
                page = context.new_page()
                page.goto(app.url)
                page.wait_for_selector("#camera option[value=cy_halves]", state="attached")
                if size is PHONE:
                    live(page, out / "app-live.png")
                    points(page, folder / "still_life.png", out / "app-points.png")
                photo(page, out / f"app-photo-{label}.png")
                if size is DESKTOP:
                    assistant(page, folder / "boards", out)
                else:
                    page.click("#tab-calibrate")
                    page.wait_for_selector("input[name=name]")
                context.close()
            page = browser.new_page(viewport=PHONE, device_scale_factor=1.5)
            page.goto(app.url)
            page.click("#tab-calibrate")
            page.click("text=bench")
            page.wait_for_selector("#shot-file", state="attached")
            time.sleep(0.5)
            page.screenshot(path=out / "app-assistant-phone.png")
            page.close()
        cameras_and_exposures(driver, folder, out)


def cameras_and_exposures(driver, folder: Path, out: Path) -> None:
    """A camera of the computer, and a sheet at two exposures through the curve of video cameras."""
    if not (folder / "boards").is_dir():
        render_session(folder / "boards")
    sheet = cv2.imread(str(folder / "boards" / "white" / "open.png"), cv2.IMREAD_UNCHANGED)
    y, x = np.mgrid[: sheet.shape[0], : sheet.shape[1]]
    dark = np.exp(-3 * (((x / sheet.shape[1]) - 0.5) ** 2 + ((y / sheet.shape[0]) - 0.5) ** 2))[..., None]  # vignetting
    light = np.clip((sheet[..., ::-1] - 16.0) / 1000, 0, 1) * dark
    for name, factor in (("long", 1.0), ("short", 0.25)):
        Image.fromarray(np.rint(255 * bt709(factor * light)).astype(np.uint8)).save(folder / f"{name}.png")
    feed = CameraFeed(f"{folder}/boards/board?black_level=16&white_level=1016&loop=1")
    with served(folder / "other", feeds=[feed]) as app, chromium(driver) as browser:
        page = browser.new_page(viewport=DESKTOP)
        page.goto(app.url)
        begin(page, "bench", FACTS)
        page.select_option("#shot-from", index=1)
        page.click("#shot-camera")
        page.wait_for_selector(".preview img[src]")
        page.fill("#shot-ruler", "2000")
        time.sleep(1)
        page.screenshot(path=out / "app-computer-camera.png")
        page.close()
        page = browser.new_page(viewport=PHONE, device_scale_factor=1.5)
        page.goto(app.url)
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
        time.sleep(0.5)
        page.screenshot(path=out / "app-tone-phone.png")


def touch(page, viewer: str, x: float, y: float) -> None:
    box = page.locator(f"{viewer} .stage canvas").bounding_box()
    page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
    time.sleep(0.3)


def live(page, path: Path) -> None:
    """By the rasteriser of Chromium, which is slow."""
    page.select_option("#where", "device")
    page.click("#live-start")
    page.wait_for_selector("#live-speed:has-text('frames/s')", timeout=240_000)
    touch(page, "#live-viewer", 0.6, 0.62)
    page.wait_for_selector("#live-viewer .reading:has-text('±'):not([aria-busy])", timeout=60_000)
    time.sleep(8)
    page.screenshot(path=path)
    page.click("#live-start")


def points(page, picture: Path, path: Path) -> None:
    page.click("#tab-photo")
    page.set_input_files("#photo-open", str(picture))
    page.wait_for_selector("#photo-tools:not([hidden])", timeout=240_000)
    page.locator("#photo-viewer [data-view=points]").click()
    canvas = page.locator("#photo-viewer .turned canvas[aria-label*=points]")
    canvas.wait_for()
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 160, box["y"] + 115, steps=3)
    page.mouse.up()
    page.mouse.wheel(0, 250)
    time.sleep(1)
    page.screenshot(path=path)
    page.locator("#photo-viewer [data-view=depth]").click()
    page.select_option("#where", "auto")


def photo(page, path: Path) -> None:
    page.click("#tab-photo")
    page.set_input_files("#photo-open", str(sample_image(SAMPLE)))
    page.wait_for_selector("#photo-tools:not([hidden])", timeout=60_000)
    page.locator("#photo-viewer [data-view=picture]").click()
    page.evaluate("() => { const f = document.getElementById('f-number'); f.value = -1.5; "
                  "f.dispatchEvent(new Event('input')); }")  # fmt: skip
    touch(page, "#photo-viewer", 0.38, 0.62)
    time.sleep(4)
    page.screenshot(path=path)


def assistant(page, boards: Path, out: Path) -> None:
    begin(page, "bench", FACTS)
    for at in (2000, 1000, 3000, 1500):
        put(page, "board", boards / "board" / f"{at}.png", ruler_mm=at)
    for i in range(3):
        put(page, "tilt", boards / "tilt" / f"{i:02d}.png")
    page.select_option("#shot-kind", "board")
    page.fill("#shot-ruler", "2900")
    page.set_input_files("#shot-file", str(boards / "board" / "2500.png"))
    page.wait_for_selector("text=Not kept")
    page.screenshot(path=out / "app-assistant.png", full_page=True)
    put(page, "board", boards / "board" / "2500.png", ruler_mm=2500)
    for i in (3, 4):
        put(page, "tilt", boards / "tilt" / f"{i:02d}.png")
    for sheet in ("open", "cy_halves", "sheet_c", "sheet_y"):
        put(page, "white", boards / "white" / f"{sheet}.png", sheet=sheet)
    page.uncheck("#lens-blur")
    page.click("#calibrate-start")
    page.wait_for_selector("#calibrated", timeout=300_000)
    time.sleep(1)
    page.screenshot(path=out / "app-calibrated.png", full_page=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

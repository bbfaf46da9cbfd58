"""Frames of a device's camera in the page: where their colours lie, and how the device is held."""

from __future__ import annotations

import base64
import json
from dataclasses import replace

import numpy as np
import pytest

from apps import BROWSER_TESTS, FACTS, PHONE, pages, planes_of, served
from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import resized
from chromaperture.products.samples import sample_camera
from test_app_page import begin, says

pytestmark = BROWSER_TESTS
NAME = "still_life_cy_halves"
WIDTH, HEIGHT = 256, 192
COLOUR = (0.8, 0.4, 0.2)
HOLDING = {"angle_deg": 90, "orientation": "landscape-primary", "facing": "environment"}
BYTES = """
    const packed = (array) => btoa(Array.from(array, (v) => String.fromCharCode(v)).join(""));
    const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
"""
# R, G, B of a frame with the given planes: by the page's function, and by a canvas of half the size.
HALVED = (
    "async ({ data, format, width, height, siting, colorSpace }) => {"
    + BYTES
    + """
    const { readPlanes } = await import("./video_planes.js"), { grab } = await import("./capture.js");
    const form = { format, codedWidth: width, codedHeight: height, timestamp: 0, colorSpace };
    const frame = new VideoFrame(bytes(data), form);
    const picture = await readPlanes(frame, siting), canvas = grab(frame, width >> 1, height >> 1);
    return { width: picture.width, planes: packed(picture.data), canvas: packed(canvas.data) };
}"""
)
# A phone whose camera looks back, held as `window.angle` says; landscape with its top to the left at first.
HELD = """
    Object.defineProperty(ScreenOrientation.prototype, "angle", { get: () => window.angle ?? 90 });
    const settings = MediaStreamTrack.prototype.getSettings;
    MediaStreamTrack.prototype.getSettings = function () {
        return { ...settings.call(this), facingMode: window.facing ?? "environment" };
    };
"""


def textured(moved_px):
    """A coloured periodic texture, encoded, that is coarser than half the pixels; R moved right against G, B left."""
    noise = np.random.default_rng(3).normal(size=(HEIGHT, WIDTH))
    across, down = np.fft.fftfreq(WIDTH), np.fft.fftfreq(HEIGHT)[:, None]
    spectrum = np.fft.fft2(noise) * np.exp(-2 * (np.pi * 2.5) ** 2 * (across**2 + down**2))
    moves = np.array([moved_px / 2, 0, -moved_px / 2])
    channels = [np.fft.ifft2(spectrum * np.exp(-2j * np.pi * across * m)).real for m in moves]
    return np.clip(0.5 + 0.12 * np.stack(channels, axis=2) / np.std(channels[1]), 0.02, 0.98) * COLOUR


def displacement(picture):
    """How far R lies right of B, px: where moved B is most like R."""
    red, blue = (picture[..., c].astype(float) for c in (0, 2))
    steps = np.arange(-2, 2.005, 0.01)
    phase, spectrum = np.fft.fftfreq(red.shape[1]), np.fft.fft(blue, axis=1)
    inner = (slice(8, -8), slice(8, -8))
    moved = (np.fft.ifft(spectrum * np.exp(-2j * np.pi * phase * s), axis=1).real for s in steps)
    return steps[np.argmax([np.corrcoef(m[inner].ravel(), red[inner].ravel())[0, 1] for m in moved])]


@pytest.fixture(scope="module")
def app(tmp_path_factory):
    with served(tmp_path_factory.mktemp("app"), camera=sample_camera(NAME)) as running:
        calibration = Calibration.load(sample_camera(NAME))
        held = {"provenance": {**calibration.provenance, "holding": HOLDING}}
        replace(calibration, **held).save(running.folder / "cameras" / "held.asdf")
        resized(calibration, 1080, 720).save(running.folder / "cameras" / "large.asdf")
        yield running


@pytest.fixture(scope="module")
def shared(browser, app):
    """A page for what leaves no trace in it."""
    with pages(browser, app.url) as opened:
        yield opened(PHONE)


def frame_data(planes, kind):
    if kind == "NV12":
        return planes[0].tobytes() + np.stack(planes[1:], axis=-1).tobytes()
    return b"".join(plane.tobytes() for plane in planes)


@pytest.mark.parametrize(
    ("kind", "siting"), [("I420", "left"), ("NV12", "left"), ("I420", "centre"), ("I420", "top-left")]
)
@pytest.mark.parametrize("moved_px", [0.0, 1.2])
def test_colours_of_a_frame_lie_where_the_camera_saw_them(shared, kind, siting, moved_px):
    encoded = textured(moved_px)
    values = {
        "data": base64.b64encode(frame_data(planes_of(encoded, siting), kind)).decode(), "format": kind,
        "width": WIDTH, "height": HEIGHT, "siting": siting, "colorSpace": {"matrix": "smpte170m", "fullRange": False},
    }  # fmt: skip
    found = shared.evaluate(HALVED, values)
    planes, canvas = (
        np.frombuffer(base64.b64decode(found[way]), np.uint8).reshape(HEIGHT // 2, WIDTH // 2, 4)[..., :3]
        for way in ("planes", "canvas")
    )
    assert displacement(planes) == pytest.approx(moved_px / 2, abs=0.03)
    if siting == "left":
        assert abs(displacement(canvas) - moved_px / 2) > 0.2  # a browser takes it for centred
    np.testing.assert_allclose(planes.mean(axis=(0, 1)), 255 * encoded.mean(axis=(0, 1)), atol=1.5)


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("matrix", ["bt709", "smpte170m"])
def test_matrix_and_range_are_those_that_the_frame_states(shared, matrix, full):
    data = np.concatenate([np.full(64, 120), np.full(16, 90), np.full(16, 170)]).astype(np.uint8).tobytes()
    space = {"matrix": matrix, "fullRange": full, "primaries": "bt709", "transfer": "bt709"}
    values = {"data": base64.b64encode(data).decode(), "format": "I420", "width": 8, "height": 8, "siting": "left",
              "colorSpace": space}  # fmt: skip
    found = shared.evaluate(HALVED, values)
    planes, canvas = (
        np.frombuffer(base64.b64decode(found[way]), np.uint8)[:3].astype(int) for way in ("planes", "canvas")
    )
    assert np.abs(planes - canvas).max() <= 5  # a browser multiplies with few bits


@pytest.mark.parametrize("kind", ["BGRA", "I444"])
def test_frames_with_all_their_colours_stay_whole(shared, kind):
    pixel = [10, 20, 30, 255] if kind == "BGRA" else [120, 128, 128]
    data = np.tile(pixel, 64) if kind == "BGRA" else np.repeat(pixel, 64)
    values = {"data": base64.b64encode(data.astype(np.uint8).tobytes()).decode(), "format": kind, "width": 8,
              "height": 8, "siting": "left"}  # fmt: skip
    found = shared.evaluate(HALVED, values)
    assert found["width"] == 8
    expected = [30, 20, 10] if kind == "BGRA" else [121, 121, 121]
    assert np.abs(np.frombuffer(base64.b64decode(found["planes"]), np.uint8)[:3] - np.array(expected)).max() <= 1


def start(page, camera):
    page.select_option("#camera", camera)
    page.click("#live-start")
    page.wait_for_selector("#live-speed:has-text('frames/s')", timeout=30_000)


def test_a_phone_held_the_other_way_round_is_asked_to_be_turned(page_at):
    page = page_at(PHONE, script=HELD)
    start(page, "held")
    assert not page.is_visible("#message")
    page.evaluate("window.angle = 270")
    assert says(page, "180°") == "Turn the phone by 180°: it was calibrated with its top to the left."
    page.evaluate("window.angle = 0")
    says(page, "Turn the phone by 90°")
    page.evaluate("window.angle = 90")
    page.wait_for_selector("#message", state="hidden")
    page.evaluate("window.facing = 'user'")
    says(page, "calibrated with the camera on the back")


def test_a_camera_file_that_does_not_tell_the_holding_is_told_once(page_at):
    page = page_at(PHONE, script=HELD)
    start(page, "cy_halves")
    assert "near and far are exchanged" in says(page, "does not tell how the device was held")
    page.click("#live-start")
    start(page, "cy_halves")
    assert not page.is_visible("#message")


def test_a_camera_file_of_full_size_measures_half_and_says_so(page_at):
    page = page_at(PHONE)
    start(page, "large")
    says(page, "measured at that scale")
    assert page.get_attribute("#live-viewer canvas", "aria-label").startswith("Depth, 720 by 480")


def test_a_browser_without_planes_says_that_colours_are_approximate(page_at):
    page = page_at(PHONE, script=HELD + "delete window.VideoFrame;")
    start(page, "held")
    assert "approximate" in page.inner_text("#live-hint")
    assert "approximate" not in page.inner_text("#message")


def test_the_session_keeps_how_the_device_was_held(page_at, app):
    page = page_at(PHONE, script=HELD)
    begin(page, "holding", {key: value for key, value in FACTS.items() if "level" not in key})
    page.click("#shot-camera")
    page.wait_for_selector(".preview video")
    page.click("#shot-camera")
    page.click("text=Keep it all the same", timeout=60_000)
    page.wait_for_selector("text=Kept as", timeout=60_000)
    state = json.loads((app.folder / "sessions" / "holding" / "assistant.json").read_text())
    assert state["holding"] == HOLDING
    assert state["size_px"] == [720, 480]
    page.evaluate("window.angle = 270")
    page.click("#shot-camera")
    says(page, "Turn the phone by 180°")

"""The app's page in a Chromium of the system, at the sizes of a phone and of a desktop."""

from __future__ import annotations

import io
import re
import zipfile

import cv2
import numpy as np
import pytest

from apps import BROWSER_TESTS, DESKTOP, FACTS, PHONE, chromium, open_photo, reading, says, served
from chromaperture.app.messages import collect_warnings
from chromaperture.capture.files import Decoded, linearise
from chromaperture.color.encoding import Encoding
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.model.camera_file import Calibration
from chromaperture.products.samples import open_sample, sample_camera, sample_image

pytestmark = BROWSER_TESTS
NAME = "still_life_cy_halves"
PLACES = ((0.25, 0.6), (0.62, 0.6), (0.8, 0.55))  # on the books of the sample, fractions of the frame

# Lets a video exchange width and height, as when a phone turns, and lets a page lie in the background.
AWAY = """
    Object.defineProperty(Document.prototype, "hidden", { get: () => Boolean(window.away) });
    const video = HTMLVideoElement.prototype;
    const [w, h] = ["videoWidth", "videoHeight"].map((name) => Object.getOwnPropertyDescriptor(video, name).get);
    Object.defineProperty(video, "videoWidth", { get() { return (window.turned ? h : w).call(this); } });
    Object.defineProperty(video, "videoHeight", { get() { return (window.turned ? w : h).call(this); } });
"""
# Controls that are shown and are less than 44 px high, or have no name for a screen reader.
FAULTS = """() => [...document.querySelectorAll("button, select, input, a.button")].flatMap((e) => {
    const inside = e.classList.contains("unseen") || e.type === "checkbox";
    const box = (inside ? e.closest("label") : e).getBoundingClientRect();
    if (!box.width || e.closest("[hidden]")) return [];
    const labels = [...(e.labels ?? [])].map((label) => label.textContent.trim()).join(" ");
    const faults = box.height < 44 ? [`${e.outerHTML}: ${box.height} px high`] : [];
    const name = e.getAttribute("aria-label") || e.textContent.trim() || labels;
    return name ? faults : [...faults, `${e.outerHTML}: no name`];
})"""


@pytest.fixture(scope="module")
def app(tmp_path_factory):
    with served(tmp_path_factory.mktemp("app"), camera=sample_camera(NAME)) as running:
        yield running


# ---- live


def test_live_depth_is_that_of_python(page_at):
    page = page_at(PHONE)
    page.click("#live-start")
    page.wait_for_selector("#live-viewer canvas:not([hidden])", timeout=30_000)
    page.wait_for_selector("#live-speed:has-text('frames/s')")
    camera, image = open_sample(NAME, quality="real-time")
    with collect_warnings() as notes:  # not pytest.warns: the app, in this process, records warnings at the same time
        picture = linearise(Decoded(linear_to_srgb_bytes(image)), camera_encoding=Encoding(16, 1016))
    assert any("encoded values" in note for note in notes())
    frame = camera.measure(picture)
    for x, y in PLACES:
        depth, sigma = reading(page, "#live-viewer", x, y)
        row, column = round(y * 480), round(x * 720)
        window = frame.depth_mm[row - 6 : row + 7, column - 6 : column + 7]
        # limited range and 4:2:0 of the video: a third of a px of chroma noise, well within the error bar or 2 %
        assert depth == pytest.approx(float(np.nanmedian(window)), abs=max(sigma, 0.02 * depth))
    assert re.search(r"\d ms from picture to depth", page.inner_text("#live-speed"))
    page.click("#live-start")
    assert page.inner_text("#live-start") == "Start the camera"


def test_a_turned_phone_and_a_page_in_the_background_pause_and_go_on(page_at):
    page = page_at(PHONE, script=AWAY)
    page.click("#live-start")
    page.wait_for_selector("#live-speed:has-text('frames/s')", timeout=30_000)
    page.evaluate("window.turned = true")
    assert "hold the device as it was calibrated" in says(page, "960 x 1440")
    page.evaluate("window.turned = false")
    page.wait_for_selector("#message", state="hidden")
    page.evaluate("window.away = true; document.dispatchEvent(new Event('visibilitychange'))")
    page.wait_for_selector("#live-speed:has-text('paused')")
    page.evaluate("window.away = false; document.dispatchEvent(new Event('visibilitychange'))")
    page.wait_for_selector("#live-speed:has-text('frames/s')", timeout=30_000)


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        ("NotReadableError", "another app uses it"),
        ("NotFoundError", "This device has no camera"),
        ("SomethingNew", "SomethingNew"),
    ],
)
def test_a_camera_that_cannot_be_opened_is_one_sentence(page_at, error, sentence):
    page = page_at(
        PHONE,
        script=f"""
        navigator.mediaDevices.getUserMedia = async () => {{ throw new DOMException("no", "{error}"); }};
    """,
    )
    page.click("#live-start")
    says(page, sentence)
    assert page.inner_text("#live-start") == "Start the camera"


def test_a_browser_that_asks_and_is_denied_says_so(driver, app):
    with chromium(driver, flags=("--use-fake-device-for-media-stream", "--deny-permission-prompts")) as strict:
        page = strict.new_page()
        page.goto(app.url)
        page.wait_for_selector("#camera option[value=cy_halves]", state="attached")
        page.click("#live-start")
        says(page, "does not give this page the camera")


# ---- photo


def test_a_photograph_is_measured_focused_by_a_touch_and_saved(page_at):
    page = page_at(DESKTOP)
    open_photo(page, sample_image(NAME))
    camera, image = open_sample(NAME, quality="real-time")
    frame = camera.measure(image)
    for x, y in PLACES:
        depth, sigma = reading(page, "#photo-viewer", x, y)
        window = frame.depth_mm[round(y * 480) - 3 : round(y * 480) + 4, round(x * 720) - 3 : round(x * 720) + 4]
        assert np.nanmin(window) - 1 <= depth <= np.nanmax(window) + 1  # rounded to mm
        assert sigma > 0
    page.locator("#photo-viewer [data-view=picture]").click()

    def is_wider(answer):  # than before; test_app_server.py looks at the pictures
        asked = re.search(r"refocused.*f_number=([\d.]+)", answer.url)
        return asked is not None and float(asked[1]) < 1.5

    with page.expect_response(is_wider) as answer:
        page.evaluate(
            "() => { const f = document.getElementById('f-number'); f.value = -2; "
            "f.dispatchEvent(new Event('input')); }"
        )
    assert answer.value.status == 200
    with page.expect_response(re.compile(r"refocused.*x=0\.2")):
        reading(page, "#photo-viewer", *PLACES[0])
    with page.expect_download() as download:
        page.click("#photo-save")
    packed = zipfile.ZipFile(io.BytesIO(download.value.path().read_bytes()))
    assert f"{NAME}.depth.tiff" in packed.namelist()
    with page.expect_download() as download:
        page.click("#photo-embed")
    assert download.value.suggested_filename == f"{NAME}.gdepth.jpg"
    assert download.value.path().read_bytes() == packed.read(f"{NAME}.gdepth.jpg")


def test_a_photograph_of_another_camera_is_one_sentence(page_at, tmp_path):
    cv2.imwrite(str(tmp_path / "p.png"), np.random.default_rng(1).integers(0, 255, (100, 100, 3), np.uint8))
    page = page_at(PHONE)
    page.click("#tab-photo")
    page.set_input_files("#photo-open", str(tmp_path / "p.png"))
    says(page, "100x100 px but the camera was calibrated at 720x480")
    page.set_input_files("#photo-open", {"name": "x.jpg", "mimeType": "image/jpeg", "buffer": b"no picture"})
    says(page, "damaged")


def test_a_file_that_is_too_large_is_not_sent(page_at):
    page = page_at(PHONE, script="Object.defineProperty(Blob.prototype, 'size', { get: () => 2 ** 30 });")
    page.click("#tab-photo")
    page.set_input_files("#photo-open", {"name": "x.png", "mimeType": "image/png", "buffer": b"x"})
    says(page, "larger than 256 MB")


# ---- the page itself


def test_a_full_storage_is_one_sentence(page_at, app):
    page = page_at(PHONE)
    origin = app.url.split("/", 3)
    control = page.context.new_cdp_session(page)
    control.send("Storage.overrideQuotaForOrigin", {"origin": "/".join(origin[:3]), "quotaSize": 1})
    page.click("#camera-menu")
    page.click("#camera-keep")
    says(page, "storage of this browser is full")


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_everything_can_be_touched_read_and_reached(page_at, size):
    page = page_at(size)
    for tab in ("live", "photo", "calibrate"):
        page.click(f"#tab-{tab}")
        if tab == "photo":
            open_photo(page, sample_image(NAME))
        if tab == "calibrate":
            page.wait_for_selector("input[name=name]")
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]  # nothing to the side
        faults = page.evaluate(FAULTS)
        assert faults == []


def test_the_keyboard_suffices(page_at):
    page = page_at(DESKTOP)
    page.focus("#tab-live")
    page.keyboard.press("ArrowRight")
    assert page.is_visible("#photo")
    open_photo(page, sample_image(NAME))
    page.focus("#photo-viewer .stage canvas")
    page.keyboard.press("ArrowLeft")
    first = page.inner_text("#photo-viewer .reading")
    assert re.fullmatch(r"[\d.]+ ± [\d.]+ mm", first)
    for _ in range(8):
        page.keyboard.press("ArrowUp")
    assert page.inner_text("#photo-viewer .reading") != first
    assert page.get_attribute("#photo-viewer .stage canvas", "aria-label").startswith("Depth, 720 by 480 pixels")


# ---- the assistant


def put(page, kind, path, *, ruler_mm=None, sheet=None):
    page.select_option("#shot-kind", kind)
    if ruler_mm:
        page.fill("#shot-ruler", str(ruler_mm))
    if sheet:
        page.select_option("#shot-sheet", sheet)
    page.set_input_files("#shot-file", str(path))
    page.wait_for_selector(f"text=Kept as {kind}/{path.name}", timeout=60_000)


def begin(page, name, facts):
    page.click("#tab-calibrate")
    page.wait_for_selector("input[name=name]")
    page.fill("input[name=name]", name)
    for key, value in facts.items():
        if key not in ("design", "inner_corners"):
            page.fill(f"input[name={key}]", str(value))
    page.click("text=Begin")
    page.wait_for_selector("#shot-file", state="attached")


def test_from_an_empty_folder_to_the_camera_of_the_command_line(page_at, app, tmp_path, rendered, rendered_camera):
    page = page_at(PHONE)
    begin(page, "bench", FACTS)
    put(page, "board", rendered / "board" / "2000.png", ruler_mm=2000)
    assert "1000 mm" in page.inner_text(".next .what")
    page.fill("#shot-ruler", "1900")  # misread
    page.set_input_files("#shot-file", str(rendered / "board" / "1500.png"))
    page.wait_for_selector("text=Not kept")
    assert "the ruler says 1900 mm" in page.inner_text(".checks")
    for at in (1000, 1500, 2500, 3000):
        put(page, "board", rendered / "board" / f"{at}.png", ruler_mm=at)
    for path in sorted((rendered / "tilt").iterdir()):
        put(page, "tilt", path)
    for sheet in ("open", "cy_halves", "sheet_c", "sheet_y"):
        put(page, "white", rendered / "white" / f"{sheet}.png", sheet=sheet)
    assert "Enough for a camera file" in page.inner_text("#calibrate")
    page.uncheck("#lens-blur")
    page.click("#calibrate-start")
    page.wait_for_selector("#calibrated", timeout=180_000)
    with page.expect_download() as download:
        page.click("text=Save the camera file")
    kept = tmp_path / "app.asdf"
    download.value.save_as(kept)
    ours, theirs = Calibration.load(kept).summary(), Calibration.load(rendered_camera).summary()
    for name in ("focal_length_mm", "in_focus_mm", "baseline_mm", "infinity_disparity_px", "scale_px_mm"):
        assert ours[name] == pytest.approx(theirs[name], rel=5e-3), name
    page.click("#camera-menu")
    page.wait_for_selector("#camera-kept li:has-text('bench')")  # it went back to the device
    with page.context.expect_page() as report:
        page.click("text=Report")
    report.value.wait_for_load_state()
    assert "Calibration of bench" in report.value.title() + report.value.inner_text("h1")
    assert (app.folder / "sessions" / "bench" / "distances.csv").is_file()  # an ordinary session


def test_the_devices_camera_photographs_for_the_assistant(page_at):
    page = page_at(PHONE)
    begin(page, "by-camera", FACTS)
    page.click("#shot-camera")
    page.wait_for_selector(".preview video")
    page.click("#shot-watch")  # live: the sample shows no board
    page.wait_for_selector(".checks:has-text('no board of 9 x 6 inner corners')", timeout=60_000)
    assert page.inner_text("#checks").startswith("Not yet")
    with page.expect_response(re.compile("/shots")):  # again by itself
        pass
    page.click("#shot-camera")  # a photograph without a board is not kept
    page.wait_for_selector("#checks:has-text('Not kept')", timeout=60_000)
    assert page.locator(".shots li").count() == 0

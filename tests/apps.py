"""The app as the tests run it: its server in a thread, a Chromium of the system, a camera that is a file."""

from __future__ import annotations

import contextlib
import http.client
import re
import shutil
import socket
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest

from chromaperture.app.gate import Access
from chromaperture.app.state import AppState
from chromaperture.color.srgb import linear_to_srgb_bytes

BROWSER_TESTS = [  # marks of a file whose tests need the app's server and a Chromium of the system
    pytest.mark.extra("serve", "starlette"),
    pytest.mark.extra("browser", "playwright"),
    pytest.mark.skipif(shutil.which("chromium") is None, reason="Chromium is not installed: the page is NOT tested"),
    pytest.mark.slow,
]
TOKEN = "a-token-that-only-the-tests-know"
TIMEOUT_MS = 120_000  # of a browser that compiles thirty shaders on a busy machine
PHONE, DESKTOP = {"width": 360, "height": 740}, {"width": 1280, "height": 860}
_FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
          "--disable-component-update", "--disable-sync"]  # fmt: skip
_CAMERA = ["--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream"]


# WebGPU by the rasteriser that Chromium brings, with canvases that it can draw into, and WebGL by the same.
WEBGPU = ("--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan",
          "--use-vulkan=swiftshader", "--use-angle=swiftshader")  # fmt: skip


# What a photographer knows of the camera of `render_session`.
FACTS = {
    "design": "cy_halves", "focal_length_mm": 51.6, "f_number": 2.1, "focus_mm": 2000.0, "sensor_width_mm": 22.3,
    "nearest_mm": 1000.0, "farthest_mm": 3000.0, "inner_corners": [9, 6], "square_mm": 30.0, "black_level": 16.0,
    "white_level": 1016.0,
}  # fmt: skip


class App(NamedTuple):
    url: str
    port: int
    folder: Path
    server: Any


def render_session(folder: Path) -> None:
    """Photograph boards, leaning boards and sheets through a thin lens whose truth is known; 5 s."""
    from chromaperture.cli.simulate import simulate

    simulate(folder, thin=True, width=360, height=240, cells=6, tilts=5, nearest_mm=1000, farthest_mm=3000,
             step_mm=500, quiet=True)  # fmt: skip
    assert "square_mm = 30" in (folder / "session.toml").read_text()  # as FACTS says


def calibrate_rendered(folder: Path, out: Path) -> None:
    """Calibrate the session of `render_session` as the command line does."""
    import typer

    from chromaperture.cli.calibrate import calibrate

    with contextlib.suppress(typer.Exit):  # of a calibration that cannot be used
        calibrate(folder, out, no_blur=True, no_report=True, quiet=True)
    assert out.is_file()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def served(
    folder: Path, *, camera: Path | None = None, feeds: Sequence[Any] = (), certificate: Any = None, **gate: Any
) -> Iterator[App]:
    """The app on this machine, by HTTPS with a certificate; ``gate`` replaces limits of its Gate."""
    from chromaperture.app.listening import make_server
    from chromaperture.app.server import make_app

    access = Access("127.0.0.1", TOKEN, scheme="https" if certificate else "http", command="serve")
    port, public = free_port(), certificate and certificate.certificate
    application = make_app(AppState(folder, camera, reserve_bytes=0), access, certificate=public, feeds=feeds)
    for name, value in gate.items():
        setattr(application, name, value)
    ready = threading.Event()
    pair = certificate and (certificate.certificate, certificate.key)
    server = make_server(application, host="127.0.0.1", port=port, certificate=pair, ready=ready.set)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    assert ready.wait(20)
    try:
        yield App(access.url(port), port, folder, server)
    finally:
        server.should_exit = True
        thread.join(20)
        assert not thread.is_alive()
        for feed in feeds:
            feed.close()


def call(
    app: Any, method: str, path: str, body: Any = None, headers: Any = None, token: str = TOKEN
) -> tuple[int, bytes, Any]:
    """One request to a port of this machine; returns status, body and headers of the answer."""
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", app.port, timeout=60)) as connection:
        connection.request(method, f"/{token}{path}", body, headers or {})
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers


@contextlib.contextmanager
def pages(browser: Any, url: str) -> Iterator[Any]:
    """Give a function that opens the page in a window of a size; afterwards nothing went wrong in any."""
    contexts: list[Any] = []
    wrong: list[str] = []

    def opened(size: Any, *, camera: str | None = "cy_halves", url: str = url, script: str = "", **options: Any) -> Any:
        context = browser.new_context(viewport=size, permissions=["camera"], **options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(TIMEOUT_MS)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda line: wrong.append(line.text) if "Security Policy" in line.text else None)
        if script:
            page.add_init_script(script)
        page.goto(url)
        if camera:
            page.wait_for_selector(f"#camera option[value={camera}]", state="attached")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert wrong == []


def says(page: Any, text: str) -> str:
    """What the page says, once that has a text in it."""
    page.wait_for_selector(f"#message:has-text('{text}')")
    return page.inner_text("#message")


def open_photo(page: Any, path: Path | str) -> None:
    page.click("#tab-photo")
    page.set_input_files("#photo-open", str(path))
    page.wait_for_selector("#photo-tools:not([hidden])")


def reading(page: Any, viewer: str, x: float, y: float, *, width: int = 720, height: int = 480) -> tuple[float, float]:
    """Touch a place of a picture, fractions of its sides; returns depth and error bar, mm."""
    box = page.locator(f"{viewer} .stage canvas").bounding_box()
    scale = min(box["width"] / width, box["height"] / height)
    left, top = box["x"] + (box["width"] - scale * width) / 2, box["y"] + (box["height"] - scale * height) / 2
    page.mouse.click(left + x * scale * width, top + y * scale * height)
    page.wait_for_selector(f"{viewer} .reading:has-text('±'):not([aria-busy])")
    found = re.fullmatch(r"([\d.]+) ± ([\d.]+) mm", page.inner_text(f"{viewer} .reading"))
    assert found
    return float(found[1]), float(found[2])


@contextlib.contextmanager
def chromium(driver: Any, *, camera: Path | None = None, flags: tuple[str, ...] = ()) -> Iterator[Any]:
    """A headless browser; its camera plays a y4m file."""
    arguments = [*_FLAGS, *flags]
    if camera is not None:
        arguments += [*_CAMERA, f"--use-file-for-fake-video-capture={camera.absolute()}"]
    browser = driver.chromium.launch(executable_path=shutil.which("chromium"), headless=True, args=arguments)
    try:
        yield browser
    finally:
        browser.close()


@contextlib.contextmanager
def chromium_with(driver: Any, folder: Path, linear: np.ndarray) -> Iterator[Any]:
    """A browser whose camera plays a picture at twice its size: what 4:2:0 loses is averaged away."""
    write_y4m(folder / "scene.y4m", cv2.resize(linear, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST))
    with chromium(driver, camera=folder / "scene.y4m") as started:
        yield started


REC_601, REC_709 = (0.299, 0.587, 0.114), (0.2126, 0.7152, 0.0722)  # shares of R, G, B in luma


def planes_of(encoded: np.ndarray, siting: str = "left", shares: Sequence[float] = REC_601) -> list[np.ndarray]:
    """Y, Cb, Cr of limited range, 4:2:0, of encoded RGB of 0 to 1; chroma filtered for where it lies."""
    luma = encoded @ np.array(shares)
    planes = [16 + 219 * luma]
    for channel in (2, 0):
        chroma = np.pad(128 + 224 * (encoded[..., channel] - luma) / (2 - 2 * shares[channel]), 1, mode="edge")
        across, down = (
            ((1, 2, 1) if siting != "centre" else (0, 2, 2)),
            ((1, 2, 1) if siting == "top-left" else (0, 2, 2)),
        )
        chroma = sum(w * chroma[:, i : i + luma.shape[1] : 2] for i, w in enumerate(across)) / 4
        planes.append(sum(w * chroma[i : i + luma.shape[0] : 2] for i, w in enumerate(down)) / 4)
    return [np.rint(plane).clip(0, 255).astype(np.uint8) for plane in planes]


def write_y4m(path: Path, linear: np.ndarray, frames: int = 2, shares: Sequence[float] = REC_601) -> None:
    """Write a picture (H, W, 3), linear RGB, as a video: sRGB, limited range, chroma 4:2:0 on the left."""
    height, width = linear.shape[:2]
    frame = b"".join(plane.tobytes() for plane in planes_of(linear_to_srgb_bytes(linear) / 255, shares=shares))
    with path.open("wb") as file:
        file.write(f"YUV4MPEG2 W{width} H{height} F15:1 Ip A1:1 C420mpeg2\n".encode())
        for _ in range(frames):
            file.write(b"FRAME\n" + frame)

"""Results in the browser: a page in one file, and a server that shows it to its owner only."""

from __future__ import annotations

import http.client
import shutil
import threading
from urllib.parse import urlsplit

import numpy as np
import pytest

from chromaperture.app.listening import PageServer
from chromaperture.files.map_page import Page, Panel, render
from chromaperture.products.samples import sample_camera, sample_image


def get(url, path=None, host=None, **headers):
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=20)
    connection.putrequest("GET", parts.path if path is None else path, skip_host=True)
    connection.putheader("Host", parts.netloc if host is None else host)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read().decode()
    connection.close()
    return answer.status, answer.headers, body


def test_only_the_owner_on_this_machine_sees_the_page():
    with PageServer("<p>mm</p>") as server:
        token = urlsplit(server.url).path
        status, headers, body = get(server.url)
        assert (status, body) == (200, "<p>mm</p>")
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["Referrer-Policy"] == "no-referrer"
        assert urlsplit(server.url).hostname == "127.0.0.1"
        assert get(server.url, token + "?a=b")[0] == 200
        for status, refused in (
            (403, {"path": "/"}), (403, {"path": "/wrong/"}), (403, {"host": "evil.example"}),
            (403, {"Origin": "http://evil.example"}), (404, {"path": f"{token}etc/passwd"}),
            (404, {"path": f"{token}../x"}),
        ):  # fmt: skip
            assert get(server.url, **refused)[0] == status, refused
        port = urlsplit(server.url).port
        with PageServer("second", port=port) as second:  # the next free port
            assert urlsplit(second.url).port > port
    with pytest.raises(OSError, match="refused"):
        get(server.url)


def test_view_serves_and_ends(run, tmp_path):
    result = run("view", sample_camera("still_life_cy_halves"), "--seconds", "0.2")
    assert result.returncode == 0
    assert "http://127.0.0.1:" in result.stdout
    assert "page server" not in {thread.name for thread in threading.enumerate()}


def test_view_writes_one_file(run, tmp_path):
    image, camera = sample_image("still_life_cy_halves"), sample_camera("still_life_cy_halves")
    assert run("depth", image, "--camera", camera, "--out", tmp_path, "--quality=real-time", "-q")[0] == 0
    ply = tmp_path / "still_life_cy_halves.ply"
    assert run("view", ply, "--out", tmp_path / "page.html")[0] == 0
    page = (tmp_path / "page.html").read_text()
    for text in ("depth from the sensor plane", "restored colour", "error bar", "disparity", "in_focus_mm", "points."):
        assert text in page
    assert run("view", camera, "--out", tmp_path / "camera.html")[0] == 0
    assert "distance in focus" in (tmp_path / "camera.html").read_text()


@pytest.mark.parametrize("name", ["missing.tiff", "notes.txt", "folder", "empty.png", "alone.json", "pickle.npy"])
def test_what_cannot_be_shown_is_one_line(run, tmp_path, name):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty.png").touch()
    (tmp_path / "alone.json").write_text("{}")
    np.save(tmp_path / "pickle.npy", np.array([{}], object))
    result = run("view", tmp_path / name, "--out", tmp_path / "page.html")
    assert (result.returncode, len(result.stderr.strip().splitlines())) == (2, 1), result.stderr
    assert not (tmp_path / "page.html").exists()


@pytest.mark.extra("browser", "playwright")
@pytest.mark.skipif(shutil.which("chromium") is None, reason="Chromium is not installed: the pages are NOT looked at")
@pytest.mark.parametrize("width", [1400, 390])
def test_chromium_shows_the_values_under_the_cursor(tmp_path, width):
    from playwright.sync_api import sync_playwright

    values = np.arange(600, dtype=np.float32).reshape(20, 30)
    panels = [Panel("first", values, "mm", 0, 600, "turbo_r", 1), Panel("second", -values, "px", -600, 0, "magma", 0)]
    with sync_playwright() as playwright, PageServer(render(Page("a page", panels=panels))) as server:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page, errors = browser.new_page(viewport={"width": width, "height": 800}), []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        page.goto(server.url)
        page.wait_for_selector("body[data-drawn=yes]")
        box = page.query_selector(".view").bounding_box()
        page.mouse.move(box["x"] + box["width"] * 10.5 / 30, box["y"] + box["height"] * 7.5 / 20)
        assert [e.inner_text() for e in page.query_selector_all(".value")] == ["220.0 mm", "-220 px"]  # 7 * 30 + 10
        assert page.inner_text("#place") == "column 10, row 7"
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        browser.close()
    assert errors == []

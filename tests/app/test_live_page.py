"""The page of the live loop: only its owner gets in, what it shows, and nothing that a browser sends ends the loop."""

from __future__ import annotations

import base64
import contextlib
import json
import math
import re
import shutil
import socket
import threading
import time
import weakref
from types import SimpleNamespace
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apps import BROWSER_TESTS, DESKTOP, PHONE, call, chromium, pages, reading
from chromaperture.app.gate import Access
from chromaperture.app.listening import bound
from chromaperture.app.live.loop import LiveLoop
from chromaperture.app.live.page import LivePage
from chromaperture.app.live.view import ControlLimits, Limits, LiveView, tracking_line
from chromaperture.camera.camera import load_camera
from chromaperture.capture.files import read_image
from chromaperture.capture.source import FileSource, Frame
from chromaperture.color.encoding import Encoding
from chromaperture.depth.error_limit import within_error
from chromaperture.products.samples import sample_camera, sample_image
from chromaperture.reconstruction.fusion import Placed
from chromaperture.reconstruction.tracking import near_steps
from chromaperture.reconstruction.volume import Mesh
from chromaperture.system.errors import InputError
from devices import unpacked
from test_app_page import FAULTS
from test_app_server import unpack
from waiting import WAIT_S, until

NAME = "still_life_cy_halves"
SERVER = pytest.mark.extra("serve", "starlette")

anything = st.one_of(
    st.floats(), st.integers(), st.text(), st.none(), st.booleans(), st.lists(st.integers()), st.just(10**400)
)


class Still(FileSource):
    """The sample's photograph, over and over."""

    live = True

    def __init__(self) -> None:
        super().__init__("still")
        self.left = threading.Event()

    def __iter__(self):
        image = read_image(sample_image(NAME), black_level=16, white_level=1016)
        counts = np.clip(image, 0, 1).astype(np.float32)
        index = 0
        while not self.left.wait(0.002):
            yield Frame(counts, Encoding(0.0, 1.0), index / 30, index)
            index += 1

    def __exit__(self, kind, error, trace):
        self.left.set()


@contextlib.contextmanager
def served(folder, **options):
    """A page that shows the sample; yields it and the lines said."""
    said: list[str] = []
    eye = load_camera(sample_camera(NAME), quality="real-time")
    with LiveLoop(Still(), eye, track=False, listener=said.append, **options) as loop:
        page = LivePage(loop, host="127.0.0.1", port=0, out=folder)
        drawing = threading.Thread(target=page.run, daemon=True)
        drawing.start()
        try:
            until(lambda: page.view.last is not None)
            yield page, said
            assert drawing.is_alive()
            assert loop.failure is None
        finally:
            loop.stop()
            drawing.join(WAIT_S)
            page.close()


def ask(page: LivePage, path: str = "", *, method: str = "GET", token: str | None = None, **headers: str):
    """One request; returns status, body and headers."""
    return call(page, method, f"/{path}", headers=headers, token=token or page.access.token)


def post(page: LivePage, path: str) -> tuple[int, dict]:
    status, body, _ = ask(page, f"api/live/{path}", method="POST")
    return status, json.loads(body)


def newest(page: LivePage, after: int = 0) -> bytes:
    """The next frame's message."""
    end = time.monotonic() + WAIT_S
    while time.monotonic() < end:
        status, body, _ = ask(page, f"api/live/frame?after={after}")
        if status == 200:
            return body
        assert status == 204
    raise AssertionError("no frame comes")


def cube() -> Mesh:
    """Some triangles before the camera."""
    points = np.random.default_rng(1).normal((0, 0, 1500), 200, (3000, 3)).astype(np.float32)
    return Mesh(points, np.arange(3000, dtype=np.int32).reshape(-1, 3), np.full((3000, 3), (250, 10, 250), np.uint8))


OWN = "127.0.0.1:8080"


@pytest.mark.parametrize(
    ("served_on", "path", "hosts", "origins"),
    [
        ("127.0.0.1", "/secret/", [OWN], []),
        ("127.0.0.1", "/secret", [OWN], [f"http://{OWN}"]),  # a WebSocket of the page
        ("127.0.0.1", "/secret/?websocket=x", ["localhost:9000"], ["http://localhost:9000"]),  # through ssh -L
        ("::1", "/secret/", ["[::1]:8080"], ["http://[::1]:8080"]),
        ("box.local", "/secret/", ["Box.local:8080"], ["http://box.local:8080"]),
        ("0.0.0.0", "/secret/", ["192.168.1.7:8080"], ["http://192.168.1.7:8080"]),
        ("0.0.0.0", "/secret/", [f"{socket.gethostname()}:8080"], []),
    ],
)
def test_the_owner_gets_in(served_on, path, hosts, origins):
    assert Access(served_on, "secret").refusal(path, hosts, origins) is None


@pytest.mark.parametrize(
    ("path", "hosts", "origins"),
    [
        ("/", [OWN], []),
        ("", [OWN], []),
        ("/?token=secret", [OWN], []),
        ("/secre", [OWN], []),
        ("/secret2/", [OWN], []),
        ("//secret/", [OWN], []),
        ("/sécret/", [OWN], []),
        ("/secret/", [], []),
        ("/secret/", [OWN, OWN], []),
        ("/secret/", ["evil.example:8080"], []),
        ("/secret/", ["evil.example@127.0.0.1:8080"], []),
        ("/secret/", ["127.0.0.1/evil.example"], []),
        ("/secret/", ["[::1"], []),
        ("/secret/", ["192.168.1.7:8080"], []),  # not served there
        ("/secret/", [OWN], ["http://evil.example"]),
        ("/secret/", [OWN], ["http://127.0.0.1:3000"]),  # another server of this machine
        ("/secret/", [OWN], ["null"]),
        ("/secret/", [OWN], [""]),
        ("/secret/", [OWN], ["file://127.0.0.1:8080"]),
        ("/secret/", [OWN], [f"http://{OWN}", "http://evil.example"]),
    ],
)
def test_nobody_else_gets_in(path, hosts, origins):
    assert Access("127.0.0.1", "secret").refusal(path, hosts, origins)


def test_on_all_addresses_a_foreign_name_stays_foreign():
    assert Access("0.0.0.0", "secret").refusal("/secret/", ["evil.example:8080"], [])


def test_every_run_has_a_token_of_its_own_and_prints_an_address_that_can_be_opened():
    first, second = Access("0.0.0.0"), Access("0.0.0.0")
    assert first.token != second.token
    assert len(first.token) >= 20  # 128 bits in base64 are 22 characters
    assert first.url(8080) == f"http://127.0.0.1:8080/{first.token}/"
    assert Access("::1", "t").url(80) == "http://[::1]:80/t/"


@SERVER
def test_the_server_answers_its_owner_only(tmp_path):
    with served(tmp_path) as (page, _):
        own = f"http://127.0.0.1:{page.port}"
        assert ask(page)[0] == ask(page, Origin=own)[0] == 200
        for path in ("", "index.html", "api/live/frame?after=0", "api/live/state"):
            assert ask(page, path, token="wrong")[0] == 403
        for refused in ({"Host": "evil.example"}, {"Origin": "http://evil.example"},
                        {"Origin": f"http://127.0.0.1:{page.port + 1}"}, {"Sec-Fetch-Site": "cross-site"}):  # fmt: skip
            assert ask(page, "api/live/record?on=1", method="POST", **refused)[0] == 403
        upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
        assert ask(page, **upgrade)[0] == 200  # the page: there is no WebSocket
        assert not page.loop.recording
        assert urlsplit(page.url).path == f"/{page.access.token}/"


@SERVER
def test_the_page_may_load_and_connect_to_nothing_else(tmp_path):
    with served(tmp_path) as (page, _):
        status, content, headers = ask(page)
        assert status == 200
        assert b"<html data-live" in content
        assert headers["Referrer-Policy"] == "no-referrer"  # the address is a secret
        assert headers["X-Frame-Options"] == "DENY"
        parts = [part.split() for part in headers["Content-Security-Policy"].split(";")]
        rules = {name: set(allowed) for name, *allowed in parts}
        assert rules["default-src"] == {"'none'"}  # what has no rule of its own: objects, frames
        assert rules["frame-ancestors"] == rules["base-uri"] == rules["form-action"] == {"'none'"}
        assert rules["script-src"] == rules["connect-src"] == {"'self'"}
        assert set().union(*rules.values()) <= {"'self'", "'none'", "blob:", "data:"}  # no name of a server
        assert ask(page, "../api/live/state")[0] == 404
        assert ask(page, "api/photos", method="POST")[0] in (404, 405)  # the app's other parts are not there


def test_an_address_of_another_machine_is_refused_and_a_free_port_is_taken():
    with pytest.raises(InputError, match="--host"):
        bound("203.0.113.7", 0)  # reserved for documentation: nobody has it
    with bound("127.0.0.1", 0) as first:
        port = first.getsockname()[1]
        with pytest.raises(InputError, match="--port"):
            bound("127.0.0.1", port)
        with bound("127.0.0.1", port, ports=100) as second:
            assert port < second.getsockname()[1] < port + 100
    with pytest.raises(InputError, match="--port"):
        bound("127.0.0.1", 70000, ports=100)


@given(anything)
def test_every_value_of_a_page_is_brought_within_its_limits(value):
    limits = Limits(10.0, 50.0, 20.0)
    found = limits.bounded(value)
    assert type(found) is float
    assert 10 <= found <= 50
    if isinstance(value, int | float) and not isinstance(value, bool) and 10 <= value <= 50:
        assert found == value
    if value is None or isinstance(value, str | list | bool) or value != value:
        assert found == 20


@given(st.floats(0.5, 1e5), st.floats(1.001, 1e3), st.floats(0, 1e6) | st.just(np.inf))
def test_limits_are_in_order_for_every_camera(nearest, ratio, sigma):
    limits = ControlLimits.of_camera(nearest, nearest * ratio, sigma)
    for control in (limits.near, limits.far, limits.focus, limits.percent, limits.pupil):
        assert 0 < control.lowest <= control.initial <= control.highest < np.inf


@SERVER
def test_no_value_ends_the_page(tmp_path):
    with served(tmp_path) as (page, said):
        number = unpack(newest(page))[0]["number"]
        for value in ("0", "-1", "1e18", "nan", "inf"):
            status, state = post(page, f"focus?distance_mm={value}&pupil={value}")
            assert status == 200
            assert all(math.isfinite(v) and v > 0 for v in state["focus"])
            assert post(page, f"snapshot?percent={value}")[0] == 200
            facts = unpack(newest(page, after=number))[0]
            assert facts["number"] > number
            number = facts["number"]
        assert not any("could not be drawn" in line for line in said)
        assert post(page, "focus")[1]["focus"] is None


@SERVER
def test_messages_of_no_sense_are_said_and_end_nothing(tmp_path):
    with served(tmp_path) as (page, _):
        for path in ("focus?distance_mm=far&pupil=2", "focus?distance_mm=1000", "record", "record?on=yes",
                     "pause?on=-1", "snapshot", "snapshot?percent=[]"):  # fmt: skip
            status, answer = post(page, path)
            assert (status, list(answer)) == (400, ["error"]), path
            assert "must be a" in answer["error"]
        for path in ("api/live/frame", "api/live/frame?after=x", "api/live/mesh", "api/cameras/live/points?width=1",
                     "api/cameras/live/points?width=7&height=999"):  # fmt: skip
            assert ask(page, path)[0] == 400
        with socket.create_connection(("127.0.0.1", page.port), timeout=WAIT_S) as connection:
            connection.sendall(b"\xff\xff\r\n\r\n")
        assert not page.loop.recording
        assert not page.loop.paused.is_set()
        newest(page)


@SERVER
def test_what_cannot_be_drawn_is_said_once_on_the_page_too_and_the_rest_goes_on(tmp_path, monkeypatch):
    def fail(*frame: object) -> None:
        raise ZeroDivisionError("division by zero")

    with served(tmp_path) as (page, said):
        newest(page)
        monkeypatch.setattr(page.view, "draw", fail)
        page.view.asked()
        until(lambda: said)
        assert "this frame could not be drawn" in page.view.state()["latest"]
        shown = page.loop.meters["view"].count
        until(lambda: page.loop.meters["view"].count > shown + 3)
        assert said == ["this frame could not be drawn: division by zero"]
        number = page.view.number
        monkeypatch.undo()
        assert unpack(newest(page, after=number))[0]["number"] > number


@SERVER
def test_nothing_is_drawn_while_nobody_looks(tmp_path):
    with served(tmp_path) as (page, _):
        shown = page.loop.meters["view"].count
        until(lambda: page.loop.meters["view"].count > shown + 2)
        assert page.view.number == 0
        newest(page)


@SERVER
def test_a_snapshot_leaves_the_reserve_of_the_disk_free(tmp_path, monkeypatch):
    with served(tmp_path / "out", reserve_bytes=10**6) as (page, _):
        monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=10**6 + 1000))
        for path in ("snapshot?percent=10", "record?on=1"):
            if path.startswith("record"):
                monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=10**6 - 1))
            status, answer = post(page, path)
            assert status == 400
            assert "free" in answer["error"]
        assert not (tmp_path / "out").exists()


def test_a_frame_is_what_was_measured_and_its_flying_pixels_are_no_points(tmp_path):
    with LiveLoop(Still(), load_camera(sample_camera(NAME), quality="real-time"), track=False) as loop:
        view = LiveView(loop, out=tmp_path, max_relative_sigma=0.3)
        assert view.limits.percent.initial == 30
        with pytest.raises(InputError, match="no frame yet"):
            view.snapshot()
        view.run(until=lambda: view.last is not None)
        frame = view.last.measurement
        view.draw(view.last)
        facts, depth, sigma, jpeg = unpack(view.message)
        assert (facts["width"], facts["height"]) == (360, 240)
        pixels = slice(1, None, 2), slice(1, None, 2)
        for found, values, name in ((depth, frame.depth_mm, "depth"), (sigma, frame.sigma_mm, "sigma")):
            np.testing.assert_allclose(found, values[pixels], atol=facts[name]["step"])
        shown = within_error(frame.depth_mm, frame.sigma_mm, 0.3)
        flying = near_steps(shown, jump=loop.config.edge_jump, reach_px=loop.config.edge_px)[pixels]
        bits = np.frombuffer(jpeg[facts["color_bytes"] :], np.uint8)
        np.testing.assert_array_equal(np.unpackbits(bits)[: flying.size].reshape(flying.shape), flying)
        assert 0 < flying.mean() < 0.3
        # Most of it lies behind the new focus, and is blurred then.
        pictures = [jpeg]
        view.focus_at(1200, 2)
        view.draw(view.last)
        pictures.append(unpack(view.message)[3])
        detail = [cv2.Laplacian(cv2.imdecode(np.frombuffer(p, np.uint8), 0), cv2.CV_64F).std() for p in pictures]
        assert 0.02 * detail[0] < detail[1] < 0.9 * detail[0]
        assert all(path.stat().st_size > 0 for path in view.snapshot())


def test_beside_tracking_there_is_a_value():
    assert "87%" in tracking_line(Placed(3, 0.1, np.eye(4), overlap=0.87, correlation=0.912))
    assert "0.91" in tracking_line(Placed(3, 0.1, np.eye(4), overlap=0.87, correlation=0.912))
    assert "too little overlap" in tracking_line(Placed(3, 0.1, None, note="lost: too little overlap"))


def test_meshes_poses_and_the_path_are_sent_and_freed_when_replaced(tmp_path):
    with LiveLoop(Still(), load_camera(sample_camera(NAME), quality="real-time"), track=False) as loop:
        view = LiveView(loop, out=tmp_path)
        view.run(until=lambda: view.last is not None)
        loop.stop()
        with pytest.raises(InputError, match="no model yet"):
            view.mesh_message()
        assert view.state()["mesh"] == 0
        drawn: list[weakref.ref[np.ndarray]] = []
        for count in range(4):
            pose = np.eye(4)
            pose[0, 3] = count
            loop.placed = Placed(count, 0.0, pose)
            loop.trail.add(pose[:3, 3])
            loop.mesh = cube()
            drawn.append(weakref.ref(loop.mesh.vertices_mm))
            view.draw(view.last)
            state = view.state()
            assert state["mesh"] == count + 1
            text, array = unpacked(view.mesh_message())
            assert view.mesh_message() is view.mesh_message()  # packed once
        assert [kept() is not None for kept in drawn] == [False] * 3 + [True]
        assert state["path"] == [0, 0, 0, 1, 0, 0, 2, 0, 0, 3, 0, 0]
        facts = unpack(view.message)[0]
        assert (np.reshape(facts["pose"], (4, 4)) == pose).all()
        assert not facts["lost"]
        np.testing.assert_array_equal(array(text["vertices"]).reshape(3, -1).T, loop.mesh.vertices_mm)
        np.testing.assert_array_equal(array(text["triangles"]).reshape(3, -1).T, loop.mesh.triangles)
        np.testing.assert_array_equal(array(text["colors"]).view(np.uint8).reshape(-1, 4)[:, :3], loop.mesh.colors)
        loop.placed = Placed(9, 0.0, None, note="lost")
        view.draw(view.last)
        assert unpack(view.message)[0]["lost"]


@SERVER
def test_viewers_come_and_go_and_one_that_dies_stops_nothing(tmp_path):
    with served(tmp_path) as (page, _):
        request = f"GET /{page.access.token}/api/live/frame?after=0 HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n"
        for _ in range(3):  # without a word, in the middle of an answer, as a browser that is killed
            with socket.create_connection(("127.0.0.1", page.port), timeout=WAIT_S) as connection:
                connection.sendall(request.encode())
                connection.recv(100)
        number = 0
        for _ in range(3):
            number = unpack(newest(page, after=number))[0]["number"]
        until(lambda: not page._server.server_state.connections)


@SERVER
def test_live_serves_its_page_and_ends_at_its_time(run, tmp_path):
    options = "--no-model", "--out", tmp_path / "out", "--port", "0", "--seconds", "0.5"
    result = run("live", sample_image(NAME), "--camera", sample_camera(NAME), *options)
    assert result.returncode == 0, result.stderr
    assert re.search(r"^ +http://127\.0\.0\.1:\d+/\S+$", result.stdout, re.M)
    assert "view" in result.stdout
    assert not (tmp_path / "out").exists()
    assert "page" not in {thread.name for thread in threading.enumerate()}


# ---- in a browser


@pytest.fixture(scope="module")
def browser(driver):
    with chromium(driver) as started:
        yield started


def browser_test(test):
    for mark in BROWSER_TESTS:
        test = mark(test)
    return test


@browser_test
@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_the_page_shows_depth_and_reads_it(browser, tmp_path, size):
    with served(tmp_path) as (live, _), pages(browser, live.url) as opened:
        page = opened(size, camera=None)
        page.wait_for_selector("#watch-found:has-text('median of what is shown')", timeout=60_000)
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        assert page.evaluate(FAULTS) == []
        assert page.is_hidden("nav")
        assert page.is_hidden("#live-start")
        frame = live.view.last.measurement
        depth, sigma = reading(page, "#watch-viewer", 0.25, 0.6, width=360, height=240)
        window = frame.depth_mm[282:295, 173:188]
        assert depth == pytest.approx(float(np.nanmedian(window)), abs=max(sigma, 0.02 * depth))
        # The limits are the page's own.
        page.fill("#watch-far", "1300")
        shown = int(page.inner_text("#watch-found").split("; ")[1].removesuffix(" % of the pixels"))
        kept = within_error(frame.depth_mm, frame.sigma_mm, 0.1)
        assert shown == pytest.approx(100 * ((kept >= 900) & (kept <= 1300)).mean(), abs=2)
        assert "1300 mm" in page.inner_text("#watch-viewer .scale")
        page.fill("#watch-percent", "0.1")
        assert page.inner_text("#watch-found") == "no pixel is within these limits"


@browser_test
def test_the_buttons_do_what_they_say(browser, tmp_path):
    with served(tmp_path) as (live, _), pages(browser, live.url) as opened:
        page = opened(DESKTOP, camera=None)
        page.wait_for_selector("#watch-found:has-text('median')", timeout=60_000)
        page.click("#watch-record")
        page.wait_for_selector("#watch-record:has-text('Stop recording')")
        until(lambda: live.loop.recorded > 2)
        page.click("#watch-record")
        page.wait_for_selector("#watch-state:has-text('frames recorded')")
        assert len(list(tmp_path.glob("recording-*"))) == 1
        page.click("#watch-snapshot")
        page.wait_for_selector("#watch-state:has-text('wrote snapshot-')")
        assert list(tmp_path.glob("snapshot-*.depth.tiff"))
        page.click("#watch-pause")
        page.wait_for_selector("#watch-pause:has-text('Go on')")
        assert live.loop.paused.is_set()
        page.click("#watch-pause")
        page.wait_for_selector("#watch-pause:has-text('Pause')")
        page.click("[data-view=color]")
        page.check("#watch-elsewhere")
        page.fill("#watch-focus", "1200")
        page.locator("#watch-focus").dispatch_event("change")
        until(lambda: live.view.focus == (1200.0, 2.0))
        page.uncheck("#watch-elsewhere")
        until(lambda: live.view.focus is None)
        # The text, not what is rendered: the page replaces the rows with every state that it hears.
        stages = page.locator("#watch-stages tr td:first-child").all_text_contents()
        assert stages == ["capture", "depth", "tracking", "view"]


@browser_test
def test_points_and_the_growing_model_are_drawn(browser, tmp_path):
    def pixels(page):
        png = page.evaluate("document.querySelector('#watch-viewer .turned canvas').toDataURL()")
        return cv2.imdecode(np.frombuffer(base64.b64decode(png.split(",")[1]), np.uint8), cv2.IMREAD_COLOR).astype(int)

    def purple(page):
        blue, green, red = np.moveaxis(pixels(page), -1, 0)
        return ((blue > 100) & (red > 100) & (green < 60)).mean()

    with served(tmp_path) as (live, _), pages(browser, live.url) as opened:
        page = opened(DESKTOP, camera=None)
        page.wait_for_selector("#watch-found:has-text('median')", timeout=60_000)
        page.click("[data-view=points]")
        page.wait_for_selector("#watch-viewer .turned canvas[aria-label*=points]", timeout=60_000)
        assert (pixels(page).max(axis=2) > 60).mean() > 0.2  # points are drawn
        assert purple(page) == 0
        live.loop.placed = Placed(1, 0.0, np.eye(4))
        live.loop.mesh = cube()
        until(lambda: purple(page) > 0.02)
        before = purple(page)
        page.locator("#watch-viewer .turned canvas").focus()
        for _ in range(30):
            page.keyboard.press("-")
        until(lambda: purple(page) < before / 2)  # from farther away
        # The points, and the camera, move with the pose.
        pose = np.eye(4)
        pose[0, 3] = 4000
        live.loop.placed = Placed(2, 0.0, pose)

        def lit(page):
            return np.flatnonzero((pixels(page).max(axis=2) > 60).any(axis=0))

        until(lambda: lit(page)[-1] > 0.75 * pixels(page).shape[1])


@browser_test
def test_an_end_is_said(browser, tmp_path):
    with contextlib.ExitStack() as stack:
        live, _ = stack.enter_context(served(tmp_path))
        opened = stack.enter_context(pages(browser, live.url))
        page = opened(DESKTOP, camera=None)
        page.wait_for_selector("#watch-found:has-text('median')", timeout=60_000)
        live.close()
        page.wait_for_selector("#message:has-text('has ended')", timeout=60_000)

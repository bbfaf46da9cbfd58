"""The page in the browser: only its owner gets in, and nothing that a browser sends ends the loop."""

from __future__ import annotations

import contextlib
import gc
import shutil
import socket
import struct
import threading
import time
import urllib.error
import urllib.request
import weakref
from base64 import b64decode
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.app.gate import Access, serve
from chromaperture.app.live.controls import ControlLimits, Limits
from chromaperture.app.live.live_scene import first_view
from chromaperture.app.live.loop import LiveLoop
from chromaperture.app.live.page import LivePage, depth_line, tracking_line
from chromaperture.app.live.probe import encode_values, values_html
from chromaperture.camera.camera import load_camera
from chromaperture.capture.files import read_image
from chromaperture.capture.source import FileSource, Frame
from chromaperture.color.encoding import Encoding
from chromaperture.products.samples import sample_camera, sample_image
from chromaperture.reconstruction.fusion import Placed
from chromaperture.system.errors import InputError

WAIT_S = 60.0  # an upper bound for a busy machine; nothing waits so long
NAME = "still_life_cy_halves"

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


def until(condition) -> None:
    end = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end, "the page does not come to what is waited for"
        time.sleep(0.005)


@contextlib.contextmanager
def served(folder, **options):
    """A page that draws the sample; yields it and the lines said."""
    said: list[str] = []
    with LiveLoop(Still(), load_camera(sample_camera(NAME)), track=False, listener=said.append, **options) as loop:
        page = LivePage(loop, host="127.0.0.1", port=0, out=folder)
        drawing = threading.Thread(target=page.run, daemon=True)
        drawing.start()
        try:
            until(lambda: page.last is not None)
            yield page, said
            assert drawing.is_alive()
            assert loop.failure is None
        finally:
            loop.stop()
            drawing.join(WAIT_S)
            page.close()


def status(url: str, **headers: str) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=WAIT_S) as answer:
            return answer.status
    except urllib.error.HTTPError as refused:
        refused.close()
        return refused.code


def browser(page: LivePage, path: str | None = None, name: str = "127.0.0.1", **options):
    """Connect as the page's script does, or with another path, name of the server, or headers."""
    import viser
    from websockets.sync.client import connect

    port = page.server.get_port()
    where = f"ws://{name}:{port}/{page.access.token if path is None else path}"
    versions = [f"viser-v{viser.__version__}"]
    reached = socket.create_connection(("127.0.0.1", port))
    return connect(where, subprotocols=versions, sock=reached, max_size=None, **options)


def send(connection, message: dict) -> None:
    import msgspec

    connection.send(msgspec.msgpack.encode(message))


def look(page: LivePage, connection) -> None:
    """Say where the browser looks from: it counts as connected then."""
    camera = {
        "type": "ViewerCameraMessage",
        "wxyz": (1, 0, 0, 0),
        "position": (0, 0, -1),
        "fov": 1.0,
        "near": 0.01,
        "far": 100.0,
        "image_height": 480,
        "image_width": 640,
        "look_at": (0, 0, 1),
        "up_direction": (0, -1, 0),
    }
    before = set(page.server.get_clients())  # one of these may leave while this one comes
    send(connection, camera)
    until(lambda: set(page.server.get_clients()) - before)


def set_value(connection, control, value: object) -> None:
    send(connection, {"type": "GuiUpdateMessage", "uuid": control._impl.uuid, "updates": {"value": value}})


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


@pytest.mark.extra("viewer", "viser")
def test_the_server_answers_its_owner_only(tmp_path):
    from websockets.exceptions import InvalidStatus

    with served(tmp_path) as (page, _):
        root = f"http://127.0.0.1:{page.server.get_port()}"
        port = page.server.get_port()
        assert status(page.url) == 200
        assert status(f"{root}/") == status(f"{root}/index.html") == status(f"{root}/wrong/") == 403
        assert status(page.url, Host="evil.example") == 403
        assert status(page.url, Origin="http://evil.example") == 403
        with urllib.request.urlopen(page.url, timeout=WAIT_S) as answer:
            headers = answer.headers
        assert headers["Referrer-Policy"] == "no-referrer"  # the address is a secret
        assert headers["X-Frame-Options"] == "DENY"
        for refused in (
            {"path": ""},
            {"path": "wrong"},
            {"origin": "http://evil.example"},
            {"origin": f"http://127.0.0.1:{port + 1}"},
            {"name": "evil.example"},  # a name that leads here: DNS rebinding
        ):
            with pytest.raises(InvalidStatus) as found:
                browser(page, **refused)
            assert found.value.response.status_code == 403
        assert page.server.get_clients() == {}
        with browser(page, origin=root) as own:
            look(page, own)
            assert own.recv(timeout=WAIT_S)
        assert page.server.request_share_url() is None  # nothing is published


@pytest.mark.extra("viewer", "viser")
def test_the_page_may_load_and_connect_to_nothing_else(tmp_path):
    """viser writes the address, with the token, behind "?websocket=" in the address bar: it must not leave the page."""
    with served(tmp_path) as (page, _):
        with urllib.request.urlopen(f"{page.url}?websocket=ws://evil.example/", timeout=WAIT_S) as answer:
            headers = answer.headers
        assert headers["Referrer-Policy"] == "no-referrer"
        parts = [part.split() for part in headers["Content-Security-Policy"].split(";")]
        rules = {name: set(allowed) for name, *allowed in parts}
        assert rules["default-src"] == {"'none'"}  # what has no rule of its own: media, objects, frames
        assert rules["frame-ancestors"] == rules["base-uri"] == rules["form-action"] == {"'none'"}
        own = {"'self'", "'none'", "'unsafe-inline'", "'unsafe-eval'", "blob:", "data:"}
        assert set().union(*rules.values()) <= own  # no name of a server, no scheme that reaches one
        assert rules["connect-src"] == {"'self'", "blob:", "data:"}


@pytest.mark.extra("viewer", "viser")
def test_a_server_whose_requests_cannot_be_checked_is_not_left_running(monkeypatch):
    import viser

    stopped = threading.Event()

    class Unchecked:
        def __init__(self, **options: object) -> None:
            pass

        def stop(self) -> None:
            stopped.set()

    monkeypatch.setattr(viser, "ViserServer", Unchecked)
    with pytest.raises(InputError, match="install viser"):
        serve(Access("127.0.0.1"), 0, listener=print)
    assert stopped.is_set()


@pytest.mark.extra("viewer", "viser")
def test_an_address_of_another_machine_is_refused_at_once():
    with pytest.raises(InputError, match="--host"):
        serve(Access("203.0.113.7"), 0, listener=print)  # reserved for documentation: nobody has it


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


@given(st.floats(0.5, 1e5), st.floats(1.001, 1e3), st.floats(0, 1e6) | st.just(np.inf), anything, anything)
def test_distances_are_positive_and_apart_for_every_camera_and_every_value(nearest, ratio, sigma, near, far):
    limits = ControlLimits.of_camera(nearest, nearest * ratio, sigma)
    for control in (limits.near, limits.far, limits.focus, limits.percent, limits.pupil):
        assert 0 < control.lowest <= control.initial <= control.highest < np.inf  # viser requires it
    near_mm, far_mm = limits.distances(near, far)
    assert 0 < near_mm < far_mm


@pytest.mark.extra("viewer", "viser")
@pytest.mark.parametrize("value", [0, -1, 10**18, float("nan"), float("inf"), "far away", None, [1, 2], {}])
def test_no_value_ends_the_page(tmp_path, value):
    with served(tmp_path) as (page, said), browser(page) as own:
        look(page, own)
        shown = page.loop.meters["view"].count
        page.refocus.value = True  # so that all values are used
        for control in (page.near, page.far, page.max_sigma, page.focus, page.pupil):
            set_value(own, control, value)
        until(lambda: page.loop.meters["view"].count > shown + 3)
        assert not any("could not be drawn" in line for line in said)
        page.snapshot()


@pytest.mark.extra("viewer", "viser")
def test_messages_of_no_sense_are_said_and_end_nothing(tmp_path):
    with served(tmp_path) as (page, said), browser(page) as own:
        look(page, own)
        for _ in range(3):
            set_value(own, page.near, "far away")
        until(lambda: said)
        own.send(b"\xff\xff")
        with browser(page) as another:
            look(page, another)
            shown = page.loop.meters["view"].count
            until(lambda: page.loop.meters["view"].count > shown + 3)
        assert len([line for line in said if "could not be used" in line]) == 1


@pytest.mark.extra("viewer", "viser")
def test_what_cannot_be_drawn_is_said_once_on_the_page_too_and_the_rest_goes_on(tmp_path, monkeypatch):
    with served(tmp_path) as (page, said), browser(page) as own:
        look(page, own)
        until(lambda: page.depth.image.any())

        def fail(*frame: object) -> None:
            raise ZeroDivisionError("division by zero")

        monkeypatch.setattr(page.scene, "draw", fail)
        until(lambda: said)
        assert "this frame could not be drawn" in page.state.content
        shown = page.loop.meters["view"].count
        until(lambda: page.loop.meters["view"].count > shown + 3)
        assert said == ["this frame could not be drawn: division by zero"]
        monkeypatch.undo()
        until(lambda: "median" in page.state.content)


@pytest.mark.extra("viewer", "viser")
def test_a_snapshot_leaves_the_reserve_of_the_disk_free(tmp_path, monkeypatch):
    with served(tmp_path / "out", reserve_bytes=10**6) as (page, _):
        monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=10**6 + 1000))
        with pytest.raises(InputError, match="free"):
            page.snapshot()
        assert not (tmp_path / "out").exists()


@pytest.mark.extra("viewer", "viser")
def test_the_page_is_served_and_a_snapshot_written(tmp_path):
    eye = load_camera(sample_camera(NAME))
    with LiveLoop(Still(), eye, track=False) as loop:
        page = LivePage(loop, host="127.0.0.1", port=0, out=tmp_path, max_relative_sigma=0.05)
        try:
            assert page.max_sigma.value == 5  # %
            with pytest.raises(InputError, match="no frame yet"):
                page.snapshot()
            page.run(until=lambda: page.last is not None)
            page.show(page.last)  # as with somebody looking
            assert page.depth.image.any()
            plain, page.refocus.value, page.focus.value = page.color.image.copy(), True, 1200
            page.show(page.last)
            detail = [cv2.Laplacian(picture, cv2.CV_64F).std() for picture in (plain, page.color.image)]
            assert 0.02 * detail[0] < detail[1] < 0.9 * detail[0]  # most of it lies behind, and is blurred now
            files = page.snapshot()
            assert all(path.stat().st_size > 0 for path in files)
        finally:
            page.close()


def test_the_values_under_the_mouse_are_those_of_the_picture():
    depth = np.arange(200 * 300, dtype=np.float32).reshape(200, 300) + 1000
    depth[0, 0] = np.nan
    attributes = dict(part.split("=", 1) for part in values_html(depth, depth / 100).split() if "=" in part)
    step, columns = int(attributes["data-step"].strip('"')), int(attributes["data-columns"].strip('"'))
    text = attributes["data-values"].partition(">")[0].strip('"')
    floats = struct.unpack(f"<{len(b64decode(text)) // 4}f", b64decode(text))
    assert np.isnan(floats[0])
    for y, x in ((7, 11), (199, 299), (100, 0)):
        at = 2 * ((y // step) * columns + x // step)  # as the script does it
        assert abs(floats[at] - depth[y, x]) <= (step - 1) * (300 + 1)  # the value of a pixel in the same cell
        assert floats[at + 1] == np.float32(floats[at]) / np.float32(100)
    assert encode_values(depth[:1, :1], depth[:1, 1:2]) == "AADAfwBAekQ="  # NaN and 1001, little-endian


@pytest.mark.parametrize("half_width", [0.1, 0.24, 0.6])
@pytest.mark.parametrize("distance", [0.3, 2.0, 50.0])
def test_the_first_view_shows_the_scene_and_from_the_side(distance, half_width):
    position, target = first_view(distance, half_width)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0, -1, 0])
    right /= np.linalg.norm(right)
    edges = np.array([[-half_width * distance, 0, distance], [half_width * distance, 0, distance]]) - position
    across = edges @ right / (edges @ forward)  # tangent of the angle from the middle of the view
    widest = np.tan(np.radians(25)) * 0.75  # a view of 50 degrees on a canvas three wide and four high
    assert (np.abs(across) < widest).all()
    assert np.ptp(across) > widest  # more than half of the width
    assert 5 < np.degrees(np.arccos(forward[2])) < 45  # relief is seen


def test_beside_tracking_there_is_a_value():
    assert "87%" in tracking_line(Placed(3, 0.1, np.eye(4), overlap=0.87, correlation=0.912))
    assert "0.91" in tracking_line(Placed(3, 0.1, np.eye(4), overlap=0.87, correlation=0.912))
    assert "too little overlap" in tracking_line(Placed(3, 0.1, None, note="lost: too little overlap"))


def test_the_line_about_depth_is_of_what_is_shown():
    depth = np.array([[1000.0, 2000.0, np.nan, 2000.0]])
    sigma = np.array([[10.0, 20.0, 500.0, 40.0]])
    assert "**2000 ± 20 mm**; 75%" in depth_line(depth, sigma)
    assert "no pixel" in depth_line(depth * np.nan, sigma)


@pytest.mark.extra("viewer", "viser")
def test_what_was_drawn_is_freed_when_it_is_replaced(tmp_path):
    """Not later, by the collector of cycles: it looks at old objects so rarely that they fill the memory until then."""
    from chromaperture.reconstruction.volume import Mesh

    with LiveLoop(Still(), load_camera(sample_camera(NAME)), track=False) as loop:
        page = LivePage(loop, host="127.0.0.1", port=0, out=tmp_path)
        page.run(until=lambda: page.last is not None)
        loop.stop()
    try:
        drawn: list[weakref.ref[np.ndarray]] = []
        gc.collect()
        gc.disable()
        gc.set_debug(gc.DEBUG_SAVEALL)
        for count in range(6):
            pose = np.eye(4)
            pose[0, 3] = count
            loop.placed = Placed(count, 0.0, pose)
            loop.trail.add(pose[:3, 3])
            vertices = np.random.default_rng(count).normal(size=(3000, 3)).astype(np.float32)
            triangles = np.arange(3000, dtype=np.int32).reshape(-1, 3)
            loop.mesh = Mesh(vertices, triangles, np.full((3000, 3), 99, np.uint8))
            drawn.append(weakref.ref(vertices))
            del vertices
            page.show(page.last)
        assert [kept() is not None for kept in drawn] == [False] * 5 + [True]  # the last is the loop's still
        gc.collect()
        held = [held for left in gc.garbage for held in [left, *gc.get_referents(left)]]
        assert [type(part) for part in held if isinstance(part, np.ndarray | bytes) and len(part) > 300] == []
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()
        page.close()


@pytest.mark.extra("viewer", "viser")
def test_viewers_come_and_go_and_one_that_dies_stops_nothing(tmp_path):
    with served(tmp_path) as (page, _):
        first, second = browser(page), browser(page)
        look(page, first)
        look(page, second)
        first.socket.close()  # without a word, as a browser that is killed
        until(lambda: len(page.server.get_clients()) == 1)
        shown = page.loop.meters["view"].count
        until(lambda: page.loop.meters["view"].count > shown + 2)
        for _ in range(3):
            assert second.recv(timeout=WAIT_S)
        second.close()

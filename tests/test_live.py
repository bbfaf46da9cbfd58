"""The live loop: the newest frame wins, nothing that goes wrong in one part stops another."""

from __future__ import annotations

import gc
import threading
import time
import urllib.request
import weakref
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from chromaperture.camera import load_camera
from chromaperture.capture.files import read_image
from chromaperture.capture.recording import Recorder, ReplaySource
from chromaperture.capture.source import Encoding, Event, FileSource, Frame
from chromaperture.capture.threaded_source import DeviceLostError, LiveSource
from chromaperture.errors import InputError
from chromaperture.products.samples import sample_camera, sample_image
from chromaperture.viewer.loop import LiveLoop
from chromaperture.viewer.pictures import depth_picture
from chromaperture.viewer.slots import Slot
from chromaperture.viewer.trail import Trail

WAIT_S = 60.0  # an upper bound for a busy machine; nothing waits so long


class Running(FileSource):
    """A camera that never waits for its reader; stops when it is left or after so many frames."""

    live = True

    def __init__(self, frames: int = 10**9, shape: tuple[int, int] = (480, 720)) -> None:
        super().__init__("running")
        self.left, self.number, self.shape = threading.Event(), frames, shape

    def __iter__(self):
        counts = np.zeros((*self.shape, 3), np.uint8)
        for index in range(self.number):
            if self.left.wait(0.002):
                return
            yield Frame(counts, Encoding(0, 255), index / 30, index)

    def __exit__(self, kind, error, trace):
        self.left.set()


class Eye:
    """A camera whose measuring can be held up; the rest is the sample's."""

    def __init__(self) -> None:
        real = load_camera(sample_camera("still_life_cy_halves"))
        self.calibration, self.config = real.calibration, real.config
        self.gate, self.seen = threading.Semaphore(0), []
        self.fails = False

    def measure(self, image: np.ndarray) -> SimpleNamespace:
        self.gate.acquire()
        if self.fails:
            raise InputError("cannot measure this")
        flat = np.full(image.shape[:2], 2000.0, np.float32)
        return SimpleNamespace(depth_mm=flat, sigma_mm=flat / 100, confidence=flat / 2000, color=image)


def until(condition) -> None:
    end = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end, "the loop does not come to what is waited for"
        time.sleep(0.005)


def test_the_newest_item_wins_and_a_patient_writer_waits():
    slot: Slot[int] = Slot()
    slot.put(1)
    slot.put(2)
    assert (slot.take(), slot.replaced) == (2, 1)
    slot.put(3)
    writer = threading.Thread(target=slot.put, args=(4,), kwargs={"patient": True})
    writer.start()
    assert slot.take() == 3
    assert slot.take() == 4
    writer.join()
    assert slot.replaced == 1
    slot.close()
    assert slot.take() is None


def test_a_slow_stage_costs_frames_and_not_latency():
    eye, source = Eye(), Running()
    with LiveLoop(source, eye, track=False) as loop:
        until(lambda: loop.meters["capture"].count > 50)
        captured = loop.meters["capture"].count
        eye.gate.release()
        loop.to_view.take()  # the one under way since the start; then the newest, which must not replace it unseen
        eye.gate.release()
        assert loop.to_view.take().frame.index >= captured - 1
        assert loop.figures()["depth"]["dropped"] > 40
        eye.gate.release(1000)  # else leaving waits for the frame that is being measured
    assert source.left.is_set()


def test_a_source_that_ends_loses_no_frame_when_it_can_wait():
    eye, source = Eye(), Running(frames=5)
    source.live = False
    eye.gate.release(5)
    with LiveLoop(source, eye, track=False) as loop:
        assert loop.over.wait(WAIT_S)
        assert loop.meters["depth"].count == 5


def test_frames_that_cannot_be_measured_are_said_once_and_the_loop_goes_on():
    said: list[str] = []
    eye = Eye()
    eye.fails = True
    eye.gate.release(3)
    with LiveLoop(Running(), eye, track=False, listener=said.append) as loop:
        until(lambda: loop.figures()["depth"]["dropped"] > 20)
        eye.fails = False
        eye.gate.release(2)
        assert loop.to_view.take() is not None
    assert sum("cannot measure" in line for line in said) == 1


def test_leaving_ends_every_thread():
    before = set(threading.enumerate())
    eye = Eye()
    with LiveLoop(Running(), eye, track=False) as loop:
        until(lambda: loop.meters["capture"].count > 3)
        eye.gate.release(1000)
    assert {thread for thread in set(threading.enumerate()) - before if thread.is_alive()} == set()


def test_what_was_recorded_can_be_replayed(tmp_path):
    eye = Eye()
    with LiveLoop(Running(shape=(48, 72)), eye, track=False) as loop:
        loop.record(tmp_path / "take")
        until(lambda: loop.recorded >= 3)
        eye.gate.release(10**6)
    with ReplaySource(str(tmp_path / "take")) as replay:
        assert len(list(replay)) == loop.recorded


def test_a_full_disk_ends_the_recording_and_not_the_loop(tmp_path, monkeypatch):
    def full(self, frame):
        raise InputError("the disk is full: recording stopped")

    monkeypatch.setattr(Recorder, "write", full)
    said: list[str] = []
    eye = Eye()
    with LiveLoop(Running(), eye, track=False, listener=said.append) as loop:
        loop.record(tmp_path / "take")
        until(lambda: said)
        eye.gate.release(2)
        assert loop.to_view.take() is not None
        eye.gate.release(1000)
    assert said == ["the disk is full: recording stopped"]


class Pluggable:
    """A device that delivers so many frames and is then pulled out."""

    def __init__(self, lasts: int) -> None:
        self.left = lasts

    def read(self, index: int) -> Frame:
        time.sleep(0.002)
        self.left -= 1
        if self.left < 0:
            raise DeviceLostError("unplugged?")
        return Frame(np.full((48, 72, 3), 20 + index % 200, np.uint8), Encoding(0, 255), time.time(), index)

    def close(self) -> None:
        pass


def test_a_camera_that_is_unplugged_comes_back_to_the_loop_and_to_its_recording(tmp_path):
    devices = [Pluggable(30), None, Pluggable(10**9)]

    def connect() -> Pluggable:
        device = devices.pop(0)
        if device is None:
            raise InputError("not there yet")
        return device

    events: list[Event] = []
    eye = Eye()
    eye.gate.release(10**6)
    with (
        LiveSource("camera", connect, listener=events.append, retry_s=0.2) as source,
        LiveLoop(source, eye, track=False) as loop,
    ):
        loop.record(tmp_path / "take")
        until(lambda: len(events) == 2)
        before = loop.meters["depth"].count
        until(lambda: loop.meters["depth"].count > before + 5)
        recorded = loop.recorded
        until(lambda: loop.recorded > recorded + 2)
        assert loop.failure is None
    assert [event.kind for event in events] == ["lost", "reconnected"]
    with ReplaySource(str(tmp_path / "take")) as replay:
        indices = [frame.index for frame in replay if (frame.counts == 20 + frame.index % 200).all()]
    assert len(indices) == loop.recorded
    assert max(indices) > 30  # frames of the second life are there
    assert indices == sorted(set(indices))


def test_depth_is_drawn_with_a_bar_of_the_same_colours():
    height, far, near = 101, 4000.0, 1000.0
    rows = np.linspace(1 / near, 1 / far, height)  # even in 1 / distance, as the bar is
    depth = np.repeat(1 / rows[:, None], 20, axis=1).astype(np.float32)
    depth[:, 0] = np.nan
    picture = depth_picture(depth, near_mm=near, far_mm=far)
    assert not picture[:, 0].any()
    np.testing.assert_allclose(picture[:, 10].astype(int), picture[:, 25].astype(int), atol=12)  # a level or two


class Still(Running):
    """The sample's photograph, over and over."""

    def __iter__(self):
        image = read_image(sample_image("still_life_cy_halves"), black_level=16, white_level=1016)
        counts = np.clip(image, 0, 1).astype(np.float32)
        for frame in super().__iter__():
            yield Frame(counts, Encoding(0.0, 1.0), frame.time_s, frame.index)


@pytest.mark.extra("viewer", "viser")
def test_the_page_is_served_and_a_snapshot_written(tmp_path):
    from chromaperture.viewer.page import LivePage

    eye = load_camera(sample_camera("still_life_cy_halves"))
    with LiveLoop(Still(), eye, track=False) as loop:
        page = LivePage(loop, host="127.0.0.1", port=8765, out=tmp_path, max_relative_sigma=0.05)
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
            assert urllib.request.urlopen(page.url, timeout=WAIT_S).status == 200
            assert page.url.startswith("http://127.0.0.1:")
        finally:
            page.close()


@pytest.mark.extra("viewer", "viser")
def test_what_was_drawn_is_freed_when_it_is_replaced(tmp_path):
    """Not later, by the collector of cycles: it looks at old objects so rarely that they fill the memory until then."""
    from chromaperture.reconstruction.fusion import Placed
    from chromaperture.reconstruction.volume import Mesh
    from chromaperture.viewer.page import LivePage

    with LiveLoop(Still(), load_camera(sample_camera("still_life_cy_halves")), track=False) as loop:
        page = LivePage(loop, host="127.0.0.1", port=8785, out=tmp_path)
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


def test_the_path_is_as_long_as_the_session_and_its_memory_is_not():
    trail = Trail(most=50)
    for place in range(3001):
        trail.add(np.array([place, 0.0, 0.0]))
        assert len(trail.points_mm) <= 50
    places = np.array(trail.points_mm)[:, 0]
    steps = np.diff(places)
    assert places[0] == 0
    assert (steps == steps[0]).all()  # evenly thinned
    assert 3000 - places[-1] < steps[0] < 2 * 3000 / 25
    assert len(places) >= 25


@pytest.mark.extra("viewer", "viser")
def test_viewers_come_and_go_and_one_that_dies_stops_nothing(tmp_path):
    import msgspec
    import viser
    from websockets.sync.client import connect

    from chromaperture.viewer.page import LivePage

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
    with LiveLoop(Still(), load_camera(sample_camera("still_life_cy_halves")), track=False) as loop:
        page = LivePage(loop, host="127.0.0.1", port=8775, out=tmp_path)
        drawing = threading.Thread(target=page.run, daemon=True)
        drawing.start()
        try:
            where = page.url.replace("http", "ws")
            first, second = (connect(where, subprotocols=[f"viser-v{viser.__version__}"]) for _ in range(2))
            for browser in (first, second):  # one counts from when it has said where it looks from
                browser.send(msgspec.msgpack.encode(camera))
            until(lambda: len(page.server.get_clients()) == 2)
            first.socket.close()  # without a word, as a browser that is killed
            until(lambda: len(page.server.get_clients()) == 1)
            shown = loop.meters["view"].count
            until(lambda: loop.meters["view"].count > shown + 2)
            for _ in range(3):
                assert second.recv(timeout=WAIT_S)
            assert drawing.is_alive()
            assert loop.failure is None
            second.close()
        finally:
            loop.stop()
            drawing.join(WAIT_S)
            page.close()

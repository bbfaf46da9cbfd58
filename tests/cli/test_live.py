"""The live loop: the newest frame wins, nothing that goes wrong in one part stops another."""

from __future__ import annotations

import shutil
import threading
import time
from types import SimpleNamespace

import numpy as np

from chromaperture.app.live.loop import LiveLoop, Trail
from chromaperture.app.live.slots import Slot
from chromaperture.camera.camera import load_camera
from chromaperture.capture.recording import Recorder, ReplaySource
from chromaperture.capture.source import FileSource, Frame
from chromaperture.color.encoding import Encoding
from chromaperture.products.samples import sample_camera, sample_image
from chromaperture.system.errors import InputError
from waiting import WAIT_S, until


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

    can_pipeline = False

    def __init__(self) -> None:
        real = load_camera(sample_camera("still_life_cy_halves"), quality="real-time")
        self.calibration, self.config = real.calibration, real.config
        self.gate, self.seen = threading.Semaphore(0), []
        self.fails = False

    def shows_frame_at(self, size_px) -> bool:
        return False

    def measure(self, image: np.ndarray) -> SimpleNamespace:
        self.gate.acquire()
        if self.fails:
            raise InputError("cannot measure this")
        flat = np.full(image.shape[:2], 2000.0, np.float32)
        return SimpleNamespace(depth_mm=flat, sigma_mm=flat / 100, confidence=flat / 2000, color=image)


class Device(Eye):
    """An eye that computes one photograph while the one before is read back."""

    can_pipeline = True

    def __init__(self) -> None:
        super().__init__()
        self.calls, self.refused = [], {}
        self.gate.release(10**6)

    def submit(self, image: np.ndarray) -> SimpleNamespace:
        number = round(float(image[0, 0, 0]) * 255)
        self.calls.append(("submit", number))
        if self.refused.get(number) == "submit":
            raise InputError("cannot begin this")
        return SimpleNamespace(result=lambda *, on_device_free: self.result(number, on_device_free))

    def result(self, number: int, on_device_free) -> SimpleNamespace:
        time.sleep(0.01)  # a frame waits by then
        self.calls.append(("read", number))
        on_device_free()
        self.calls.append(("result", number))
        if self.refused.get(number) == "result":
            raise InputError("cannot complete this")
        return self.measure(np.zeros((4, 6, 3), np.float32))


class Numbered(Running):
    """Frames whose counts are their number."""

    def __iter__(self):
        for frame in super().__iter__():
            yield Frame(np.full_like(frame.counts, frame.index), frame.encoding, frame.time_s, frame.index)


def test_the_newest_item_wins_and_a_patient_writer_waits():
    slot: Slot[int] = Slot()
    assert not slot.wait(0.01)
    slot.put(1)
    slot.put(2)
    assert slot.wait(WAIT_S)
    assert (len(slot), slot.take(), slot.replaced, len(slot)) == (1, 2, 1, 0)
    slot.put(3)
    writer = threading.Thread(target=slot.put, args=(4,), kwargs={"patient": True})
    writer.start()
    assert slot.take() == 3
    assert slot.take() == 4
    writer.join()
    assert slot.replaced == 1
    slot.close()
    assert slot.wait(WAIT_S)
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


def test_the_first_frame_that_was_measured_is_looked_at_once():
    said: list[str] = []
    seen: list[int] = []

    def look(frame: Frame) -> str:
        seen.append(frame.index)
        return "another film"

    eye, source = Eye(), Running(frames=9)
    source.live, eye.fails = False, True
    eye.gate.release(9)
    with LiveLoop(source, eye, track=False, listener=said.append, on_first=look) as loop:
        until(lambda: loop.unused > 1)
        eye.fails = False
        assert loop.over.wait(WAIT_S)
    assert len(seen) == 1
    assert seen[0] >= 2
    assert said.count("another film") == 1


def test_the_film_of_a_live_view_is_checked(run, tmp_path):
    options = "--no-page", "--no-model", "-q", "--out", tmp_path
    for camera, doubts in (("still_life_cy_halves", False), ("still_life_cy_open", True)):
        result = run("live", sample_image("still_life_cy_halves"), "--camera", sample_camera(camera), *options)
        assert result.returncode == 0, result.stderr
        assert ("was not taken through this camera's film" in result.stderr) == doubts


def test_another_part_of_the_sensor_is_refused_in_one_line(run, tmp_path):
    with Recorder(tmp_path / "take") as recorder:
        recorder.write(Frame(np.zeros((48, 72, 3), np.uint8), Encoding(0, 255), 0.0, 0, {"region_px": [0, 0, 72, 48]}))
    camera = sample_camera("still_life_cy_halves")
    options = "--no-page", "--no-model", "-q", "--out", tmp_path / "out"
    result = run("live", f"replay:{tmp_path / 'take'}", "--camera", camera, *options)
    assert result.returncode == 2
    assert result.stderr.startswith("error: frames are 72x48 px of the sensor")
    assert result.stderr.count("\n") == 1


def seen_of(eye: Device, frames: int) -> tuple[list[int], LiveLoop]:
    """Numbers of the frames that come out of a loop into which so many go."""
    source, seen = Numbered(frames=frames, shape=(4, 6)), []
    source.live = False
    loop = LiveLoop(source, eye, track=False, listener=lambda line: None)
    loop.to_stream = Slot()
    with loop:
        while (item := loop.to_stream.take()) is not None:
            seen.append(item.frame.index)
    return seen, loop


def test_a_device_begins_a_frame_while_the_cpu_finishes_the_one_before():
    eye = Device()
    seen, _ = seen_of(eye, 30)
    assert seen == list(range(30))
    for what in ("submit", "read", "result"):
        assert [number for name, number in eye.calls if name == what] == list(range(30))
    at = {call: place for place, call in enumerate(eye.calls)}
    ahead = [at["read", n] < at["submit", n + 1] < at["result", n] for n in range(29)]
    assert sum(ahead) > 20  # the others were late, on a busy machine


def test_a_frame_that_a_device_refuses_costs_no_other():
    eye = Device()
    eye.refused = {3: "submit", 7: "result"}
    seen, loop = seen_of(eye, 12)
    assert seen == [n for n in range(12) if n not in (3, 7)]
    assert loop.unused == 2


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


def disk_with(monkeypatch, *free_bytes: int) -> None:
    """A disk of which so much is free at each look, the last value from then on."""
    values = list(free_bytes)

    def usage(path):
        return SimpleNamespace(free=values.pop(0) if len(values) > 1 else values[0])

    monkeypatch.setattr(shutil, "disk_usage", usage)


def test_a_recording_leaves_the_reserve_of_the_disk_free(tmp_path, monkeypatch):
    frame_bytes, reserve = 48 * 72 * 3, 10**6
    enough = reserve + frame_bytes
    disk_with(monkeypatch, enough, enough, enough, enough, enough - 1)  # the first look is that of `record`
    said: list[str] = []
    eye = Eye()
    running = Running(shape=(48, 72))
    with LiveLoop(running, eye, track=False, listener=said.append, reserve_bytes=reserve) as loop:
        loop.record(tmp_path / "take")
        until(lambda: not loop.recording)
        assert len(said) == 1
        assert said[0].startswith("recording stopped, 3 frames are safe")
        assert loop.latest == said[0]  # what the page shows
        eye.gate.release(10**6)
        measured = loop.meters["depth"].count
        until(lambda: loop.meters["depth"].count > measured + 3)
    with ReplaySource(str(tmp_path / "take")) as replay:
        assert len(list(replay)) == 3


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

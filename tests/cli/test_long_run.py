"""For hours: nothing grows, a stage that hangs is named, and the time given ends the loop whatever happens."""

from __future__ import annotations

import contextlib
import gc
import importlib.util
import os
import sys
import threading
import time
import weakref
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from chromaperture.app.live.loop import LiveLoop, RareNotices, forget_old
from chromaperture.app.live.view import LiveView
from chromaperture.app.live.watchdog import Watchdog
from chromaperture.camera.camera import load_camera
from chromaperture.capture import threaded_source
from chromaperture.capture.recording import Recorder, ReplaySource
from chromaperture.capture.source import Event, FileSource, Frame
from chromaperture.capture.threaded_source import LiveSource, StreamEndedError
from chromaperture.cli import setup
from chromaperture.color.encoding import Encoding
from chromaperture.products.samples import sample_camera
from chromaperture.reconstruction.fusion import Submap
from chromaperture.reconstruction.tracking import Keyframe
from chromaperture.reconstruction.volume import Mesh
from chromaperture.system.errors import InputError
from waiting import WAIT_S, until

SHORT_S = 0.05  # until a stage counts as hanging: less than any of them is held up here
SAMPLE = sample_camera("still_life_cy_halves")
SHAPE = (48, 72, 3)

spec = importlib.util.spec_from_file_location("long_run", Path(__file__).parents[2] / "benchmarks" / "long_run.py")
assert spec is not None
assert spec.loader is not None
long_run = importlib.util.module_from_spec(spec)
sys.modules["long_run"] = long_run
spec.loader.exec_module(long_run)


class Camera(FileSource):
    """A live source that gives frames while its gate is open."""

    live = True

    def __init__(self) -> None:
        super().__init__("camera")
        self.gate, self.left = threading.Event(), threading.Event()
        self.gate.set()

    def __iter__(self):
        index = 0
        while not self.left.is_set():
            if self.gate.wait(0.01) and not self.left.wait(0.002):
                yield Frame(np.zeros(SHAPE, np.uint8), Encoding(0, 255), index / 30, index)
                index += 1

    def __exit__(self, kind, error, trace):
        self.left.set()


class Eye:
    """Measures at once, unless its gate is closed."""

    can_pipeline, method = False, None

    def shows_frame_at(self, size_px) -> bool:
        return False

    def __init__(self) -> None:
        real = load_camera(SAMPLE, quality="real-time")
        self.calibration, self.config = real.calibration, real.config
        self.gate = threading.Event()
        self.gate.set()
        self.error: Exception | None = None

    def measure(self, image: np.ndarray) -> SimpleNamespace:
        self.gate.wait(WAIT_S)
        if self.error is not None:
            raise self.error
        flat = np.full(image.shape[:2], 2000.0, np.float32)
        return SimpleNamespace(depth_mm=flat, sigma_mm=flat / 100, confidence=flat / 2000, color=image)


@contextlib.contextmanager
def watched(source=None, eye=None):
    """A loop with a watchdog of little patience; yields it and the lines said."""
    said: list[str] = []
    loops: list[LiveLoop] = []
    with Watchdog(SHORT_S, listener=lambda line: loops[0].say(line)) as watchdog:
        loop = LiveLoop(source or Camera(), eye or Eye(), track=False, listener=said.append, watchdog=watchdog)
        loops.append(loop)
        with loop:
            yield loop, said


def lines_of(stage: str, said: list[str]) -> list[str]:
    return [line for line in said if line.startswith(f"{stage} ")]


def test_a_source_that_hangs_is_named_once_and_so_is_its_return(tmp_path):
    source = Camera()
    with watched(source) as (loop, said):
        until(lambda: loop.meters["depth"].count > 3)
        source.gate.clear()
        until(lambda: lines_of("source", said))
        view = LiveView(loop, out=tmp_path)  # what the page shows
        assert view.state()["hanging"][0].startswith("source has not finished for")
        assert len(lines_of("source", said)) == 1
        source.gate.set()
        until(lambda: len(lines_of("source", said)) == 2)
        assert "source went on after" in lines_of("source", said)[1]
        assert view.state()["hanging"] == []
        measured = loop.meters["depth"].count
        until(lambda: loop.meters["depth"].count > measured + 3)  # nothing was ended


def test_a_measuring_that_hangs_is_named_while_frames_go_on_coming():
    eye = Eye()
    with watched(eye=eye) as (loop, said):
        until(lambda: loop.meters["depth"].count > 3)
        eye.gate.clear()
        until(lambda: lines_of("measure", said))
        captured = loop.meters["capture"].count
        until(lambda: loop.meters["capture"].count > captured + 3)
        assert lines_of("source", said) == []
        eye.gate.set()
        until(lambda: len(lines_of("measure", said)) == 2)


def test_a_disk_that_hangs_is_named(tmp_path, monkeypatch):
    hang = threading.Event()
    monkeypatch.setattr(Recorder, "write", lambda self, frame: hang.wait(WAIT_S))
    with watched() as (loop, said):
        loop.record(tmp_path / "take")
        until(lambda: lines_of("record", said))
        hang.set()
        until(lambda: len(lines_of("record", said)) >= 2)


def test_a_watchdog_without_end_says_nothing_and_one_without_patience_is_refused():
    said: list[str] = []
    with Watchdog(float("inf"), listener=said.append) as watchdog, watchdog.stage("measure"):
        assert watchdog.hanging() == []
        assert not [thread for thread in threading.enumerate() if thread.name == "watchdog"]
    for seconds in (0, -1, float("nan")):
        with pytest.raises(InputError, match="--watchdog-seconds"):
            Watchdog(seconds)


@pytest.mark.extra("serve", "starlette")
@pytest.mark.parametrize("held_up", ["paused", "source"])
def test_a_page_without_frames_ends_at_its_time(tmp_path, held_up):
    from chromaperture.app.live.page import LivePage

    source = Camera()
    with watched(source) as (loop, _):
        page = LivePage(loop, host="127.0.0.1", port=0, out=tmp_path)
        drawing = None
        try:
            page.run(until=lambda: page.view.last is not None)
            if held_up == "paused":
                loop.paused.set()
            else:
                source.gate.clear()
            over = threading.Event()
            drawing = threading.Thread(target=page.run, kwargs={"until": over.is_set}, daemon=True)
            drawing.start()
            over.set()
            drawing.join(WAIT_S)
            assert not drawing.is_alive()
        finally:
            loop.stop()
            page.close()


class Silent:
    """A device that gives two frames and then none; it answers, but slowly."""

    def read(self, index: int) -> Frame | None:
        if index >= 2:
            time.sleep(0.01)
            return None
        return Frame(np.full((480, 720, 3), 99, np.uint8), Encoding(0, 255), index / 30, index)

    def close(self) -> None:
        pass


def silent(*args: object, **options: object) -> LiveSource:
    return LiveSource("silent", Silent, silence_s=float("inf"), listener=lambda event: None)


def test_live_ends_at_its_time_although_the_camera_gives_nothing(tmp_path, run, monkeypatch):
    monkeypatch.setattr(setup, "open_source", silent)
    options = ("--camera", SAMPLE, "--out", tmp_path, "--no-page", "--no-model", "--quiet")
    result = run("live", "webcam:0", *options, "--seconds", 0.5, "--watchdog-seconds", 0.1)
    assert result.returncode == 0
    assert "warning: source has not finished for" in result.stderr


def test_record_ends_at_its_time_although_the_camera_gives_nothing(tmp_path, run, monkeypatch):
    monkeypatch.setattr(setup, "open_source", silent)
    result = run("record", "webcam:0", "--out", tmp_path / "take", "--seconds", 0.5, "--quiet")
    assert result.returncode == 0
    with ReplaySource(str(tmp_path / "take")) as replay:
        assert 1 <= len(list(replay)) <= 2  # the newest wins where the first is still being written


def test_a_camera_that_hangs_when_it_is_opened_is_named(tmp_path, run, monkeypatch):
    def slow() -> Silent:
        time.sleep(1.0)
        raise InputError("nobody answers")

    monkeypatch.setattr(setup, "open_source", lambda *args, **options: LiveSource("slow", slow))
    options = ("--camera", SAMPLE, "--out", tmp_path, "--no-page", "--no-model", "--watchdog-seconds", 0.1)
    result = run("live", "webcam:0", *options)
    assert result.returncode == 2
    assert "source has not finished for" in result.stderr


@pytest.mark.parametrize(
    "error", [ZeroDivisionError("by zero"), MemoryError(), ValueError("odd\nshape"), InputError("dark")]
)
def test_no_error_of_one_frame_ends_the_loop(error):
    eye = Eye()
    with watched(eye=eye) as (loop, said):
        eye.error = error
        until(lambda: loop.unused > 5)
        eye.error = None
        measured = loop.meters["depth"].count
        until(lambda: loop.meters["depth"].count > measured + 3)
        assert loop.failure is None
    told = [line for line in said if type(error).__name__ in line or line.endswith("dark")]
    assert len(told) == 1
    assert "\n" not in told[0]


class Faulty:
    """A device whose frames are no pictures now and then, and whose driver fails."""

    given = (
        np.zeros((0, 72, 3), np.uint8),
        np.zeros((48, 72), np.uint8),
        np.zeros((48, 72, 4), np.uint8),
        np.zeros(SHAPE, object),
        np.zeros(SHAPE, complex),
    )

    def __init__(self, lives: list[str]) -> None:
        self.lives = lives
        if lives.pop(0) == "absent":
            raise OSError(19, "No such device")

    def read(self, index: int) -> Frame | None:
        if not self.lives and index > 40:
            raise StreamEndedError
        if self.lives and index > 10:
            raise OSError(5, "Input/output error")
        counts = self.given[index % 10] if index % 10 < 5 else np.full(SHAPE, 99, np.uint8)
        return Frame(counts, Encoding(0, 255), index / 30, index)

    def close(self) -> None:
        pass


def test_damaged_frames_and_errors_of_the_driver_end_no_live_source():
    lives, events = ["there", "absent", "there"], list[Event]()
    with LiveSource("faulty", lambda: Faulty(lives), listener=events.append, retry_s=0.01) as source:
        frames = list(source)
    assert frames
    assert all(frame.counts.shape == SHAPE for frame in frames)
    kinds = [event.kind for event in events]
    assert kinds.count("lost") == kinds.count("reconnected") == 1
    assert kinds.count("skipped") == 5  # once a row of damaged frames: 0, 10, ... 40


@pytest.mark.parametrize("jump_s", [86400.0, -86400.0])
def test_a_clock_that_was_set_while_recording_delays_nothing_in_the_playback(jump_s, monkeypatch):
    """The frames before and after keep their pace; the jump itself lasts no longer than a gap may."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(threaded_source.time, "monotonic", lambda: clock.now)
    monkeypatch.setattr(threaded_source.time, "sleep", lambda seconds: setattr(clock, "now", clock.now + seconds))
    times = [index / 10 + (jump_s if index >= 5 else 0) for index in range(10)]
    source = SimpleNamespace(
        __enter__=lambda: None,
        frames=lambda: iter([Frame(np.zeros(SHAPE, np.uint8), Encoding(0, 255), each, 0) for each in times]),
    )
    device, shown = threaded_source.Playback(source, speed=1.0, loop=False), []
    for index in range(10):
        device.read(index)
        shown.append(clock.now)
    steps = np.diff(shown)
    np.testing.assert_allclose(np.delete(steps, 4), 0.1, atol=1e-9)  # rounding
    assert 0 <= steps[4] <= 5.0


def test_what_recurs_is_said_rarely_and_counted():
    said: list[str] = []
    notices = RareNotices(said.append, pause_s=1e9)
    for index in range(1000):
        notices(f"frame {index}: the image is all black")
        notices(f"the camera is gone ({index})")
    assert said == ["frame 0: the image is all black", "the camera is gone (0)"]
    often = RareNotices(said.append, pause_s=0.0)
    often("again")
    often("again")
    assert said[2:] == ["again", "again"]


def test_the_memory_of_notices_is_bounded():
    notices = RareNotices(lambda line: None, pause_s=1e9)
    words = ["".join(chr(97 + (n >> shift) % 16) for shift in (0, 4, 8)) for n in range(3000)]
    for word in words:
        notices(word)
    gc.collect()
    held = [found for found in gc.get_referrers(words[0]) if found is not words]
    assert held == []  # the oldest are forgotten


def test_old_submaps_take_no_more_memory_than_the_model():
    def submap(number: int) -> Submap:
        key = Keyframe(np.eye(4), np.zeros((30, 40), np.float32), np.zeros((60, 80), np.uint8),
                       np.zeros((60, 80), np.float32), np.zeros((60, 80), np.float32), np.eye(3))  # fmt: skip
        mesh = Mesh(np.zeros((300, 3), np.float32), np.zeros((100, 3), np.int32), np.zeros((300, 3), np.uint8))
        return Submap(None, mesh, [key], root=number)

    model, said = SimpleNamespace(submaps=[submap(number) for number in range(50)]), []
    one = 30 * 40 * 4 + 60 * 80 * 9 + 300 * 12 + 100 * 12 + 300 * 3
    forget_old(model, 3 * one, listener=said.append)
    assert [bool(each.keyframes) for each in model.submaps] == [False] * 46 + [True] * 4  # the last one grows
    assert [len(each.surface().vertices_mm) for each in model.submaps] == [0] * 46 + [300] * 4
    assert [each.root for each in model.submaps] == list(range(50))
    forget_old(model, 3 * one, listener=said.append)
    assert len(said) == 46  # each once


def test_what_only_refers_to_itself_does_not_wait_for_the_collector_of_old_objects():
    class Connection:
        def __init__(self) -> None:
            self.owner, self.buffer = self, np.zeros(1000)

    gc.disable()
    try:
        with LiveLoop(Camera(), Eye(), track=False, tidy_every_s=SHORT_S):
            left = weakref.ref(Connection())
            until(lambda: left() is None)
    finally:
        gc.enable()


@pytest.mark.slow
def test_a_camera_that_misbehaves_leaves_nothing_behind(tmp_path):
    """A short run of benchmarks/long_run.py: with the page where the server is installed."""
    page_shown = importlib.util.find_spec("starlette") is not None
    threads, handles = set(threading.enumerate()), len(os.listdir("/proc/self/fd"))
    rows, facts = long_run.run(12.0, page_shown=page_shown, model=False, folder=tmp_path, sample_s=0.2)
    assert facts["failure"] is None
    assert not facts["ended_early"]
    assert facts["frames"]["refused"] > 0  # damaged frames reached the camera
    assert len(facts["troubles"]) >= 8  # of 14 kinds
    late = rows[len(rows) // 2 :]
    assert late[-1, -1] > late[0, -1]  # frames are measured still
    queued = late[:, long_run.COLUMNS.index("queued")]
    assert queued.max() <= 4  # one between each two stages, one to the disk
    memory = late[:, long_run.COLUMNS.index("memory_mb")]
    # A picture of 115 KB kept of every frame would be 400 MB here; compilation and pools of threads are no 100.
    assert np.median(memory[-5:]) - np.median(memory[:5]) < 100
    # The package's pool of threads stays for the next picture.
    until(lambda: [t for t in set(threading.enumerate()) - threads if not t.name.startswith("chromaperture")] == [])
    until(lambda: len(os.listdir("/proc/self/fd")) <= handles)


@pytest.mark.parametrize(("leak", "flat"), [(0.0, True), (1.0, False)])
def test_a_leak_is_found_and_scatter_is_none(rng, leak, flat):
    seconds = np.arange(1200.0)
    rows = np.zeros((len(seconds), len(long_run.COLUMNS)))
    rows[:, 0] = seconds
    for name, level in (("memory_mb", 800), ("handles", 20), ("threads", 30), ("queued", 1), ("connections", 6),
                        ("blocks", 3e5)):  # fmt: skip
        column = long_run.COLUMNS.index(name)
        warm = np.minimum(seconds / 300, 1) * level  # rises while it warms up
        growing = leak * 3 * max(long_run.LIMITS[name], long_run.MEMORY_PART * level) * seconds / 800
        rows[:, column] = warm + growing + rng.normal(0, 0.05 * level, len(seconds))
    assert {name: each["flat"] for name, each in long_run.judged(rows).items()} == dict.fromkeys(long_run.LIMITS, flat)

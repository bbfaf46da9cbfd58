"""Run capture, depth and tracking in threads of their own, connected by queues of one item.

A slow stage costs frames, not latency: it takes the newest item.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import gc
import re
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from chromaperture.app.free_space import RESERVE_BYTES, require_space
from chromaperture.app.live.slots import Meter, Slot
from chromaperture.app.live.watchdog import Watchdog
from chromaperture.camera.camera import CodedApertureCamera, DepthFrame, PendingFrame
from chromaperture.capture.recording import Recorder
from chromaperture.capture.source import Frame, Source
from chromaperture.products.foxglove_stream import FoxgloveStream
from chromaperture.products.rectified import undistorter
from chromaperture.reconstruction.fusion import Placed, Reconstruction, Submap
from chromaperture.reconstruction.settings import ReconstructionConfig
from chromaperture.reconstruction.volume import Mesh, open3d
from chromaperture.system.errors import ChromapertureError, InputError

STAGES = ("capture", "depth", "tracking", "view")
_PATIENCE_S = 0.5  # of depth with tracking: then the page goes on without a model; longer than a mesh takes; by hand
FUSE_EVERY = 2  # frames of a camera lie close together: docs/reconstruction.md
_MESH_REST = 10.0  # pause after a mesh in units of its duration, while nothing is tracked; by hand
_JOIN_S = 30.0  # for all stages together when the loop ends, then for a recording: a slow frame and disk; by hand
_NOTICE_S = 60.0  # between two lines of a kind: a minute of a fault is one line. Chosen by hand
_MOST_KINDS = 100  # of lines remembered, chosen by hand; of more, the oldest may be said again at once
_MOST_PLACES = 2000  # of a path


@dataclass(frozen=True)
class Measured:
    """One frame: ``arrived`` on the monotonic clock, the capture, the measurement."""

    arrived: float
    frame: Frame
    measurement: DepthFrame


class _Ahead(NamedTuple):
    """A frame that the camera has begun to measure, and when it arrived and was begun on the monotonic clock."""

    arrived: float
    frame: Frame
    start: float
    pending: PendingFrame | None  # None on the CPU, where nothing is computed ahead


class LiveLoop:
    """Run the stages; a context manager that stops and joins them on exit.

    Source and watchdog are entered by the caller; by default nothing is said about a stage that hangs. ``track`` needs
    the extra ``reconstruct``. ``listener`` receives messages for the user, one line each, from any thread, ``on_first``
    the first frame that was measured, from the thread that measures; what it returns is said, unless it is empty.
    ``failure`` is the error that ended the loop, if one did.
    """

    def __init__(
        self,
        source: Source,
        camera: CodedApertureCamera,
        *,
        track: bool = True,
        config: ReconstructionConfig | None = None,
        listener: Callable[[str], None] = lambda line: None,
        mesh_every_s: float = 5.0,  # of the growing model, while a page asks
        reserve_bytes: int = RESERVE_BYTES,  # of the disk, that recordings leave free
        tidy_every_s: float = 20.0,
        watchdog: Watchdog | None = None,
        on_first: Callable[[Frame], str] = lambda frame: "",
    ) -> None:
        if track:
            open3d()
        self.source, self.camera, self.reserve_bytes = source, camera, reserve_bytes
        self.latest = ""  # the last message for the user
        self._listener, self._rarely = listener, RareNotices(listener)
        self.watchdog, self._tidy_every_s = watchdog or Watchdog(), tidy_every_s
        self.meters = {name: Meter() for name in STAGES}
        self.paused, self.over = threading.Event(), threading.Event()
        self.want_mesh = threading.Event()
        self.placed: Placed | None = None
        self.trail = Trail()
        self.mesh: Mesh | None = None
        self.model: Reconstruction | None = None
        self.track, self._mesh_every_s = track, mesh_every_s
        self.config = config or ReconstructionConfig(fuse_every=FUSE_EVERY)
        self._leave = threading.Event()
        self._to_depth, self._to_track = Slot[tuple[float, Frame]](), Slot[Measured]()
        self.to_view = Slot[Measured]()
        self.to_stream: Slot[Measured] | None = None  # every measurement, beside the page; set before the loop runs
        self._to_disk: Slot[Frame] | None = None
        self._recorder: threading.Thread | None = None
        self._starting = threading.Lock()  # two clicks at once start one recording
        self._threads: list[threading.Thread] = []
        self._ahead: _Ahead | None = None
        self.recorded = self.unused = 0  # frames on the disk, and frames that could not be measured
        self.failure: BaseException | None = None
        self._on_first: Callable[[Frame], str] | None = on_first

    def __enter__(self) -> Self:
        gc.freeze()  # modules and calibration stay: `tidy` need not look at them, which would take a tenth of a second
        stages = {"capture": self._capture, "depth": self._depth} | ({"tracking": self._tracking} if self.track else {})
        for name, work in stages.items():
            self._threads.append(threading.Thread(target=self._guarded, args=(work,), name=name, daemon=True))
            self._threads[-1].start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End all stages; unfinished frames are dropped, recordings are kept."""
        self._leave.set()
        for slot in (self._to_depth, self._to_track, self.to_view):
            slot.close(drop=True)
        if self.to_stream is not None:
            self.to_stream.close()
        self.stop_recording()
        with contextlib.suppress(Exception):
            self.source.__exit__(None, None, None)  # wakes a stage waiting for a frame
        end = time.monotonic() + _JOIN_S
        for thread in self._threads:
            thread.join(timeout=max(0.0, end - time.monotonic()))
        for thread in self._threads:
            if thread.is_alive():
                self.say(f"the stage {thread.name} did not end within {_JOIN_S:.0f} s and is left behind")
        self.over.set()
        gc.unfreeze()

    def say(self, line: str) -> None:
        """Hand the user a message, and keep it for the page."""
        self.latest = line
        self._listener(line)

    def say_rarely(self, line: str) -> None:
        """Keep a message for the page, and hand the user one a minute of its kind: it may recur with every frame."""
        self.latest = line
        self._rarely(line)

    @property
    def recording(self) -> bool:
        """Whether frames are being recorded."""
        return self._recorder is not None and self._recorder.is_alive()

    def record(self, folder: str | Path) -> None:
        """Start recording; raises InputError on a disk nearly full, which later ends the recording, not the loop."""
        with self._starting:
            if self.recording:
                return
            require_space(folder, 0, self.reserve_bytes)
            slot = self._to_disk = Slot[Frame]()
            self.recorded = 0
            self._recorder = threading.Thread(target=self._write, args=(folder, slot), name="record", daemon=True)
            self._recorder.start()

    def _write(self, folder: str | Path, slot: Slot[Frame]) -> None:
        try:
            with Recorder(folder, source=self.source.name) as recorder:
                while (frame := slot.take()) is not None:
                    with self.watchdog.stage("record"):
                        try:
                            require_space(folder, frame.counts.nbytes, self.reserve_bytes)
                        except InputError as error:
                            self.say(f"recording stopped, {recorder.count} frames are safe in {folder}: {error}")
                            return
                        recorder.write(frame)
                    self.recorded = recorder.count
            self.say(f"recorded {recorder.count} frames to {folder}, {slot.replaced} came too fast")
        except ChromapertureError as error:
            self.say(str(error))
        except Exception as error:  # of one frame, or of the disk: the loop goes on
            self.say(f"recording stopped, {self.recorded} frames are safe in {folder}: {one_line(error)}")
        finally:
            slot.close(drop=True)

    def stop_recording(self) -> None:
        """Finish the recording, if there is one."""
        if self._to_disk is not None:
            self._to_disk.close()
        if self._recorder is not None:
            self._recorder.join(timeout=_JOIN_S)
        self._to_disk = None

    def figures(self) -> dict[str, Any]:
        """Return rate, duration and latency of each stage, and the number of frames dropped."""
        slots = (self._to_depth, self._to_track, self.to_view)
        dropped = (getattr(self.source, "dropped", 0), *(slot.replaced for slot in slots))
        return {name: self.meters[name].summary() | {"dropped": n} for name, n in zip(STAGES, dropped, strict=True)}

    @property
    def queued(self) -> int:
        """Items that wait between two stages."""
        slots = (self._to_depth, self._to_track, self.to_view, self._to_disk)
        return sum(len(slot) for slot in slots if slot is not None)

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:  # no caller catches it: end the loop; who runs it says `failure`, once
            if not self._leave.is_set():
                self.failure = error
                self.latest = one_line(error)
            for slot in (self._to_depth, self._to_track, self.to_view):
                slot.close(drop=True)

    def _capture(self) -> None:
        meter, stream = self.meters["capture"], iter(self.source)
        while not self._leave.is_set():
            start = time.monotonic()
            with self.watchdog.stage("source"):
                frame = next(stream, None)
            if frame is None:
                break
            while self.paused.is_set() and not self.source.live and not self._leave.is_set():
                time.sleep(0.05)
            arrived = time.monotonic()
            meter.record(arrived - start, 0.0)
            if (to_disk := self._to_disk) is not None:  # a click may end the recording meanwhile
                to_disk.put(frame)
            if not self.paused.is_set():
                self._to_depth.put((arrived, frame), patient=not self.source.live)
        self._to_depth.close()

    def _depth(self) -> None:
        tidied = time.monotonic()
        while True:
            if self.track:  # a frame measured while another waits would be left out, and its work lost
                self._to_track.wait_taken(_PATIENCE_S)
            if self._ahead is None:
                if (item := self._to_depth.take()) is None:
                    break
                self._ahead = self._begun(*item)
            if time.monotonic() - tidied > self._tidy_every_s:
                tidy()
                tidied = time.monotonic()
            here, self._ahead = self._ahead, None
            if here is not None:
                self._complete(here)
        self._to_track.close()
        if not self.track:
            self._finish()

    def _begin_waiting(self) -> None:
        """Have the device begin the frame that waits; not while frames are tracked, when it would be old by then."""
        if not self.track and len(self._to_depth) and (item := self._to_depth.take()) is not None:
            self._ahead = self._begun(*item)

    def _begun(self, arrived: float, frame: Frame) -> _Ahead | None:
        """Begin to measure a frame; None, which is said, where it cannot be."""
        start = time.monotonic()
        try:
            with self.watchdog.stage("measure"):
                height, width = frame.counts.shape[:2]
                if self.camera.shows_frame_at((width, height)):
                    self.camera = self.camera.at_size(width, height)
                pending = self.camera.submit(frame.image) if self.camera.can_pipeline else None
                return _Ahead(arrived, frame, start, pending)
        except Exception as error:  # of this frame, whatever it holds; the next may be in order
            self._unused(frame, error)
            return None

    def _complete(self, here: _Ahead) -> None:
        """Measure a frame, and hand it on."""
        try:
            with self.watchdog.stage("measure"):
                if here.pending is None:
                    measurement = self.camera.measure(here.frame.image)
                else:
                    measurement = here.pending.result(on_device_free=self._begin_waiting)
        except Exception as error:
            self._unused(here.frame, error)
            return
        if (on_first := self._on_first) is not None:
            self._on_first = None
            if line := on_first(here.frame):
                self.say(line)
        measured = Measured(here.arrived, here.frame, measurement)
        now = time.monotonic()
        self.meters["depth"].record(now - here.start, now - here.arrived)
        self.to_view.put(measured)
        if self.to_stream is not None:
            self.to_stream.put(measured, patient=not self.source.live)
        if self.track:
            self._to_track.put(measured, patient=not self.source.live)

    def _unused(self, frame: Frame, error: Exception) -> None:
        self.say_rarely(f"frame {frame.index}: {one_line(error)}")
        self.unused += 1

    def _tracking(self) -> None:
        next_mesh, root = time.monotonic() + self._mesh_every_s, 0
        while (item := self._to_track.take()) is not None:
            if self.model is None:  # by now the camera has the size of the frames
                matrix = self.camera.calibration.lens.camera_matrix
                self.model = Reconstruction(matrix, self.config, listener=self.say_rarely)
                to_view = undistorter(self.camera)
            model = self.model
            start = time.monotonic()
            with self.watchdog.stage("track"):
                try:
                    view = to_view(item.measurement, item.frame.time_s, item.frame.index)
                    self.placed = placed = model.in_root(model.add(view))
                except Exception as error:  # of this frame
                    self.say_rarely(f"frame {item.frame.index}: {one_line(error)}")
                    continue
                del model.placed[:-1]  # memory: the path below is thinned
                forget_old(model, self.config.memory_mb * 2**20, listener=self.say_rarely)
                if placed.pose is not None and placed.submap != root:  # another world frame
                    root, self.trail = placed.submap, Trail()
                if placed.pose is not None:
                    self.trail.add(placed.pose[:3, 3])
                if self.want_mesh.is_set() and start > next_mesh and model.current is not None:
                    began = time.monotonic()
                    self.mesh = model.mesh(model.current.root, ordered=False)
                    self.want_mesh.clear()
                    trim_memory()
                    taken = time.monotonic() - began
                    next_mesh = start + max(self._mesh_every_s, _MESH_REST * taken)
            now = time.monotonic()
            self.meters["tracking"].record(now - start, now - item.arrived)
        if self.model is not None and self.model.current is not None:
            self.mesh = self.model.mesh(self.model.current.root)
        self._finish()

    def _finish(self) -> None:
        self.to_view.close()
        if self.to_stream is not None:
            self.to_stream.close()
        self.over.set()


def one_line(error: BaseException) -> str:
    """Return the message of an error; its kind too, unless it was written for the user."""
    text = " ".join(str(error).split())
    return text if text and isinstance(error, ChromapertureError) else f"{type(error).__name__}: {text}".rstrip(": ")


def forget_old(model: Reconstruction, most_bytes: int, *, listener: Callable[[str], None] = lambda line: None) -> None:
    """Empty the oldest submaps that no longer grow until meshes and keyframes fit into the memory."""
    left = most_bytes
    for number in reversed(range(len(model.submaps) - 1)):
        submap = model.submaps[number]
        left -= _bytes_of(submap)
        if left < 0 and submap.keyframes:
            submap.keyframes = []
            submap.mesh = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
            listener(f"submap {number} is forgotten: older submaps take more than --memory-mb")


def _bytes_of(submap: Submap) -> int:
    mesh = submap.mesh
    vertices = 0 if mesh is None else mesh.vertices_mm.nbytes + mesh.triangles.nbytes + mesh.colors.nbytes
    arrays = ((key.thumbnail, key.grey, key.z_mm, key.sigma_mm) for key in submap.keyframes)
    return vertices + sum(array.nbytes for each in arrays for array in each)


def tidy() -> None:
    """Free what only refers to itself, and return it to the system: Python's collector hardly looks at old objects."""
    gc.collect()
    trim_memory()


def trim_memory() -> None:
    """Return freed memory to the system: glibc keeps fragments freed by many threads, and grows for hours."""
    if (trim := _trim()) is not None:
        trim(0)


@functools.cache  # a CDLL is a reference cycle: create one only
def _trim() -> Callable[[int], int] | None:
    with contextlib.suppress(OSError, AttributeError):
        trim: Callable[[int], int] = ctypes.CDLL("libc.so.6").malloc_trim
        return trim
    return None  # not glibc


class RareNotices:
    """Pass a line on unless one equal but for numbers was passed on lately; says how many were left out."""

    def __init__(self, listener: Callable[[str], None], *, pause_s: float = _NOTICE_S) -> None:
        self._listener, self._pause_s = listener, pause_s
        self._said: OrderedDict[str, tuple[float, int]] = OrderedDict()  # kind: when, left out since
        self._changing = threading.Lock()

    def __call__(self, line: str) -> None:
        """Pass one line on, or count it."""
        kind, now = re.sub(r"\d+", "0", line), time.monotonic()
        with self._changing:
            when, left_out = self._said.get(kind, (float("-inf"), 0))
            if now - when < self._pause_s:
                self._said[kind] = (when, left_out + 1)
                return
            self._said[kind] = (now, 0)
            self._said.move_to_end(kind)
            while len(self._said) > _MOST_KINDS:
                self._said.popitem(last=False)
        self._listener(f"{line} ({left_out} more like it since the last)" if left_out else line)


class Trail:
    """Positions of a camera, evenly thinned: when there are too many, every second is kept, then every fourth."""

    def __init__(self, most: int = _MOST_PLACES) -> None:
        self.points_mm: list[np.ndarray] = []  # (3,) float64; a new list after every change, for other threads
        self._most, self._step, self._count = most, 1, 0

    def add(self, point_mm: np.ndarray) -> None:
        """Add a position, unless it is thinned out."""
        if self._count % self._step == 0:
            points = [*self.points_mm, point_mm.copy()]
            if len(points) > self._most:
                points, self._step = points[::2], 2 * self._step
            self.points_mm = points
        self._count += 1


_STREAM_END_S = 5.0  # for the last message at the end; chosen by hand


class Streaming:
    """Take the measurements of a loop and send them, leaving out what comes too fast; a context manager."""

    def __init__(self, loop: LiveLoop, stream: FoxgloveStream) -> None:
        self.loop, self.stream = loop, stream
        self._slot = loop.to_stream = Slot[Measured]()
        self._thread = threading.Thread(target=self._run, name="stream", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._slot.close()
        self._thread.join(timeout=_STREAM_END_S)

    def _run(self) -> None:
        to_view, posed = None, None
        while (item := self._slot.take()) is not None:
            try:
                to_view = to_view or undistorter(self.loop.camera)  # by now it has the size of the frames
                self.stream.send(to_view(item.measurement, item.frame.time_s, item.frame.index))
                placed = self.loop.placed
                if placed is not None and placed.pose is not None and placed is not posed:
                    self.stream.send_pose(placed.pose, placed.time_s)
                    posed = placed
            except Exception as error:  # of one frame, or of the disk: the loop goes on
                self.loop.say_rarely(f"frame {item.frame.index} was not streamed: {one_line(error)}")

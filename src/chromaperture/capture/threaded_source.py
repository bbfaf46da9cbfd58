"""Live cameras, and files played like one: a thread reads frames, only the newest is kept, lost cameras return."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from chromaperture.capture.source import Event, FileSource, Frame, FrameCounts, Listener, log_event, steady
from chromaperture.system.errors import ChromapertureError, InputError

_KEPT_BYTES = 512 << 20  # frames of a loop that are cached: 290 of VGA in 16 bits
_INTERVAL_S = 1 / 30  # of a loop of one picture: the frame rate that other sources assume
_LONGEST_WAIT_S = 5.0  # a gap of the recording lasts no longer: closing waits for it. Chosen by hand, not tuned


_REPORT_S = 10.0  # between two events of frames that do not arrive; chosen by hand, not tuned


class DeviceLostError(Exception):
    """The device stopped delivering: unplugged, switched off, or taken by another program."""


class StreamEndedError(Exception):
    """The device will not deliver more frames, as at the end of a replayed recording."""


@dataclass(frozen=True)
class Arrival:
    """What came from a camera that numbers its frames, and how many it sent since the last one that did not come."""

    frame: Frame | None = None
    skipped: int = 0  # whole, left out by the driver for a newer one
    incomplete: int = 0
    lost: int = 0
    advice: str = ""  # against what is incomplete or lost
    clock: str = ""  # what the camera's clock did, where that is to be told


class Device(Protocol):
    """One opened camera, used only by the thread that opened it."""

    def read(self, index: int) -> Frame | Arrival | None:
        """Wait up to about a second for a frame; None when none came; raises DeviceLostError or StreamEndedError."""

    def close(self) -> None:
        """Release the camera; never raises."""


class LiveSource:
    """Deliver the newest frame of a running camera; older ones are dropped, so a slow reader adds no latency.

    ``connect`` opens the device and raises InputError when it is missing or in use. ``listener`` is called with events
    from the capture thread. A camera is lost after ``silence_s`` without a frame, and looked for every ``retry_s``.
    ``counts`` says what became of the frames since it was entered.
    """

    live = True
    camera_size_px: tuple[int, int] | None = None

    def __init__(
        self,
        name: str,
        connect: Callable[[], Device],
        *,
        listener: Listener | None = None,
        silence_s: float = 5.0,
        retry_s: float = 1.0,
    ) -> None:
        self.name, self.counts = name, FrameCounts()
        self._connect, self._listener = connect, listener or log_event
        self._silence_s, self._retry_s = silence_s, retry_s
        self._slot: Frame | None = None
        self._ready = threading.Condition()
        self._opened, self._leave = threading.Event(), threading.Event()
        self._failure: BaseException | None = None
        self._over = False
        self._thread: threading.Thread | None = None

    @property
    def dropped(self) -> int:
        """Number of frames that were replaced by newer ones before they were read."""
        return self.counts.skipped

    def __enter__(self) -> Self:
        self._opened.clear()
        self._leave.clear()
        self._slot, self._failure, self._over, self.counts = None, None, False, FrameCounts()
        # Since the last event of missing frames: their number, the advice; and its time.
        self._missing, self._advice, self._reported = FrameCounts(), "", -math.inf
        self._is_whole = True
        self._thread = threading.Thread(target=self._run, name=f"capture {self.name}", daemon=True)
        self._thread.start()
        self._opened.wait()
        if self._failure is not None:
            self._thread.join()
            raise self._failure
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()
        if self._thread is not None:
            self._thread.join(timeout=10)  # s: do not wait for a driver that hangs
        with self._ready:
            self.counts.skipped += self._slot is not None
            self._slot = None

    def stop(self) -> None:
        """End the stream for a reader that waits for a frame; from any thread."""
        self._leave.set()
        with self._ready:
            self._ready.notify_all()

    def __iter__(self) -> Iterator[Frame]:
        yield from steady(self._newest(), self._listener, self.camera_size_px)

    def _newest(self) -> Iterator[Frame]:
        while True:
            with self._ready:
                self._ready.wait_for(lambda: self._slot or self._leave.is_set() or self._over)
                frame, self._slot = self._slot, None
            if frame is None or self._leave.is_set():
                if self._failure is not None:
                    raise self._failure
                return
            self.counts.delivered += 1
            yield frame

    def _run(self) -> None:
        device: Device | None = None
        try:
            device = self._connect()
            self._opened.set()
            index, last = 0, time.monotonic()
            while device is not None and not self._leave.is_set():
                try:
                    arrival = device.read(index)
                    if arrival is not None:
                        index = self._arrived(arrival if isinstance(arrival, Arrival) else Arrival(arrival), index)
                        last = time.monotonic()
                    elif time.monotonic() - last > self._silence_s:
                        raise DeviceLostError(f"no frame for {self._silence_s:g} s")
                except (DeviceLostError, OSError) as lost:
                    self._listener(Event("lost", f"{self.name} is gone ({lost}); looking for it again"))
                    device.close()
                    device = self._reconnected()
                    last = time.monotonic()
        except StreamEndedError:
            pass
        except BaseException as error:  # raised in the reader, which would otherwise wait forever
            self._failure = error
        finally:
            if device is not None:
                device.close()
            with self._ready:
                self._over = True
                self._ready.notify_all()
            self._opened.set()

    def _reconnected(self) -> Device | None:
        while not self._leave.wait(self._retry_s):
            try:
                device = self._connect()
            except (ChromapertureError, OSError):
                continue
            self._listener(Event("reconnected", f"{self.name} is back"))
            return device
        return None

    def _arrived(self, arrival: Arrival, index: int) -> int:
        """Count what the camera sent, report what is missing, and pass the frame on; returns the next one's number."""
        self._report(arrival)
        if arrival.clock:
            self._listener(Event("clock", f"{self.name}: {arrival.clock}"))
        index += arrival.skipped + arrival.incomplete + arrival.lost
        if arrival.frame is None:
            return index
        was_whole, self._is_whole = self._is_whole, is_picture(arrival.frame.counts)
        if self._is_whole:
            with self._ready:
                self.counts.skipped += self._slot is not None
                self._slot = replace(arrival.frame, index=index)
                self._ready.notify()
        else:
            self.counts.incomplete += 1
            if was_whole:
                self._listener(Event("skipped", f"{self.name}: frame {index} is no colour picture; it is left out"))
        return index + 1

    def _report(self, arrival: Arrival) -> None:
        """Count what did not arrive, and tell of it: at once, then at intervals."""
        for counts in (self.counts, self._missing):
            counts.skipped += arrival.skipped
            counts.incomplete += arrival.incomplete
            counts.lost += arrival.lost
        self._missing.delivered += arrival.frame is not None
        self._advice = arrival.advice or self._advice
        missing = self._missing
        if not (missing.incomplete or missing.lost) or time.monotonic() - self._reported < _REPORT_S:
            return
        message = (
            f"{self.name}: of {missing.sent} frames {missing.incomplete} arrived incomplete, {missing.lost} not at all"
        )
        self._listener(Event("missing", f"{message}; {self._advice}" if self._advice else message))
        self._missing, self._advice, self._reported = FrameCounts(), "", time.monotonic()


class Playback:
    """A device that plays a file source; speed 1 is the recorded one, inf as fast as frames can be read."""

    def __init__(self, source: FileSource, *, speed: float, loop: bool) -> None:
        self._source, self._speed, self._loop = source, speed, loop
        source.__enter__()
        self._frames: Iterator[Frame] = source.frames()
        self._kept: list[Frame] = []
        self._keeping = loop  # in the first round, while there is room
        self._due = time.monotonic()  # when the last frame was to be delivered
        self._is_first = True
        self._last_s, self._interval_s, self._rest_s = 0.0, _INTERVAL_S, 0.0  # the last frame of a round lasts too

    def read(self, index: int) -> Frame | None:
        """Wait for the next frame's time."""
        frame = self._next()
        step_s = frame.time_s - self._last_s
        if self._is_first:
            self._is_first, self._due, step_s = False, time.monotonic(), self._rest_s
        elif step_s > 0:
            self._interval_s = min(step_s, _LONGEST_WAIT_S)
        self._last_s = frame.time_s
        # Step by step: a clock that was set during the recording, by a day or back, must not delay all that follows.
        self._due += min(max(step_s / self._speed, 0.0), _LONGEST_WAIT_S)
        time.sleep(max(0.0, self._due - time.monotonic()))
        return replace(frame, index=index, time_s=time.time())

    def _next(self) -> Frame:
        for _ in range(2):
            if (frame := next(self._frames, None)) is not None:
                if self._keeping:
                    self._kept.append(frame)
                    if len(self._kept) * frame.counts.nbytes > _KEPT_BYTES:
                        self._kept, self._keeping = [], False
                return frame
            if not self._loop:
                break
            self._frames, self._keeping, self._is_first = iter(self._kept or self._source.frames()), False, True
            self._rest_s = self._interval_s
        raise StreamEndedError

    def close(self) -> None:
        """Close the files."""
        self._source.close()


def played(
    source: FileSource, *, speed: float = 1.0, loop: bool = False, listener: Listener | None = None
) -> LiveSource:
    """Make a live source of files: frames arrive at their times, whether they are read or not; the newest wins."""
    if not speed > 0:
        raise InputError(f"the speed of playback must be positive, got {speed:g}")
    return LiveSource(source.name, lambda: Playback(source, speed=speed, loop=loop), listener=listener)


def is_picture(counts: np.ndarray) -> bool:
    """Find whether a driver delivered what every stage expects: (H, W, 3), not empty, unsigned counts or float."""
    return counts.ndim == 3 and counts.shape[2] == 3 and counts.size > 0 and counts.dtype.kind in "uf"


def not_there(what: str, hint: str) -> InputError:
    """Make the error of a camera that cannot be opened."""
    return InputError(f"{what} cannot be opened: {hint}; 'chromaperture sources' lists what is connected")

"""Live cameras: a thread reads frames, only the newest is kept, and a lost camera is reconnected."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from chromaperture.capture.source import Event, Frame, Listener, log_event, steady
from chromaperture.system.errors import ChromapertureError, InputError


class DeviceLostError(Exception):
    """The device stopped delivering: unplugged, switched off, or taken by another program."""


class StreamEndedError(Exception):
    """The device will not deliver more frames, as at the end of a replayed recording."""


class Device(Protocol):
    """One opened camera, used only by the thread that opened it."""

    def read(self, index: int) -> Frame | None:
        """Wait up to about a second for a frame; None when none came; raises DeviceLostError or StreamEndedError."""
        ...

    def close(self) -> None:
        """Release the camera; never raises."""
        ...


class LiveSource:
    """Deliver the newest frame of a running camera; older ones are dropped, so a slow reader adds no latency.

    Parameters
    ----------
    name : str
    connect : callable
        Opens the device; raises InputError when it is missing or in use.
    listener : callable, optional
        Called with events, from the capture thread.
    silence_s : float
        Time without a frame after which a camera is considered lost.
    retry_s : float
        Pause between attempts to reconnect it.
    """

    live = True

    def __init__(
        self,
        name: str,
        connect: Callable[[], Device],
        *,
        listener: Listener | None = None,
        silence_s: float = 5.0,
        retry_s: float = 1.0,
    ) -> None:
        self.name, self.dropped = name, 0
        self._connect, self._listener = connect, listener or log_event
        self._silence_s, self._retry_s = silence_s, retry_s
        self._slot: Frame | None = None
        self._ready = threading.Condition()
        self._opened, self._leave = threading.Event(), threading.Event()
        self._failure: BaseException | None = None
        self._over = False
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self._opened.clear()
        self._leave.clear()
        self._slot, self._failure, self._over, self.dropped = None, None, False, 0
        self._thread = threading.Thread(target=self._run, name=f"capture {self.name}", daemon=True)
        self._thread.start()
        self._opened.wait()
        if self._failure is not None:
            self._thread.join()
            raise self._failure
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        if self._thread is not None:
            self._thread.join(timeout=10)  # s: do not wait for a driver that hangs

    def stop(self) -> None:
        """End the stream for a reader that waits for a frame; from any thread."""
        self._leave.set()
        with self._ready:
            self._ready.notify_all()

    def __iter__(self) -> Iterator[Frame]:
        yield from steady(self._newest(), self._listener)

    def _newest(self) -> Iterator[Frame]:
        while True:
            with self._ready:
                self._ready.wait_for(lambda: self._slot or self._leave.is_set() or self._over)
                frame, self._slot = self._slot, None
            if frame is None or self._leave.is_set():
                if self._failure is not None:
                    raise self._failure
                return
            yield frame

    def _run(self) -> None:
        device: Device | None = None
        try:
            device = self._connect()
            self._opened.set()
            index, last, is_whole = 0, time.monotonic(), True
            while device is not None and not self._leave.is_set():
                try:
                    frame = device.read(index)
                    if frame is not None:
                        was_whole, is_whole = is_whole, is_picture(frame.counts)
                        if is_whole:
                            self._put(frame)
                        elif was_whole:
                            event = Event("skipped", f"{self.name}: frame {index} is no colour picture; it is left out")
                            self._listener(event)
                        index, last = index + 1, time.monotonic()
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

    def _put(self, frame: Frame) -> None:
        with self._ready:
            self.dropped += self._slot is not None
            self._slot = frame
            self._ready.notify()


def is_picture(counts: np.ndarray) -> bool:
    """Find whether a driver delivered what every stage expects: (H, W, 3), not empty, unsigned counts or float."""
    return counts.ndim == 3 and counts.shape[2] == 3 and counts.size > 0 and counts.dtype.kind in "uf"


def not_there(what: str, hint: str) -> InputError:
    """Make the error of a camera that cannot be opened."""
    return InputError(f"{what} cannot be opened: {hint}; 'chromaperture sources' lists what is connected")

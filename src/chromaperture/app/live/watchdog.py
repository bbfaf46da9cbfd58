"""Name the stage of the live loop that hangs, in one line; nothing is ended."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Self

from chromaperture.system.errors import InputError

# Six times as long as a silent camera needs to count as lost (5 s), and longer than the slowest pass that is in order,
# a model of 512 MB that becomes a mesh (some seconds); a person gives up later. Chosen by hand.
WATCHDOG_S = 30.0
_LOOKS = 8  # in the time after which a stage hangs, chosen by hand: the line is late by an eighth of it at most
_LONGEST_REST_S, _JOIN_S = 1.0, 5.0  # between two looks; chosen by hand
# What to look at when a stage hangs.
_HINTS = {
    "source": "no frame comes: is the camera connected and switched on?",
    "measure": "the first frame compiles the matcher; later ones wait for a busy processor or a picture too large",
    "track": "a large model takes long: try --memory-mb, a larger --voxel-mm or --no-model",
    "draw": "the page does not take what is drawn",
    "record": "the disk does not take what is written",
}


@dataclass(eq=False)
class _Pass:
    stage: str
    began: float  # on the monotonic clock
    is_said: bool = False


class Watchdog:
    """Tell a listener of stages of the live loop that take longer than so many seconds; a context manager."""

    def __init__(self, seconds: float = WATCHDOG_S, *, listener: Callable[[str], None] = lambda line: None) -> None:
        if not seconds > 0:
            raise InputError(f"--watchdog-seconds must be positive, got {seconds:g}; inf turns it off")
        self.seconds, self._listener = seconds, listener
        self._passes: set[_Pass] = set()
        self._changing = threading.Lock()
        self._leave = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self._leave.clear()
        if math.isfinite(self.seconds):
            self._thread = threading.Thread(target=self._look, name="watchdog", daemon=True)
            self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._leave.set()
        if self._thread is not None:
            self._thread.join(timeout=_JOIN_S)  # the listener may hang too
        self._thread = None

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Watch one pass of a stage: source, measure, track, draw or record."""
        present = _Pass(name, time.monotonic())
        with self._changing:
            self._passes.add(present)
        try:
            yield
        finally:
            with self._changing:
                self._passes.discard(present)
            if present.is_said:
                self._listener(f"{name} went on after {time.monotonic() - present.began:.0f} s")

    def hanging(self) -> list[str]:
        """Return a line for every stage that hangs now, the longest first."""
        now = time.monotonic()
        return [_line(each, now) for each in self._late(now)]

    def _late(self, now: float) -> list[_Pass]:
        with self._changing:
            late = [each for each in self._passes if now - each.began >= self.seconds]
        return sorted(late, key=lambda each: each.began)

    def _look(self) -> None:
        while not self._leave.wait(min(_LONGEST_REST_S, self.seconds / _LOOKS)):
            now = time.monotonic()
            for each in self._late(now):
                if not each.is_said:
                    each.is_said = True
                    self._listener(_line(each, now))


def _line(late: _Pass, now: float) -> str:
    hint = f" ({_HINTS[late.stage]})" if late.stage in _HINTS else ""
    return f"{late.stage} has not finished for {now - late.began:.0f} s{hint}"

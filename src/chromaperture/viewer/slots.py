"""What lies between two stages of the live loop: at most one item, and the clock of a stage."""

from __future__ import annotations

import threading
import time
from typing import Generic, TypeVar

T = TypeVar("T")


class Slot(Generic[T]):
    """A queue of one. The newest item wins, or a patient writer waits until it was taken.

    Attributes
    ----------
    replaced : int
        Items that nobody took.
    """

    def __init__(self) -> None:
        self.replaced = 0
        self._item: T | None = None
        self._closed = False
        self._change = threading.Condition()

    def put(self, item: T, *, patient: bool = False) -> None:
        """Leave an item; nothing happens after closing."""
        with self._change:
            if patient:
                self._change.wait_for(lambda: self._item is None or self._closed)
            if self._closed:
                return
            self.replaced += self._item is not None
            self._item = item
            self._change.notify_all()

    def take(self) -> T | None:
        """Wait for an item; None when the slot is closed and empty."""
        with self._change:
            self._change.wait_for(lambda: self._item is not None or self._closed)
            item, self._item = self._item, None
            self._change.notify_all()
            return item

    def close(self, *, drop: bool = False) -> None:
        """No more items; what lies in the slot can still be taken, unless dropped."""
        with self._change:
            self._closed = True
            if drop:
                self._item = None
            self._change.notify_all()


class Meter:
    """Rate and duration of a stage, over about the last second or ten passes."""

    def __init__(self) -> None:
        self.count = 0
        self.milliseconds = self.latency_ms = self.per_second = 0.0
        self._last: float | None = None

    def passed(self, seconds: float, latency_s: float) -> None:
        """Count a pass that took so long and ended so long after the frame had arrived."""
        now = time.monotonic()
        share = 1.0 if self.count == 0 else 0.1
        self.milliseconds += share * (1000 * seconds - self.milliseconds)
        self.latency_ms += share * (1000 * latency_s - self.latency_ms)
        if self._last is not None and now > self._last:
            rate = 1.0 / (now - self._last)
            # The mean of intervals, not of rates: two frames in a burst are not a thousand a second.
            self.per_second = rate if self.count == 1 else 1.0 / (0.9 / max(self.per_second, 1e-6) + 0.1 / rate)
        self._last = now
        self.count += 1

    def summary(self) -> dict[str, float]:
        """Give the figures, units in the names."""
        return {
            "frames": self.count,
            "per_second": round(self.per_second, 2),
            "milliseconds": round(self.milliseconds, 1),
            "latency_ms": round(self.latency_ms, 1),
        }

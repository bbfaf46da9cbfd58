"""Connect two stages of the live loop by a queue of one item, and measure a stage's rate."""

from __future__ import annotations

import threading
import time
from typing import Generic, TypeVar

T = TypeVar("T")


class Slot(Generic[T]):
    """Queue of one item. A new item replaces the old one, or a patient writer waits until it was taken."""

    def __init__(self) -> None:
        self.replaced = 0  # items replaced before they were taken
        self._item: T | None = None
        self._closed = False
        self._change = threading.Condition()

    def put(self, item: T, *, patient: bool = False) -> None:
        """Put an item; no effect after closing."""
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

    def wait(self, timeout_s: float) -> bool:
        """Wait so long at most for an item or the end; whether `take` would return at once."""
        with self._change:
            return self._change.wait_for(lambda: self._item is not None or self._closed, timeout_s)

    def wait_taken(self, timeout_s: float) -> bool:
        """Wait so long at most until the item was taken, or the end; whether `put` would replace nothing."""
        with self._change:
            return self._change.wait_for(lambda: self._item is None or self._closed, timeout_s)

    def __len__(self) -> int:
        return int(self._item is not None)

    def close(self, *, drop: bool = False) -> None:
        """Accept no more items; the present one can still be taken, unless dropped."""
        with self._change:
            self._closed = True
            if drop:
                self._item = None
            self._change.notify_all()


class Meter:
    """Rate and duration of a stage, exponential means over about ten passes."""

    def __init__(self) -> None:
        self.count = 0
        self.milliseconds = self.latency_ms = self.per_second = 0.0
        self._last: float | None = None

    def record(self, seconds: float, latency_s: float) -> None:
        """Record a pass: its duration and the time from the frame's arrival to its end."""
        now = time.monotonic()
        weight = 1.0 if self.count == 0 else 0.1
        self.milliseconds += weight * (1000 * seconds - self.milliseconds)
        self.latency_ms += weight * (1000 * latency_s - self.latency_ms)
        if self._last is not None and now > self._last:
            rate = 1.0 / (now - self._last)
            # Mean of intervals, not of rates: two frames in a burst would count as a thousand a second.
            self.per_second = rate if self.count == 1 else 1.0 / (0.9 / max(self.per_second, 1e-6) + 0.1 / rate)
        self._last = now
        self.count += 1

    def summary(self) -> dict[str, float]:
        """Return the figures, units in the names."""
        return {
            "frames": self.count,
            "per_second": round(self.per_second, 2),
            "milliseconds": round(self.milliseconds, 1),
            "latency_ms": round(self.latency_ms, 1),
        }

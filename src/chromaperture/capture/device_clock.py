"""Clocks and frame numbers of cameras: when a frame came, by the camera's own clock, and how many did not."""

from __future__ import annotations

import math
from collections import deque

_WINDOW_S = 10.0  # clocks drift by up to 100 ppm: 1 ms in this time; chosen by hand, not tuned
_APART_S = 0.5  # arrivals on a busy computer vary by less; chosen by hand, not tuned
_REPORT_S = 10.0  # between two reports of a clock that jumps; chosen by hand, not tuned
_LAST_OF_16_BITS = 65535
_MOST_MISSING = 10_000  # across the end of 16 bits; more is a camera that began anew. Chosen by hand, not tuned


class DeviceClock:
    """Seconds since 1970 of the ticks that a camera gives its frames; its zero is where the least delayed arrive.

    The zero follows the drift. A clock that leaves the computer's by more than half a second has jumped (or the
    computer's has, or the computer stood still): the zero is found anew, and `report` says so. Frames without ticks, or
    with those of the frame before, have the time of their arrival: `is_camera_time` is False.
    """

    def __init__(self, ticks_per_s: float = 1e9) -> None:
        self._ticks_per_s = ticks_per_s
        self._last_ticks = 0
        self._zeros: deque[tuple[float, float]] = deque()  # arrival and zero, both rising: minima of the window
        self._reported_s = -math.inf
        self.is_camera_time = False
        self.report = ""  # of the last frame: one line where its clock jumped

    def time_s(self, ticks: int, arrived_s: float) -> float:
        """Return when a frame would have arrived without delay, in seconds since 1970, never after it did."""
        self.report = ""
        self.is_camera_time = ticks not in (0, self._last_ticks)
        if not self.is_camera_time:
            return arrived_s
        zero_s = arrived_s - ticks / self._ticks_per_s
        apart_s = zero_s - self._zeros[0][1] if self._zeros else 0.0
        if ticks < self._last_ticks or abs(apart_s) > _APART_S:
            self._zeros.clear()
            if not abs(arrived_s - self._reported_s) < _REPORT_S:
                self._reported_s = arrived_s
                self.report = f"its clock and the computer's moved apart by {abs(apart_s):.3g} s; frames are timed anew"
        self._last_ticks = ticks
        while self._zeros and self._zeros[-1][1] >= zero_s:
            self._zeros.pop()
        self._zeros.append((arrived_s, zero_s))
        while arrived_s - self._zeros[0][0] > _WINDOW_S:
            self._zeros.popleft()
        return self._zeros[0][1] + ticks / self._ticks_per_s


class FrameNumbers:
    """Counts the frames that are missing between the numbers of those that came.

    Numbers of 16 bits, as of GigE Vision 1, go on with 1 after 65535. Another number that is not later than the last
    one is of a camera that began anew: nothing is known to be missing.
    """

    def __init__(self) -> None:
        self.last: int | None = None
        self._unnumbered = 0  # frames since

    def missing(self, number: int, *, whole: bool = True) -> int:
        """Return how many frames were left out before this one; one that is not whole may have no number, or 0."""
        last = number - 1 if self.last is None else self.last
        if last <= _LAST_OF_16_BITS and number - last <= _MOST_MISSING - _LAST_OF_16_BITS:
            last -= _LAST_OF_16_BITS
        if not whole and (number == 0 or number <= last):
            self._unnumbered += 1
            return 0
        missing = max(number - last - 1 - self._unnumbered, 0)
        self.last, self._unnumbered = number, 0
        return missing

"""Say what recurs rarely: a live loop runs for days, and its log must not grow with every frame."""

from __future__ import annotations

import re
import threading
import time
from collections import OrderedDict
from collections.abc import Callable

_PAUSE_S = 60.0  # between two lines of a kind: a minute of a fault is one line. Chosen by hand
_MOST_KINDS = 100  # remembered, chosen by hand; of more, the oldest may be said again at once


class RareNotices:
    """Pass a line on unless one of its kind, equal but for numbers, was passed on lately.

    Parameters
    ----------
    listener : callable
        Receives the lines; a later one of its kind says how many were left out.
    pause_s : float
    """

    def __init__(self, listener: Callable[[str], None], *, pause_s: float = _PAUSE_S) -> None:
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

"""Waiting for what other threads do."""

from __future__ import annotations

import time
from collections.abc import Callable

WAIT_S = 60.0  # an upper bound for a busy machine; nothing waits so long


def until(condition: Callable[[], object]) -> None:
    """Return once a condition holds."""
    end = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end, "what is waited for does not come"
        time.sleep(0.005)

"""Memory that one call after the other uses: the system takes as long to hand it out as the work takes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

_CACHE_LINE = 64  # bytes: a vector that straddles two lines costs two loads
_SMALL = 1 << 26  # bytes: so much is not given back when less is asked for


class Workspace:
    """Arrays by name. Each starts on a cache line and holds finite numbers, if any."""

    def __init__(self) -> None:
        self._kept: dict[str, np.ndarray] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        """Return an array with whatever finite numbers an earlier call left in it."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        raw = self._kept.get(name)
        if raw is None or not size + _CACHE_LINE <= len(raw) <= max(2 * size, _SMALL) + _CACHE_LINE:
            raw = self._kept[name] = np.zeros(size + _CACHE_LINE, np.uint8)
        start = -raw.ctypes.data % _CACHE_LINE
        return raw[start : start + size].view(dtype).reshape(shape)


_spare: list[Workspace] = []  # append and pop are atomic: threads that match at the same time take different ones


@contextmanager
def workspace() -> Iterator[Workspace]:
    """Lend a workspace; its arrays must not be used after the loan."""
    try:
        lent = _spare.pop()
    except IndexError:
        lent = Workspace()
    try:
        yield lent
    finally:
        _spare.append(lent)

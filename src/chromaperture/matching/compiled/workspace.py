"""Memory that one call after the other uses: the system takes as long to hand it out as the work takes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from chromaperture.system.memory import are_volumes_on_disk, scratch_array

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


_VOLUMES = 2  # of evidence and of costs: so many are used at a time
# Bytes of a volume that is kept; of 720 x 480 px and 143 labels it is 2e8. Larger ones are given back: other programs
# may need that memory more than this one needs the tenth of its time that handing it out takes.
_MOST_KEPT = 1 << 28
_volumes: deque[np.ndarray] = deque(maxlen=_VOLUMES)  # memory that no array uses


def volume(shape: tuple[int, ...]) -> np.ndarray:
    """Return a float32 array with whatever numbers an earlier one left in it; its memory is kept for later ones.

    Inside `system.scratch.volumes_on_disk` it is a file's; raises OutOfMemoryError where the disk is full.
    """
    if are_volumes_on_disk():
        return scratch_array(shape)
    size = math.prod(shape)
    if 4 * size > _MOST_KEPT:
        return np.empty(shape, np.float32)
    for _ in range(len(_volumes)):
        try:
            raw = _volumes.popleft()
        except IndexError:  # another thread took it
            break
        if size <= len(raw) <= 2 * size:
            return np.asarray(_Lent(raw))[:size].reshape(shape)
        _volumes.append(raw)
    return np.asarray(_Lent(np.empty(size, np.float32))).reshape(shape)


def give_back_volumes() -> None:
    """Give memory that `volume` keeps back to the system, where maps of a large photograph need as much."""
    _volumes.clear()


class _Lent:
    """Memory of arrays; when the last of them is gone it may be lent again."""

    def __init__(self, raw: np.ndarray) -> None:
        self._raw, self.__array_interface__ = raw, raw.__array_interface__

    def __del__(self, keep: Callable[[np.ndarray], None] = _volumes.append) -> None:
        keep(self._raw)

"""Work on all cores, by plain threads: kernels and libraries release the interpreter's lock.

Kernels for plain threads compile several times faster than Numba's parallel loops, and any thread may call them.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

_limit: int | None = None  # set by `limited_threads`


def thread_count() -> int:
    """How many threads work is divided among: the processors this process may use, or ``CHROMAPERTURE_THREADS``."""
    return _limit or _default_count()


@cache
def _default_count() -> int:
    wanted = os.environ.get("CHROMAPERTURE_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Divide work among ``count`` threads inside a ``with`` block, in the whole process."""
    global _limit
    before, _limit = _limit, count
    try:
        yield
    finally:
        _limit = before


@contextlib.contextmanager
def limited_opencv_threads(count: int) -> Iterator[None]:
    """Let OpenCV use ``count`` threads inside a ``with`` block, in the whole process.

    Its bundle adjustment adds float sums in the order in which threads finish: only one thread repeats its result.
    """
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def in_parallel(work: Callable[[int, int, int], None], count: int, *, threads: int | None = None) -> None:
    """Run ``work(thread, first, last)`` over ``count`` pieces, in contiguous portions.

    Parameters
    ----------
    work : callable
        Called once for each thread, with its number and its pieces from ``first`` to before ``last``.
    count : int
    threads : int, optional
        At most this many; `thread_count` when absent.
    """
    threads = min(thread_count() if threads is None else threads, count)
    portions = [(i, count * i // threads, count * (i + 1) // threads) for i in range(threads)]
    others = [_pool().submit(work, *portion) for portion in portions[1:]]
    try:
        if portions:
            work(*portions[0])
    finally:
        wait(others)  # even after an error no thread writes to the arrays any more
    for other in others:
        other.result()


def parallel_map(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """Apply a function to items of unlike cost, each as soon as a thread is free; results in the items' order."""
    with ThreadPoolExecutor(thread_count()) as pool:
        return list(pool.map(function, items))


@contextlib.contextmanager
def beside() -> Iterator[Callable[[Callable[[], R]], Future[R]]]:
    """Start work on one other thread, in the order it was given; leaving the ``with`` block waits for it."""
    with ThreadPoolExecutor(1, thread_name_prefix="chromaperture-beside") as thread:
        yield thread.submit


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(os.cpu_count() or 1, _default_count()), thread_name_prefix="chromaperture")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork

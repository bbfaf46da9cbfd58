"""Work on all cores, by plain threads: kernels and libraries release the interpreter's lock.

Kernels for plain threads compile several times faster than Numba's parallel loops, and any thread may call them.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from functools import cache
from threading import Lock
from typing import Any, Generic, TypeVar

from chromaperture.system.errors import InputError

T = TypeVar("T")
R = TypeVar("R")

BAND_ROWS = 64  # of a picture; 1.5 MB of float32 for 6000 columns; chosen by hand

_limit: int | None = None  # set by `limited_threads`


def thread_count() -> int:
    """How many threads work is divided among: the processors this process may use, or ``CHROMAPERTURE_THREADS``."""
    return _limit or _default_count()


@cache
def _default_count() -> int:
    return _wanted("CHROMAPERTURE_THREADS") or (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )


def check_environment() -> None:
    """Check the numbers of threads set in the environment, which Numba refuses with a traceback."""
    for name in ("CHROMAPERTURE_THREADS", "NUMBA_NUM_THREADS"):
        _wanted(name)


def _wanted(name: str) -> int | None:
    """Read a number of threads from the environment; None where it is not set."""
    text = os.environ.get(name, "").strip()
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and len(text) <= 6 and int(text) > 0):
        raise InputError(f"{name}={text[:40]} is no number of threads: set it to 1 or more, or unset it")
    return int(text)


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
    """Let OpenCV use ``count`` threads meanwhile: float sums repeat only with one."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def in_parallel(work: Callable[[int, int, int], None], count: int, *, threads: int | None = None) -> None:
    """Run ``work(thread, first, last)`` over ``count`` pieces, in contiguous portions, once for each thread."""
    threads = min(thread_count() if threads is None else threads, count)
    if threads == 1:
        work(0, 0, count)
        return
    portions = [(i, count * i // threads, count * (i + 1) // threads) for i in range(threads)]
    _run([_Task(work, *portion) for portion in portions], _pool())


def parallel_map(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """Apply a function to items of unlike cost, each as soon as a thread is free; results in the items' order."""
    tasks = [_Task(function, item) for item in items]
    threads = min(thread_count(), len(tasks))

    def some() -> None:
        for task in tasks:
            task()

    if threads > 1:
        _start(_pool(), [some] * (threads - 1))
    return _run(tasks)


def each_band(work: Callable[[slice], object], rows: int, *, rows_a_band: int = BAND_ROWS) -> None:
    """Run ``work(band)`` for bands of rows of a picture, on all threads: what is computed of one stays in the cache."""
    parallel_map(work, [slice(top, min(top + rows_a_band, rows)) for top in range(0, rows, rows_a_band)])


@contextlib.contextmanager
def beside() -> Iterator[Callable[[Callable[[], R]], Future[R]]]:
    """Start work on one other thread, in order; leaving waits for it, and without a thread it is done at once."""
    with ThreadPoolExecutor(1, thread_name_prefix="chromaperture-beside") as thread:

        def begin(work: Callable[[], R]) -> Future[R]:
            task = _Task(work)
            if not _start(thread, [task]):
                task()
            return task.result

        yield begin


def submit(work: Callable[[], R]) -> Callable[[], R]:
    """Begin work on another thread; what is returned waits for its outcome, and does it if no thread has begun it."""
    task = _Task(work)
    if thread_count() > 1:
        _start(_pool(), [task])

    def outcome() -> R:
        task()
        return task.result.result()

    return outcome


class _Task(Generic[R]):
    """Work that the first thread to call it does, as a queue may keep it for later; ``result`` is its outcome."""

    def __init__(self, work: Callable[..., R], *arguments: Any) -> None:
        self.result: Future[R] = Future()
        self._work, self._arguments, self._begun = work, arguments, Lock()

    def __call__(self) -> None:
        """Do the work, unless a thread has begun it."""
        if not self._begun.acquire(blocking=False):
            return
        try:
            outcome = self._work(*self._arguments)
        except BaseException as error:
            self.result.set_exception(error)
        else:
            self.result.set_result(outcome)

    def cancel(self) -> None:
        """Leave the work undone, unless a thread has begun it."""
        if self._begun.acquire(blocking=False):
            self.result.cancel()
            self.result.set_running_or_notify_cancel()  # else `wait` would wait for it


def _start(pool: Executor, tasks: Iterable[Callable[[], Any]]) -> bool:
    """Hand tasks to other threads, as far as these can be started; returns whether all were."""
    try:
        for task in tasks:
            pool.submit(task)
    except RuntimeError as error:
        if "can't start new thread" not in str(error):
            raise
        return False
    return True


def _run(tasks: list[_Task[R]], pool: Executor | None = None) -> list[R]:
    """Do tasks here and, all but the first, on a pool's threads; after an error no other is begun."""
    try:
        if pool is not None:
            _start(pool, tasks[1:])
        for task in tasks:
            task()
            if task.result.done() and task.result.exception() is not None:
                break
    finally:
        for task in tasks:
            task.cancel()
        wait([task.result for task in tasks])  # even after an error no thread writes to the arrays any more
    for task in tasks:  # the first error
        if not task.result.cancelled():
            task.result.result()
    return [task.result.result() for task in tasks]


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(os.cpu_count() or 1, _default_count()), thread_name_prefix="chromaperture")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork

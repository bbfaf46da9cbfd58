"""Measure photographs in several processes of this machine: `archive_cluster.measure_photograph` without a cluster.

A process that dies, as for lack of memory, costs the photograph it measured; another takes its place.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from types import FrameType

from chromaperture.products.archive_cluster import Outcome, Recipe, measure_photograph
from chromaperture.system.threads import limited_opencv_threads, limited_threads, thread_count

STOP_S = 30.0  # for a process to remove half-written files after it was asked to end; chosen by hand
DIED = "the process that measured it died, perhaps for lack of memory; run again with fewer --jobs"


def measure_in_processes(images: Sequence[str], recipe: Recipe, *, jobs: int) -> Iterator[Outcome]:
    """Measure photographs, ``jobs`` at a time, each process with its share of the threads.

    ``images``: absolute paths; ``jobs``: each needs the memory of one measurement. Yields one for each photograph, in
    the order they finish. An abandoned iteration ends the processes.
    """
    waiting, lock = iter(images), threading.Lock()
    finished: SimpleQueue[Outcome] = SimpleQueue()
    pool = _WorkerPool(recipe, max(1, thread_count() // jobs))

    def measure_waiting() -> None:
        with contextlib.suppress(_EndedError):
            worker: _Worker | None = None
            while True:
                with lock:
                    image = next(waiting, None)
                if image is None:
                    return
                worker = worker or pool.start_worker()
                outcome = worker.measure(image)
                if outcome is None:
                    worker, outcome = None, Outcome(image, DIED)
                finished.put(outcome)

    try:
        for _ in range(min(jobs, len(images))):
            threading.Thread(target=measure_waiting, daemon=True, name="chromaperture-job").start()
        for _ in images:
            yield finished.get()
    finally:
        pool.stop()


class _EndedError(Exception):
    """The run has ended: no process is started any more."""


class _Worker:
    """A process, and this end of the pipe to it."""

    def __init__(self, process: BaseProcess, pipe: Connection) -> None:
        self.process, self._pipe = process, pipe

    def measure(self, image: str) -> Outcome | None:
        """Return what became of a photograph; None where the process died."""
        try:
            self._pipe.send(image)
            outcome: Outcome = self._pipe.recv()
        except (EOFError, OSError):
            return None
        return outcome


class _WorkerPool:
    """All processes of a run."""

    def __init__(self, recipe: Recipe, threads: int) -> None:
        self._recipe, self._threads = recipe, threads
        self._workers: list[_Worker] = []
        self._lock, self._ended = threading.Lock(), False
        # Not "fork": locks of this process's threads would be copied as they are.
        self._context = multiprocessing.get_context("spawn")

    def start_worker(self) -> _Worker:
        """Start a process; raises _EndedError after `stop`."""
        with self._lock:
            if self._ended:
                raise _EndedError
            own, theirs = self._context.Pipe()
            process = self._context.Process(target=_serve, args=(theirs, self._recipe, self._threads), daemon=True)
            process.start()
            theirs.close()  # so that its end is seen here
            worker = _Worker(process, own)
            self._workers.append(worker)
            return worker

    def stop(self) -> None:
        """End all processes; what they were writing is removed."""
        with self._lock:
            self._ended = True
        for worker in self._workers:
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join(STOP_S)
            worker.process.kill()


def _serve(pipe: Connection, recipe: Recipe, threads: int) -> None:
    """Measure what comes through the pipe, until it is closed; of a process of its own."""

    def leave(number: int, frame: FrameType | None) -> None:
        sys.exit(1)  # through the blocks that remove half-written files

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal sends it to all; this process's owner ends it
    signal.signal(signal.SIGTERM, leave)
    with limited_threads(threads), limited_opencv_threads(threads), contextlib.suppress(EOFError, OSError):
        while True:
            image = pipe.recv()
            try:
                outcome = measure_photograph(image, recipe)
            except Exception as error:  # of a store that does not answer
                outcome = Outcome(image, str(error))
            pipe.send(outcome)

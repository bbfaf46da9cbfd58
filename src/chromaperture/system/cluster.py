"""Tasks on the workers of a Dask cluster; workers that die or join do not change the results."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import metadata
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeVar

from chromaperture.system.errors import InputError, needed

T = TypeVar("T")

CONNECT_S, WORKERS_S = 10, 60  # time limits for the scheduler's answer and for the first worker; chosen by hand
# Called while a task is waited for: the task, its worker, and the seconds since the scheduler gave it to this one.
Waiting = Callable[[Any, str, float], None]

CHECK_EVERY_S = 2.0  # between two looks for workers while no result arrives; chosen by hand
AT_ONCE = 1000  # tasks at the scheduler at a time, which bounds its memory and the client's; chosen by hand
# A task that raises is run so many times again; one that returns is not. Chosen by hand.
RETRIES = 2


class WorkersDiedError(InputError):
    """A task was given up: as many workers as the scheduler allows died one after the other while they ran it."""


@dataclass(frozen=True)
class TaskResult(Generic[T]):
    """A task with what it returned, or with the error it ended in."""

    task: T
    value: Any = None
    error: BaseException | None = None


def dask_distributed() -> Any:
    """Import Dask's distributed scheduler; raises MissingDependencyError naming the extra."""
    return needed("distributed", "--cluster needs the extra: pip install 'chromaperture[cluster]'")


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """Yield Dask's client of a scheduler that has workers of this version; raises InputError."""
    dask = dask_distributed()
    with _silent():
        try:
            client = dask.Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError, RuntimeError) as error:  # TimeoutError is an OSError
            raise InputError(_no_answer(address, error)) from None
        with client:
            _check_workers(client, address)
            yield client


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Keep Dask from logging tracebacks of a lost connection, which is reported in one line."""
    loggers = [logging.getLogger(f"distributed.{name}") for name in ("client", "comm", "core", "utils")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def run_tasks(
    client: Any,
    function: Callable[..., Any],
    tasks: Iterable[T],
    *shared: Any,
    key_of: Callable[[T], str] | None = None,
    waiting_for: Waiting = lambda task, worker, seconds: None,
) -> Iterator[TaskResult[T]]:
    """Run ``function(task, *shared)`` on the workers, for every task.

    Dask runs the task of a worker that died on another one. A task during which workers died repeatedly is run once
    more when all others are finished, by itself: one that takes a worker's whole memory also ends its neighbours.

    ``client``: from `connected`; ``function``: of a module that the workers have too; ``tasks``: no more than `AT_ONCE`
    are taken from it ahead of the results; ``*shared``: sent to each worker once, and again to workers that join;
    ``key_of``: name of a task at the scheduler, which runs equal names once; every task when absent;
    ``waiting_for``: see `Waiting`, of the task that has taken longest, while no result arrives. Yields as they
    finish; ``error`` is a `WorkersDiedError`, or what the function raised in the last of its attempts. Raises
    InputError: the scheduler was lost, or no worker is left.
    """
    # A task whose result is the argument, and not scattered data: Dask makes it again when the worker with it dies.
    sent = [client.submit(_same, argument, pure=False) for argument in shared]
    running: dict[Any, T] = {}
    finished: SimpleQueue[Any] = SimpleQueue()

    def submit(task: T) -> None:
        named = {"pure": False} if key_of is None else {"key": key_of(task)}
        future = client.submit(function, task, *sent, retries=RETRIES, **named)
        running[future] = task
        future.add_done_callback(finished.put)

    seen: dict[tuple[str, str], float] = {}  # when a task was first seen at a worker

    def look() -> None:
        now = time.monotonic()
        at = [(key, worker) for worker, keys in client.processing().items() for key in keys]
        tasks_of = {future.key: task for future, task in running.items()}
        begun = {place: seen.get(place, now) for place in at if place[0] in tasks_of}
        seen.clear()
        seen.update(begun)
        if begun:
            key, worker = min(begun, key=lambda place: begun[place])
            waiting_for(tasks_of[key], worker, now - begun[key, worker])

    waiting, suspects = iter(tasks), list[T]()
    for task in islice(waiting, AT_ONCE):
        submit(task)
    while running:
        future = _wait_with_timeout(client, lambda seconds: finished.get(timeout=seconds), look)
        result = _finished(running.pop(future), future, client)
        del future  # the scheduler forgets the result
        for task in islice(waiting, 1):
            submit(task)
        if isinstance(result.error, WorkersDiedError):
            suspects.append(result.task)
        else:
            yield result
    for task in suspects:
        submit(task)
        future = _wait_with_timeout(client, lambda seconds: finished.get(timeout=seconds), look)
        yield _finished(running.pop(future), future, client)


def _same(argument: T) -> T:
    return argument


def _wait_with_timeout(client: Any, wait: Callable[[float], T], look: Callable[[], None] = lambda: None) -> T:
    """Repeat a wait that ends in TimeoutError or Empty while the scheduler and its workers are there."""
    last_seen = time.monotonic()
    while True:
        try:
            return wait(CHECK_EVERY_S)
        except (Empty, TimeoutError):
            try:
                workers = client.ncores()
                look()
            except (OSError, RuntimeError, ValueError):
                raise _lost(client) from None
            if workers:
                last_seen = time.monotonic()
            elif time.monotonic() - last_seen > WORKERS_S:
                raise InputError(
                    f"no worker has been left for {WORKERS_S} s: start some and run again; what is finished is kept"
                ) from None


def _finished(task: T, future: Any, client: Any) -> TaskResult[T]:
    dask = dask_distributed()
    ended = ("error", "cancelled")
    if future.status not in ended:
        try:
            # A result is fetched from its worker. When that died meanwhile, the task is run again, and waited for here.
            return TaskResult(task, _wait_with_timeout(client, lambda seconds: future.result(timeout=seconds)))
        except (Exception, dask.CancelledError) as raised:
            if future.status not in ended:
                # The connection to the scheduler closed while it sent the result.
                raise _lost(client) if isinstance(raised, OSError) else raised from None
    error = future.exception() if future.status == "error" else None
    if error is None:
        raise _lost(client)
    if isinstance(error, dask.scheduler.KilledWorker):
        return TaskResult(task, error=WorkersDiedError("workers died repeatedly, perhaps for lack of memory"))
    return TaskResult(task, error=error)


def _lost(client: Any) -> InputError:
    address = client.scheduler.address if client.scheduler is not None else "its address"
    return InputError(f"the cluster was lost: repair {address} and run again; what is finished is kept")


def _no_answer(address: str, error: BaseException) -> str:
    if address.startswith("tls:") and not isinstance(error, ValueError):
        return (
            f"no Dask scheduler that this machine trusts answers at {address} ({type(error).__name__}): start it with "
            "--tls-ca-file, --tls-cert and --tls-key, and give the same authority and a certificate of your own in "
            "Dask's configuration (docs/archives.md)"
        )
    return (
        f"no Dask scheduler answers at {address} ({type(error).__name__}): start one with 'dask scheduler' and "
        "give its address, such as tcp://10.0.0.1:8786"
    )


def _check_workers(client: Any, address: str) -> None:
    """Wait for a worker; refuse workers with another version of the package, whose results may differ."""
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError:
        raise InputError(
            f"the scheduler at {address} has no workers: start some with 'dask worker {address} --nthreads 1'"
        ) from None
    theirs = client.run(metadata.version, "chromaperture", on_error="return")
    for worker, found in theirs.items():
        check_version(worker, found if isinstance(found, str) else None)


def check_version(worker: str, theirs: str | None) -> None:
    """Refuse a worker with another version of the package; raises InputError."""
    own = metadata.version("chromaperture")
    if theirs != own:
        has = f"chromaperture {theirs}" if theirs else "no chromaperture"
        raise InputError(f"worker {worker} has {has}: install chromaperture=={own} on all workers")

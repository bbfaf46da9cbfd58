"""Trials on a Dask cluster: a worker that dies, or joins, changes nothing but the time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import metadata
from typing import Any

from chromaperture.errors import InputError, MissingDependencyError
from chromaperture.evaluation.paper.trial import Trial, run_alone

_CONNECT_S, _WORKERS_S = 10, 60
_AT_ONCE = 1000  # trials handed to the scheduler; the rest waits here


def dask_distributed() -> Any:
    """Import Dask's distributed scheduler; raises MissingDependencyError naming the extra."""
    try:
        import distributed
    except ImportError:
        raise MissingDependencyError("--cluster needs the extra: pip install 'chromaperture[cluster]'") from None
    return distributed


def on_cluster(trials: Sequence[Trial], address: str) -> Iterator[tuple[Trial, dict[str, float]]]:
    """Run trials on the workers of a scheduler.

    Parameters
    ----------
    trials : sequence of Trial
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.

    Yields
    ------
    (Trial, dict)
        As they finish. Dask gives the trials of a worker that died to the others.

    Raises
    ------
    InputError
        Nobody answers there, no worker comes, workers have another version, or the cluster was lost.
    MissingDependencyError
        The extra ``cluster`` is not installed.
    """
    dask = dask_distributed()
    with _client(dask, address) as client:
        _check_workers(client, address)
        waiting = iter(trials)
        running: dict[Any, Trial] = {}

        def start() -> Any:
            trial = next(waiting, None)
            if trial is None:
                return None
            future = client.submit(run_alone, trial, key=f"chromaperture-{trial.key}")
            running[future] = trial
            return future

        first = [future for future in (start() for _ in range(_AT_ONCE)) if future is not None]
        finished = dask.as_completed(first, loop=client.loop, raise_errors=False)
        for future in finished:
            yield running.pop(future), _result(dask, future, address)
            another = start()
            if another is not None:
                finished.add(another)


def _client(dask: Any, address: str) -> Any:
    try:
        return dask.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is an OSError
        raise InputError(
            f"no Dask scheduler answers at {address} ({type(error).__name__}): start one with 'dask scheduler' and "
            "give its address, such as tcp://10.0.0.1:8786"
        ) from None


def _check_workers(client: Any, address: str) -> None:
    """Wait for a worker; refuse workers whose package would give other results."""
    try:
        client.wait_for_workers(1, timeout=_WORKERS_S)
    except TimeoutError:
        raise InputError(
            f"the scheduler at {address} has no workers: start some with 'dask worker {address} --nthreads 1'"
        ) from None
    own = metadata.version("chromaperture")
    theirs = client.run(metadata.version, "chromaperture", on_error="return")
    other = {worker: found for worker, found in theirs.items() if found != own}
    if other:
        worker, found = next(iter(other.items()))
        has = f"chromaperture {found}" if isinstance(found, str) else "no chromaperture"
        raise InputError(f"worker {worker} has {has}: install chromaperture=={own} on all workers, so that they agree")


def _result(dask: Any, future: Any, address: str) -> dict[str, float]:
    if future.status == "finished":
        return dict(future.result())
    error = future.exception() if future.status == "error" else None
    if error is None or isinstance(error, dask.scheduler.KilledWorker):
        why = "workers died again and again, as they do where memory is short" if error else "the cluster was lost"
        raise InputError(f"{why}: mend {address} and run again, what is finished is kept")
    raise error

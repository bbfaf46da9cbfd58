"""Trials on a Dask cluster; workers that die or join do not change the results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import metadata
from itertools import islice
from typing import Any

from chromaperture.errors import InputError, MissingDependencyError
from chromaperture.evaluation.paper.trial import Trial, run_alone

CONNECT_S, WORKERS_S = 10, 60  # time limits for the scheduler's answer and for the first worker; chosen by hand
_AT_ONCE = 1000  # trials at the scheduler at a time, which bounds its memory; chosen by hand


def dask_distributed() -> Any:
    """Import Dask's distributed scheduler; raises MissingDependencyError naming the extra."""
    try:
        import distributed
    except ImportError:
        raise MissingDependencyError("--cluster needs the extra: pip install 'chromaperture[cluster]'") from None
    return distributed


def on_cluster(trials: Sequence[Trial], address: str) -> Iterator[tuple[Trial, dict[str, float]]]:
    """Run trials on the workers of a scheduler.

    Trials and results are yielded as they finish; Dask reassigns the trials of a worker that died. Raises InputError
    without an answer, without workers, for workers of another version, and when the cluster is lost.
    """
    dask = dask_distributed()
    with _client(dask, address) as client:
        _check_workers(client, address)
        waiting = iter(trials)
        running: dict[Any, Trial] = {}

        def submit(trial: Trial) -> Any:
            future = client.submit(run_alone, trial, key=f"chromaperture-{trial.key}")
            running[future] = trial
            return future

        first = [submit(trial) for trial in islice(waiting, _AT_ONCE)]
        finished = dask.as_completed(first, loop=client.loop, raise_errors=False)
        for future in finished:
            yield running.pop(future), _result(dask, future, address)
            for trial in islice(waiting, 1):
                finished.add(submit(trial))


def _client(dask: Any, address: str) -> Any:
    try:
        return dask.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is an OSError
        raise InputError(
            f"no Dask scheduler answers at {address} ({type(error).__name__}): start one with 'dask scheduler' and "
            "give its address, such as tcp://10.0.0.1:8786"
        ) from None


def _check_workers(client: Any, address: str) -> None:
    """Wait for a worker; refuse workers with another version of the package, whose results may differ."""
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
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
        raise InputError(f"worker {worker} has {has}: install chromaperture=={own} on all workers")


def _result(dask: Any, future: Any, address: str) -> dict[str, float]:
    if future.status == "finished":
        return dict(future.result())
    error = future.exception() if future.status == "error" else None
    if error is None or isinstance(error, dask.scheduler.KilledWorker):
        why = "workers died repeatedly, perhaps for lack of memory" if error else "the cluster was lost"
        raise InputError(f"{why}: repair {address} and run again; finished trials are kept")
    raise error

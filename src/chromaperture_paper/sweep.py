"""Many small trials on all cores; the result does not depend on the number of workers.

Each trial has its own seed, every worker computes on one thread, and results are returned in the order of the trials.
Finished trials are kept; when a worker dies, only its unfinished trials are repeated.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

from chromaperture.system.cluster import connected, run_tasks
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged, write_json
from chromaperture_paper.trial import Trial, one_thread, run_alone, run_trial

_ATTEMPTS = 4  # pools of processes, each after the one before died; chosen by hand
_ONE_THREAD = {f"{name}_THREADS": "1" for name in ("CHROMAPERTURE", "OMP_NUM", "OPENBLAS_NUM", "MKL_NUM")}
Result = dict[str, float]


def sweep(
    trials: Sequence[Trial],
    *,
    workers: int,
    keep_in: Path,
    cluster: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Result]:
    """Run trials in parallel.

    ``workers``: processes on this machine, at least 1; ``keep_in``: folder of the finished trials, from which an
    interrupted run continues; ``cluster``: address of a Dask scheduler, whose workers run the trials instead; see
    `run_tasks`; ``progress``: called with how many are done, and of how many. Raises InputError: workers died
    repeatedly, or the cluster cannot be reached.
    """
    results = {trial.key: _kept(keep_in, trial) for trial in trials}
    missing = list({t.key: t for t in trials if results[t.key] is None}.values())
    done = len(results) - len(missing)
    progress(done, len(results))
    if missing:
        finished = _on_cluster(missing, cluster) if cluster else _on_this_machine(missing, workers)
        for count, (trial, result) in enumerate(finished, done + 1):
            keep(keep_in, trial, result)
            results[trial.key] = result
            progress(count, len(results))
    in_order = [results[trial.key] for trial in trials]
    return [result for result in in_order if result is not None]


def _on_cluster(trials: Sequence[Trial], address: str) -> Iterator[tuple[Trial, Result]]:
    """Yield trials and their results as they finish on the workers of a scheduler; raises InputError."""
    with connected(address) as client:
        for finished in run_tasks(client, run_alone, trials, key_of=lambda trial: f"chromaperture-{trial.key}"):
            if finished.error is not None:
                raise finished.error
            yield finished.task, dict(finished.value)


def _on_this_machine(trials: Sequence[Trial], workers: int) -> Iterator[tuple[Trial, Result]]:
    """Yield trials and their results as they finish; raises InputError when workers die repeatedly."""
    left = {trial.key: trial for trial in trials}
    for _ in range(_ATTEMPTS):
        context = get_context("spawn")  # a fork would copy the threads' locks
        try:
            with _inherited(_ONE_THREAD), ProcessPoolExecutor(min(workers, len(left)), context, one_thread) as pool:
                waiting = {pool.submit(run_trial, trial): trial for trial in left.values()}
                for future in as_completed(waiting):
                    result = future.result()
                    del left[waiting[future].key]
                    yield waiting[future], result
            return
        except BrokenProcessPool:
            if not left:
                return
    raise InputError(f"worker processes died {_ATTEMPTS} times: run again with fewer --workers, which need less memory")


@contextlib.contextmanager
def _inherited(variables: dict[str, str]) -> Iterator[None]:
    """Set environment variables for processes started meanwhile: BLAS reads its number of threads at start."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _kept(folder: Path, trial: Trial) -> Result | None:
    try:
        content = json.loads((folder / f"{trial.key}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return {name: float("nan") if value is None else float(value) for name, value in content["result"].items()}


def keep(folder: Path, trial: Trial, result: Result) -> None:
    """Store the result of a trial for `sweep`."""
    with staged(folder) as stage:
        write_json(stage.path(f"{trial.key}.json"), {"trial": asdict(trial), "result": result})

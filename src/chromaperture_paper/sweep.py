"""Many small trials on all cores; the result does not depend on the number of workers.

Each trial has its own seed, every worker computes on one thread, and results are returned in the order of the trials.
TaskResult trials are kept; when a worker dies, only its unfinished trials are repeated.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from importlib import metadata
from multiprocessing import get_context
from pathlib import Path

from chromaperture.system.cluster import connected, run_tasks
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged, write_json
from chromaperture.system.threads import limited_threads

_ALONE = threading.Lock()


@dataclass(frozen=True)
class Trial:
    """One capture and one method."""

    method: str
    design: str
    exposure: float  # image level of a reflectance of 1 through an open pupil, of white level; determines the noise
    width_px: int
    height_px: int
    cells: int  # rays across the pupil
    seed: int
    saturation: float = 0.5  # of the scene's colours
    scene: str = "still life"  # or "wall": flat, filling the picture
    distance_mm: float = 0.0  # of the wall

    @property
    def key(self) -> str:
        """Stem of the file of the result, different for each version of the package."""
        text = json.dumps([metadata.version("chromaperture"), asdict(self)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:24]


def run_trial(trial: Trial) -> dict[str, float]:
    """Photograph the scene, measure it, and return `methods.scores`."""
    import numpy as np

    from chromaperture_paper import methods, world

    wall = trial.scene == "wall"
    # A wall is a crop of the full picture: its pixels are as fine as those of the still life in a full run.
    pitch_mm = world.FINE_PITCH_MM if wall else None
    camera = world.camera_of(trial.width_px, trial.height_px, pitch_mm=pitch_mm)
    if wall:
        planes = world.board(camera, trial.distance_mm, seed=trial.seed, saturation=trial.saturation)
    else:
        planes = world.still_life(seed=trial.seed, saturation=trial.saturation)
    shot = world.pinhole_capture(
        trial.design, planes, camera, cells=trial.cells, seed=trial.seed, exposure=trial.exposure
    )
    curve = methods.calibrate(trial.method, trial.design, camera, trial.cells)
    value = methods.METHODS[trial.method](shot.image, methods.setting_of(trial.design, camera))
    inner = np.s_[20:-20, 20:-20] if wall else np.s_[:, :]  # at the rim windows are cut; it is much of a small wall
    depth = methods.depth_of(curve.radius_of(np.asarray(value)), camera)
    return methods.scores(depth[inner], shot.depth_mm[inner])


def run_alone(trial: Trial) -> dict[str, float]:
    """Run a trial on one thread, in any process and thread: sums of many threads depend on their number."""
    with _ALONE, limited_threads(1):  # the limit holds for the whole process
        one_thread()
        return run_trial(trial)


def one_thread() -> None:
    """Limit OpenCV to one thread."""
    import cv2

    cv2.setNumThreads(1)


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

"""Many small trials on all cores: the result depends on the trials alone, not on how many workers shared them.

Each trial carries its own seed, every worker computes on one thread, and results are put together in the order of the
trials. What is finished is kept; a worker that dies takes with it only the trials it was at, and they are done again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

from chromaperture.errors import InputError
from chromaperture.outputs import staged

_ATTEMPTS = 4


@dataclass(frozen=True)
class Trial:
    """One capture and one method.

    Attributes
    ----------
    method, design : str
    exposure : float
        White level that a reflectance of 1 through an open pupil reaches.
    width_px, height_px, cells : int
        Picture, and rays across the pupil.
    seed : int
    saturation : float
        Of the scene's colours.
    """

    method: str
    design: str
    exposure: float
    width_px: int
    height_px: int
    cells: int
    seed: int
    saturation: float = 0.5

    @property
    def key(self) -> str:
        """Name of the file that keeps the result."""
        text = json.dumps(asdict(self), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:24]


def run_trial(trial: Trial) -> dict[str, float]:
    """Photograph the still life, measure, and judge.

    Returns
    -------
    dict
        As `methods.scores`.
    """
    import numpy as np

    from chromaperture.evaluation.paper import methods, world

    camera = world.camera_of(trial.width_px, trial.height_px)
    table = world.pinhole_table(camera, trial.design, trial.cells)
    planes = world.still_life(seed=trial.seed, saturation=trial.saturation)
    shot = world.photograph(table, planes, camera, seed=trial.seed, exposure=trial.exposure)
    line = methods.calibrate(trial.method, trial.design, camera, trial.exposure, trial.cells, 1000 + trial.seed)
    value = methods.METHODS[trial.method](shot.image, trial.design, camera)
    return methods.scores(methods.depth_of(line.radius_px(np.asarray(value)), camera), shot.depth_mm)


def sweep(trials: Sequence[Trial], *, workers: int, keep_in: Path) -> list[dict[str, float]]:
    """Run trials in parallel.

    Parameters
    ----------
    trials : sequence of Trial
    workers : int
        Processes, at least 1.
    keep_in : Path
        Folder for the finished trials: a run that was interrupted goes on from there.

    Returns
    -------
    list of dict, in the order of the trials; the same for any number of workers

    Raises
    ------
    InputError
        Workers died again and again, as they do where memory is short.
    """
    results = {trial.key: _kept(keep_in, trial) for trial in trials}
    for _ in range(_ATTEMPTS):
        open_trials = list({t.key: t for t in trials if results[t.key] is None}.values())
        if not open_trials:
            break
        context = get_context("spawn")  # a fork would copy the threads' locks
        try:
            with ProcessPoolExecutor(min(workers, len(open_trials)), context, _one_thread) as pool:
                waiting = {pool.submit(run_trial, trial): trial for trial in open_trials}
                for future in as_completed(waiting):
                    results[waiting[future].key] = _keep(keep_in, waiting[future], future.result())
        except BrokenProcessPool:
            continue
    done = [results[trial.key] for trial in trials]
    if any(result is None for result in done):
        raise InputError("worker processes died four times: run again with fewer --workers, which need less memory")
    return [result for result in done if result is not None]


def _one_thread() -> None:
    """Keep a worker to one thread: sums of many threads depend on their number."""
    import cv2
    import numba

    cv2.setNumThreads(1)
    numba.set_num_threads(1)


def _kept(folder: Path, trial: Trial) -> dict[str, float] | None:
    try:
        content = json.loads((folder / f"{trial.key}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return {name: float("nan") if value is None else float(value) for name, value in content["result"].items()}


def _keep(folder: Path, trial: Trial, result: dict[str, float]) -> dict[str, float]:
    from chromaperture.outputs import write_json

    with staged(folder) as stage:
        write_json(stage.path(f"{trial.key}.json"), {"trial": asdict(trial), "result": result})
    return result

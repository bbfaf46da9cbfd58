"""One trial of a sweep: a capture that is simulated, a method, and what its depth is worth."""

from __future__ import annotations

import hashlib
import json
import threading
from dataclasses import asdict, dataclass
from importlib import metadata

_ALONE = threading.Lock()


@dataclass(frozen=True)
class Trial:
    """One capture and one method.

    Attributes
    ----------
    method, design : str
    exposure : float
        White level that a reflectance of 1 through an open pupil reaches: light, and with it noise.
    width_px, height_px, cells : int
        Picture, and rays across the pupil.
    seed : int
    saturation : float
        Of the scene's colours.
    scene : str
        "still life", or "wall": a flat one that fills the picture.
    distance_mm : float
        Of the wall.
    """

    method: str
    design: str
    exposure: float
    width_px: int
    height_px: int
    cells: int
    seed: int
    saturation: float = 0.5
    scene: str = "still life"
    distance_mm: float = 0.0

    @property
    def key(self) -> str:
        """Name of the file that keeps the result; another version of the package has another."""
        text = json.dumps([metadata.version("chromaperture"), asdict(self)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:24]


def run_trial(trial: Trial) -> dict[str, float]:
    """Photograph the scene, measure, and judge.

    Returns
    -------
    dict
        As `methods.scores`.
    """
    import numpy as np

    from chromaperture.evaluation.paper import methods, world

    wall = trial.scene == "wall"
    # A wall is a piece of the full picture, so that its pixels are as fine as the still life's of a full run.
    pitch_mm = world.SENSOR_WIDTH_MM / 480 if wall else None
    camera = world.camera_of(trial.width_px, trial.height_px, pitch_mm=pitch_mm)
    table = world.pinhole_table(camera, trial.design, trial.cells)
    if wall:
        planes = world.board(camera, trial.distance_mm, seed=trial.seed, saturation=trial.saturation)
    else:
        planes = world.still_life(seed=trial.seed, saturation=trial.saturation)
    shot = world.photograph(table, planes, camera, seed=trial.seed, exposure=trial.exposure)
    curve = methods.calibrate(trial.method, trial.design, camera, trial.cells)
    value = methods.METHODS[trial.method](shot.image, methods.setting_of(trial.design, camera))
    inner = np.s_[20:-20, 20:-20] if wall else np.s_[:, :]  # the rim, where windows are cut, would be most of a wall
    depth = methods.depth_of(curve.radius_of(np.asarray(value)), camera)
    return methods.scores(depth[inner], shot.depth_mm[inner])


def run_alone(trial: Trial) -> dict[str, float]:
    """Run a trial on one thread, for sums of many threads depend on their number; in any process, any thread."""
    with _ALONE:  # threads of one process share the threads of the kernels
        one_thread()
        return run_trial(trial)


def one_thread() -> None:
    """Keep what calls it to one thread."""
    import cv2
    import numba

    cv2.setNumThreads(1)
    numba.set_num_threads(1)


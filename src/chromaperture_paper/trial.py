"""One trial of a sweep: a simulated capture, a method, and the quality of its depth."""

from __future__ import annotations

import hashlib
import json
import threading
from dataclasses import asdict, dataclass
from importlib import metadata

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

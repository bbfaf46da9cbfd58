"""The usual alternative: two ordinary cameras side by side, matched by OpenCV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.ray_table import pinhole_rays
from chromaperture.optics.simulator.scene import Plane
from chromaperture_paper import methods, world
from chromaperture_paper.prior.stereo import semi_global_matching

BASELINE_MM, STOPPED = 60.0, 4.0  # as in commercial pairs; f/2 stopped down to f/8, so that all is sharp
_NEAREST_MM = 1000.0  # of the searched range, as the coded cameras'


def measured(
    planes: Sequence[Plane], camera: PupilCamera, *, seed: int, cells: int
) -> tuple[world.Capture, np.ndarray, float]:
    """Photograph a scene with two cameras, exposed to the same level as the others, and match them.

    Returns ``capture`` the left picture and its truth; ``depth_mm`` (H, W) float64, NaN unknown; ``seconds`` of the
    matching.
    """
    stopped = replace(camera, pupil_radius_mm=camera.pupil_radius_mm / STOPPED)
    table = pinhole_rays(stopped, world.real_film("open"), cells=cells)
    shots = [
        world.photograph(table, _beside(planes, x), stopped, seed=seed + i, exposure=world.WHITE)
        for i, x in enumerate((0.0, BASELINE_MM))
    ]
    return shots[0], *methods.timed(depth_of_pair, shots[0].image, shots[1].image, camera)


def depth_of_pair(left: np.ndarray, right: np.ndarray, camera: PupilCamera) -> np.ndarray:
    """Match two pictures of cameras side by side; depth from the sensor plane, (H, W) float64, mm, NaN unknown."""
    scale = camera.focal_px * BASELINE_MM
    count = 16 * int(np.ceil(scale / (_NEAREST_MM - camera.sensor_to_pupil_mm) / 16))
    pair = [(255 * np.sqrt(np.clip(picture.mean(axis=2), 0, 1))).astype(np.uint8) for picture in (left, right)]
    padded = [cv2.copyMakeBorder(p, 0, 0, count, 0, cv2.BORDER_REFLECT_101) for p in pair]
    disparity = semi_global_matching(padded[0], padded[1], 0, count)[:, count:].astype(float)
    with np.errstate(divide="ignore"):
        return np.where(disparity > 0, scale / disparity + camera.sensor_to_pupil_mm, np.nan)


def _beside(planes: Sequence[Plane], x_mm: float) -> list[Plane]:
    """Transform planes into the frame of a camera that stands farther right."""
    return [replace(p, center_mm=p.center_mm - np.array([x_mm, 0, 0])) for p in planes]

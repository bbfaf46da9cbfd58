"""Pose of one view against the picture of the model: depth and colour together (Open3D's hybrid odometry)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from chromaperture.reconstruction.settings import ReconstructionConfig
from chromaperture.reconstruction.volume import ModelView, Volume, open3d
from chromaperture.views import View

_ITERATIONS, _FINE = (10, 8, 6), (4, 6, 8)  # coarse to fine
_MIN_MODEL = 0.05  # share of the picture that the model must fill


@dataclass(frozen=True)
class Track:
    """Where the camera was found.

    Attributes
    ----------
    pose : (4, 4) float64
        Camera to world, mm.
    overlap : float
        Share of the view's points that found the model.
    likeness : float
        Correlation with the model's picture from that pose, -1..1.
    lost : str
        Why the pose is not to be trusted; empty when it is.
    """

    pose: np.ndarray
    overlap: float
    likeness: float
    lost: str


def track(
    view: View,
    volume: Volume,
    guess: np.ndarray,
    *,
    camera_matrix: np.ndarray,
    config: ReconstructionConfig,
    verify: bool = True,
) -> Track:
    """Find the camera from a guess of its pose.

    Parameters
    ----------
    view : View
        Cleaned.
    volume : Volume
    guess : (4, 4) float, camera to world, mm
    camera_matrix : (3, 3) float, px
    config : ReconstructionConfig
    verify : bool
        Look at the model once more from the pose that was found; costs a ray cast.

    Returns
    -------
    Track
        Never raises because of what is in the picture: `Track.lost` says what is wrong.
    """
    scale = config.tracking_scale
    small, matrix = shrunk(view, scale), scaled(camera_matrix, scale)
    height, width = small.z_mm.shape
    if np.isfinite(small.z_mm).mean() < _MIN_MODEL:
        return Track(guess, 0.0, 0.0, "hardly any pixel has a depth that can be trusted; light, texture or range?")
    model = volume.look(matrix, guess, width, height)
    if (model.z_mm > 0).mean() < _MIN_MODEL:
        return Track(guess, 0.0, 0.0, "the camera has left what was seen so far")
    try:
        moved, overlap = _odometry(small, model, matrix, config)
    except RuntimeError:  # Open3D, where surface and texture leave the pose undetermined
        return Track(guess, 0.0, 0.0, "surface and texture do not determine the pose")
    if not np.isfinite(moved).all():
        return Track(guess, 0.0, 0.0, "surface and texture do not determine the pose")
    pose = guess @ moved
    step = float(np.linalg.norm(moved[:3, 3]))
    turn = float(np.degrees(np.arccos(np.clip((np.trace(moved[:3, :3]) - 1) / 2, -1, 1))))
    if step > config.max_step_mm or turn > config.max_turn_deg:
        return Track(guess, overlap, 0.0, f"a jump of {step:.0f} mm and {turn:.0f} degrees")
    if overlap < config.min_overlap:
        return Track(guess, overlap, 0.0, f"only {overlap:.0%} of the view fits the model")
    like = likeness(small, volume.look(matrix, pose, width, height)) if verify else float("nan")
    if like < config.min_likeness:
        return Track(guess, overlap, like, f"the picture does not look like the model (correlation {like:.2f})")
    return Track(pose, overlap, like, "")


def _odometry(
    view: View, model: ModelView, matrix: np.ndarray, config: ReconstructionConfig
) -> tuple[np.ndarray, float]:
    o3d = open3d()
    slam: Any = o3d.t.pipelines.odometry
    core = o3d.core

    def picture(z_mm: np.ndarray, color: np.ndarray) -> Any:
        images = (np.ascontiguousarray(color), np.ascontiguousarray(np.nan_to_num(z_mm), np.float32))
        return o3d.t.geometry.RGBDImage(*(o3d.t.geometry.Image(core.Tensor(image)) for image in images))

    far = max(1.0, float(np.nanmedian(view.z_mm)) / 2000)
    outlier_m = config.outlier_mm * far / 1000
    pictures = picture(view.z_mm, view.color), picture(model.z_mm, model.color)
    start = core.Tensor(np.eye(4))
    found: Any = None
    # Depth and colour find the valley; colour alone, which errors of depth do not pull at, finds its bottom.
    for method, iterations in ((slam.Method.Hybrid, _ITERATIONS), (slam.Method.Intensity, _FINE)):
        try:
            found = slam.rgbd_odometry_multi_scale(
                *pictures,
                core.Tensor(np.ascontiguousarray(matrix, np.float64)),
                start,
                1000.0,
                config.max_distance_mm / 1000,
                [slam.OdometryConvergenceCriteria(n) for n in iterations],
                method,
                slam.OdometryLossParams(outlier_m, outlier_m * 0.7, 0.1),
            )
        except RuntimeError:
            if found is None:
                raise
            break  # too little colour for the second step; the first one's pose stands
        start = found.transformation
    moved = found.transformation.numpy().copy()
    moved[:3, 3] *= 1000
    known = np.isfinite(view.z_mm).mean()  # Open3D counts shares of all pixels
    return moved, float(found.fitness / known)


def likeness(view: View, model: ModelView) -> float:
    """Correlation of the luminance of a view with the model's picture, where both know depth; 0 if too little."""
    both = np.isfinite(view.z_mm) & (model.z_mm > 0)
    if both.mean() < _MIN_MODEL / 2:
        return 0.0
    a, b = (cv2.GaussianBlur(p.astype(np.float32).mean(axis=2), (0, 0), 1.5)[both] for p in (view.color, model.color))
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > both.sum() else 0.0  # less than one grey level says nothing


def shrunk(view: View, scale: int) -> View:
    """Reduce a view; colours are averaged, depths and error bars taken as they are."""
    if scale == 1:
        return view
    size = (view.color.shape[1] // scale, view.color.shape[0] // scale)
    half = scale // 2
    rows, columns = slice(half, half + size[1] * scale, scale), slice(half, half + size[0] * scale, scale)
    color = cv2.resize(view.color, size, interpolation=cv2.INTER_AREA)
    return View(color, view.z_mm[rows, columns], view.sigma_mm[rows, columns], view.time_s, view.index)


def scaled(camera_matrix: np.ndarray, scale: int) -> np.ndarray:
    """Camera matrix of the reduced picture, whose pixel centres lie at (scale - 1) / 2 of the full one's."""
    matrix = np.array(camera_matrix, float)
    matrix[:2] /= scale
    matrix[:2, 2] -= (scale - 1) / (2 * scale)
    return matrix

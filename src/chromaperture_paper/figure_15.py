"""Figure 15: a scene seen from a moving camera, and its 3D model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import cv2
import numpy as np

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.color_maps import DISTANCE
from chromaperture.evaluation.figures import new_figure, show_image
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.simulator.scene import Plane
from chromaperture.products.rectified import View, undistorter
from chromaperture.reconstruction.fusion import Reconstruction
from chromaperture.reconstruction.settings import ReconstructionConfig
from chromaperture.reconstruction.tracking import cleaned
from chromaperture.reconstruction.volume import open3d
from chromaperture.system.errors import MissingDependencyError
from chromaperture_paper import methods, world
from chromaperture_paper.context import Context
from chromaperture_paper.registry import Chart, Comparison, Content

PIVOT_MM = np.array([0.0, 0.0, 2200.0])  # centre of the camera's orbit, in the middle of the still life
_STEP_DEG, _NOD_DEG = 0.8, 1.0  # yaw from frame to frame; amplitude of the pitch; chosen by hand
_VIEWPOINTS_DEG = ((-12.0, 8.0), (20.0, 8.0))  # yaw and pitch of the shown renderings of the model
# Pictures have a third of a camera's size: discard fewer pixels at edges, track at full size.
_CONFIG = ReconstructionConfig(tracking_scale=1, edge_px=1, edge_jump=0.08, max_relative_sigma=0.2)
_MARGIN_MM = 30.0  # a point at most this far beside a board is assigned to it; chosen by hand


@dataclass(frozen=True)
class Model:
    """Points of a model in the frame of the first camera's pupil, and how it was tracked."""

    points_mm: np.ndarray
    colors: np.ndarray
    lines: tuple[str, ...]
    tracked: str
    track_ms: float


def figure_15(context: Context) -> Content:
    """Swing the simulated camera about a still life; measure, track, fuse, and render the model from elsewhere."""
    simulated = context.simulated
    result, source = simulated.calibrated()
    matrix = result.calibration.lens.camera_matrix
    poses = orbit(6 if context.quick else 16)
    planes = world.still_life(seed=15, saturation=0.4)
    views, measure_ms = _measured(simulated, result.calibration, planes, poses)
    delta = float(np.mean(result.calibration.depth_model("real-time").sensor_to_pupil_mm))
    try:
        open3d()
        model = tracked_model(views, matrix, poses, delta)
    except MissingDependencyError:
        model = placed_cloud(views, matrix, poses, delta)
    pupil = np.array([0, 0, delta])
    off = off_surface(model.points_mm + pupil, planes)
    median, most = (float(v) for v in np.percentile(off / np.maximum(model.points_mm[:, 2], 1), (50, 90)))
    figure = new_figure(height=4.8)
    panels = figure.subplots(2, 2).ravel()
    show_image(panels[0], views[0].color, "(c) test scene, first frame")
    show_image(panels[1], views[0].z_mm, "its depth", bar="mm", colors=DISTANCE)
    titles = ("(d) model, from the left", "(f) model, from the right")
    for axes, title, (yaw, pitch) in zip(panels[2:], titles, _VIEWPOINTS_DEG, strict=True):
        pose = turned(yaw, pitch, PIVOT_MM - pupil)
        show_image(axes, splat(model, matrix, pose, views[0].z_mm.shape), title)
    rates = (measure_ms, model.track_ms or np.inf, measure_ms + model.track_ms)
    size = f"{simulated.session_camera.width_px}x{simulated.session_camera.height_px} px"
    return Content(
        source=f"{source} It swings by {_STEP_DEG * (len(poses) - 1):g}° about a still life in {len(poses)} frames.",
        charts=[Chart("model", figure, "Below, the model rendered from where the camera never was.")],
        comparisons=[
            Comparison("3D model", "pictures", f"points off the true surfaces by {median:.1%} of the distance in the "
                       f"median, nine tenths within {most:.1%}", "The paper has no truth to compare with; ours does."),
            Comparison("camera path", "a picture", model.tracked,
                       "KinFu there, Open3D's odometry against the model here; the chessboard in the paper's scene "
                       "adds texture, as our speckle does."),
            Comparison("rate: depth / tracking and fusion / all", "53 / 45 / 15 frames a second on a GPU",
                       f"{' / '.join(f'{1000 / ms:.0f}' for ms in rates)} at {size}",
                       "On this machine's processor, colour restored too; frames are smaller."),
        ],
        lines=model.lines,
    )  # fmt: skip


def _measured(
    context: Context, calibration: Calibration, planes: Sequence[Plane], poses: Sequence[np.ndarray]
) -> tuple[list[View], float]:
    """Photograph and measure planes from poses; return the views and the median time of a measurement, ms."""
    camera = CodedApertureCamera(calibration, default_config(calibration, "real-time"))
    to_view = undistorter(camera)
    views, took = [], []
    for k, pose in enumerate(poses):
        context.progress("frames of figure-15", k, len(poses))
        shot = context.session_capture(seen_from(planes, pose), seed=150 + k)
        view, seconds = methods.timed(lambda image, k: to_view(camera.measure(image), k / 15, k), shot.image, k)
        views.append(view)
        took.append(1000 * seconds)
    return views, float(np.median(took))


def turned(yaw_deg: float, pitch_deg: float, pivot_mm: np.ndarray) -> np.ndarray:
    """Return the pose of a camera that looked along z and was rotated about a point; (4, 4), camera to world, mm."""
    about_y = cv2.Rodrigues(np.array([0.0, np.radians(yaw_deg), 0.0]))[0]
    about_x = cv2.Rodrigues(np.array([np.radians(pitch_deg), 0.0, 0.0]))[0]
    pose = np.eye(4)
    pose[:3, :3] = about_y @ about_x
    pose[:3, 3] = pivot_mm - pose[:3, :3] @ pivot_mm
    return pose


def orbit(count: int) -> list[np.ndarray]:
    """Return poses of a camera that swings to one side and nods; the first is the identity."""
    return [turned(k * _STEP_DEG, _NOD_DEG * np.sin(2 * np.pi * k / count), PIVOT_MM) for k in range(count)]


def seen_from(planes: Sequence[Plane], pose: np.ndarray) -> list[Plane]:
    """Transform planes of the world into the frame of a camera."""
    turn, origin = pose[:3, :3], pose[:3, 3]
    return [
        replace(p, center_mm=turn.T @ (p.center_mm - origin), right=turn.T @ p.right, down=turn.T @ p.down)
        for p in planes
    ]


def in_pupil(pose: np.ndarray, delta_mm: float) -> np.ndarray:
    """Convert a pose between frames with origin on the sensor to one with origin in the pupil; (4, 4)."""
    shift = np.eye(4)
    shift[2, 3] = delta_mm
    return np.asarray(np.linalg.inv(shift) @ pose @ shift)


def tracked_model(views: Sequence[View], matrix: np.ndarray, poses: Sequence[np.ndarray], delta_mm: float) -> Model:
    """Track and fuse; raises MissingDependencyError without Open3D."""
    model = Reconstruction(matrix, _CONFIG)
    took = [1000 * methods.timed(model.add, view)[1] for view in views]
    mesh = model.meshes()[0]
    errors = [
        float(np.linalg.norm(place.pose[:3, 3] - in_pupil(poses[place.index], delta_mm)[:3, 3]))
        for place in model.placed if place.pose is not None and place.submap == 0
    ]  # fmt: skip
    path = sum(float(np.linalg.norm(b[:3, 3] - a[:3, 3])) for a, b in pairwise(poses))
    tracked = (
        f"{len(errors)} of {len(views)} frames tracked over {path:.0f} mm, off by "
        f"{np.sqrt(np.mean(np.square(errors))):.0f} mm rms"
    )
    return Model(mesh.vertices_mm.astype(float), mesh.colors, (), tracked, float(np.median(took)))


def placed_cloud(views: Sequence[View], matrix: np.ndarray, poses: Sequence[np.ndarray], delta_mm: float) -> Model:
    """Place the points of all views by the true poses, instead of a tracked model."""
    points, colors = [], []
    v, u = np.indices(views[0].z_mm.shape)
    rays = np.stack([(u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1], np.ones(u.shape)], axis=-1)
    for view, pose in zip(views, poses, strict=True):
        z = cleaned(view, _CONFIG).z_mm
        known = np.isfinite(z)
        moved = in_pupil(pose, delta_mm)
        points.append((rays[known] * z[known][:, None]) @ moved[:3, :3].T + moved[:3, 3])
        colors.append(view.color[known])
    lines = (
        "The extra 'reconstruct' is not installed: the points of all frames are placed by the TRUE poses, "
        "neither tracked nor fused.",
    )
    return Model(np.concatenate(points), np.concatenate(colors), lines, "not tracked", 0.0)


def off_surface(points_mm: np.ndarray, planes: Sequence[Plane]) -> np.ndarray:
    """Return the distance of points from the nearest of the planes; (N,) float64, mm."""
    best = np.full(len(points_mm), np.inf)
    for p in planes:
        height, width = p.texture.shape[:2]
        away = points_mm - p.center_mm
        along = np.stack([away @ p.right, away @ p.down], axis=1)
        beside = np.abs(along) > np.array([width, height]) * p.texel_mm / 2 + _MARGIN_MM
        distance = np.abs(away @ np.cross(p.right, p.down))
        best = np.where(beside.any(axis=1), best, np.minimum(best, distance))
    return np.where(np.isfinite(best), best, np.nan_to_num(np.nanmax(best, initial=0.0, where=np.isfinite(best))))


def splat(model: Model, matrix: np.ndarray, pose: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Render points from a pose; (H, W, 3) uint8, white where there is none."""
    height, width = shape
    local = (model.points_mm - pose[:3, 3]) @ pose[:3, :3]
    order = np.argsort(-local[:, 2])  # the nearest is drawn last
    local, colors = local[order], model.colors[order]
    ahead = local[:, 2] > 1
    u, v = (local[ahead, :2] / local[ahead, 2:] * [matrix[0, 0], matrix[1, 1]] + matrix[:2, 2]).T
    picture = np.full((height, width, 3), 255, np.uint8)
    for down, across in product((-1, 0, 1), repeat=2):
        x, y = np.rint(u).astype(int) + across, np.rint(v).astype(int) + down
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        picture[y[inside], x[inside]] = colors[ahead][inside]
    return picture

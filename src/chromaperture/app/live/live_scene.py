"""Draw points, model, camera and path in the page's scene, which is in metres."""

from __future__ import annotations

from typing import Any

import numpy as np

from chromaperture.app.live.loop import LiveLoop, Measured
from chromaperture.camera.camera import DepthFrame
from chromaperture.products.measure_file import points as camera_points
from chromaperture.reconstruction.clean_views import near_steps
from chromaperture.reconstruction.model_files import glb, quaternion

_POINTS = 40_000  # of the cloud, chosen by hand: the page must leave the processor to depth and tracking
_POINT_OVERLAP = 1.5  # size of a point in distances of neighbours, chosen by hand: leaves no holes in slanted surfaces
_TRACKED, _LOST = (40, 120, 220), (220, 60, 40)  # colours of the camera, blue and red
# First view, chosen by hand: from the upper right, so that relief is seen, and so far away that what the camera sees at
# the scene's distance fills this part of the page between the panels.
_YAW_DEG, _PITCH_DEG = 20.0, 12.0
_FILLED, _VIEW_FOV_DEG, _CANVAS_ASPECT = 0.6, 50.0, 0.75


class LiveScene:
    """What is drawn in the scene of a viser server.

    Parameters
    ----------
    server : viser.ViserServer
    loop : LiveLoop
    """

    def __init__(self, server: Any, loop: LiveLoop) -> None:
        self._server, self._loop, self._mesh = server, loop, object()
        server.scene.set_up_direction("-y")

    def look_at(self, distance_mm: float) -> None:
        """Set the first view, and "reset view", to a scene at this distance; browsers that are connected turn there."""
        lens, sensor = self._loop.camera.calibration.lens, self._loop.camera.calibration.sensor
        position, target = first_view(distance_mm / 1000, sensor.width_px / 2 / lens.camera_matrix[0, 0])
        cameras = [self._server.initial_camera, *(client.camera for client in self._server.get_clients().values())]
        for camera in cameras:
            camera.position, camera.look_at = position, target
            camera.fov = np.radians(_VIEW_FOV_DEG)

    def draw(self, item: Measured) -> None:
        """Draw one frame, whose uncertain depth is NaN, and the state of the model."""
        scene, placed = self._server.scene, self._loop.placed
        pose = placed.pose if placed is not None and placed.pose is not None else None
        turn = np.eye(3) if pose is None else pose[:3, :3]
        shift = np.zeros(3) if pose is None else pose[:3, 3]
        self._draw_points(item.measurement, turn, shift)
        x, y, z, w = quaternion(turn)
        height, width = item.measurement.depth_mm.shape
        scene.add_camera_frustum(
            "/camera",
            fov=float(2 * np.arctan(height / 2 / self._loop.camera.calibration.lens.camera_matrix[1, 1])),
            aspect=width / height,
            scale=0.1,
            wxyz=(w, x, y, z),
            position=shift / 1000,
            color=_LOST if placed is not None and placed.pose is None else _TRACKED,
        )
        path = np.array([*self._loop.trail.points_mm, shift]) / 1000
        if len(path) > 2:
            pairs = np.stack([path[:-1], path[1:]], axis=1)
            scene.add_line_segments("/path", pairs, _TRACKED, thickness=2, thickness_units="screen")
        mesh = self._loop.mesh
        if mesh is not None and mesh is not self._mesh and len(mesh.triangles):
            self._mesh = mesh
            # Not through trimesh: its objects are reference cycles that hold many megabytes until the collector runs.
            scene.add_glb("/model", glb(mesh), wxyz=(0, 1, 0, 0))  # the file's y points up and its z backward

    def _draw_points(self, measured: DepthFrame, turn: np.ndarray, shift: np.ndarray) -> None:
        depth = measured.depth_mm
        step = max(1, round((depth.size / _POINTS) ** 0.5))
        thinned = (slice(None, None, step),) * 2
        c = self._loop.config  # pixels between two surfaces are removed, as in the model
        flying = near_steps(depth, jump=c.edge_jump, reach_px=c.edge_px)[thinned]
        thin = np.where(flying, np.float32(np.nan), depth[thinned])
        cloud = camera_points(self._loop.camera, thin, measured.color[thinned], step=step)
        points = (cloud.points_mm @ turn.T + shift) / 1000
        between_m = step / self._loop.camera.calibration.lens.camera_matrix[0, 0] * median_distance(thin) / 1000
        size = _POINT_OVERLAP * between_m if len(points) else 0.004  # m, of no point
        self._server.scene.add_point_cloud("/points", points.astype(np.float32), cloud.colors, point_size=size)


def median_distance(depth_mm: np.ndarray, otherwise: float = np.nan) -> float:
    """Return the median of known distances, mm."""
    known = depth_mm[np.isfinite(depth_mm)]
    return float(np.median(known)) if known.size else otherwise


def first_view(distance_m: float, half_width: float) -> tuple[np.ndarray, np.ndarray]:
    """Return place and target of a view of what a camera in the origin sees, x right, y down, z forward.

    Parameters
    ----------
    distance_m : float
        Of the scene, on the camera's axis.
    half_width : float
        Tangent of half the camera's horizontal angle of view.

    Returns
    -------
    position, target : (3,) float64, m
    """
    target = np.array([0.0, 0.0, distance_m])
    away = distance_m * half_width / (_FILLED * np.tan(np.radians(_VIEW_FOV_DEG) / 2) * _CANVAS_ASPECT)
    yaw, pitch = np.radians((_YAW_DEG, _PITCH_DEG))
    direction = np.array([np.sin(yaw) * np.cos(pitch), -np.sin(pitch), -np.cos(yaw) * np.cos(pitch)])
    return target + away * direction, target

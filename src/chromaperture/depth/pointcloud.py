"""Depth maps as coloured point clouds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from chromaperture.color.srgb import linear_to_srgb


@dataclass(frozen=True)
class PointCloud:
    """Points in the camera frame: origin at the entrance pupil, x right, y down, z forward."""

    points_mm: np.ndarray  # (N, 3) float32
    colors: np.ndarray  # (N, 3) uint8, sRGB


def depth_to_points(
    depth_mm: np.ndarray,
    color: np.ndarray,
    *,
    camera_matrix: np.ndarray,
    distortion: np.ndarray,
    sensor_to_pupil_mm: float,
) -> PointCloud:
    """Back-project every pixel of known depth.

    Parameters
    ----------
    depth_mm : (H, W) float, mm from the sensor plane, NaN unknown
    color : (H, W, 3) float, linear RGB
    camera_matrix : (3, 3) float, px
    distortion : (5,) float
        OpenCV's k1, k2, p1, p2, k3.
    sensor_to_pupil_mm : float
        delta; Z = depth - delta, from the entrance pupil.
    """
    known = np.isfinite(depth_mm)
    v, u = np.nonzero(known)
    if len(u) == 0:
        return PointCloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
    pixels = np.stack([u, v], axis=1).astype(np.float64)[:, None]
    rays = cv2.undistortPoints(pixels, np.asarray(camera_matrix, float), np.asarray(distortion, float))[:, 0]
    z = depth_mm[known].astype(np.float64) - sensor_to_pupil_mm
    points = np.column_stack([rays * z[:, None], z]).astype(np.float32)
    return PointCloud(points, np.rint(linear_to_srgb(color[known]) * 255).astype(np.uint8))


def write_ply(path: Path, cloud: PointCloud) -> None:
    """Write a binary PLY with positions in mm and 8-bit colours."""
    vertices = np.empty(len(cloud.points_mm), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])  # PLY has no padding
    vertices["xyz"], vertices["rgb"] = cloud.points_mm, cloud.colors
    names = [f"property float {n}" for n in "xyz"] + [f"property uchar {n}" for n in ("red", "green", "blue")]
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            "comment unit: mm; origin at the entrance pupil, x right, y down, z forward",
            f"element vertex {len(vertices)}",
            *names,
            "end_header\n",
        ]
    )
    path.write_bytes(header.encode("ascii") + vertices.tobytes())

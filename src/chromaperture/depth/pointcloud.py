"""Depth maps as coloured point clouds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.depth.pointcloud_kernels import back_project
from chromaperture.threads import in_parallel

# Rays are linear between pixels so far apart, to within 0.002 px for a wide lens (focal length 500 px, k1 = 0.1).
RAY_PITCH_PX = 4
_VERTICES = 1 << 16  # written at once; chosen by hand


@dataclass(frozen=True, repr=False)
class PointCloud:
    """Points in the camera frame: origin at the entrance pupil, x right, y down, z forward."""

    points_mm: np.ndarray  # (N, 3) float32
    colors: np.ndarray  # (N, 3) uint8, sRGB

    def __repr__(self) -> str:
        return f"PointCloud({len(self.points_mm)} points)"


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

    Returns
    -------
    PointCloud
        In the order of the pixels, row by row.
    """
    depth = np.ascontiguousarray(depth_mm, np.float32)
    before = np.concatenate([[0], np.cumsum([np.count_nonzero(np.isfinite(row)) for row in depth])])  # in rows above
    points, colors = np.empty((before[-1], 3), np.float32), np.empty((before[-1], 3), np.uint8)
    if not len(points):
        return PointCloud(points, colors)
    rays = grid_of_rays(depth.shape, np.asarray(camera_matrix, float), np.asarray(distortion, float))
    srgb, delta = linear_to_srgb_bytes(color), float(sensor_to_pupil_mm)

    def rows(thread: int, first: int, last: int) -> None:
        back_project(depth, rays, RAY_PITCH_PX, delta, srgb, before, points, colors, first, last)

    in_parallel(rows, len(depth))
    return PointCloud(points, colors)


def grid_of_rays(shape: tuple[int, ...], matrix: np.ndarray, distortion: np.ndarray) -> np.ndarray:
    """Return x and y at Z = 1 of every `RAY_PITCH_PX`-th pixel, and of one beyond the last; (h, w, 2) float64.

    Parameters
    ----------
    shape : (H, W)
        Of the picture.
    matrix : (3, 3) float, px
    distortion : (5,) float
        OpenCV's k1, k2, p1, p2, k3.
    """
    down, across = (np.arange(0, side + RAY_PITCH_PX, RAY_PITCH_PX, dtype=float) for side in shape)
    pixels = np.stack(np.meshgrid(across, down), axis=-1)
    return cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, distortion).reshape(pixels.shape)


def write_ply(path: str | Path, cloud: PointCloud) -> None:
    """Write a binary PLY with positions in mm and 8-bit colours."""
    names = [f"property float {n}" for n in "xyz"] + [f"property uchar {n}" for n in ("red", "green", "blue")]
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            "comment unit: mm; origin at the entrance pupil, x right, y down, z forward",
            f"element vertex {len(cloud.points_mm)}",
            *names,
            "end_header\n",
        ]
    )
    vertices = np.empty(_VERTICES, dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])  # PLY has no padding
    with Path(path).open("wb") as file:
        file.write(header.encode("ascii"))
        for start in range(0, len(cloud.points_mm), _VERTICES):
            points, colors = cloud.points_mm[start : start + _VERTICES], cloud.colors[start : start + _VERTICES]
            vertices["xyz"][: len(points)], vertices["rgb"][: len(points)] = points, colors
            file.write(vertices[: len(points)].data)

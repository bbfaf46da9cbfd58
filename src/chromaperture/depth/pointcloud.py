"""Depth maps as coloured point clouds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.threads import in_parallel

_ROWS = 16  # of the picture, handled at once: their points stay in the cache; chosen by hand
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
    known = np.isfinite(depth_mm)
    if not known.any():
        return PointCloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
    matrix, coefficients = np.asarray(camera_matrix, float), np.asarray(distortion, float)
    before = np.concatenate([[0], np.cumsum(known.sum(axis=1))])  # points of the rows above
    points = np.empty((before[-1], 3), np.float32)

    def back_project(thread: int, first: int, last: int) -> None:
        for top in range(first * _ROWS, min(last * _ROWS, len(known)), _ROWS):
            band = slice(top, min(top + _ROWS, len(known)))
            v, u = np.nonzero(known[band])
            if not len(u):
                continue
            pixels = np.stack([u, v + top], axis=1).astype(np.float64)[:, None]
            rays = cv2.undistortPoints(pixels, matrix, coefficients)[:, 0]
            z = depth_mm[band][known[band]].astype(np.float64) - sensor_to_pupil_mm
            found = points[before[band.start] : before[band.stop]]
            found[:, :2], found[:, 2] = rays * z[:, None], z

    in_parallel(back_project, -(-len(known) // _ROWS))
    return PointCloud(points, linear_to_srgb_bytes(color)[known])


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

"""Depth maps as coloured point clouds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.system.compilation import compiled
from chromaperture.system.memory import Rows
from chromaperture.system.threads import each_band, in_parallel


@compiled(error_model="numpy")
def back_project(depth, first_row, rays, pitch, sensor_to_pupil, srgb, before, points, colors):  # type: ignore[no-untyped-def]
    """Fill in the points of rows from ``first_row`` on, along rays linear between every ``pitch``-th pixel."""
    width, columns = depth.shape[1], rays.shape[1]
    across = np.empty((2, columns))  # x and y of the row at Z = 1, at the columns of the grid
    for y in range(len(depth)):
        n, row = before[y], (first_row + y) // pitch
        down = (first_row + y - row * pitch) / pitch
        for column in range(columns):
            for k in range(2):
                across[k, column] = rays[row, column, k] * (1 - down) + rays[row + 1, column, k] * down
        for column in range(columns - 1):
            x0, y0 = across[0, column], across[1, column]
            step_x, step_y = (across[0, column + 1] - x0) / pitch, (across[1, column + 1] - y0) / pitch
            left = column * pitch
            for x in range(left, min(left + pitch, width)):
                z = np.float64(depth[y, x]) - sensor_to_pupil
                if not np.isfinite(z):
                    continue
                right = x - left
                points[n, 0], points[n, 1], points[n, 2] = (x0 + right * step_x) * z, (y0 + right * step_y) * z, z
                colors[n, 0], colors[n, 1], colors[n, 2] = srgb[y, x, 0], srgb[y, x, 1], srgb[y, x, 2]
                n += 1


@compiled(error_model="numpy")
def interleave(places, colors, vertices):  # type: ignore[no-untyped-def]
    """Put the 12 bytes of each place and the 3 of its colour behind each other: (N, 12), (N, 3) and (N, 15) uint8."""
    for n in range(len(vertices)):
        for k in range(12):
            vertices[n, k] = places[n, k]
        for k in range(3):
            vertices[n, 12 + k] = colors[n, k]


# Rays are linear between pixels so far apart, to within 0.002 px for a wide lens (focal length 500 px, k1 = 0.1).
RAY_PITCH_PX = 4
_VERTICES = 1 << 16  # written at once; chosen by hand
_UNIT = "mm; origin at the entrance pupil, x right, y down, z forward"
_VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])  # PLY has no padding


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
    """Back-project pixels of known depth, in their order; Z = depth - delta, from the entrance pupil."""
    depth = np.ascontiguousarray(depth_mm, np.float32)
    before = _points_above(depth)
    points, colors = np.empty((before[-1], 3), np.float32), np.empty((before[-1], 3), np.uint8)
    if not len(points):
        return PointCloud(points, colors)
    rays = grid_of_rays(depth.shape, np.asarray(camera_matrix, float), np.asarray(distortion, float))
    srgb, delta = color if color.dtype == np.uint8 else linear_to_srgb_bytes(color), float(sensor_to_pupil_mm)

    def rows(thread: int, first: int, last: int) -> None:
        some = slice(first, last)
        back_project(depth[some], first, rays, RAY_PITCH_PX, delta, srgb[some], before[some], points, colors)

    in_parallel(rows, len(depth))
    return PointCloud(points, colors)


def grid_of_rays(shape: tuple[int, ...], matrix: np.ndarray, distortion: np.ndarray) -> np.ndarray:
    """Return x and y at Z = 1 of every `RAY_PITCH_PX`-th pixel, and of one beyond the last; (h, w, 2)."""
    down, across = (np.arange(0, side + RAY_PITCH_PX, RAY_PITCH_PX, dtype=float) for side in shape)
    pixels = np.stack(np.meshgrid(across, down), axis=-1)
    return cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, distortion).reshape(pixels.shape)


def _points_above(depth: Rows) -> np.ndarray:
    """Points in the rows above each row, and of all; (H + 1,) int64."""
    counts = np.zeros(len(depth) + 1, np.int64)

    def count(band: slice) -> None:
        counts[band.start + 1 : band.stop + 1] = np.isfinite(depth[band]).sum(axis=1)

    each_band(count, len(depth))
    return np.cumsum(counts)


def write_depth_ply(
    path: str | Path,
    depth_mm: Rows,
    srgb: np.ndarray,
    *,
    camera_matrix: np.ndarray,
    distortion: np.ndarray,
    sensor_to_pupil_mm: float,
) -> None:
    """Write the points of `depth_to_points` as `write_ply` does, in bands of rows by several threads."""
    path, before = Path(path), _points_above(depth_mm)
    rays = grid_of_rays(depth_mm.shape, np.asarray(camera_matrix, float), np.asarray(distortion, float))
    header, delta = ply_header(int(before[-1])), float(sensor_to_pupil_mm)
    with path.open("wb") as file:
        file.write(header)

    def write(band: slice) -> None:
        first, last = before[band.start], before[band.stop]
        points, colors = np.empty((last - first, 3), np.float32), np.empty((last - first, 3), np.uint8)
        depth, above = np.ascontiguousarray(depth_mm[band], np.float32), before[band] - first
        back_project(depth, band.start, rays, RAY_PITCH_PX, delta, srgb[band], above, points, colors)
        vertices = np.empty((last - first, _VERTEX.itemsize), np.uint8)
        interleave(points.astype("<f4", copy=False).view(np.uint8), colors, vertices)
        with path.open("r+b") as file:
            file.seek(len(header) + _VERTEX.itemsize * int(first))
            file.write(vertices.data)

    each_band(write, len(depth_mm), rows_a_band=max(1, _VERTICES // max(1, depth_mm.shape[1])))


def write_ply(path: str | Path, cloud: PointCloud) -> None:
    """Write a binary PLY with positions in mm and 8-bit colours.

    Parameters
    ----------
    path : str or Path
    cloud : PointCloud
        Of `depth_to_points` or `DepthFrame.points`.
    """
    with Path(path).open("wb") as file:
        file.write(ply_header(len(cloud.points_mm)))
        for start in range(0, len(cloud.points_mm), _VERTICES):
            points, colors = cloud.points_mm[start : start + _VERTICES], cloud.colors[start : start + _VERTICES]
            file.write(ply_vertices(points, colors).data)


def ply_header(count: int, unit: str = _UNIT, *more: str) -> bytes:
    """Return the header of a binary PLY of coloured vertices; ``more`` are lines of what follows them."""
    names = [f"property float {n}" for n in "xyz"] + [f"property uchar {n}" for n in ("red", "green", "blue")]
    head = ["ply", "format binary_little_endian 1.0", f"comment unit: {unit}", f"element vertex {count}"]
    return "\n".join([*head, *names, *more, "end_header\n"]).encode("ascii")


def ply_vertices(points: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Return points and their colours as a PLY file stores them."""
    vertices = np.empty(len(points), _VERTEX)
    vertices["xyz"], vertices["rgb"] = points, colors
    return vertices

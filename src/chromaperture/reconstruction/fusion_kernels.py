"""Fuse a view into voxels with a weight for every pixel; Open3D's own fusion weighs all pixels alike."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.compilation import compiled


class Voxels(NamedTuple):
    """Blocks of voxels, axes z, y, x."""

    tsdf: np.ndarray  # (capacity, r, r, r) float32, signed distance in units of the truncation
    weight: np.ndarray  # (capacity, r, r, r) float32
    color: np.ndarray  # (capacity, r, r, r, 3) float32, 0..255


class Pixels(NamedTuple):
    """Pixels of a view, and where they were seen."""

    z_mm: np.ndarray  # (H, W) float32, NaN unknown
    gain: np.ndarray  # (H, W) float32, weight
    reach_mm: np.ndarray  # (H, W) float32, how far behind the surface the pixel is used
    color: np.ndarray  # (H, W, 3) uint8
    matrix: np.ndarray  # (3, 3) float64
    world_to_camera: np.ndarray  # (4, 4) float64, mm


@compiled()
def fuse(voxels, slots, keys, view, voxel_mm, truncation_mm, max_weight):  # type: ignore[no-untyped-def]
    """Update the running means of the blocks in ``slots`` (N,), whose corners are ``keys`` (N, 3) times their edge.

    A slot occurs once, so that threads may call this for parts of the blocks.
    """
    tsdf, weight, color = voxels
    z_mm, gain, reach_mm, picture, matrix, world_to_camera = view
    rows, columns = z_mm.shape
    edge = tsdf.shape[1]
    turn, shift = world_to_camera[:3, :3], world_to_camera[:3, 3]
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    for n in range(len(slots)):
        slot = slots[n]
        for k in range(edge):
            for j in range(edge):
                y, z = (keys[n, 1] * edge + j) * voxel_mm, (keys[n, 2] * edge + k) * voxel_mm
                for i in range(edge):
                    x = (keys[n, 0] * edge + i) * voxel_mm
                    depth = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift[2]
                    if depth <= 0.0:
                        continue
                    u = fx * (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift[0]) / depth + cx
                    v = fy * (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift[1]) / depth + cy
                    if not (-0.5 <= u < columns - 0.5 and -0.5 <= v < rows - 0.5):
                        continue
                    column, row = int(u + 0.5), int(v + 0.5)
                    distance = z_mm[row, column] - depth
                    if not distance >= -reach_mm[row, column]:  # unknown, or hidden behind the surface
                        continue
                    new, old = gain[row, column], weight[slot, k, j, i]
                    total = old + new
                    value = min(max(distance / truncation_mm, -1.0), 1.0)
                    tsdf[slot, k, j, i] = (tsdf[slot, k, j, i] * old + value * new) / total
                    for c in range(3):
                        mean = color[slot, k, j, i, c]
                        color[slot, k, j, i, c] = (mean * old + picture[row, column, c] * new) / total
                    weight[slot, k, j, i] = min(total, max_weight)


@compiled()
def holds_surface(tsdf, weight, slots, min_weight, reach):  # type: ignore[no-untyped-def]
    """Return which blocks have a voxel of that weight within ``reach`` truncations of a surface; (N,) bool."""
    found = np.zeros(len(slots), np.bool_)
    for n in range(len(slots)):
        weights, distances = weight[slots[n]].reshape(-1), tsdf[slots[n]].reshape(-1)
        for i in range(len(weights)):
            if weights[i] >= min_weight and abs(distances[i]) <= reach:
                found[n] = True
                break
    return found


@compiled()
def clear_faint(weight, slots, fraction):  # type: ignore[no-untyped-def]
    """Clear the voxels whose weight is below a fraction of the largest in their block."""
    for slot in slots:
        block = weight[slot].reshape(-1)
        strongest = block.max()
        for i in range(len(block)):
            if block[i] < fraction * strongest:
                block[i] = 0.0

"""Readable NumPy twins of the compiled kernels of ``reconstruction/`` and of the nearest known pixel.

They share no code with what they explain: blocks lie in one box, rays are walked in small even steps, and the nearest
pixel is found among all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates

EDGE = 16  # voxels along a block


def nearest_known(values: np.ndarray) -> list[list[set[float]]]:
    """Return, for every pixel, the values of all known pixels at the least distance from it."""
    y, x = np.nonzero(np.isfinite(values))
    found = []
    for row in range(values.shape[0]):
        found.append([])
        for column in range(values.shape[1]):
            distance2 = (y - row) ** 2 + (x - column) ** 2
            nearest = distance2 == distance2.min()
            found[-1].append(set(values[y[nearest], x[nearest]].tolist()))
    return found


class Fused(NamedTuple):
    """Blocks (N, EDGE, EDGE, EDGE), axes z, y, x, and which voxels a rounding of 32 bits could have decided."""

    tsdf: np.ndarray
    weight: np.ndarray
    color: np.ndarray
    doubtful: np.ndarray


def voxel_places(keys: np.ndarray) -> np.ndarray:
    """Return the places of the voxels of blocks in voxels; (N, EDGE, EDGE, EDGE, 3), the last axis x, y, z."""
    k, j, i = np.indices((EDGE, EDGE, EDGE))
    return keys[:, None, None, None, :] * EDGE + np.stack([i, j, k], -1)


def fused(before, keys, view, voxel_mm, truncation_mm, max_weight, painted=0.5) -> Fused:
    """Return blocks with a view in their running means: weighted means of the signed distance in front of the surface.

    Parameters
    ----------
    before : three arrays
        Signed distance, weight, colour of the blocks.
    keys : (N, 3) int
    view : Pixels
    voxel_mm, truncation_mm, max_weight : float
    painted : float
        Share of the truncation within which voxels take colours.
    """
    tsdf, weight, color = (np.array(part, float) for part in before)
    places = voxel_places(keys) * voxel_mm
    seen = places @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3]
    z = seen[..., 2]
    in_front = z >= voxel_mm
    safe = np.where(in_front, z, 1.0)
    u = view.matrix[0, 0] * seen[..., 0] / safe + view.matrix[0, 2]
    v = view.matrix[1, 1] * seen[..., 1] / safe + view.matrix[1, 2]
    column, row = (np.floor(part + 0.5).astype(int) for part in (u, v))  # the pixel whose centre is nearest
    height, width = view.z_mm.shape
    inside = in_front & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    row, column = np.where(inside, row, 0), np.where(inside, column, 0)
    distance = view.z_mm[row, column].astype(float) - z
    used = inside & (distance >= -view.reach_mm[row, column])  # never where z_mm is NaN
    gain = np.where(used, view.gain[row, column], 0.0)
    value = np.where(used, np.clip(distance / truncation_mm, -1, 1), 0.0)
    total = weight + gain
    share = np.divide(gain, total, out=np.zeros_like(gain), where=total > 0)
    tsdf += share * (value - tsdf)
    takes = used & (share > 0) & ((np.abs(value) < painted) | (weight == 0))
    color += np.where(takes, share, 0.0)[..., None] * (view.color[row, column] - color)
    between = [np.abs(part + 0.5 - np.round(part + 0.5)) < 1e-3 for part in (u, v)]  # of two pixels
    at_limit = np.abs(distance + view.reach_mm[row, column]) < 1e-2
    at_paint = np.abs(np.abs(value) - painted) < 1e-4
    doubtful = between[0] | between[1] | at_limit | at_paint | (np.abs(z - voxel_mm) < 1e-2)
    return Fused(tsdf, np.minimum(total, max_weight), color, doubtful)


def dense(keys: np.ndarray, tsdf: np.ndarray, weight: np.ndarray, min_weight: float) -> tuple[np.ndarray, ...]:
    """Return the box about all blocks, axes x, y, z: signed distance or 0, known or not, and its corner in voxels."""
    corner = keys.min(axis=0) * EDGE
    known = np.zeros((keys.max(axis=0) + 1) * EDGE - corner)
    distance = np.zeros(known.shape)
    for key, values, weights in zip(keys, tsdf, weight, strict=True):
        block = tuple(slice(at, at + EDGE) for at in key * EDGE - corner)
        known[block] = weights.transpose(2, 1, 0) >= min_weight
        distance[block] = np.where(known[block], values.transpose(2, 1, 0), 0)
    return distance, known, corner


def first_surface(box, start, slope, far_mm: float, voxel_mm: float) -> float:
    """Return where a ray first comes from before a surface to behind it, mm along the optical axis; NaN nowhere.

    Parameters
    ----------
    box : tuple
        From `dense`.
    start : (3,) float
        Of the ray, mm.
    slope : (3,) float
        Its way for a mm along the optical axis.
    far_mm, voxel_mm : float
    """
    distance, known, corner = box
    z = np.arange(voxel_mm, far_mm, voxel_mm / 8)
    places = (start + z[:, None] * slope).T / voxel_mm - corner[:, None]
    total, value = (map_coordinates(part, places, order=1, mode="constant") for part in (known, distance))
    with np.errstate(invalid="ignore", divide="ignore"):
        value = np.where(total > 0.5, value / total, np.nan)  # at least half of the eight voxels around are known
    entered = np.flatnonzero((value[:-1] > 0) & (value[1:] <= 0))
    if not len(entered):
        return np.nan
    i = entered[0]
    return z[i] + (z[i + 1] - z[i]) * value[i] / (value[i] - value[i + 1])

"""Fuse a view into voxels with a weight for every pixel; Open3D's own fusion weighs all pixels alike."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.system.compilation import compiled

# Of the truncation: voxels farther from the surface keep their colour. A mesh takes colours from within a voxel of it;
# half of eight voxels leaves room for what later views correct, and saves a fifth of the time.
_PAINTED = np.float32(0.5)


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


@compiled(error_model="numpy")
def fuse(voxels, slots, keys, view, voxel_mm, truncation_mm, max_weight):  # type: ignore[no-untyped-def]
    """Update the running means of the blocks in ``slots`` (N,), whose corners are ``keys`` (N, 3) times their edge.

    A slot occurs once, so that threads may call this for parts of the blocks. A row of voxels is projected, looked up
    and updated in three loops of float32 without branches, so that several voxels are computed at once; a voxel that
    no pixel changes has a share of 0.
    """
    edge = voxels.tsdf.shape[1]
    tsdf, weight, color = voxels.tsdf.reshape(-1), voxels.weight.reshape(-1), voxels.color.reshape(-1)
    z_mm, gain, reach_mm = view.z_mm.reshape(-1), view.gain.reshape(-1), view.reach_mm.reshape(-1)
    picture = view.color.reshape(-1)
    rows, columns = np.int32(view.z_mm.shape[0]), np.int32(view.z_mm.shape[1])
    to_camera, m = view.world_to_camera, view.matrix
    fx, fy, cx, cy = np.float32(m[0, 0]), np.float32(m[1, 1]), np.float32(m[0, 2] + 0.5), np.float32(m[1, 2] + 0.5)
    along = (to_camera[:3, :3] * voxel_mm).astype(np.float32)  # from a voxel to the next, in the camera's axes
    ax, ay, az = along[0, 0], along[1, 0], along[2, 0]
    one, least, scale = np.float32(1), np.float32(voxel_mm), np.float32(1 / truncation_mm)
    most = np.float32(max_weight)
    depth, pixel = np.empty(edge, np.float32), np.empty(edge, np.int32)
    value, new = np.empty(edge, np.float32), np.empty(edge, np.float32)
    for n in range(len(slots)):
        for line in range(edge * edge):
            x, y = keys[n, 0] * edge * voxel_mm, (keys[n, 1] * edge + line % edge) * voxel_mm
            z = (keys[n, 2] * edge + line // edge) * voxel_mm
            px = np.float32(to_camera[0, 0] * x + to_camera[0, 1] * y + to_camera[0, 2] * z + to_camera[0, 3])
            py = np.float32(to_camera[1, 0] * x + to_camera[1, 1] * y + to_camera[1, 2] * z + to_camera[1, 3])
            pz = np.float32(to_camera[2, 0] * x + to_camera[2, 1] * y + to_camera[2, 2] * z + to_camera[2, 3])
            for i in range(edge):
                step = np.float32(i)
                depth[i] = pz + step * az
                inverse = one / max(depth[i], least)
                u = fx * (px + step * ax) * inverse + cx
                v = fy * (py + step * ay) * inverse + cy
                # Clipped to one beyond the picture: whole numbers of 32 bits hold no more than 2e9.
                column = np.int32(min(max(u, -one), np.float32(columns)))
                row = np.int32(min(max(v, -one), np.float32(rows)))
                inside = (u >= 0) & (v >= 0) & (column < columns) & (row < rows) & (depth[i] >= least)
                pixel[i] = row * columns + column if inside else np.int32(-1)
            changed = False
            for i in range(edge):
                at = max(pixel[i], np.int32(0))
                distance = z_mm[at] - depth[i]
                used = (pixel[i] >= 0) & (distance >= -reach_mm[at])  # never for NaN, which is unknown
                new[i] = gain[at] if used else np.float32(0)
                value[i] = min(max(distance * scale, -one), one) if used else np.float32(0)
                changed |= used
            if not changed:
                continue
            first = (slots[n] * edge * edge + line) * edge
            t, w, c = tsdf[first : first + edge], weight[first : first + edge], color[3 * first : 3 * (first + edge)]
            for i in range(edge):
                total = w[i] + new[i]
                share = new[i] / max(total, np.float32(1e-12))
                t[i] += (value[i] - t[i]) * share
                w[i] = min(total, most)
                new[i] = share
            for i in range(edge):
                if new[i] > 0 and (abs(value[i]) < _PAINTED or new[i] == one):  # the first colour in any case
                    at = 3 * pixel[i]
                    for k in range(3):
                        c[3 * i + k] += (np.float32(picture[at + k]) - c[3 * i + k]) * new[i]


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

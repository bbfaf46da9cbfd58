"""Cast rays into blocks of voxels: the distance at which each ray enters a surface.

Voxels are found through a table of the blocks with open addressing. A ray begins where the nearest block in its cell of
the picture begins, skips what no block holds, and steps by the signed distance; the crossing is then searched between
trilinear values, so that it is exact on a plane.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.threads import in_parallel

EDGE = 16  # voxels along a block
_BITS, _LAST = 4, EDGE - 1  # a voxel's number in bits, and the last one
CELL_PX = 8  # side of the cells in which rays are bounded, as Open3D's
_REFINEMENTS = 2  # of the crossing by the secant method; a third changes noisy walls by less than 0.01 voxels
_UNKNOWN_STEP = 2.0  # voxels, where nothing was measured: half of the least reach behind a surface, with that before it
_STEP = 0.01  # relative difference of neighbours from which nothing is interpolated; chosen by hand
_OFFSET = 1 << 20  # added to block numbers, which fit in 21 bits: 160 km at blocks of 160 mm


class Blocks(NamedTuple):
    """Where blocks of voxels are: their corners over their edge, their slots, and a table from one to the other."""

    keys: np.ndarray  # (N, 3) int32
    slots: np.ndarray  # (N,) int64
    codes: np.ndarray  # (2^k,) int64, -1 empty
    places: np.ndarray  # (2^k,) int64


def table_of(keys: np.ndarray, slots: np.ndarray) -> Blocks:
    """Make the table of blocks (N, 3) int32 in slots (N,); at most a quarter of it is used."""
    size = 1 << int(np.ceil(np.log2(max(4 * len(keys), 16))))
    codes, places = np.full(size, -1, np.int64), np.zeros(size, np.int64)
    _enter(keys, slots, codes, places)
    return Blocks(keys, slots, codes, places)


def cast_rays(
    voxels: tuple[np.ndarray, np.ndarray],
    blocks: Blocks,
    matrix: np.ndarray,
    camera_to_world: np.ndarray,
    size: tuple[int, int],
    *,
    voxel_mm: float,
    truncation_mm: float,
    max_distance_mm: float,
    min_weight: float,
) -> np.ndarray:
    """Return the distance of the first front surface along every pixel's ray; (H, W) float32 mm, NaN."""
    z_mm = np.full(size, np.nan, np.float32)
    if len(blocks.keys) == 0:
        return z_mm
    ends = ray_ends(blocks.keys, matrix, np.linalg.inv(camera_to_world), size, EDGE * voxel_mm)
    lengths = (voxel_mm, truncation_mm, max_distance_mm, min_weight)
    in_parallel(
        lambda _, first, last: _cast(voxels, blocks, matrix, camera_to_world, ends, lengths, z_mm, first, last), size[0]
    )
    return z_mm


def enlarged_distances(z_mm: np.ndarray, factor: int, size: tuple[int, int]) -> np.ndarray:
    """Interpolate inverse distances of a reduced picture; the nearest pixel's at steps and unknown ones."""
    inverse = np.nan_to_num(1 / z_mm)
    shift = (1 / factor - 1) / 2  # of the reduced picture's first pixel, whose centre is between the full one's
    onto = np.array([[1 / factor, 0, shift], [0, 1 / factor, shift]], np.float32)
    linear, nearest = (
        cv2.warpAffine(inverse, onto, size[::-1], flags=how | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)
        for how in (cv2.INTER_LINEAR, cv2.INTER_NEAREST)
    )
    smooth = np.abs(linear - nearest) < _STEP * nearest
    with np.errstate(divide="ignore"):
        return np.where(nearest > 0, 1 / np.where(smooth, linear, nearest), np.float32(np.nan)).astype(np.float32)


@compiled()
def ray_ends(keys, matrix, world_to_camera, size, edge_mm):  # type: ignore[no-untyped-def]
    """Return the least and the greatest distance of blocks seen in each cell; (2, rows, columns) float64, mm."""
    rows, columns = (size[0] + CELL_PX - 1) // CELL_PX, (size[1] + CELL_PX - 1) // CELL_PX
    ends = np.empty((2, rows, columns))
    ends[0], ends[1] = np.inf, 0.0
    half_diagonal = 0.5 * edge_mm * np.sqrt(3.0)
    turn, shift = world_to_camera[:3, :3], world_to_camera[:3, 3]
    for n in range(len(keys)):
        cx, cy, cz = (keys[n, 0] + 0.5) * edge_mm, (keys[n, 1] + 0.5) * edge_mm, (keys[n, 2] + 0.5) * edge_mm
        x = turn[0, 0] * cx + turn[0, 1] * cy + turn[0, 2] * cz + shift[0]
        y = turn[1, 0] * cx + turn[1, 1] * cy + turn[1, 2] * cz + shift[1]
        z = turn[2, 0] * cx + turn[2, 1] * cy + turn[2, 2] * cz + shift[2]
        if z <= -half_diagonal:
            continue
        near, far = max(z - half_diagonal, 0.0), z + half_diagonal
        least_u, most_u, least_v, most_v = 0.0, float(size[1] - 1), 0.0, float(size[0] - 1)
        if near > 0.0:  # the sphere about the block, bounded by its box
            least_u = _least(x - half_diagonal, near, far) * matrix[0, 0] + matrix[0, 2]
            most_u = -_least(-x - half_diagonal, near, far) * matrix[0, 0] + matrix[0, 2]
            least_v = _least(y - half_diagonal, near, far) * matrix[1, 1] + matrix[1, 2]
            most_v = -_least(-y - half_diagonal, near, far) * matrix[1, 1] + matrix[1, 2]
        if most_u < 0 or most_v < 0 or least_u > size[1] - 1 or least_v > size[0] - 1:
            continue
        for row in range(int(max(least_v, 0.0)) // CELL_PX, int(min(most_v, size[0] - 1.0)) // CELL_PX + 1):
            for column in range(int(max(least_u, 0.0)) // CELL_PX, int(min(most_u, size[1] - 1.0)) // CELL_PX + 1):
                ends[0, row, column] = min(ends[0, row, column], near)
                ends[1, row, column] = max(ends[1, row, column], far)
    return ends


@inlined()
def _least(x, near, far):  # type: ignore[no-untyped-def]
    """Return the least x / z for z between near and far."""
    return x / near if x < 0 else x / far


@inlined()
def _code(x, y, z):  # type: ignore[no-untyped-def]
    return ((x + _OFFSET) << 42) | ((y + _OFFSET) << 21) | (z + _OFFSET)


@inlined()
def _place(code, size):  # type: ignore[no-untyped-def]
    """Return where a code's search begins in a table of 2^k entries: multiplicative hashing (Knuth 6.4)."""
    mixed = np.uint64(code) * np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio
    return np.int64((mixed >> np.uint64(32)) & np.uint64(size - 1))


@compiled()
def _enter(keys, slots, codes, places):  # type: ignore[no-untyped-def]
    for n in range(len(keys)):
        code = _code(np.int64(keys[n, 0]), np.int64(keys[n, 1]), np.int64(keys[n, 2]))
        at = _place(code, len(codes))
        while codes[at] >= 0:
            at = (at + 1) & (len(codes) - 1)
        codes[at], places[at] = code, slots[n]


@inlined()
def _slot(codes, places, x, y, z):  # type: ignore[no-untyped-def]
    """Return the slot of a block, -1 where there is none."""
    code = _code(x, y, z)
    at = _place(code, len(codes))
    while codes[at] >= 0:
        if codes[at] == code:
            return places[at]
        at = (at + 1) & (len(codes) - 1)
    return np.int64(-1)


@inlined()
def _index(slot, i, j, k):  # type: ignore[no-untyped-def]
    """Return where a voxel is in the flat array of all blocks."""
    return (((slot << _BITS | k & _LAST) << _BITS) | j & _LAST) << _BITS | i & _LAST


@inlined()
def _value(tsdf, weight, codes, places, x, y, z, min_weight):  # type: ignore[no-untyped-def]
    """Return the signed distance between eight voxels at a place in voxels; NaN where too few of them are known."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    s, t, r = x - i, y - j, z - k
    total, value = 0.0, 0.0
    inside = i & _LAST < _LAST and j & _LAST < _LAST and k & _LAST < _LAST
    slot = _slot(codes, places, i >> _BITS, j >> _BITS, k >> _BITS)
    for dk in range(2):
        for dj in range(2):
            for di in range(2):
                ci, cj, ck = i + di, j + dj, k + dk
                here = slot if inside else _slot(codes, places, ci >> _BITS, cj >> _BITS, ck >> _BITS)
                if here < 0:
                    continue
                at = _index(here, ci, cj, ck)
                if weight[at] < min_weight:
                    continue
                share = (s if di else 1 - s) * (t if dj else 1 - t) * (r if dk else 1 - r)
                value += share * tsdf[at]
                total += share
    return value / total if total > 0.5 else np.nan


@inlined(error_model="numpy")
def _ray(tsdf, weight, codes, places, place, slopes, begin, end, lengths):  # type: ignore[no-untyped-def]
    """Follow a ray from a place (voxels) along slopes (voxels a mm of distance); NaN where it enters no surface."""
    ox, oy, oz = place
    dx, dy, dz = slopes
    voxel_mm, truncation_mm, _, min_weight = lengths
    z = begin
    before, before_z = -1.0, 0.0
    known_x, known_y, known_z, slot = -_OFFSET, 0, 0, np.int64(-1)
    while z <= end:
        px, py, pz = ox + z * dx, oy + z * dy, oz + z * dz
        i, j, k = int(np.floor(px + 0.5)), int(np.floor(py + 0.5)), int(np.floor(pz + 0.5))
        bx, by, bz = i >> _BITS, j >> _BITS, k >> _BITS
        if bx != known_x or by != known_y or bz != known_z:
            slot = _slot(codes, places, bx, by, bz)
            known_x, known_y, known_z = bx, by, bz
        if slot < 0:  # to the other side of the block
            out = min(_exit(px, dx, bx), _exit(py, dy, by), _exit(pz, dz, bz))
            before = -1.0
            z += max(out, voxel_mm)
            continue
        at = _index(slot, i, j, k)
        if weight[at] < min_weight:
            before = -1.0
            z += _UNKNOWN_STEP * voxel_mm
            continue
        value = tsdf[at]
        if value <= 0.0 and before > 0.0:
            slope = (value - before) / (z - before_z)
            least, most = before_z - voxel_mm, z + voxel_mm
            found, old, here_old = z - value / slope, 0.0, np.nan
            for _ in range(_REFINEMENTS):  # secant method
                here = _value(
                    tsdf, weight, codes, places, ox + found * dx, oy + found * dy, oz + found * dz, min_weight
                )
                if not np.isfinite(here):
                    break
                steeper = (here - here_old) / (found - old)
                if steeper < 0.3 * slope:  # else two places are too close to tell
                    slope = steeper
                old, here_old = found, here
                found = min(max(found - here / slope, least), most)
            return found
        before, before_z = float(value), z
        z += max(abs(value) * truncation_mm, voxel_mm)
    return np.nan


@compiled(error_model="numpy")
def _cast(voxels, blocks, matrix, pose, ends, lengths, z_mm, first, last):  # type: ignore[no-untyped-def]
    """Cast the rays of rows of cells, cell by cell: neighbours read the same blocks."""
    tsdf, weight = voxels[0].reshape(-1), voxels[1].reshape(-1)
    codes, places = blocks.codes, blocks.places
    voxel_mm, max_mm = lengths[0], lengths[2]
    place = (pose[0, 3] / voxel_mm, pose[1, 3] / voxel_mm, pose[2, 3] / voxel_mm)
    rows, columns = z_mm.shape
    for cell_row in range(first, last):
        for cell_column in range(ends.shape[2]):
            begin = max(ends[0, cell_row, cell_column], voxel_mm)
            end = min(ends[1, cell_row, cell_column], max_mm)
            for row in range(cell_row * CELL_PX, min((cell_row + 1) * CELL_PX, rows)):
                for column in range(cell_column * CELL_PX, min((cell_column + 1) * CELL_PX, columns)):
                    x, y = (column - matrix[0, 2]) / matrix[0, 0], (row - matrix[1, 2]) / matrix[1, 1]
                    slopes = (
                        (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2]) / voxel_mm,
                        (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2]) / voxel_mm,
                        (pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]) / voxel_mm,
                    )
                    z_mm[row, column] = _ray(tsdf, weight, codes, places, place, slopes, begin, end, lengths)


@inlined()
def _exit(place, slope, block):  # type: ignore[no-untyped-def]
    """Return after how many mm a ray leaves a block along one axis; the middles of voxels are at whole numbers."""
    if slope > 0.0:
        return ((block + 1) * EDGE - 0.5 - place) / slope + 1e-3
    if slope < 0.0:
        return (block * EDGE - 0.5 - place) / slope + 1e-3
    return np.inf

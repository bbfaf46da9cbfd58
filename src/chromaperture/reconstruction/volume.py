"""A signed-distance volume of fixed memory on Open3D's voxel blocks: fuse, look at, make a mesh of.

Millimetres outside, metres inside Open3D; this file is where they meet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from chromaperture.errors import MissingDependencyError
from chromaperture.products.rectified import View
from chromaperture.reconstruction.fusion_kernels import forget_faint, fuse, holds_surface

EDGE = 16  # voxels along a block
BLOCK_BYTES = EDGE**3 * 4 * 5  # tsdf, weight, three colours
_SEEN = 0.02  # weight from which a voxel counts as known
_SHOWN = 1.5  # weight from which the mesh shows a surface
_SIGMAS = 3.0
_PRUNE_EVERY, _REST = 32, 128  # views fused between two clearings, and without a block until it may be cleared
_FAINT = 0.1  # of the weight of a block's strongest voxel: less is noise
_BESIDE_VOXELS = 2.0  # a block that far from any surface has no part in it
# Open3D bounds rays in cells of so many px, and reads past the last whole one: pictures are cast in whole cells.
_RANGE_PX = 8


def open3d() -> Any:
    """Import Open3D; raises MissingDependencyError naming the extra."""
    try:
        import open3d
    except ImportError:
        raise MissingDependencyError("3D models need the extra: pip install 'chromaperture[reconstruct]'") from None
    # Open3D brings a TBB of its own that Numba finds, thinks too old, and warns about: let it look at the others first.
    numba.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]  # type: ignore[attr-defined]
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d


@dataclass(frozen=True)
class Mesh:
    """Triangles in mm, world frame: vertices (N, 3) float32, triangles (M, 3) int32, colors (N, 3) uint8 sRGB."""

    vertices_mm: np.ndarray
    triangles: np.ndarray
    colors: np.ndarray


def joined(parts: list[tuple[Mesh, np.ndarray]]) -> Mesh:
    """Make one mesh of several, each moved by its (4, 4) pose; surfaces that lie on each other stay double."""
    if len(parts) == 1 and np.array_equal(parts[0][1], np.eye(4)):
        return parts[0][0]
    vertices, triangles, colors, first = [], [], [], 0
    for mesh, pose in parts:
        vertices.append((mesh.vertices_mm @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32))
        triangles.append(mesh.triangles + np.int32(first))
        colors.append(mesh.colors)
        first += len(mesh.vertices_mm)
    return Mesh(np.concatenate(vertices), np.concatenate(triangles), np.concatenate(colors))


class Volume:
    """Voxels near surfaces, in blocks of 16^3.

    Parameters
    ----------
    voxel_mm : float
    truncation_voxels : float
    memory_mb : int
        Fixes the number of blocks; when they are used up, `full` turns true and nothing outside them is fused.
    max_distance_mm : float
    """

    def __init__(self, *, voxel_mm: float, truncation_voxels: float, memory_mb: int, max_distance_mm: float) -> None:
        self.voxel_mm, self.truncation_voxels = voxel_mm, truncation_voxels
        self.max_distance_mm = max_distance_mm
        self.capacity = max(64, memory_mb * 2**20 // BLOCK_BYTES)
        self.blocks, self.full = 0, False
        self._fused, self._asked = 0, np.zeros(self.capacity, np.int64)  # when each block was last fused into
        self._sigma_mm: float | None = None
        o3d = open3d()
        self._o3d, self._core = o3d, o3d.core
        self._device = o3d.core.Device("CPU:0")
        kinds = (o3d.core.float32,) * 3
        self._grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight", "color"), kinds, ((1,), (1,), (3,)), voxel_mm / 1000, EDGE, self.capacity, self._device
        )

    def integrate(self, view: View, camera_matrix: np.ndarray, camera_to_world: np.ndarray) -> int:
        """Fuse a cleaned view; returns the number of blocks that it touched."""
        if not np.isfinite(view.z_mm).any():
            return 0
        keys = self._blocks_of(view.z_mm, camera_matrix, camera_to_world)
        keys = self._with_room(keys)
        if len(keys) == 0:
            return 0
        table = self._grid.hashmap()
        found, _ = table.find(self._core.Tensor(keys, device=self._device))
        slots = found.numpy().astype(np.int64)
        tsdf, weight, color = self._voxels()
        self._fused += 1
        self._asked[slots] = self._fused
        truncation_mm = self.voxel_mm * self.truncation_voxels
        known = np.isfinite(view.z_mm)
        sigma = np.where(known, view.sigma_mm, 1.0)
        if self._sigma_mm is None:
            self._sigma_mm = float(np.median(view.sigma_mm[known]))
        gain = ((self._sigma_mm / np.maximum(sigma, 1e-3)) ** 2).clip(0.05, 4.0)  # inverse variance, 1 is ordinary
        reach_mm = np.clip(_SIGMAS * sigma, 3 * self.voxel_mm, truncation_mm)
        fuse(
            tsdf[..., 0],
            weight[..., 0],
            color,
            slots,
            keys,
            np.ascontiguousarray(view.z_mm, np.float32),
            gain.astype(np.float32),
            reach_mm.astype(np.float32),
            view.color,
            np.asarray(camera_matrix, float),
            np.linalg.inv(camera_to_world),
            self.voxel_mm,
            truncation_mm,
            64.0,
        )
        if self._fused % _PRUNE_EVERY == 0:
            self.prune()
        return len(keys)

    def prune(self, *, rest: int | None = None) -> int:
        """Forget what few views say against many, and blocks that show nothing and no view asked for; returns how many.

        Depth errs, and every frame puts a few of its points where nothing is: behind surfaces, where no view looks
        through them, they would add up to surfaces of their own, and in time to a full volume.
        """
        table = self._grid.hashmap()
        slots = table.active_buf_indices().numpy().astype(np.int64)
        tsdf, weight, color = self._voxels()
        forget_faint(weight[..., 0], slots, _FAINT)
        slots = slots[self._fused - self._asked[slots] >= (_REST if rest is None else rest)]
        reach = _BESIDE_VOXELS / self.truncation_voxels
        empty = slots[~holds_surface(tsdf[..., 0], weight[..., 0], slots, _SHOWN, reach)]
        if len(empty):
            keys = table.key_tensor().numpy()[empty].copy()
            table.erase(self._core.Tensor(keys, device=self._device))
            for values in (tsdf, weight, color):  # the next block in their place begins with nothing
                values[empty] = 0
            self.blocks -= len(empty)
            self.full = False
        return len(empty)

    def _voxels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        tsdf, weight, color = (self._grid.attribute(name).numpy() for name in ("tsdf", "weight", "color"))
        return tsdf, weight, color

    def look(self, camera_matrix: np.ndarray, camera_to_world: np.ndarray, width: int, height: int) -> np.ndarray:
        """Give the distances to the model that a camera would see; (height, width) float32 mm, 0 unknown."""
        keys = self._grid.hashmap().key_tensor()[self._grid.hashmap().active_buf_indices().to(self._core.int64)]
        if len(keys) == 0:
            return np.zeros((height, width), np.float32)
        seen = self._grid.ray_cast(
            keys,
            self._tensor(camera_matrix),
            self._tensor(_metres(np.linalg.inv(camera_to_world))),
            -(-width // _RANGE_PX) * _RANGE_PX,
            -(-height // _RANGE_PX) * _RANGE_PX,
            ["depth", "index", "mask", "interp_ratio"],
            depth_scale=1000.0,
            depth_min=0.05,
            depth_max=self.max_distance_mm / 1000,
            weight_threshold=_SEEN / 2,
            trunc_voxel_multiplier=self.truncation_voxels,
            range_map_down_factor=_RANGE_PX,
        )
        z_mm = seen["depth"].numpy()[..., 0]
        z_mm = np.where(z_mm > 0, z_mm + self._left_mm(seen), 0).astype(np.float32)
        return z_mm[:height, :width].copy()

    def _left_mm(self, seen: Any) -> np.ndarray:
        """Distance from the points of a ray cast to the surface: Open3D's stop about a voxel behind it."""
        tsdf = self._grid.attribute("tsdf").numpy().reshape(-1)
        share = np.where(seen["mask"].numpy(), seen["interp_ratio"].numpy(), 0.0)
        distance = np.einsum("hwn,hwn->hw", tsdf[seen["index"].numpy()], share) / np.maximum(share.sum(axis=2), 1e-6)
        left_mm = distance * self.truncation_voxels * self.voxel_mm
        return left_mm.clip(-2 * self.voxel_mm, 2 * self.voxel_mm)

    def mesh(self, *, min_weight: float = _SHOWN) -> Mesh:
        """Extract the surface where enough was seen."""
        empty = Mesh(np.empty((0, 3), np.float32), np.empty((0, 3), np.int32), np.empty((0, 3), np.uint8))
        if self.blocks == 0:
            return empty
        found = self._grid.extract_triangle_mesh(min_weight)
        if "positions" not in found.vertex or len(found.vertex.positions) == 0 or "indices" not in found.triangle:
            return empty
        colors = np.rint(np.clip(found.vertex.colors.numpy(), 0.0, 1.0) * 255).astype(np.uint8)
        vertices = (found.vertex.positions.numpy() * 1000).astype(np.float32)
        return Mesh(vertices, found.triangle.indices.numpy().astype(np.int32), colors)

    def _blocks_of(self, z_mm: np.ndarray, camera_matrix: np.ndarray, camera_to_world: np.ndarray) -> np.ndarray:
        image = self._o3d.t.geometry.Image(self._core.Tensor(np.nan_to_num(z_mm).astype(np.float32)))
        keys = self._grid.compute_unique_block_coordinates(
            image,
            self._tensor(camera_matrix),
            self._tensor(_metres(np.linalg.inv(camera_to_world))),
            1000.0,
            self.max_distance_mm / 1000,
            self.truncation_voxels,
        )
        return keys.numpy().copy()

    def _with_room(self, keys: np.ndarray) -> np.ndarray:
        """Activate the blocks that are new, as far as the memory goes; gives those that can be used."""
        table = self._grid.hashmap()
        _, known = table.find(self._core.Tensor(keys, device=self._device))
        fresh = np.flatnonzero(~known.numpy())
        room = self.capacity - self.blocks
        if len(fresh) > room:
            self.full = True
            left_out = fresh[room:]
            keys = np.delete(keys, left_out, axis=0)
            fresh = fresh[:room]
            fresh = np.flatnonzero(~table.find(self._core.Tensor(keys, device=self._device))[1].numpy())
        if len(fresh):
            table.activate(self._core.Tensor(np.ascontiguousarray(keys[fresh]), device=self._device))
            self.blocks += len(fresh)
        return np.ascontiguousarray(keys)

    def _tensor(self, values: np.ndarray) -> Any:
        return self._core.Tensor(np.ascontiguousarray(values, np.float64), device=self._core.Device("CPU:0"))


def _metres(pose_mm: np.ndarray) -> np.ndarray:
    pose = np.array(pose_mm, float)
    pose[:3, 3] /= 1000
    return pose

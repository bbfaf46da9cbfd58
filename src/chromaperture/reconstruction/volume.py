"""Signed-distance volume of fixed memory on Open3D's voxel blocks: fuse, ray cast, extract a mesh.

The package uses millimetres, Open3D metres; this file converts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from chromaperture.products.rectified import View
from chromaperture.reconstruction.ray_casting import EDGE, cast_rays, enlarged_distances, table_of
from chromaperture.reconstruction.tracking import scaled
from chromaperture.system.compilation import compiled
from chromaperture.system.errors import needed
from chromaperture.system.threads import in_parallel

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


BLOCK_BYTES = EDGE**3 * 4 * 5  # tsdf, weight, three colours
# Chosen by hand; not tuned. Weight 1 is a pixel of the first view's median standard deviation.
_KNOWN_WEIGHT = 0.01  # from which a voxel is used by a ray
_MESH_WEIGHT = 1.5  # from which the mesh has a surface
_MIN_GAIN, _MAX_GAIN, _MAX_WEIGHT = 0.05, 4.0, 64.0  # weight of a pixel; and of a voxel, so that the mean keeps moving
_SIGMAS = 3.0  # truncation of the signed distance, standard deviations
PRUNE_EVERY, MIN_AGE = 32, 128  # views fused between two prunings, and since a block was updated until it may be erased
_FAINT = 0.1  # of the largest weight in a block, below which a voxel is noise
_BESIDE_VOXELS = 2.0  # a block that far from any surface has no part in it


def open3d() -> Any:
    """Import Open3D; raises MissingDependencyError naming the extra."""
    open3d = needed("open3d", "3D models need the extra: pip install 'chromaperture[reconstruct]'")
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d


@dataclass(frozen=True)
class Mesh:
    """Triangles in mm, world frame: vertices (N, 3) float32, triangles (M, 3) int32, colors (N, 3) uint8 sRGB."""

    vertices_mm: np.ndarray
    triangles: np.ndarray
    colors: np.ndarray


def joined(parts: list[tuple[Mesh, np.ndarray]]) -> Mesh:
    """Join meshes, each moved by its (4, 4) pose; coincident surfaces stay double."""
    if len(parts) == 1 and np.array_equal(parts[0][1], np.eye(4)):
        return parts[0][0]
    first = np.cumsum([0, *(len(mesh.vertices_mm) for mesh, _ in parts)], dtype=np.int32)
    vertices = [(mesh.vertices_mm @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32) for mesh, pose in parts]
    triangles = [mesh.triangles + number for (mesh, _), number in zip(parts, first, strict=False)]
    return Mesh(np.concatenate(vertices), np.concatenate(triangles), np.concatenate([mesh.colors for mesh, _ in parts]))


def in_order(mesh: Mesh) -> Mesh:
    """Sort vertices by position and colour, triangles by their vertices; Open3D's order changes from run to run."""
    order = np.lexsort((*mesh.colors.T, *mesh.vertices_mm.T))
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    triangles = rank[mesh.triangles]
    first = triangles.argmin(axis=1)[:, None]  # each begins with its first vertex; which side is its front stays
    triangles = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    return Mesh(mesh.vertices_mm[order], triangles[np.lexsort(triangles.T[::-1])], mesh.colors[order])


class Volume:
    """Voxels near surfaces, in blocks of 16^3, on Open3D's ``grid``, in metres; `full` when they are used up."""

    def __init__(self, *, voxel_mm: float, truncation_voxels: float, memory_mb: int, max_distance_mm: float) -> None:
        self.voxel_mm, self.truncation_voxels = voxel_mm, truncation_voxels
        self.max_distance_mm = max_distance_mm
        self.capacity = max(64, memory_mb * 2**20 // BLOCK_BYTES)
        self.blocks, self.full = 0, False
        self._views, self._updated = 0, np.zeros(self.capacity, np.int64)  # number fused; that at a block's last update
        self._sigma_mm: float | None = None
        o3d = open3d()
        self._o3d, self._core = o3d, o3d.core
        self._device = o3d.core.Device("CPU:0")
        kinds = (o3d.core.float32,) * 3
        self.grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight", "color"), kinds, ((1,), (1,), (3,)), voxel_mm / 1000, EDGE, self.capacity, self._device
        )

    def integrate(self, view: View, camera_matrix: np.ndarray, camera_to_world: np.ndarray) -> int:
        """Fuse a cleaned view; returns the number of blocks updated."""
        if not np.isfinite(view.z_mm).any():
            return 0
        keys = self._blocks_of(view.z_mm, camera_matrix, camera_to_world)
        keys = self._with_room(keys)
        if len(keys) == 0:
            return 0
        table = self.grid.hashmap()
        found, _ = table.find(self._core.Tensor(keys, device=self._device))
        slots = found.numpy().astype(np.int64)
        voxels = self._voxels()
        self._views += 1
        self._updated[slots] = self._views
        truncation_mm = self.voxel_mm * self.truncation_voxels
        known = np.isfinite(view.z_mm)
        sigma = np.where(known, view.sigma_mm, 1.0)
        if self._sigma_mm is None:
            self._sigma_mm = float(np.median(view.sigma_mm[known]))
        weight = ((self._sigma_mm / np.maximum(sigma, 1e-3)) ** 2).clip(_MIN_GAIN, _MAX_GAIN)  # inverse variance
        behind_mm = np.clip(_SIGMAS * sigma, 3 * self.voxel_mm, truncation_mm)
        z_mm, gain, reach_mm = (np.ascontiguousarray(m, np.float32) for m in (view.z_mm, weight, behind_mm))
        matrix, to_camera = np.asarray(camera_matrix, float), np.linalg.inv(camera_to_world)
        pixels = Pixels(z_mm, gain, reach_mm, view.color, matrix, to_camera)
        limits = (self.voxel_mm, truncation_mm, _MAX_WEIGHT)
        in_parallel(lambda _, a, b: fuse(voxels, slots[a:b], keys[a:b], pixels, *limits), len(slots))
        if self._views % PRUNE_EVERY == 0:
            self.prune()
        return len(keys)

    def prune(self, *, min_age: int | None = None) -> int:
        """Clear faint voxels and erase idle blocks without surface, which wrong points fill; returns their number."""
        table = self.grid.hashmap()
        slots = table.active_buf_indices().numpy().astype(np.int64)
        voxels = self._voxels()
        clear_faint(voxels.weight, slots, _FAINT)
        slots = slots[self._views - self._updated[slots] >= (MIN_AGE if min_age is None else min_age)]
        reach = _BESIDE_VOXELS / self.truncation_voxels
        empty = slots[~holds_surface(voxels.tsdf, voxels.weight, slots, _MESH_WEIGHT, reach)]
        if len(empty):
            keys = table.key_tensor().numpy()[empty].copy()
            table.erase(self._core.Tensor(keys, device=self._device))
            for values in voxels:  # the next block in their place begins empty
                values[empty] = 0
            self.blocks -= len(empty)
            self.full = False
        return len(empty)

    def _voxels(self) -> Voxels:
        tsdf, weight, color = (self.grid.attribute(name).numpy() for name in ("tsdf", "weight", "color"))
        return Voxels(tsdf[..., 0], weight[..., 0], color)

    def ray_cast(
        self, camera_matrix: np.ndarray, camera_to_world: np.ndarray, width: int, height: int, *, reduced: int = 1
    ) -> np.ndarray:
        """Return the model's distances in a camera's picture, (height, width) mm, a ray every ``reduced`` px."""
        table = self.grid.hashmap()
        slots = table.active_buf_indices().numpy().astype(np.int64)
        voxels = self._voxels()
        z_mm = cast_rays(
            (voxels.tsdf, voxels.weight), table_of(table.key_tensor().numpy()[slots], slots),
            scaled(camera_matrix, reduced), np.asarray(camera_to_world, float),
            (-(-height // reduced), -(-width // reduced)),
            voxel_mm=self.voxel_mm, truncation_mm=self.voxel_mm * self.truncation_voxels,
            max_distance_mm=self.max_distance_mm, min_weight=_KNOWN_WEIGHT,
        )  # fmt: skip
        return z_mm if reduced == 1 else enlarged_distances(z_mm, reduced, (height, width))

    def mesh(self, *, min_weight: float = _MESH_WEIGHT, ordered: bool = True) -> Mesh:
        """Extract the surface where voxels have that weight, see `in_order`."""
        empty = Mesh(np.empty((0, 3), np.float32), np.empty((0, 3), np.int32), np.empty((0, 3), np.uint8))
        if self.blocks == 0:
            return empty
        found = self.grid.extract_triangle_mesh(min_weight)
        if "positions" not in found.vertex or len(found.vertex.positions) == 0 or "indices" not in found.triangle:
            return empty
        colors = np.rint(np.clip(found.vertex.colors.numpy(), 0.0, 1.0) * 255).astype(np.uint8)
        vertices = (found.vertex.positions.numpy() * 1000).astype(np.float32)
        mesh = Mesh(vertices, found.triangle.indices.numpy().astype(np.int32), colors)
        return in_order(mesh) if ordered else mesh

    def _blocks_of(self, z_mm: np.ndarray, camera_matrix: np.ndarray, camera_to_world: np.ndarray) -> np.ndarray:
        image = self._o3d.t.geometry.Image(self._core.Tensor(np.nan_to_num(z_mm).astype(np.float32)))
        camera, farthest_m = self._camera(camera_matrix, camera_to_world), self.max_distance_mm / 1000
        keys = self.grid.compute_unique_block_coordinates(image, *camera, 1000.0, farthest_m, self.truncation_voxels)
        found = keys.numpy()
        return found[np.lexsort(found.T)]  # when not all have room, the same are left out in every run

    def _with_room(self, keys: np.ndarray) -> np.ndarray:
        """Activate new blocks as far as the memory allows; returns the keys of those that can be used."""
        table = self.grid.hashmap()
        _, known = table.find(self._core.Tensor(keys, device=self._device))
        fresh = np.flatnonzero(~known.numpy())
        room = self.capacity - self.blocks
        if len(fresh) > room:
            self.full = True
            keys = np.delete(keys, fresh[room:], axis=0)
            fresh = np.flatnonzero(~table.find(self._core.Tensor(keys, device=self._device))[1].numpy())
        if len(fresh):
            table.activate(self._core.Tensor(np.ascontiguousarray(keys[fresh]), device=self._device))
            self.blocks += len(fresh)
        return np.ascontiguousarray(keys)

    def _camera(self, matrix: np.ndarray, camera_to_world: np.ndarray) -> tuple[Any, Any]:
        """Return the camera matrix and the pose, world to camera in metres, as Open3D's tensors."""
        world_to_camera = np.linalg.inv(camera_to_world)
        world_to_camera[:3, 3] /= 1000
        both = (np.ascontiguousarray(m, np.float64) for m in (matrix, world_to_camera))
        intrinsic, extrinsic = (self._core.Tensor(m, device=self._device) for m in both)
        return intrinsic, extrinsic

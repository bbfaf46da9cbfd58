#!/usr/bin/env bash
# Open3D's VoxelBlockGrid: a slanted wall, fused from one exact depth picture and read again as mesh and by ray_cast.
#
# Expected: ray_cast from the pose that was fused gives the wall to a tenth of a voxel, or as far off as the mesh.
# Seen with Open3D 0.20.0 (open3d-cpu): the mesh lies .13 voxels behind the wall from wherever it was seen. The surface
# of ray_cast stands .69 voxels behind it where the camera looks along +z of the world's axes and .54 before it along
# -z; .49 behind along +x and .32 before along -x: it is moved towards + of the world. Tracking against such views is
# led that way.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 open3d-cpu==0.20.0
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import open3d as o3d
from open3d import core

WIDTH, HEIGHT, FOCAL_PX, VOXEL_M, TRUNCATION = 160, 120, 150.0, 1 / 128, 8.0
matrix = np.array([[FOCAL_PX, 0, WIDTH / 2 - 0.5], [0, FOCAL_PX, HEIGHT / 2 - 0.5], [0, 0, 1]])
x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(matrix).T
normal = np.array([0.2, 0.1, 1]) / np.linalg.norm([0.2, 0.1, 1])  # of a wall 1 m from the camera, in its axes
depth_m = (1 / (rays @ normal)).astype(np.float32)


def behind_wall(points_m):
    """Mean distance of points in the camera's axes, in voxels."""
    return float(np.mean(points_m @ normal - 1)) / VOXEL_M


def read_again(world_to_camera):
    kinds = (core.float32, core.float32)
    grid = o3d.t.geometry.VoxelBlockGrid(("tsdf", "weight"), kinds, ((1), (1)), VOXEL_M, 16, 6000)
    camera, picture = (core.Tensor(matrix), core.Tensor(world_to_camera)), o3d.t.geometry.Image(depth_m[..., None])
    limits = {"depth_scale": 1.0, "depth_max": 3.0, "trunc_voxel_multiplier": TRUNCATION}
    blocks = grid.compute_unique_block_coordinates(picture, *camera, **limits)
    grid.integrate(blocks, picture, *camera, **limits)
    seen = grid.ray_cast(
        blocks, *camera, WIDTH, HEIGHT, ["depth"], 1.0, 0.1, 3.0, 0.5, trunc_voxel_multiplier=TRUNCATION
    )["depth"].numpy()
    mesh = grid.extract_triangle_mesh(weight_threshold=0.5).vertex.positions.numpy()
    in_camera = mesh @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    known = seen[..., 0] > 0
    assert known.mean() > 0.95, "rays miss the wall"
    return behind_wall(in_camera), behind_wall((rays * seen)[known])


found = {}
for view, turn in (
    ("+z", np.eye(3)), ("-z", np.diag([-1, 1, -1])),
    ("+x", np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]])), ("-x", np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])),
):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, (0.013, 0.007, 0.003)
    found[view] = read_again(pose)
    print(f"seen along {view}: mesh {found[view][0]:.2f} voxels behind the wall, ray_cast {found[view][1]:.2f}")
for view, (mesh, ray_cast) in found.items():
    assert abs(mesh - 0.13) < 0.02, f"the mesh lies elsewhere along {view}"
    assert 0.25 < (ray_cast if view.startswith("+") else -ray_cast) < 0.8, f"ray_cast lies elsewhere along {view}"
PYTHON

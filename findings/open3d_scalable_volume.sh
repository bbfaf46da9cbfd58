#!/usr/bin/env bash
# Open3D's ScalableTSDFVolume, the volume of its older pipeline, with one picture of a wall a metre away.
#
# Expected: integrate fills voxels near the wall, as UniformTSDFVolume does, and as it did in the version before.
# Seen with Open3D 0.20.0 (open3d-cpu): nothing is fused, without a warning: no voxels, points or triangles, with and
# without colour, at voxels of 5 to 50 mm, at strides of 1 and 4. UniformTSDFVolume gives 16,590 triangles of the same
# picture, and so did ScalableTSDFVolume in 0.19.0.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for version in 0.20.0 0.19.0; do
    python3 -m venv "$folder/$version"
    "$folder/$version/bin/pip" install -q numpy==2.4.6 "open3d-cpu==$version"
    "$folder/$version/bin/python" - <<'PYTHON'
import itertools

import numpy as np
import open3d as o3d
from open3d.pipelines.integration import ScalableTSDFVolume, TSDFVolumeColorType, UniformTSDFVolume

WIDTH, HEIGHT, FOCAL_PX, WALL_MM = 160, 120, 150.0, 1003
camera = o3d.camera.PinholeCameraIntrinsic(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5)
depth = o3d.geometry.Image(np.full((HEIGHT, WIDTH), WALL_MM, np.uint16))
color = o3d.geometry.Image(np.full((HEIGHT, WIDTH, 3), 128, np.uint8))
picture = o3d.geometry.RGBDImage.create_from_color_and_depth(
    color, depth, depth_scale=1000, depth_trunc=3, convert_rgb_to_intensity=False
)


def fused(volume):
    volume.integrate(picture, camera, np.eye(4))
    return (
        len(volume.extract_voxel_point_cloud().points), len(volume.extract_point_cloud().points),
        len(volume.extract_triangle_mesh().triangles),
    )


uniform = fused(UniformTSDFVolume(3, 300, 0.04, TSDFVolumeColorType.RGB8, origin=np.array([-1.5, -1.5, 0.0])))
kinds = itertools.product((0.005, 0.01, 0.05), (TSDFVolumeColorType.RGB8, TSDFVolumeColorType.NoColor), (1, 4))
scalable = {
    (voxel_m, str(kind), stride): fused(ScalableTSDFVolume(voxel_m, 4 * voxel_m, kind, depth_sampling_stride=stride))
    for voxel_m, kind, stride in kinds
}
usual = scalable[0.01, str(TSDFVolumeColorType.RGB8), 4]
print(f"Open3D {o3d.__version__}: voxels, points and triangles: uniform {uniform}, scalable {usual}")
assert uniform[1:] == (8480, 16590), "the uniform volume gives something else"
if o3d.__version__ == "0.19.0":
    assert usual[1:] == uniform[1:], "the scalable volume of 0.19.0 gives something else"
else:
    assert set(scalable.values()) == {(0, 0, 0)}, "the scalable volume fuses now"
PYTHON
done

"""The compiled kernels of the 3D model and of the nearest known pixel against their readable twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from chromaperture.color.alignment import fill_from_nearest
from chromaperture.reconstruction.ray_casting import CELL_PX, cast_rays, ray_ends, table_of
from chromaperture.reconstruction.volume import Pixels, Voxels, clear_faint, fuse, holds_surface
from readable_reconstruction import EDGE, dense, first_surface, fused, nearest_known, voxel_places

VOXEL_MM, TRUNCATION_MM = 10.0, 60.0
SIZE = (26, 35)  # not whole cells of rays
MATRIX = np.array([[40.0, 0, 16.6], [0, 42.0, 13.1], [0, 0, 1]])
SEEDS = st.integers(0, 10_000)


def pose_of(rng: np.random.Generator) -> np.ndarray:
    """A camera near the origin that looks about along z."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.15, 3)).as_matrix()
    pose[:3, 3] = rng.normal(0, 30, 3)
    return pose


def keys_around(center_mm: np.ndarray, reach: int) -> np.ndarray:
    """All blocks within so many of a place, (N, 3) int32."""
    middle = np.floor(center_mm / (EDGE * VOXEL_MM)).astype(int)
    return (np.stack(np.indices((2 * reach + 1,) * 3), -1).reshape(-1, 3) - reach + middle).astype(np.int32)


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.integers(1, 17), st.integers(1, 23), st.floats(0, 1), st.sampled_from([np.float32, np.float64]))
def test_unknown_pixels_take_the_value_of_a_nearest_known_one(seed, height, width, unknown, kind):
    rng = np.random.default_rng(seed)
    values = rng.permutation(height * width).reshape(height, width).astype(kind)  # each tells where it was
    hidden = rng.uniform(size=values.shape) < unknown
    hidden.flat[rng.integers(values.size)] = False
    values[hidden] = np.nan
    filled = fill_from_nearest(values)
    assert filled.dtype == kind
    np.testing.assert_array_equal(filled[~hidden], values[~hidden])
    allowed = nearest_known(values)
    assert all(filled[y, x] in allowed[y][x] for y, x in np.argwhere(hidden))


def view_of(rng: np.random.Generator, pose: np.ndarray) -> Pixels:
    """A slanted wall with a step, noise, unknown pixels and weights that differ."""
    y, x = np.indices(SIZE)
    z_mm = 700 + 3.0 * x - 2.0 * y + 150 * (x > SIZE[1] * rng.uniform(0.2, 0.8)) + rng.normal(0, 2, SIZE)
    z_mm[rng.uniform(size=SIZE) < 0.1] = np.nan
    gain = rng.uniform(0.05, 4, SIZE)
    reach_mm = rng.uniform(20, 60, SIZE)
    color = rng.integers(0, 256, (*SIZE, 3), np.uint8)
    maps = (part.astype(np.float32) for part in (z_mm, gain, reach_mm))
    return Pixels(*maps, color, MATRIX, np.linalg.inv(pose))


@settings(max_examples=8, deadline=None)
@given(SEEDS)
def test_views_are_fused_as_by_the_readable_twin(seed):
    rng = np.random.default_rng(seed)
    keys = keys_around(np.array([0, 0, 750.0]), 1)
    keys = keys[rng.permutation(len(keys))]
    slots = rng.permutation(len(keys) + 5)[: len(keys)]
    shape = (len(keys) + 5, EDGE, EDGE, EDGE)
    voxels = Voxels(*(np.zeros((*shape, *more), np.float32) for more in ((), (), (3,))))
    expected = tuple(np.zeros((len(keys), *part.shape[1:])) for part in voxels)
    doubtful, changed = np.zeros((len(keys), EDGE, EDGE, EDGE), bool), 0
    for _ in range(3):
        view = view_of(rng, pose_of(rng))
        fuse(voxels, slots, keys, view, VOXEL_MM, TRUNCATION_MM, 6.0)
        *expected, unsure = fused(expected, keys, view, VOXEL_MM, TRUNCATION_MM, 6.0)
        doubtful |= unsure
    changed = (expected[1] > 0) & ~doubtful
    assert changed.mean() > 0.05
    assert doubtful.mean() < 0.05
    sure = ~doubtful
    # Places of 32 bits: 700 mm to 1e-4 mm, of a truncation of 60; weights and shares are sums and quotients of order 1.
    np.testing.assert_allclose(voxels.tsdf[slots][sure], expected[0][sure], atol=1e-4)
    np.testing.assert_allclose(voxels.weight[slots][sure], expected[1][sure], rtol=1e-5)
    np.testing.assert_allclose(voxels.color[slots][sure], expected[2][sure], atol=0.01)
    others = np.setdiff1d(np.arange(len(keys) + 5), slots)
    assert not any(part[others].any() for part in voxels)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.floats(0.0625, 1, width=32), st.floats(0.02, 0.5))  # reach in 32 bits, as the distances
def test_blocks_with_a_surface_and_faint_voxels_are_those_of_numpy(seed, reach, fraction):
    rng = np.random.default_rng(seed)
    tsdf = rng.uniform(-1, 1, (9, EDGE, EDGE, EDGE)).astype(np.float32)
    tsdf[rng.uniform(size=9) < 0.5] = 0.999  # air
    weight = (rng.uniform(0, 3, tsdf.shape) * rng.uniform(0, 1, (9, 1, 1, 1))).astype(np.float32)
    slots = rng.permutation(9)[:6]
    expected = ((weight >= 1) & (np.abs(tsdf) <= reach)).any(axis=(1, 2, 3))[slots]
    np.testing.assert_array_equal(holds_surface(tsdf, weight, slots, 1.0, reach), expected)
    strongest = weight.max(axis=(1, 2, 3), keepdims=True)
    is_faint = (weight < fraction * strongest.astype(float)) & np.isin(np.arange(9), slots)[:, None, None, None]
    cleared = weight.copy()
    clear_faint(cleared, slots, fraction)
    np.testing.assert_array_equal(cleared, np.where(is_faint, np.float32(0), weight))


def ball_and_wall(rng: np.random.Generator, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance and weight of a ball before a slanted wall, unknown far behind both."""
    places = voxel_places(keys) * VOXEL_MM
    normal = np.array([*rng.normal(0, 0.2, 2), -1.0])
    normal /= np.linalg.norm(normal)
    wall = (places - (0, 0, 800)) @ normal
    ball = np.linalg.norm(places - (*rng.uniform(-60, 60, 2), 650), axis=-1) - 90
    distance = np.minimum(wall, ball)
    return np.clip(distance / TRUNCATION_MM, -1, 1), np.where(distance > -TRUNCATION_MM, 2.0, 0.0)


@settings(max_examples=6, deadline=None)
@given(SEEDS)
def test_rays_end_where_small_steps_between_voxels_find_the_surface(seed):
    rng = np.random.default_rng(seed)
    keys = keys_around(np.array([0, 0, 720.0]), 2)
    tsdf, weight = ball_and_wall(rng, keys)
    slots = rng.permutation(len(keys)).astype(np.int64)
    voxels = tuple(np.empty(part.shape, np.float32) for part in (tsdf, weight))
    for stored, part in zip(voxels, (tsdf, weight), strict=True):
        stored[slots] = part
    pose = pose_of(rng)
    found = cast_rays(
        voxels, table_of(keys, slots), MATRIX, pose, SIZE,
        voxel_mm=VOXEL_MM, truncation_mm=TRUNCATION_MM, max_distance_mm=2000.0, min_weight=1.0,
    )  # fmt: skip
    box = dense(keys, tsdf, weight, 1.0)
    expected = np.empty(SIZE)
    for y, x in np.ndindex(SIZE):
        slope = pose[:3, :3] @ ((x - MATRIX[0, 2]) / MATRIX[0, 0], (y - MATRIX[1, 2]) / MATRIX[1, 1], 1.0)
        expected[y, x] = first_surface(box, pose[:3, 3], slope, 1400.0, VOXEL_MM)
    assume(np.isfinite(expected).mean() > 0.2)  # some poses look past the box
    both = np.isfinite(expected) & np.isfinite(found)
    # Rays that graze the ball, or the border of what is known, meet a surface in one of the two only, or another one.
    assert (np.isfinite(expected) != np.isfinite(found)).mean() < 0.03
    # Found: 2e-6 voxels in the median, 1e-3 at the 95th hundredth, where the ball bends within a step.
    gap = np.abs(expected - found)[both]
    assert np.median(gap) < 1e-4 * VOXEL_MM
    assert np.quantile(gap, 0.95) < 0.01 * VOXEL_MM


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_no_place_in_a_block_lies_beyond_the_ends_of_its_ray(seed):
    rng = np.random.default_rng(seed)
    keys = rng.integers(-4, 5, (12, 3)).astype(np.int32)
    edge_mm, world_to_camera = EDGE * VOXEL_MM, np.linalg.inv(pose_of(rng))
    ends = ray_ends(keys, MATRIX, world_to_camera, SIZE, edge_mm)
    places = (keys[:, None, :] + rng.uniform(0, 1, (len(keys), 200, 3))).reshape(-1, 3) * edge_mm
    x, y, z = (places @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        column, row = np.rint(MATRIX[0, 0] * x / z + MATRIX[0, 2]), np.rint(MATRIX[1, 1] * y / z + MATRIX[1, 2])
    seen = (z > 0) & (column >= 0) & (column < SIZE[1]) & (row >= 0) & (row < SIZE[0])
    near, far = (end[row[seen].astype(int) // CELL_PX, column[seen].astype(int) // CELL_PX] for end in ends)
    assert (near <= z[seen]).all()
    assert (z[seen] <= far).all()


def test_a_picture_without_blocks_has_no_surface():
    nothing = np.zeros((1, EDGE, EDGE, EDGE), np.float32)
    none = table_of(np.zeros((0, 3), np.int32), np.zeros(0, np.int64))
    found = cast_rays(
        (nothing, nothing), none, MATRIX, np.eye(4), SIZE,
        voxel_mm=VOXEL_MM, truncation_mm=TRUNCATION_MM, max_distance_mm=2000.0, min_weight=1.0,
    )  # fmt: skip
    assert np.isnan(found).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1)])
def test_a_single_known_pixel_fills_the_picture(shape):
    values = np.full(shape, np.nan, np.float32)
    values.flat[-1] = 7.0
    np.testing.assert_array_equal(fill_from_nearest(values), np.full(shape, np.float32(7.0)))

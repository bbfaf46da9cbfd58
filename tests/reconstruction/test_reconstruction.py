"""A textured room of known planes is photographed from known places; the reconstruction gives both back."""

from __future__ import annotations

import json
import sys

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from chromaperture.capture.open import open_source
from chromaperture.cli.reconstruct import _announced
from chromaperture.products.rectified import View
from chromaperture.products.samples import sample_camera, sample_image
from chromaperture.reconstruction.build_model import glb, quaternion, write_mesh_ply
from chromaperture.reconstruction.fusion import Reconstruction, orthonormal
from chromaperture.reconstruction.ray_casting import enlarged_distances, table_of
from chromaperture.reconstruction.settings import ReconstructionConfig
from chromaperture.reconstruction.tracking import cleaned, near_steps, prepare, track
from chromaperture.reconstruction.volume import Mesh, Volume, in_order
from chromaperture.system.errors import InputError

MATRIX = np.array([[160.0, 0, 119.5], [0, 160.0, 89.5], [0, 0, 1]])
SIZE = (180, 240)
# Normal and offset of three walls of a room: n . x = c, mm.
WALLS = ((np.array([0.0, 0, 1]), 2200.0), (np.array([0.0, 1, 0]), 600.0), (np.array([0.8, 0, 0.6]), 1700.0))


def texture(points: np.ndarray) -> np.ndarray:
    """Smooth colours that repeat nowhere in the room; (N, 3) 0..255."""
    rng = np.random.default_rng(5)
    waves = rng.normal(0, 1 / 60, (24, 3))
    values = np.sin(points @ waves.T + rng.uniform(0, 6, 24)) @ rng.normal(0, 14, (24, 3))
    return np.clip(128 + values, 0, 255)


def photograph(pose: np.ndarray, *, noise: float = 0.0, seed: int = 0, index: int = 0) -> View:
    """Trace a ray through every pixel to the nearest wall; depth is spoilt by correlated relative noise."""
    v, u = np.indices(SIZE).reshape(2, -1)
    rays = np.linalg.inv(MATRIX) @ np.array([u, v, np.ones(u.size)])
    turned, start = pose[:3, :3] @ rays, pose[:3, 3]
    z = np.full(u.size, np.inf)
    for normal, offset in WALLS:
        slope = normal @ turned
        with np.errstate(divide="ignore"):
            hit = (offset - normal @ start) / slope
        z = np.where((hit > 0) & (hit < z), hit, z)
    color = texture((turned * z + start[:, None]).T).reshape(*SIZE, 3)
    z = z.reshape(SIZE)
    if noise:
        grain = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, SIZE), (0, 0), 3.0)
        z = z * (1 + noise * grain / grain.std())
    sigma = np.full(SIZE, max(noise, 0.002)) * z
    return View(np.rint(color).astype(np.uint8), z.astype(np.float32), sigma.astype(np.float32), index / 30, index)


def pose_at(k: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("yxz", [1.2 * k, 0.6 * k, 0.3 * k], degrees=True).as_matrix()
    pose[:3, 3] = 22 * k, 10 * np.sin(k), 4 * k
    return pose


def plane(z_mm: float, sigma_mm: float) -> View:
    grey = np.full((*SIZE, 3), 100, np.uint8)
    return View(grey, np.full(SIZE, z_mm, np.float32), np.full(SIZE, sigma_mm, np.float32))


def reconstruction(**changes) -> tuple[Reconstruction, list[str]]:
    """A model that is tracked at full size, and what it says."""
    said: list[str] = []
    config = ReconstructionConfig(**{"tracking_scale": 1, "voxel_mm": 15.0} | changes)
    return Reconstruction(MATRIX, config, listener=said.append), said


def tracked(first: View, then: View, guess: np.ndarray | None = None):
    """The pose of a view by a keyframe at the first place, from a guess, else from that place."""
    config = ReconstructionConfig(tracking_scale=1)
    keyframe = prepare(first, MATRIX, config).keyframe(pose_at(0))
    return track(prepare(then, MATRIX, config), keyframe, pose_at(0) if guess is None else guess, config=config)


def off_mm(pose: np.ndarray, expected: np.ndarray) -> float:
    """Distance between two places of a camera."""
    return float(np.linalg.norm((pose - expected)[:3, 3]))


def from_first(k: float) -> np.ndarray:
    """Pose of a camera in the world of a model, which is the first camera's."""
    return np.linalg.inv(pose_at(0)) @ pose_at(k)


def small_volume(**changes) -> Volume:
    settings = {"voxel_mm": 10.0, "truncation_voxels": 8.0, "memory_mb": 128, "max_distance_mm": 6000.0}
    return Volume(**settings | changes)


@pytest.mark.extra("reconstruct", "open3d")
def test_our_fusion_is_open3ds_where_all_pixels_weigh_the_same():
    import open3d as o3d

    view = photograph(pose_at(2.0))
    ours = small_volume()
    ours.integrate(View(view.color, view.z_mm, np.full(SIZE, 50.0, np.float32)), MATRIX, pose_at(2.0))
    core, theirs = o3d.core, small_volume().grid
    image = o3d.t.geometry.Image(core.Tensor(view.z_mm))
    extrinsic = np.linalg.inv(pose_at(2.0))
    extrinsic[:3, 3] /= 1000
    pinhole, outside = core.Tensor(MATRIX), core.Tensor(extrinsic)
    keys = theirs.compute_unique_block_coordinates(image, pinhole, outside, 1000.0, 6.0, 8.0)
    color = o3d.t.geometry.Image(core.Tensor(view.color.astype(np.float32) / 255))
    theirs.integrate(keys, image, color, pinhole, outside, 1000.0, 6.0, 8.0)

    def voxels(grid, name):
        slots, found = grid.hashmap().find(keys)
        assert found.numpy().all()
        return grid.attribute(name).numpy()[slots.numpy()]

    seen = (voxels(ours.grid, "weight") > 0) & (voxels(theirs, "weight") > 0)
    assert seen.mean() > 0.1  # else the comparison means little
    gap = np.abs(voxels(ours.grid, "tsdf") - voxels(theirs, "tsdf"))[seen]
    # Which of two pixels a voxel falls on is rounded in other ways: walls are smooth, but for their corners.
    assert np.median(gap) < 5e-3
    assert np.quantile(gap, 0.8) < 0.05


@pytest.mark.extra("reconstruct", "open3d")
def test_surfaces_are_the_inverse_variance_mean_of_what_was_measured():
    volume = small_volume()
    for z, sigma in ((1000.0, 4.0), (1010.0, 8.0)):
        volume.integrate(plane(z, sigma), MATRIX, np.eye(4))
    heights = volume.mesh(min_weight=1.0).vertices_mm[:, 2]
    mean = np.average([1000.0, 1010.0], weights=[4.0**-2, 8.0**-2])
    # Both planes reach every voxel near the surface, where signed distance is linear: rounding of float32 is left.
    assert np.median(heights) == pytest.approx(mean, abs=0.05)


@pytest.mark.extra("reconstruct", "open3d")
def test_what_was_seen_once_and_never_shown_is_forgotten():
    wall, ghost = plane(1000.0, 4.0), plane(1600.0, 16.0)  # a sixteenth of the weight
    volume, alone = small_volume(), small_volume()
    for _ in range(3):
        volume.integrate(wall, MATRIX, np.eye(4))
        alone.integrate(wall, MATRIX, np.eye(4))
    blocks, before = volume.blocks, volume.mesh()
    volume.integrate(ghost, MATRIX, np.eye(4))
    assert volume.blocks > blocks
    assert volume.prune(min_age=5) == 0  # it may still be confirmed
    ghosts = volume.blocks - blocks
    # The ghost's own blocks go, and those of the wall's that hold nothing but air before it or behind.
    assert volume.prune(min_age=0) >= ghosts
    assert volume.blocks <= blocks
    np.testing.assert_array_equal(np.sort(volume.mesh().vertices_mm, axis=0), np.sort(before.vertices_mm, axis=0))
    # Blocks that take the place of the forgotten ones remember nothing of them.
    for each in (volume, alone):
        each.integrate(plane(1600.0, 16.0), MATRIX, np.eye(4))
    kinds = [each.mesh(min_weight=0.05).vertices_mm for each in (volume, alone)]
    behind = [np.sort(vertices[vertices[:, 2] > 1300], axis=0) for vertices in kinds]
    np.testing.assert_array_equal(*behind)


@pytest.mark.extra("reconstruct", "open3d")
def test_what_few_say_against_many_is_no_surface():
    volume = small_volume()
    for k in range(30):
        view = plane(1000.0, 4.0)
        if k % 15 == 0:  # two of thirty measure a corner too far, where nobody looks through the wall
            view.z_mm[:60, :60] = 1040.0
        volume.integrate(view, MATRIX, np.eye(4))
    behind = volume.mesh().vertices_mm[:, 2] > 1020
    assert behind.any()  # else this test shows nothing
    volume.prune()
    vertices = volume.mesh().vertices_mm
    assert len(vertices) > 0.5 * len(behind)  # the wall in front is kept
    assert not (vertices[:, 2] > 1020).any()


@pytest.mark.extra("reconstruct", "open3d")
def test_a_camera_that_errs_for_hours_does_not_fill_the_volume(monkeypatch):
    def blocks_over_time() -> list[int]:
        volume, rng, blocks = small_volume(voxel_mm=20.0), np.random.default_rng(0), []
        for _ in range(120):
            view = plane(1500.0, 10.0)
            rows, columns = rng.integers(0, SIZE[0], 12), rng.integers(0, SIZE[1], 12)
            view.z_mm[rows, columns] = rng.uniform(800, 4000, 12)  # a few pixels lie
            view.sigma_mm[rows, columns] = 60.0
            volume.integrate(view, MATRIX, np.eye(4))
            blocks.append(volume.blocks)
        return blocks

    monkeypatch.setattr("chromaperture.reconstruction.volume.MIN_AGE", 16)
    monkeypatch.setattr("chromaperture.reconstruction.volume.PRUNE_EVERY", 8)
    kept = blocks_over_time()
    monkeypatch.setattr("chromaperture.reconstruction.volume.PRUNE_EVERY", 10**9)
    control = blocks_over_time()
    wall = small_volume(voxel_mm=20.0)
    wall.integrate(plane(1500.0, 10.0), MATRIX, np.eye(4))
    # What is kept is the wall and the lies of the last 24 views, a fifth of all, but some repeat themselves.
    assert max(kept[80:]) < 1.2 * max(kept[40:80])
    assert kept[-1] - wall.blocks < 0.5 * (control[-1] - wall.blocks)


@pytest.mark.extra("reconstruct", "open3d")
def test_the_camera_is_found_on_its_way_through_a_room():
    model, _ = reconstruction()
    placed = [model.add(photograph(pose_at(k), noise=0.003, seed=k, index=k)) for k in range(5)]
    # A tenth of a pixel, which is 13 mm wide at 2 m.
    assert max(off_mm(p.pose, from_first(k)) for k, p in enumerate(placed)) < 1.5
    vertices = model.meshes()[0].vertices_mm
    world = vertices @ pose_at(0)[:3, :3].T + pose_at(0)[:3, 3]
    off = np.min([np.abs(world @ n - c) for n, c in WALLS], axis=0)
    assert np.median(off) < 10.0  # of voxels of 15 mm


@pytest.mark.extra("reconstruct", "open3d")
def test_every_second_frame_is_fused_and_every_one_is_tracked(monkeypatch):
    fused: list[int] = []
    integrate = Volume.integrate

    def noted(self, view, *at):
        fused.append(view.index)
        return integrate(self, view, *at)

    monkeypatch.setattr(Volume, "integrate", noted)
    model, _ = reconstruction(fuse_every=2)
    for index in range(7):  # close together: only the first is a keyframe
        placed = model.add(photograph(pose_at(index / 4), index=index))
        assert off_mm(placed.pose, from_first(index / 4)) < 1.5  # a tenth of a pixel, which is 13 mm wide at 2 m
    assert fused == [0, 1, 3, 5]
    assert len(model.current.keyframes) == 1


@pytest.mark.extra("reconstruct", "open3d")
def test_a_ray_finds_the_walls_where_they_are():
    volume = small_volume()
    for k in range(3):
        volume.integrate(photograph(pose_at(k)), MATRIX, pose_at(k))
    for reduced in (1, 2):
        seen = volume.ray_cast(MATRIX, pose_at(0.7), SIZE[1], SIZE[0], reduced=reduced)
        assert np.isfinite(seen).mean() > 0.95
        error = np.abs(seen - photograph(pose_at(0.7)).z_mm)[np.isfinite(seen)]
        # Voxels of 10 mm: flat walls are exact but for the rounding of a voxel to a pixel, edges of the room are round.
        assert np.median(error) < 0.5
        assert np.quantile(error, 0.9) < 3.0
    away = pose_at(0)
    away[:3, :3] = np.diag([-1.0, 1, -1])
    assert np.isnan(volume.ray_cast(MATRIX, away, SIZE[1], SIZE[0])).all()


def test_blocks_are_found_in_a_table_however_many_fall_on_one_place(rng):
    keys = np.unique(rng.integers(-40, 40, (3000, 3)), axis=0).astype(np.int32)
    slots = rng.permutation(len(keys))
    table = table_of(keys, slots)
    used = table.codes >= 0
    assert used.sum() == len(keys)
    np.testing.assert_array_equal(np.sort(table.places[used]), np.arange(len(keys)))


def test_distances_are_enlarged_along_planes_and_not_across_steps():
    rows, columns = np.indices((24, 32), np.float32)
    plane_mm = 1 / (1 / 2000 + columns * 1e-6 + rows * 2e-6)  # planes are linear in 1 / z
    halved = 1 / cv2.resize(1 / plane_mm, (16, 12), interpolation=cv2.INTER_AREA)
    inner = enlarged_distances(halved, 2, plane_mm.shape)[1:-1, 1:-1]  # the border takes its neighbour's
    np.testing.assert_allclose(inner, plane_mm[1:-1, 1:-1], rtol=3e-5)  # OpenCV interpolates in steps of 1/32
    halved[:, 8:] += 500
    halved[:, 12:] = np.nan
    enlarged = enlarged_distances(halved, 2, plane_mm.shape)
    assert np.isfinite(enlarged).sum() == 24 * 24
    steps = np.abs(np.diff(enlarged[:, :24], axis=1))
    assert (steps.max(axis=1) > 450).all()  # one leap, and nothing between
    assert ((steps > 20).sum(axis=1) == 1).all()


@pytest.mark.extra("reconstruct", "open3d")
def test_a_lost_camera_is_said_and_found_again():
    model, said = reconstruction()
    views = [photograph(pose_at(k), index=k) for k in (0, 1, 2)]
    blind = View(views[0].color, np.full(SIZE, np.nan, np.float32), np.full(SIZE, np.nan, np.float32), 0.1, 3)
    placed = [model.add(view) for view in (*views, blind, blind, photograph(pose_at(0.5), index=5))]
    assert [p.pose is None for p in placed] == [False, False, False, True, True, False]
    assert "lost" in said[0]
    assert "found again" in said[1]
    assert len(said) == 2
    assert off_mm(placed[-1].pose, from_first(0.5)) < 1.5  # a tenth of a pixel, as above


@pytest.mark.extra("reconstruct", "open3d")
def test_frames_may_be_dropped_and_the_camera_may_leap_to_where_it_was():
    model, said = reconstruction()
    for k in (0, 1, 2, 6, 8, 13, 16, 17, 2, 0.5, 14):
        placed = model.add(photograph(pose_at(k), index=int(k)))
        assert placed.pose is not None, (k, said)
        assert off_mm(placed.pose, from_first(k)) < 6.0, k  # tenths of a pixel, over the keyframes between
    assert said == []


def test_a_guess_that_is_turned_away_leads_to_the_pose():
    first, then = photograph(pose_at(0)), photograph(pose_at(1.0))
    for across, down in ((-6.0, 0.0), (4.0, 4.0), (0.0, -5.0), (8.0, 0.0)):  # degrees
        guess = pose_at(0)
        guess[:3, :3] = Rotation.from_euler("yx", [across, down], degrees=True).as_matrix() @ guess[:3, :3]
        found = tracked(first, then, guess)
        assert not found.lost, (across, down)
        assert off_mm(found.pose, pose_at(1.0)) < 1.5  # a tenth of a pixel


def behind_bars(pose: np.ndarray, *, seed: int) -> View:
    """The room behind bright bars whose distance is not known: they hide other parts of it from every place."""
    view = photograph(pose)
    v, u = np.indices(SIZE).reshape(2, -1)
    rays, start = pose[:3, :3] @ np.linalg.inv(MATRIX) @ np.array([u, v, np.ones(u.size)]), pose[:3, 3]
    across = start[0] + rays[0] * (900.0 - start[2]) / rays[2]
    middles = np.array([-330.0, -190, -70, 40, 130, 290])
    bar = (np.abs(across - middles[:, None]) < 18).any(axis=0).reshape(SIZE)
    color = np.where(bar[..., None], 200.0, view.color) + np.random.default_rng(seed).normal(0, 5, (*SIZE, 3))
    z_mm, sigma_mm = (np.where(bar, np.float32(np.nan), m) for m in (view.z_mm, view.sigma_mm))
    return View(np.rint(np.clip(color, 0, 255)).astype(np.uint8), z_mm, sigma_mm)


def test_what_hides_a_place_and_has_no_distance_does_not_pull():
    for k in (1.0, 2.0):
        found = tracked(behind_bars(pose_at(0), seed=0), behind_bars(pose_at(k), seed=1))
        assert not found.lost
        # A sixth of a pixel; weights that never fall to nothing leave three times as much.
        assert off_mm(found.pose, pose_at(k)) < 2.0


def test_points_of_uncertain_place_in_the_picture_count_less():
    first, then = photograph(pose_at(0)), photograph(pose_at(6.0))
    wrong = np.zeros(SIZE, bool)
    wrong[:, : SIZE[1] // 2] = True  # half of the keyframe is measured a fifteenth too near, and says so or not
    z_mm = np.where(wrong, first.z_mm * np.float32(14 / 15), first.z_mm)
    errors = []
    for said in (0.14, 0.002):
        sigma_mm = np.where(wrong, np.float32(said), np.float32(0.002)) * z_mm
        spoilt = View(first.color, z_mm, sigma_mm.astype(np.float32))
        errors.append(off_mm(tracked(spoilt, then, pose_at(5.5)).pose, pose_at(6.0)))
    assert errors[0] < 0.7 * errors[1]


def test_parallax_mends_distances_that_are_wrong_alike():
    v, u = np.indices(SIZE)
    wrong = np.float32(1) + (0.05 * np.sin(u / 25) * np.cos(v / 25)).astype(np.float32)
    config = ReconstructionConfig(tracking_scale=1)

    def spoilt(k: float):
        view = photograph(pose_at(k))
        return prepare(View(view.color, view.z_mm * wrong, 0.06 * view.z_mm), MATRIX, config)

    truth = photograph(pose_at(0)).z_mm
    keyframe, blind = (spoilt(0).keyframe(pose_at(0)) for _ in range(2))
    guess, errors = pose_at(0), []
    for k in range(1, 13):
        found, unmended = (track(spoilt(k), key, guess, config=config) for key in (keyframe, blind))
        keyframe.refine(found.points)
        errors.append([off_mm(each.pose, pose_at(k)) for each in (found, unmended)])
        guess = found.pose
    mended, left = np.mean(errors, axis=0)
    assert mended < 0.5 * left
    seen = keyframe.z_mm != blind.z_mm
    before, after = (np.abs(key.z_mm / truth - 1)[seen] for key in (blind, keyframe))
    assert np.median(after) < 0.5 * np.median(before)
    keyframe.set_distances(blind.z_mm)  # the model's distances do not undo it
    np.testing.assert_array_equal(np.abs(keyframe.z_mm / truth - 1)[seen], after)


def test_a_camera_is_found_where_light_has_changed_and_nothing_is_fused():
    first, then = photograph(pose_at(0)), photograph(pose_at(2.0))
    dimmed = View(np.rint(0.7 * then.color + 20).astype(np.uint8), then.z_mm, then.sigma_mm)
    found = tracked(first, dimmed)
    assert not found.lost
    assert off_mm(found.pose, pose_at(2.0)) < 1.5  # 0.16 is found; a tenth of a pixel is 1.3 mm
    assert found.correlation > 0.99  # 0.9996 is found


@pytest.mark.extra("reconstruct", "open3d")
def test_a_place_seen_again_joins_the_submaps():
    model, said = reconstruction(submap_after=1)
    steps = [0, 1, 16, *range(15, 0, -1)]  # a leap out of sight, and the way back
    placed = [model.add(photograph(pose_at(k), index=3 * n)) for n, k in enumerate(steps)]
    assert [p.submap for p in placed[-3:]] == [1, 1, 1]
    assert "joined" in said[-1]
    assert len(model.meshes()) == 1
    for place, k in zip(placed, steps, strict=True):
        if place.pose is not None:
            assert off_mm(model.in_root(place).pose, from_first(k)) < 6.0  # tenths of a pixel, over the keyframes
    world = model.meshes()[0].vertices_mm @ pose_at(0)[:3, :3].T + pose_at(0)[:3, 3]
    assert np.median(np.min([np.abs(world @ n - c) for n, c in WALLS], axis=0)) < 2.0  # mm, as single poses above


@pytest.mark.extra("reconstruct", "open3d")
def test_another_place_begins_a_submap():
    model, _ = reconstruction(submap_after=2)
    model.add(photograph(pose_at(0)))
    far = pose_at(0)
    far[:3, :3] = [[-1, 0, 0], [0, 1, 0], [0, 0, -1]]  # looks the other way
    here = photograph(pose_at(3))
    other = View(here.color[::-1, ::-1].copy(), here.z_mm[::-1, ::-1].copy(), here.sigma_mm, 0, 1)
    placed = [model.add(other) for _ in range(3)]
    assert [p.pose is None for p in placed] == [True, True, False]
    assert placed[-1].submap == 1
    assert len(model.meshes()) == 2


@pytest.mark.extra("reconstruct", "open3d")
def test_a_wall_without_texture_never_raises():
    model, said = reconstruction()
    for _ in range(3):
        placed = model.add(plane(1500.0, 10.0))
    assert placed.pose is None
    assert "lost" in said[0]


@pytest.mark.extra("reconstruct", "open3d")
def test_a_full_volume_is_said_once_and_stays_within_its_memory():
    model, said = reconstruction(voxel_mm=8.0, memory_mb=16)
    for k in range(3):
        model.add(photograph(pose_at(k), index=k))
    volume = model.current.volume
    assert volume.full
    assert volume.blocks <= volume.capacity
    assert volume.grid.hashmap().capacity() == volume.capacity
    assert sum("volume is full" in line for line in said) == 1


def test_steps_are_flying_pixels_and_slopes_are_not():
    slope = (1 / np.linspace(1 / 1000, 1 / 1500, 200, dtype=np.float32))[None].repeat(50, axis=0)
    assert not near_steps(slope, jump=0.04, reach_px=3).any()
    stepped = slope.copy()
    stepped[:, 100:] += 400
    columns = np.flatnonzero(near_steps(stepped, jump=0.04, reach_px=3).any(axis=0))
    np.testing.assert_array_equal(columns, np.arange(97, 103))


def test_wide_error_bars_and_far_points_are_left_out():
    view = plane(1000.0, 10.0)
    view.sigma_mm[:, :50] = 200.0
    view.z_mm[:90] = 9000.0
    kept = np.isfinite(cleaned(view, ReconstructionConfig(edge_px=0)).z_mm)
    assert not kept[:90].any()
    assert not kept[:, :50].any()
    assert kept[90:, 50:].all()


def a_mesh() -> Mesh:
    corners = np.array([[0, 0, 1000], [100, 0, 1000], [0, 200, 1000], [100, 200, 1300]], np.float32)
    colors = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [128, 128, 128]], np.uint8)
    return Mesh(corners, np.array([[0, 1, 2], [1, 3, 2]], np.int32), colors)


@pytest.mark.extra("reconstruct", "open3d")
def test_meshes_are_read_by_another_program(tmp_path):
    import open3d as o3d

    mesh = a_mesh()
    write_mesh_ply(tmp_path / "a.ply", mesh)
    read = o3d.t.io.read_triangle_mesh(str(tmp_path / "a.ply"))
    np.testing.assert_array_equal(read.vertex.positions.numpy(), mesh.vertices_mm)
    np.testing.assert_array_equal(np.rint(read.vertex.colors.numpy() * 255), mesh.colors)
    np.testing.assert_array_equal(read.triangle.indices.numpy(), mesh.triangles)


@pytest.mark.extra("readers", "trimesh")
def test_glb_files_are_read_by_another_program(tmp_path):
    import trimesh

    mesh = a_mesh()
    (tmp_path / "a.glb").write_bytes(glb(mesh))
    solid = trimesh.load(tmp_path / "a.glb", force="mesh", process=False)
    # Float32, mm from metres.
    np.testing.assert_allclose(solid.vertices * [1000, -1000, -1000], mesh.vertices_mm, atol=1e-3)
    np.testing.assert_array_equal(solid.faces, mesh.triangles)
    assert {"POSITION", "COLOR_0"} <= set(attributes_of(tmp_path / "a.glb"))


def attributes_of(path) -> dict[str, int]:
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + length])["meshes"][0]["primitives"][0]["attributes"]


def test_quaternions_turn_as_their_matrix_does():
    turn = orthonormal(pose_at(7.0))[:3, :3]
    x, y, z, w = quaternion(turn)
    axis, point = np.array([x, y, z]), np.array([1.0, 2.0, 3.0])
    turned = point + 2 * w * np.cross(axis, point) + 2 * np.cross(axis, np.cross(axis, point))
    np.testing.assert_allclose(turned, turn @ point, atol=1e-12)  # rounding


@pytest.mark.extra("reconstruct", "open3d")
def test_a_camera_that_does_not_move_is_found_where_it_was(run, tmp_path):
    folder, out = tmp_path / "still", tmp_path / "model"
    folder.mkdir()
    for name in ("0.png", "1.png"):
        (folder / name).write_bytes(sample_image("still_life_cy_halves").read_bytes())
    camera = sample_camera("still_life_cy_halves")
    result = run("reconstruct", folder, "-c", camera, "-o", out, "--quality", "real-time", "--json")
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout)
    assert report["frames_tracked"] == 2
    assert report == json.loads((out / "report.json").read_text())
    rows = np.loadtxt(out / "trajectory.txt")
    assert np.linalg.norm(rows[1, 1:4]) < 0.010  # m; the same picture twice, seen through voxels of 10 mm
    assert report["meshes"][0]["triangles"] > 100
    assert (out / "mesh.ply").stat().st_size > 1000
    assert (out / "mesh.glb").stat().st_size > 1000


def test_it_says_what_it_waits_for_and_how_many_frames_there_are(tmp_path):
    for name in ("0.png", "1.png"):
        (tmp_path / name).write_bytes(sample_image("still_life_cy_halves").read_bytes())
    said: list[tuple[str, int, int]] = []
    with open_source(str(tmp_path), white_level=1016) as source:
        for frame in _announced(source, lambda *state: said.append(state), source.total):
            assert said[-1] == (f"measuring and tracking frame {frame.index}", frame.index, 2)
    assert said[::2] == [("waiting for a frame", done, 2) for done in (0, 1, 2)]


@pytest.mark.extra("reconstruct", "open3d")
def test_frames_through_another_film_are_refused(run, tmp_path):
    command = "reconstruct", sample_image("still_life_cy_halves"), "--camera", sample_camera("still_life_cy_open")
    result = run(*command, "--out", tmp_path / "model", "--quality", "real-time")
    assert result.returncode == 2
    assert "the first frame was not taken through this camera's film" in result.stderr
    assert not (tmp_path / "model").exists()


@pytest.mark.parametrize("command", ["reconstruct", "live"])
def test_a_missing_extra_is_named(run, command, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "open3d", None)
    monkeypatch.setitem(sys.modules, "starlette", None)
    result = run(command, tmp_path, "-c", sample_camera("still_life_cy_halves"))
    assert result.returncode == 2
    assert "pip install 'chromaperture[" in result.stderr


@pytest.mark.parametrize(
    "changes", [{"voxel_mm": 0.0}, {"memory_mb": 1}, {"edge_jump": -1.0}, {"submap_after": 0}, {"fuse_every": 0}]
)
def test_senseless_settings_are_refused(changes):
    with pytest.raises(InputError):
        ReconstructionConfig(**changes)


def test_a_mesh_in_order_does_not_depend_on_the_order_it_came_in(rng):
    points = np.round(rng.normal(0, 100, (60, 3))).astype(np.float32)
    colors = rng.integers(0, 255, (60, 3)).astype(np.uint8)
    points[:20] = points[20:40]  # coincident vertices differ by their colours
    triangles = np.stack([rng.permutation(60)[:3] for _ in range(90)]).astype(np.int32)
    expected = in_order(Mesh(points, triangles, colors))
    for _ in range(5):
        shuffle = rng.permutation(60)
        number = np.argsort(shuffle).astype(np.int32)
        turned = np.stack([np.roll(number[t], rng.integers(3)) for t in rng.permutation(triangles)])
        found = in_order(Mesh(points[shuffle], turned, colors[shuffle]))
        for name in ("vertices_mm", "triangles", "colors"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))

    # The same surface, its fronts on the same side.
    def fronts(mesh):
        corners = mesh.vertices_mm[mesh.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return sorted(map(tuple, np.concatenate([corners.sum(axis=1), normals], axis=1).round(0).tolist()))

    assert fronts(expected) == fronts(Mesh(points, triangles, colors))


@pytest.mark.extra("reconstruct", "open3d")
def test_tracked_poses_go_into_an_exported_sequence(tmp_path):
    from chromaperture.products.posed_sequence import write_posed
    from chromaperture.reconstruction.build_model import Tracker

    lines = []
    tracker = Tracker(MATRIX, listener=lines.append)

    def views():
        for k in range(5):
            view = photograph(pose_at(k), noise=0.005, seed=k, index=k)
            tracker.see(view)
            yield view
        blank = plane(1500.0, 10.0)  # nothing to track by
        lost = View(blank.color, np.full(SIZE, np.nan, np.float32), blank.sigma_mm, 1.0, 5)
        tracker.see(lost)
        yield lost

    count = write_posed(tmp_path / "out", views(), form="nerfstudio", camera_matrix=MATRIX, poses=tracker.poses)
    frames = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]
    assert (count, len(frames)) == (5, 5)
    assert "1 of 6 frames" in lines[-1]
    flip = np.diag([1.0, -1, -1, 1])
    for k, frame in enumerate(frames):
        found = np.array(frame["transform_matrix"]) @ flip
        assert np.linalg.norm(1000 * found[:3, 3] - from_first(k)[:3, 3]) < 5  # mm, of 90; depth has 0.5 % of noise
    assert len(list((tmp_path / "out" / "depth_mm").iterdir())) == 5

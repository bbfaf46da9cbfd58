"""Parts of the exhibits on worlds that are known: a moving camera, a stereo pair, prior methods on a session."""

from __future__ import annotations

import numpy as np
import pytest

from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.system.errors import InputError
from chromaperture_paper import bench, figure_15, methods, prior_art, sweep, world
from worlds import INFINITY_PX, PUPIL_MM, RULERS_MM, SCALE_PX_MM, moved, texture

# Figure 15


def test_a_camera_that_goes_round_a_point_keeps_it_ahead():
    for pose in figure_15.orbit(7):
        local = (figure_15.PIVOT_MM - pose[:3, 3]) @ pose[:3, :3]
        np.testing.assert_allclose(local, figure_15.PIVOT_MM, atol=1e-9)  # float64, mm
    np.testing.assert_allclose(figure_15.orbit(7)[0], np.eye(4), atol=1e-12)  # float64


def test_planes_seen_from_a_pose_lie_where_their_points_are_seen(rng):
    planes = world.still_life(seed=15)
    pose = figure_15.turned(8.0, -3.0, np.array([0.0, 0.0, 2000.0]))
    seen = figure_15.seen_from(planes, pose)
    for p, q in zip(planes, seen, strict=True):
        a, b = rng.uniform(-50, 50, 2)
        point = p.center_mm + a * p.right + b * p.down
        np.testing.assert_allclose((point - pose[:3, 3]) @ pose[:3, :3], q.center_mm + a * q.right + b * q.down)
        normal = np.cross(p.right, p.down)
        off = figure_15.off_surface(np.array([point, point + 7 * normal]), [p])
        np.testing.assert_allclose(off, [0, 7], atol=1e-9)  # float64, mm


def test_points_of_perfect_views_put_together_lie_on_the_surfaces():
    camera = world.camera_of(96, 64)
    matrix = np.array([[camera.focal_px, 0, 47.5], [0, camera.focal_px, 31.5], [0, 0, 1]])
    planes = world.still_life(seed=15)
    poses = figure_15.orbit(3)
    delta = camera.sensor_to_pupil_mm
    views = []
    for pose in poses:
        table = world.pinhole_table(camera, "cy_halves", 4)
        depth = world.photograph(table, figure_15.seen_from(planes, pose), camera, seed=0, exposure=1.0).depth_mm
        z = (depth - delta).astype(np.float32)
        views.append(figure_15.View(np.full((64, 96, 3), 90, np.uint8), z, np.full_like(z, 1.0)))
    model = figure_15.placed_cloud(views, matrix, poses, delta)
    off = figure_15.off_surface(model.points_mm + np.array([0, 0, delta]), planes)
    # Rays through the centre of the pupil meet the planes: float32 is good to 0.0003 mm at 3 m, grazing ones to more.
    assert np.nanmax(off) < 0.05
    picture = figure_15.splat(model, matrix, np.eye(4), (64, 96))
    assert (picture == 90).all(axis=2).mean() > 0.9  # a tenth for what no view shows


def test_the_nearer_point_is_painted_over_the_farther():
    colors = np.array([[1, 2, 3], [7, 8, 9]], np.uint8)
    model = figure_15.Model(np.array([[0.0, 0, 900], [0, 0, 1000]]), colors, (), "", 0)
    matrix = np.array([[50.0, 0, 5], [0, 50, 5], [0, 0, 1]])
    assert figure_15.splat(model, matrix, np.eye(4), (11, 11))[5, 5].tolist() == [1, 2, 3]
    assert figure_15.splat(model, matrix, np.eye(4), (11, 11))[0, 0].tolist() == [255, 255, 255]


# Two cameras


@pytest.mark.parametrize("distance_mm", [1300.0, 2600.0])
def test_a_stereo_pair_gives_the_depth_of_its_shift(rng, distance_mm):
    camera = world.camera_of(240, 160)
    shift = camera.focal_px * prior_art.BASELINE_MM / (distance_mm - camera.sensor_to_pupil_mm)
    left = texture(rng, height=160, width=240)
    # What is at x in the left picture is at x - shift in the right one, whose camera stands farther right.
    right = moved(left, -shift, 0.0)
    found = prior_art.depth_of_pair(*(np.repeat(p[..., None], 3, axis=2) for p in (left, right)), camera)
    inner = found[20:-20, 60:-20]
    # OpenCV's sub-pixel estimate is biased towards whole px, by up to a third of one.
    assert np.nanmedian(np.abs(inner / distance_mm - 1)) < 0.34 / shift
    assert np.isfinite(inner).mean() > 0.9  # OpenCV rejects ambiguous matches


# The bench


def test_a_prior_method_is_calibrated_on_the_boards_it_reads(calibrated_session, tmp_path):
    result = calibrated_session
    setting = methods.Setting("cy_halves", result.calibration.unmixing, (-4.5, 3.0), 8.0)
    calls = []

    def read(image):
        calls.append(1)
        return methods.METHODS["normalised cross-correlation, unmixed"](image, setting)

    for _ in range(2):  # what was read is kept
        model = bench.fitted(result.evidence, result.session, "ncc", read, keep_in=tmp_path)
    assert len(calls) == len(RULERS_MM)
    for z in (1250.0, 2000.0, 2800.0):
        expected = INFINITY_PX - SCALE_PX_MM / (z - PUPIL_MM)
        # As the project's own curve, plus a tenth of a px for layers of a quarter and the parabola between them.
        assert np.median(depth_to_disparity(z, model)) == pytest.approx(expected, abs=0.13)


def test_a_method_that_reads_nothing_of_the_boards_cannot_be_calibrated(calibrated_session, tmp_path):
    result = calibrated_session

    def read(image):
        return np.zeros(image.shape[:2])

    with pytest.raises(InputError):
        bench.fitted(result.evidence, result.session, "none", read, keep_in=tmp_path)


# Trials


def test_light_makes_walls_better_and_another_seed_another_wall():
    def scatter(exposure, seed=0):
        one = sweep.Trial(
            "normalised cross-correlation, unmixed", "cy_halves", exposure, 120, 96, 6, seed, 0.0, "wall", 2600.0
        )
        return sweep.run_trial(one)["scatter"]

    bright, dim = scatter(0.9), scatter(0.02)
    assert dim > 2 * bright  # noise falls with the root of the light: 6.7 times, where photons rule
    assert scatter(0.9, seed=1) != bright

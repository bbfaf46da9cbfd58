"""The same camera with fewer pixels: against pictures, rays and depths of the full one."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from chromaperture.capture.picture_header import same_frame
from chromaperture.color.noise import photon_noise_variance
from chromaperture.depth.conversion import disparity_to_depth
from chromaperture.depth.field import DepthField, LocalField
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import at_scale, resized
from chromaperture.optics.lens_blur import BlurModel, rims
from chromaperture.system.errors import InputError
from worlds import halves_camera

W, H, S = 96, 64, 4  # of the full camera, and its reduction


def field(*, degree_terms: int = 15, local: bool = True) -> DepthField:
    """Curves over the frame of degree 4, with every part that a camera file can hold."""
    rng = np.random.default_rng(5)
    infinity, scale = rng.normal(0, 0.1, degree_terms), rng.normal(0, 60, degree_terms)
    infinity[0], scale[0] = 8.0, 16000.0
    count = 2 * degree_terms + 1 + 2
    root = (
        rng.normal(size=(count, count)) * np.r_[np.full(degree_terms, 1e-3), np.full(degree_terms, 2.0), 1, 0.01, 0.01]
    )
    grid = [rng.normal(0, size, (4, 6)).astype(np.float32) for size in (0.05, 20)]
    part = LocalField(7.5, 16.0, *grid, np.diag([1e-4, 4.0])) if local else None
    curve = Nonlinearity(-6.0, 6.0, np.array([0.05, 0.03]))
    return DepthField(infinity, scale, 51.0, root.T @ root, curve, part)


def camera(**changes) -> Calibration:
    blur = BlurModel(10.0, 20000.0, curvature_px=1.7, spherical_px=4.0, lateral_red_px=0.2, front_rim_shift=0.3)
    made = halves_camera(field(), W, H, blur=blur)
    sensor = replace(made.sensor, full_well_electrons=5000.0, read_noise_electrons=4.0)
    lens = replace(made.lens, distortion=np.array([-0.1, 0.02, 1e-3, -1e-3, 0.0]))
    return replace(made, sensor=sensor, lens=lens, **changes)


def full_places(places):
    """Where the centres of reduced pixels are in the full picture."""
    return (np.asarray(places, float) + 0.5) * S - 0.5


def test_depth_of_a_reduced_pixel_is_that_of_the_full_camera_there():
    full, small = camera(), at_scale(camera(), S)
    x, y = np.meshgrid(np.arange(W // S), np.arange(H // S))
    d = np.random.default_rng(0).uniform(-1, 1, x.shape)  # px of the reduced picture
    for quality in ("paper", "accurate"):
        there = full.depth[quality].at(full_places(x), full_places(y), W, H)
        here = small.depth[quality].at(x, y, W // S, H // S)
        expected = disparity_to_depth(S * d, there, np.full(x.shape, 0.1 * S))
        found = disparity_to_depth(d, here, np.full(x.shape, 0.1))
        # The covariance of the nonlinearity is averaged over the pixels asked for, the same ones here: float32 is left.
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_allclose(a, b, rtol=2e-6)


def test_points_project_to_the_same_place():
    full, small = camera(), at_scale(camera(), S)
    points = np.random.default_rng(1).uniform((-300, -200, 900), (300, 200, 3000), (50, 3))

    def project(one: Calibration) -> np.ndarray:
        return cv2.projectPoints(points, np.zeros(3), np.zeros(3), one.lens.camera_matrix, one.lens.distortion)[0][:, 0]

    np.testing.assert_allclose(full_places(project(small)), project(full), atol=1e-9)


def test_rays_meet_the_sensor_at_the_same_place():
    full, small = camera().field_blur(), at_scale(camera(), S).field_blur()
    for x, y in ((0, 0), (5, 3), (23, 15)):
        there, here = full.rays(full_places(x), full_places(y)), small.rays(x, y)
        np.testing.assert_allclose(S * here.at_infinity_px, there.at_infinity_px, atol=1e-12)
        np.testing.assert_allclose(here.light, there.light, atol=1e-12)
    assert small.reach == pytest.approx(full.reach)  # px of disparity a px of blur: no px are left
    here = rims(small.model, small.pupil.points, small.frame_position(3, 2))
    np.testing.assert_array_equal(here, rims(full.model, full.pupil.points, full.frame_position(*full_places((3, 2)))))


def test_noise_is_that_of_the_mean_of_pixels():
    """Against noise that is drawn: photons of full pixels, averaged."""
    rng, level, small = np.random.default_rng(2), 0.4, at_scale(camera(), S)
    electrons = rng.poisson(level * 5000, (512, 512)) + rng.normal(0, 4, (512, 512))
    mean = cv2.resize(electrons / 5000, (512 // S, 512 // S), interpolation=cv2.INTER_AREA)
    sensor = small.sensor
    known = photon_noise_variance(
        np.full((4, 4, 3), level, np.float32),
        full_well_electrons=sensor.full_well_electrons, read_noise_electrons=sensor.read_noise_electrons,
    )  # fmt: skip
    # 16384 samples: their variance has a relative standard error of 1.1 %.
    assert known[0, 0, 0] == pytest.approx(mean.var(), rel=0.05)


def test_lengths_stay():
    full, small = camera(), at_scale(camera(), S)
    assert small.image_distance_mm == pytest.approx(full.image_distance_mm)
    assert small.in_focus_mm == pytest.approx(full.in_focus_mm)
    assert small.baseline_mm == pytest.approx(full.baseline_mm)
    assert (small.sensor.width_px, small.sensor.height_px) == (W // S, H // S)
    assert small.disparity_range_px()[0] * S == pytest.approx(full.disparity_range_px()[0], rel=0.01)  # other pixels


def test_there_and_back_is_the_same_camera(tmp_path):
    full = camera()
    back = resized(at_scale(full, S), W, H)
    np.testing.assert_allclose(back.lens.camera_matrix, full.lens.camera_matrix)
    for quality, curve in full.depth.items():
        np.testing.assert_allclose(back.depth[quality].covariance, curve.covariance, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(back.depth[quality].scale_px_mm, curve.scale_px_mm)
    assert back.sensor.full_well_electrons == pytest.approx(5000)
    at_scale(full, S).save(tmp_path / "small.asdf")  # a camera file like any other
    assert Calibration.load(tmp_path / "small.asdf").sensor.width_px == W // S


def test_maps_of_a_band_are_rows_of_the_whole():
    whole, band = field().model(W, H), field().model(W, H, slice(17, 30))
    for name in ("infinity_disparity_px", "scale_px_mm", "covariance"):
        np.testing.assert_allclose(getattr(band, name), getattr(whole, name)[17:30], rtol=1e-12)


def test_sizes():
    assert same_frame((6000, 4000), (750, 500))
    assert same_frame((6001, 4000), (750, 500))
    assert not same_frame((6000, 4000), (4000, 6000))
    assert not same_frame((6000, 4000), (6000, 3376))  # 16:9
    made = camera()
    assert at_scale(made, 1) is made
    with pytest.raises(InputError, match="working scale"):
        at_scale(camera(), 0)
    with pytest.raises(InputError, match="same frame"):
        resized(camera(), H, W)

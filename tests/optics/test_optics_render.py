"""Both renderers against closed forms and against each other; orientation of the picture; sensor noise."""

import math
from dataclasses import replace

import numpy as np
import pytest

from chromaperture.optics.aperture import DESIGNS, centroids, channel_transmission, made_of
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.ray_table import pinhole_rays
from chromaperture.optics.simulator.layer_renderer import behind_edges, fill_unknown, render_layers
from chromaperture.optics.simulator.render import render, render_depth, render_sharp
from chromaperture.optics.simulator.scene import load_scene, plane, scene_from_dict
from chromaperture.optics.simulator.sensor import SensorModel, develop, expose
from chromaperture.optics.simulator.textures import chessboard, noise
from chromaperture.system.errors import InputError

CAMERA = PupilCamera(72, 56, 800.0, 10.0, 2000.0, 50.0, 0.02)
CY = made_of(DESIGNS["cy_halves"], "ideal")
FAR, NEAR = 4000.0, 1300.0


def grey(picture):
    return np.repeat(np.asarray(picture, np.float32)[..., None], 3, axis=2)


def point(depth, size_mm=None):
    """A small bright square on the axis, about a pixel wide, on black."""
    width = size_mm or (depth - CAMERA.sensor_to_pupil_mm) / CAMERA.focal_px
    return [plane(np.ones((2, 2, 3)), center_mm=(0, 0, depth), width_mm=width)]


def centroid(image):
    h, w = image.shape[:2]
    total = image.sum(axis=(0, 1))
    x = (image * (np.arange(w) - (w - 1) / 2)[None, :, None]).sum(axis=(0, 1)) / total
    y = (image * (np.arange(h) - (h - 1) / 2)[:, None, None]).sum(axis=(0, 1)) / total
    return np.stack([x, y], -1)


@pytest.mark.parametrize("depth", [FAR, NEAR])
@pytest.mark.parametrize("name", ["cy_halves", "rgb_squares"])
def test_a_point_moves_by_radius_times_pupil_centroid(name, depth):
    """Catches a swapped half, a mirrored blur and an inverted picture in one."""
    spot = point(depth, 12 * (depth - CAMERA.sensor_to_pupil_mm) / CAMERA.focal_px)  # 12 px wide
    image = render(pinhole_rays(CAMERA, DESIGNS[name]), spot)
    expected = float(CAMERA.blur_radius_px(depth)) * centroids(DESIGNS[name])
    # 20 cells across the pupil and jittered pixels leave a hundredth of a pixel of sampling noise.
    np.testing.assert_allclose(centroid(image), expected, atol=0.03)


def test_the_picture_stands_upright():
    """A light right of and above the axis lies right of and above the middle of the image."""
    spot = [plane(np.ones((2, 2, 3)), center_mm=(30.0, -20.0, 2000.0), width_mm=4.0)]
    x, y = centroid(render(pinhole_rays(CAMERA, CY), spot))[1]
    scale = CAMERA.focal_px / (2000.0 - 50.0)
    # Rays at random places of a pixel.
    assert (x, y) == (pytest.approx(30 * scale, abs=0.1), pytest.approx(-20 * scale, abs=0.1))


def test_an_even_wall_gives_the_light_of_the_aperture():
    wall = [plane(np.full((2, 2, 3), 0.5), center_mm=(0, 0, FAR), width_mm=3000.0)]
    for name in ("cy_halves", "rgb_circles", "magenta_annulus"):
        aperture = made_of(DESIGNS[name], "real")
        image = render(pinhole_rays(CAMERA, aperture), wall)
        # The 20-cell mask against the 1000-cell one: rims are shared by area.
        np.testing.assert_allclose(image.mean(axis=(0, 1)), 0.5 * channel_transmission(aperture), rtol=5e-3)
        assert image.std(axis=(0, 1)).max() < 1e-4


def test_depth_of_a_tilted_plane_is_its_equation():
    table = pinhole_rays(CAMERA, CY)
    slope = math.tan(math.radians(30))
    tilted = [plane(np.ones((2, 2, 3)), center_mm=(0, 0, 2000.0), width_mm=2000.0, tilt_deg=(0, -30, 0))]
    depth = render_depth(table, tilted)
    x = (np.arange(72) - 35.5) / 800.0
    expected = 50.0 + 1950.0 / (1 - slope * x)  # x right goes away from the camera: z = z0 + x z slope
    np.testing.assert_allclose(depth, np.broadcast_to(expected, (56, 72)), rtol=1e-5)


def test_nearer_planes_hide_farther_ones_and_holes_let_through():
    picture = np.ones((4, 4, 4), np.float32)
    picture[..., :3] = (0, 1, 0)
    picture[:, :2, 3] = 0  # left half is a hole
    front = plane(picture, center_mm=(0, 0, 1500.0), width_mm=200.0)
    back = plane(np.tile(np.float32([1, 0, 0]), (2, 2, 1)), center_mm=(0, 0, 2000.0), width_mm=400.0)
    table = pinhole_rays(CAMERA, CY)
    for planes in ([front, back], [back, front]):
        sharp, depth = render_sharp(table, planes), render_depth(table, planes)
        np.testing.assert_allclose(sharp[:, 60], np.tile([0, 1, 0], (56, 1)), atol=1e-6)  # float32
        np.testing.assert_allclose(sharp[:, 10], np.tile([1, 0, 0], (56, 1)), atol=1e-6)  # float32
        assert depth[28, 60] == pytest.approx(1500)
        assert depth[28, 10] == pytest.approx(2000)


def test_layers_and_rays_agree_away_from_depth_edges_and_nearly_at_them():
    camera = replace(CAMERA, width_px=160, height_px=120)
    smooth = [noise((300, 400), exponent=1.8, seed=s) for s in (1, 2)]  # nothing finer than the ray sampling
    planes = [
        plane(grey(smooth[0]), center_mm=(0, 0, FAR), width_mm=1600.0, tilt_deg=(0, 20, 0)),
        plane(grey(smooth[1]) * [1.0, 0.7, 0.5], center_mm=(-60, 0, NEAR), width_mm=130.0, tilt_deg=(0, 0, 15)),
    ]
    aperture = made_of(DESIGNS["cy_halves"], "real")
    truth = render(pinhole_rays(camera, aperture, cells=32), planes)
    point_camera = pinhole_rays(replace(camera, pupil_radius_mm=1e-4), DESIGNS["open"], cells=8)
    sharp, depth = render(point_camera, planes), render_depth(point_camera, planes)
    made = render_layers(sharp, depth, camera=camera, aperture=aperture, pitch_px=0.25)
    error = np.abs(made.image - truth)[12:-12, 12:-12]  # beyond the picture's rim the layers can only guess
    step = np.abs(np.diff(depth, axis=1, prepend=depth[:, :1])) + np.abs(np.diff(depth, axis=0, prepend=depth[:1]))
    rows, columns = np.nonzero(step > 300)
    y, x = np.indices(depth.shape)
    distance = np.hypot(y[..., None] - rows[::4], x[..., None] - columns[::4]).min(axis=-1)[12:-12, 12:-12]
    away = distance > 12
    level = truth.mean(axis=(0, 1))
    assert 0.3 < away.mean() < 0.9  # else the comparison means little
    assert (np.sqrt((error[away] ** 2).mean(axis=0)) < 0.01 * level).all()  # 1 %: rays are samples
    # At the edges the hidden background is a guess; without it (one sheet) the error is several times this.
    assert (np.sqrt((error[~away] ** 2).mean(axis=0)) < 0.06 * level).all()


def test_a_wall_between_two_coarse_layers_is_divided_and_does_not_hide_itself():
    camera, aperture = replace(CAMERA, width_px=96, height_px=64), made_of(DESIGNS["cy_halves"], "real")
    color = np.repeat(noise((64, 96), exponent=1.0, seed=3, mean=0.5, contrast=0.2)[..., None], 3, axis=2)
    at_infinity = float(camera.blur_radius_px(np.inf))
    pitch = at_infinity / 3

    def wall(layer):
        depth = camera.sensor_to_pupil_mm + camera.focal_px * camera.pupil_radius_mm / (at_infinity - layer * pitch)
        assert camera.blur_radius_px(depth) == pytest.approx(layer * pitch)
        return render_layers(color, np.full((64, 96), depth), camera=camera, aperture=aperture, pitch_px=pitch).image

    assert pitch > 0.7  # so far apart two surfaces would be
    # Borders are mirrored as far as blur reaches: they are alike for layers that are.
    divided = 0.75 * wall(1.0) + 0.25 * wall(2.0)
    np.testing.assert_allclose(wall(1.25)[16:-16, 16:-16], divided[16:-16, 16:-16], atol=2e-4)


def test_a_blurred_near_rim_shows_the_background_and_not_itself():
    """A black card before a white wall: under its soft rim green follows the disc's integral from 1 to 0."""
    camera = replace(CAMERA, width_px=96, height_px=48)
    depth = np.full((48, 96), 2000.0)  # the wall is in focus
    depth[:, :48] = NEAR
    color = np.where(depth[..., None] == NEAR, 0.0, 1.0) * np.ones(3)
    row = render_layers(color, depth, camera=camera, aperture=DESIGNS["open"]).image[24, :, 1]
    radius = abs(float(camera.blur_radius_px(NEAR)))
    t = np.clip((np.arange(96) - 47.5) / radius, -1, 1)
    expected = 0.5 + (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi  # area of the disc left of a chord
    # Between layers 0.5 px apart, and pixels of finite size: 2 %.
    np.testing.assert_allclose(row[20:-20], expected[20:-20], atol=0.02)


def test_unknown_depth_takes_its_neighbour_and_none_is_an_error():
    depth = np.full((9, 9), np.nan)
    depth[4, 2], depth[4, 8] = 1000, 2000
    filled = fill_unknown(depth)
    assert filled[0, 0] == 1000
    assert filled[0, 8] == 2000
    with pytest.raises(InputError, match="no depth at all"):
        fill_unknown(np.full((4, 4), np.nan))


def test_the_far_surface_continues_behind_the_near_one_only():
    radius = np.full((20, 40), 2.0, np.float32)
    radius[:, :20] = -3.0
    color = np.zeros((20, 40, 3), np.float32)
    color[:, 20:] = np.arange(20, dtype=np.float32)[None, :, None]
    behind, deep = behind_edges(color, radius, reach=5, edge_px=0.7)
    np.testing.assert_array_equal(behind[:, 20:], color[:, 20:])
    np.testing.assert_array_equal(deep[:, 15:20], 2.0)
    np.testing.assert_array_equal(behind[0, 15:20, 0], [5, 4, 3, 2, 1])  # mirrored at the edge
    np.testing.assert_array_equal(deep[:, :14], -3.0)


def test_what_cannot_be_rendered():
    table = pinhole_rays(CAMERA, CY)
    with pytest.raises(InputError, match="no planes"):
        render(table, [])
    with pytest.raises(InputError, match="behind the camera"):
        render(table, point(40.0, 5.0))
    with pytest.raises(InputError, match="camera's size"):
        render_layers(np.ones((4, 4, 3)), np.ones((4, 4)), camera=CAMERA, aperture=CY)
    with pytest.raises(InputError, match="behind the entrance pupil"):
        render_layers(np.ones((56, 72, 3)), np.full((56, 72), 20.0), camera=CAMERA, aperture=CY)
    good = {"center_mm": [0, 0, 5], "width_mm": 10}
    for wrong, words in (
        ({"center_mm": [0, 0, -5]}, "plane 1: center_mm 3 must be greater than 0"),
        ({"center_mm": 5}, "center_mm must be a list"),
        ({"width_mm": "10"}, "width_mm must be a number, is '10'"),
        ({"widht_mm": 10}, "did you mean 'width_mm'"),
        ({"color": [1, 1]}, "color 3 is missing"),
        ({"seed": -1}, "seed"),
        ({"texel_mm": 1e-320}, "texels is too large"),
        ({"texture": "n" * 5000}, "texture"),
    ):
        with pytest.raises(InputError, match=words):
            scene_from_dict({"plane": [good | wrong]})
    with pytest.raises(InputError, match="center_mm is missing"):
        scene_from_dict({"plane": [{"width_mm": 10}]})
    with pytest.raises(InputError, match="unknown texture"):
        scene_from_dict({"plane": [{"center_mm": [0, 0, 5], "width_mm": 10, "texture": "marble"}]})
    with pytest.raises(InputError, match="no \\[\\[plane"):
        scene_from_dict({})


def test_a_scene_file_is_what_it_says(tmp_path):
    (tmp_path / "desk.toml").write_text(
        '[[plane]]\ncenter_mm = [0, 0, 2000]\nwidth_mm = 500\ntexture = "plain"\ncolor = [0.2, 0.4, 0.6]\n'
    )
    image = render_sharp(pinhole_rays(CAMERA, CY), load_scene(tmp_path / "desk.toml"))
    np.testing.assert_allclose(image[28, 36], [0.2, 0.4, 0.6], atol=1e-6)  # float32


def test_noise_of_the_sensor_is_photons_and_reading():
    sensor = SensorModel(full_well_electrons=5000, read_noise_electrons=20)
    level = np.float32([0.02, 0.2, 0.8])
    image = develop(expose(np.broadcast_to(level, (200, 250, 3)), sensor, seed=3), sensor)
    count = 200 * 250
    variance = level / 5000 + (20 / 5000) ** 2 + 1 / 12 / 1000**2  # shot, read, rounding of 1000 counts
    np.testing.assert_allclose(image.mean(axis=(0, 1)), level, atol=5 * np.sqrt(variance.max() / count))
    np.testing.assert_allclose(image.var(axis=(0, 1)), variance, rtol=5 * math.sqrt(2 / count))


def test_saturation_clips_and_bad_light_is_refused():
    sensor = SensorModel()
    assert expose(np.full((4, 4, 3), 5.0), sensor, seed=0).max() == 1023
    with pytest.raises(InputError, match="finite light"):
        expose(np.full((4, 4, 3), np.nan), sensor, seed=0)
    with pytest.raises(InputError, match="must rise"):
        SensorModel(black_level=100, white_level=50)
    with pytest.raises(InputError, match="full_well"):
        SensorModel(full_well_electrons=0)


def test_chessboard_counts_its_squares():
    board = chessboard((9, 6), 30.0, 1.0)
    assert board.shape == (270, 360)
    assert board[45, 45] < 0.1 < board[45, 75]  # black in the corner, then white
    assert board[15].min() > 0.9
    assert np.mean(board < 0.1) == pytest.approx(35 / 108, abs=1e-6)

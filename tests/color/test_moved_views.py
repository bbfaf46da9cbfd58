"""Channels that a lens moves, matched where they show the same: tables, sampling, the lens's part, planes, devices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import map_coordinates

from chromaperture.calibration.calibrate_blur import beyond_disparity, lens_moves
from chromaperture.calibration.options import Cache, silent
from chromaperture.calibration.read_boards import BoardMeasurement, measure_again
from chromaperture.depth.conversion import DepthModel
from chromaperture.matching.device.device import open_device
from chromaperture.matching.device.gpu_method import GpuMethod
from chromaperture.matching.estimate import estimate_disparity, method_for
from chromaperture.matching.integer_light import MOVE_PARTS, halved_moves, moved, pixel_maps
from chromaperture.matching.views import channel_space, halved_views
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import Film
from chromaperture.model.scale import resized
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.settings.methods import RealTimeConfig
from chromaperture.system.errors import InputError
from devices import with_device
from worlds import MARGIN_PX, Boards, capture, halves_camera, ideal_film, texture, wavy_capture

W, H = 97, 80
SMALL = RealTimeConfig().with_range(-3.0, 3.0)
THIN = BlurModel(10.0, 20000.0)  # in focus at 2 m from the pupil


def table(rng, largest_px=1.5):
    """Displacements of three channels at 5 x 4 places."""
    return rng.uniform(-largest_px, largest_px, (4, 5, 3, 2))


def places(height=H, width=W):
    """Full pixels of the halved picture, as the table's rows and columns count them."""
    y, x = np.meshgrid(
        np.arange(0, height, 2) * 3 / (height - 1), np.arange(0, width, 2) * 4 / (width - 1), indexing="ij"
    )
    return np.stack([y, x], axis=-1)


def test_displacements_are_linear_between_the_places(rng):
    values = table(rng)
    expected = RegularGridInterpolator((np.arange(4), np.arange(5)), values)(places()) / 2  # px of the halved picture
    found = halved_moves(values, (H, W)) / MOVE_PARTS
    assert np.abs(found.transpose(1, 2, 0, 3) - expected).max() <= 0.5 / MOVE_PARTS + 1e-9


def test_a_view_is_sampled_between_four_pixels_without_rounding(rng):
    values = table(rng, largest_px=6.0)
    view = rng.integers(-(2**13), 2**13, (H // 2, (W + 1) // 2)).astype(np.float32)
    y, x = np.mgrid[: view.shape[0], : view.shape[1]]
    for k, maps in enumerate(pixel_maps(values, (H, W))):
        dx, dy = np.moveaxis(halved_moves(values, (H, W))[k].astype(int), -1, 0)
        at = np.stack([y + dy / MOVE_PARTS, x + dx / MOVE_PARTS])
        expected = map_coordinates(view.astype(np.float64), at, order=1, mode="nearest")
        np.testing.assert_array_equal(moved(view, maps), expected)  # whole parts of whole numbers: exact in 24 bits


def test_what_disparity_explains_is_taken_off(rng):
    directions = channel_space(DESIGNS["rgb_squares"], np.eye(3)).directions
    translation, disparity = rng.normal(size=(6, 1, 2)), rng.normal(size=(6, 1, 1))
    rest = beyond_disparity(rng.normal(size=(6, 3, 2)), directions)
    found = beyond_disparity(rest + translation + disparity * directions, directions)
    np.testing.assert_allclose(found, rest, atol=1e-12)
    np.testing.assert_allclose(beyond_disparity(translation + disparity * directions, directions), 0, atol=1e-12)


def camera(model: BlurModel, design: str = "rgb_squares") -> Calibration:
    made = halves_camera(DepthModel(8.0, 16000.0, 50.0, np.diag([1e-4, 9.0, 4.0])), W, H, blur=model)
    return replace(made, design=design, film=Film(ideal_film(design), np.ones(3), np.ones(3)))


def test_lateral_colour_of_a_lens_is_found():
    found = lens_moves(camera(replace(THIN, lateral_red_px=1.5)))
    rows, columns = found.shape[:2]
    y, x = np.meshgrid(np.linspace(0, H - 1, rows), np.linspace(0, W - 1, columns), indexing="ij")
    lateral = np.zeros((rows, columns, 3, 2))
    lateral[..., 0, :] = 1.5 * np.stack([x - (W - 1) / 2, y - (H - 1) / 2], axis=-1) / (W / 2)
    directions = channel_space(DESIGNS["rgb_squares"], camera(THIN).unmixing).directions
    np.testing.assert_allclose(found, beyond_disparity(lateral, directions), atol=0.02)  # squares by 1500 rays
    assert lens_moves(replace(camera(THIN), blur=None)) is None
    assert lens_moves(camera(THIN, "cy_halves")) is None  # matches two channels


def test_a_camera_file_keeps_them_and_other_pixels_divide_them(tmp_path, rng):
    made = replace(camera(THIN), channel_moves_px=table(rng))
    made.save(tmp_path / "camera.asdf")
    np.testing.assert_array_equal(Calibration.load(tmp_path / "camera.asdf").channel_moves_px, made.channel_moves_px)
    np.testing.assert_allclose(resized(made, 2 * W, 2 * H).channel_moves_px, 2 * made.channel_moves_px)
    replace(made, channel_moves_px=np.full((4, 5, 3, 2), 1e6)).save(tmp_path / "camera.asdf")
    with pytest.raises(InputError, match="channel_moves_px"):
        Calibration.load(tmp_path / "camera.asdf")


def spoiled(image, values):
    """Every channel shows at x + displacement what it showed at x, to first order."""
    y, x = np.mgrid[:H, :W]
    grids = RegularGridInterpolator((np.arange(4), np.arange(5)), values)
    field = grids(np.stack([y * 3 / (H - 1), x * 4 / (W - 1)], axis=-1))
    at = [[y - field[..., k, 1], x - field[..., k, 0]] for k in range(3)]
    return np.stack([map_coordinates(image[..., k], at[k], order=5, mode="nearest") for k in range(3)], axis=-1)


@pytest.mark.parametrize("execution", ["numba", "numpy"])
def test_a_plane_through_a_lens_with_lateral_colour(execution):
    rng = np.random.default_rng(2)
    x, y = np.linspace(-1, 1, 5), np.linspace(-0.8, 0.8, 4)[:, None]
    values = np.zeros((4, 5, 3, 2))
    values[..., 0, 0], values[..., 0, 1], values[..., 2, 0] = 1.2 * x + 0 * y, 1.2 * y + 0 * x, 0.5 * x * y
    image = capture(texture(rng, H, W, blur_px=2.0), "rgb_squares", 1.2)

    def disparity(picture, moves):
        found = estimate_disparity(
            picture.astype(np.float32),
            aperture="rgb_squares",
            config=SMALL,
            channel_moves_px=moves,
            execution=execution,
        ).value_px
        return found[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]

    lens = spoiled(image, values)
    # Cells near the frame's sides are .9 px off without; .02 px are the plane's own errors (test_real_time.py).
    assert np.nanquantile(np.abs(disparity(lens, None) - 1.2), 0.9) > 0.15
    assert np.nanquantile(np.abs(disparity(lens, values) - 1.2), 0.9) < 0.05


def test_boards_are_measured_again_with_them():
    rng = np.random.default_rng(1)
    values = table(rng, largest_px=1.0)
    image = spoiled(capture(texture(rng, H, W, blur_px=2.0), "rgb_squares", 1.2), values).astype(np.float32)
    board = BoardMeasurement(
        "a.png", 1500.0, {"paper": 7.0, "real-time": 7.0}, {"paper": 1.0, "real-time": 1.0}, {"paper": np.zeros(1)}
    )
    session = Boards({1500.0: image})
    made = replace(camera(THIN), channel_moves_px=values)
    (again,) = measure_again([board], session, made, cache=Cache(), progress=silent)
    assert again.disparity_px["paper"] == 7.0
    # .004 and .006 px are found; without the displacement .09 and .45.
    assert again.disparity_px["real-time"] == pytest.approx(1.2, abs=0.03)
    assert np.nanquantile(np.abs(again.grid_px["real-time"][3:-3, 3:-3] - 1.2), 0.9) < 0.05


def test_designs_of_two_channels_ignore_them(rng):
    method = method_for(SMALL, aperture="cy_halves", channel_moves_px=table(rng))
    assert method.space.moves_px is None


@with_device
@pytest.mark.parametrize("hole", [False, True])
def test_a_device_samples_the_same_views(hole, rng):
    values, image = table(rng), wavy_capture("rgb_squares", shape=(H, W))
    if hole:
        image[30:36, 40:47] = np.nan
    method = method_for(SMALL, aperture="rgb_squares", channel_moves_px=values, execution="numpy")
    views, _ = halved_views(image, method.space, config=method.config.views)
    on_device = GpuMethod(method, open_device("gpu"))
    found = on_device.match(image)
    planes = on_device._chain.run({"image": image}, ["planes"])["planes"].reshape(5, *views.mask.shape)[:3]
    expected = np.moveaxis(views.pictures, -1, 0)
    planes = planes - planes.mean(axis=(1, 2), keepdims=True) + expected.mean(axis=(1, 2), keepdims=True)
    assert np.abs(planes - expected).max() < 1e-6  # whole units of light, but for the mean
    oracle = method.match(image).value_px
    known = np.isfinite(oracle) & np.isfinite(found.value_px)
    assert (np.isfinite(oracle) == np.isfinite(found.value_px)).mean() > 0.99
    assert np.quantile(np.abs(found.value_px - oracle)[known], 0.98) < 1e-3

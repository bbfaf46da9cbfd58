"""A dual-pixel sensor: its rays, the blur model of a lens from its prescription, and scores of its photographs."""

import json

import numpy as np
import pytest

from chromaperture.calibration import flat_boards
from chromaperture.optics.aperture import DESIGNS, centroids
from chromaperture.optics.dual_pixel_rays import HalfPixels, fit_to_rays, half_pixel_rays
from chromaperture.optics.lens_blur import BlurModel, LensBlur, displacement, sample_pupil
from chromaperture.optics.pinhole import PupilCamera, focused_at, pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays, pinhole_rays
from chromaperture.system.errors import InputError
from chromaperture_paper.dual_pixel import score

CAMERA = PupilCamera(96, 64, 400.0, 12.0, 2000.0, 50.0, 0.12)
HALVES = HalfPixels(slope=0.4, half_slope_px=40.0)


def test_the_halves_see_the_pupil_through_ramps_that_flatten_towards_the_sides():
    rays = half_pixel_rays(pinhole_rays(CAMERA, DESIGNS["open"], cells=40), HALVES, pupil_radius_mm=12.0)
    light = rays.weight.sum(axis=-1)
    np.testing.assert_allclose(light[0], light[2], rtol=1e-5)  # float32
    np.testing.assert_allclose(light[1], light[0], rtol=1e-5)
    xi = (rays.origin[0, ..., 0] - rays.chief[..., None, 0]) / 12.0
    right, left = ((rays.weight[k] * xi).sum(axis=-1) / light[k] for k in (0, 2))
    # The centroid of 1 + s xi over a disc is s / 4; cells of a fortieth sample it to 1 %.
    at_sides = 0.4 / (1 + (47.5 / 40) ** 2) / 4
    np.testing.assert_allclose(right, at_sides, rtol=0.01)
    np.testing.assert_allclose(left, -at_sides, rtol=0.01)


def test_leaking_film_of_the_same_centroid_replaces_the_ramps():
    red, _, blue = centroids(DESIGNS["cy_halves"].with_film(HALVES.film()))
    assert red[0] == pytest.approx(0.4 / 4, rel=2e-3)  # the pupil's grid is good to 4e-4 radii
    assert blue[0] == pytest.approx(-0.4 / 4, rel=2e-3)


def test_the_blur_of_a_dual_pixel_sensor_is_displaced_as_its_ramps_are():
    film = sample_pupil(DESIGNS["cy_halves"].with_film(HALVES.film()))
    wide = {"front_rim_radius": 2.0, "rear_rim_radius": 2.0}
    blur = LensBlur(BlurModel(10.0, 20000.0, **wide, contrast_fall=48 / 40), film, 96, 64)
    middle, side = blur.half_disparity(47.5, 31.5), blur.half_disparity(95.5, 31.5)
    np.testing.assert_allclose(middle, (10.0 * 0.4 / 4, 20000.0 * 0.4 / 4), rtol=0.01)  # 1500 samples of the pupil
    np.testing.assert_allclose(side, np.array(middle) / (1 + 1.2**2), rtol=0.01)


@pytest.mark.parametrize("numbers", [(0.0, 40.0), (1.5, 40.0), (0.4, 0.0)])
def test_half_pixels_that_cannot_be_are_refused(numbers):
    with pytest.raises(InputError, match="half pixels"):
        HalfPixels(*numbers)


def test_the_model_of_an_ideal_lens_is_its_defocus_alone():
    model, rms = fit_to_rays(pinhole_rays(CAMERA, DESIGNS["open"], cells=12), pupil_radius_mm=12.0)
    assert rms < 1e-3  # px; float32 slopes at 400 px
    # The edge of the pupil is displaced by F R (1 / z_f - 1 / z) px, z from the pupil. The table has the corners only.
    points = np.array([[0.3, -0.4], [1.0, 0.0], [0.0, -1.0]])
    corner = (np.array([95.0, 63.0]) - (47.5, 31.5)) / 48
    for inverse_mm in (0.0, 1e-3):
        expected = 400.0 * 12.0 * (1 / (2000.0 - 50.0) - inverse_mm) * points
        np.testing.assert_allclose(displacement(model, points, corner, inverse_mm, 1), expected, atol=2e-3)  # px


def test_the_model_of_a_prescription_says_where_its_rays_meet_the_sensor():
    size = {"width_px": 240, "height_px": 160, "pixel_pitch_mm": 0.09}
    lens = focused_at(load_lens("double_gauss_50"), 2000.0)
    pupil = pupil_camera(lens, **size)
    table = lens_rays(lens, DESIGNS["open"], **size, cells=12, nodes=9)
    model, rms = fit_to_rays(table, pupil_radius_mm=pupil.pupil_radius_mm)
    edge = pupil.focal_px * pupil.pupil_radius_mm
    assert model.scale_px_mm == pytest.approx(edge, rel=0.02)
    # 28 numbers follow its rays to a hundredth of the blur; aberrations alone would be a fifth of it.
    assert rms < 0.02 * edge / (2000.0 - pupil.sensor_to_pupil_mm)
    i, j = 1, 2  # a place off the axis: the rays of a point 1 m from the pupil, straight from the table
    origin = table.origin[1, i, j] - table.chief[i, j, :2]
    slope = table.slope[1, i, j] - table.chief[i, j, 2:]
    beside = -(origin / 1000.0 + slope) * pupil.focal_px
    position = (np.array([table.x_px[j], table.y_px[i]]) - (119.5, 79.5)) / 120.0
    found = displacement(model, origin.astype(float) / pupil.pupil_radius_mm, position, 1e-3, 1)
    lit = table.weight[1, i, j] > 0.9 * table.weight[1, 3, 4]
    assert lit.sum() > 20
    # The lens's distortion, 2 % here, is in the model and not in the line above.
    np.testing.assert_allclose(found[lit], beside[lit], atol=0.05 * np.abs(beside[lit]).max())


def flat(distance_mm):
    value = np.full((64, 96), 1.0 - 900 / distance_mm)
    return flat_boards.Seen(distance_mm, value, np.full_like(value, 0.05))


@pytest.mark.parametrize("distances", [(600.0, 1500.0), (600.0, 900.0, 900.0, 4000.0)])
def test_boards_determine_a_curve(distances):
    field = flat_boards._curve([flat(mm) for mm in distances], 2)
    model = field.model(96, 64)
    np.testing.assert_allclose(model.infinity_disparity_px, 1.0, rtol=1e-6)
    np.testing.assert_allclose(model.scale_px_mm, 900.0, rtol=1e-6)


def test_the_crosstalk_is_found_from_how_far_boards_seem_apart():
    true, start, scale = HalfPixels(0.42, 320.0), HalfPixels(0.35, 400.0), 700.0
    x = np.arange(768) - 383.5
    seen = true.slope_at(x) / start.slope_at(x)  # disparity found over that of the camera assumed
    layers = [flat_boards.Seen(mm, np.tile(-scale / mm * seen, (8, 1)), np.ones((8, 768))) for mm in (600.0, 1500.0)]
    found = flat_boards._refitted(start, layers, scale)
    assert found.slope == pytest.approx(0.42, rel=1e-3)
    assert found.half_slope_px == pytest.approx(320.0, rel=1e-3)


def test_a_lens_of_a_raytracers_json_is_read(tmp_path):
    surfaces = [
        {"type": "Spheric", "r": 10.0, "roc": 50.0, "d_next": 4.0, "mat2": "1.5/60"},
        {"type": "Aspheric", "r": 9.0, "roc": -50.0, "d_next": 2.0, "mat2": "air", "k": 0.5, "ai": [0.0, 1e-6]},
        {"type": "Stop", "r": 4.0, "d_next": 48.0, "mat2": "air"},
    ]
    path = tmp_path / "lens.json"
    path.write_text(json.dumps({"surfaces": surfaces}))
    lens = load_lens(path)
    assert [s.radius_mm for s in lens.surfaces] == [50.0, -50.0, np.inf]
    assert (lens.surfaces[0].index_d, lens.surfaces[0].abbe) == (1.5, 60.0)
    assert (lens.surfaces[1].conic, lens.surfaces[1].coefficients) == (0.5, (1e-6,))
    assert (lens.stop_index, lens.sensor_gap_mm) == (2, 48.0)
    for text in ("", "{}", json.dumps({"surfaces": [{"type": "Stop"}]})):
        path.write_text(text)
        with pytest.raises(InputError, match="no lens prescription"):
            load_lens(path)


def test_scores_are_of_all_pixels_and_allow_for_the_steps_of_the_truth():
    truth = np.array([[1000.0, 1000.0, 2000.0, 0.0, 10.0]])
    depth = np.array([[1010.0, np.nan, 2600.0, 5.0, 1000.0]])
    found = score(depth, np.full(truth.shape, 5.0), truth, truth_step_mm=0.0)
    assert found["fill"] == 0.75
    assert found["ratio_below_1.25"] == 0.25
    assert found["within_2_percent"] == 0.25
    assert found["abs_rel"] == pytest.approx((0.01 + 0.3 + 99) / 3)
    assert found["abs_rel_of_plausible"] == pytest.approx((0.01 + 0.3) / 2)
    assert found["within_1_sigma"] == 0.0
    # A step of 39 mm is an error of 11 mm.
    assert score(depth, np.full(truth.shape, 5.0), truth, truth_step_mm=39.0)["within_1_sigma"] == pytest.approx(1 / 3)

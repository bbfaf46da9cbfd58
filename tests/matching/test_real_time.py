"""Quality "real-time": planes against their truth, between the layers and through a lens of curved labels."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from chromaperture.color.unmixing import own_film_unmixing, view_reach
from chromaperture.matching import compiled as cpu
from chromaperture.matching import readable as stages
from chromaperture.matching.error_bar import sigma_of_range
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.labels import IDENTITY, LabelMap, PathWinner, labels_between
from chromaperture.matching.readable.correlation import of_own_sign
from chromaperture.matching.readable.place import (
    BIAS,
    EDGE_REACH_PX,
    EDGE_SHARE,
    SCATTER,
    halved_surface,
    place_by_correlation,
)
from chromaperture.matching.views import Views, channel_space
from chromaperture.optics.aperture import DESIGNS, centroids, made_of
from chromaperture.settings.methods import RealTimeConfig
from chromaperture.settings.stages import CorrelationConfig, LayersConfig
from worlds import LAYOUT, MARGIN_PX, capture, ideal_film, moved, texture

SMALL = RealTimeConfig().with_range(-4.0, 4.0)


@pytest.mark.parametrize("design", ["cy_halves", "cmy_circles"])
@pytest.mark.parametrize("disparity", [-2.3, -0.6, 0.25, 1.7])
def test_a_plane_is_found_between_the_layers(design, disparity):
    image = capture(texture(np.random.default_rng(4), blur_px=2.0), design, disparity)
    variance = np.full(image.shape, 1e-8, np.float32)
    found = estimate_disparity(image, aperture=design, config=SMALL, noise_variance=variance).value_px
    inner = found[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    # Cubic splines on the halved views err by up to 0.01 px between their pixels; channels that see two circles each
    # move a third as far.
    assert abs(np.nanmedian(inner) - disparity) < (0.02 if design == "cy_halves" else 0.07)
    assert np.isfinite(inner).mean() > 0.95


@pytest.mark.parametrize(("design", "most_px"), [("cy_halves", 0.005), ("rgb_squares", 0.005), ("cmy_circles", 0.03)])
@pytest.mark.parametrize("disparity", [1.35, 1.75, 2.1])
@pytest.mark.parametrize("side", [-1, 1])
def test_the_end_of_the_range_does_not_draw_a_plane(design, most_px, disparity, side):
    image = capture(texture(np.random.default_rng(11), blur_px=2.0), design, side * disparity)
    wide, narrow = (
        estimate_disparity(image, aperture=design, config=RealTimeConfig().with_range(*sorted(ends))).value_px
        for ends in ((-4.0, 4.0), (-4.0 * side, 2.5 * side))
    )
    inner = np.s_[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    # Scores beyond the range are those of a parabola, which scores are not quite; through circles a px of disparity
    # moves the views a third as far. With the outermost layer repeated it was up to 0.059, 0.020 and 0.27 px.
    assert abs(np.nanmedian((narrow - wide)[inner])) < most_px
    assert np.isfinite(narrow[inner]).mean() > 0.95


def test_a_plane_of_even_disparity_is_found_through_any_labels():
    """Labels are converted back to disparities."""
    picture = texture(np.random.default_rng(6), blur_px=2.0)
    image = capture(picture, "cy_halves", 1.2)
    labels = LabelMap(np.full(picture.shape, 0.4, np.float32), np.full(picture.shape, 0.8, np.float32))
    without, through = (
        estimate_disparity(image, aperture="cy_halves", config=SMALL, label_maps=maps).value_px
        for maps in ((), (labels,))
    )
    assert np.nanmedian(np.abs(without - through)) < 0.05  # half of the bias of linear interpolation between layers


@pytest.mark.parametrize("view_count", [2, 3])
@pytest.mark.parametrize("place", [4.0, 4.3, 3.6])
def test_the_place_between_layers_is_the_vertex_of_the_correlation(view_count, place):
    layers = np.array([3, 4, 5, 2, 6])
    rho = 0.8 - 0.1 * (layers - place) ** 2
    likelihood = -0.5 * np.log(1 - rho**2) if view_count == 2 else -np.log(1 - rho)
    around = [np.full((1, 1), value, np.float32) for value in likelihood]
    nearest = np.full((1, 1), 4.0, np.float32)
    winner = PathWinner(nearest, *around[:3], nearest, *around[3:])
    found, information = place_by_correlation(winner, 9, view_count=view_count)
    assert found[0, 0] == pytest.approx(place, abs=1e-5)  # float32
    peak = 0.8 if view_count == 2 else 0.8 - 0.1 * (4 - place) ** 2  # of three views at the layer
    left = 1 - peak**2 if view_count == 2 else 1 - peak
    # rho rho'' / (1 - rho^2), whose denominator has a floor of 3e-3: at most 2 % of what is left here
    power = 1.25 if view_count == 2 else 1.0
    assert information[0, 0] ** (1 / power) == pytest.approx(0.2 * peak / left, rel=0.02)


def test_noise_draws_the_place_of_three_views_little_to_the_layer():
    rng = np.random.default_rng(2)
    layers, place = np.array([3, 4, 5, 2, 6])[:, None, None], 4.4
    rho = 0.4 - 0.02 * (layers - place) ** 2 + rng.normal(0, 0.05, (5, 100, 100))  # layers differ by 0.01
    around = (-np.log(1 - rho)).astype(np.float32)
    nearest = np.full((100, 100), 4.0, np.float32)
    winner = PathWinner(nearest, *around[:3], nearest, *around[3:])
    found, information = place_by_correlation(winner, 9, view_count=3)
    # 0.037; 0.077 where places farther than 1.5 layers away are cut off
    assert np.average(found, weights=information) == pytest.approx(place, abs=0.05)


@pytest.mark.parametrize("run", [stages, cpu])
def test_cells_beside_nearer_things_count_less(run):
    layer = np.full((9, 20), 5.0, np.float32)
    layer[4, 8], layer[4, 15], layer[0, 2] = 3.0, 4.0, 8.0  # nearer by two and by one, farther by three
    around = [np.full(layer.shape, value, np.float32) for value in (0.5, 0.8, 0.6, 0.2, 0.3)]
    place, information = run.place_by_correlation(PathWinner(layer, *around[:3], layer, *around[3:]), 12, view_count=3)
    less = np.zeros(layer.shape, bool)
    less[2:7, 6:11] = True
    less[4, 8] = False
    less[0, 2] = True  # farther than its neighbours is beside what is nearer
    np.testing.assert_allclose(information[less], 0.05 * information[4, 8], rtol=1e-5)
    np.testing.assert_allclose(information[~less], information[4, 8], rtol=1e-5)
    np.testing.assert_allclose(place - layer, place[4, 8] - 3, atol=1e-5)


def test_a_bright_spot_does_not_hide_the_texture_of_a_dark_wall():
    pictures = np.random.default_rng(0).normal(0, 1e-3, (40, 60, 1)).astype(np.float32).repeat(3, axis=2)
    pictures[:8] += 1
    even = np.ones(pictures.shape[:2], np.float32)
    views = Views(pictures, np.array([[1.0, 0.0], [-0.5, 0.9], [-0.5, -0.9]]), 0 * even, even)
    score = stages.correlate(views, np.array([0.0]), config=RealTimeConfig().correlation)
    assert score[8:].min() > 0.9  # 0.07 where the floor is 1e-6 of the view's variance


@pytest.mark.parametrize("execution", ["numpy", "numba"])
def test_a_texture_of_two_hues_is_found_where_its_views_are_contrary(execution):
    """Orange on blue: blue falls where red rises. By positive correlations alone hardly a pixel was right."""
    image = capture(texture(np.random.default_rng(4), blur_px=2.0), "cy_halves", 1.0)
    image[..., 2] = image[..., 2].max() + 0.1 - image[..., 2]
    found = estimate_disparity(image, aperture="cy_halves", config=SMALL, execution=execution).value_px
    inner = found[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    assert (np.abs(inner - 1.0) < 0.1).mean() > 0.95


def test_a_cell_counts_by_its_strongest_correlation():
    scores = np.array([[[0.5, -0.9, 0.1], [0.92, -0.9, 0.1], [0.5, -0.7, 0.1], [0.2, 0.9, 0.1]]])
    expected = scores.copy()
    expected[0, 0] *= -1  # contrary and clear; then a positive one is stronger, then it is no clearer than noise
    np.testing.assert_array_equal(of_own_sign(scores), expected)


@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares", "cmy_circles"])
def test_saturated_pixels_take_the_disparity_of_their_neighbours_or_are_unknown(design):
    for top, bottom, left, right in ((30, 40, 40, 50), (24, 64, 30, 80)):
        image = capture(texture(np.random.default_rng(5), blur_px=2.0), design, 1.0)
        image[top:bottom, left:right] = 1.0
        patch = estimate_disparity(image, aperture=design, config=SMALL).value_px[top:bottom, left:right]
        known = np.isfinite(patch)
        np.testing.assert_allclose(patch[known], 1.0, atol=0.1)  # a fifth of a layer
        if bottom - top == 10:  # px of a cell's window: a spot no larger is filled
            assert known.mean() > 0.9
        else:  # in its middle any disparity explains it; a cell and the pixels up to the next are filled, 4 + 2 px
            assert not known[6:-6, 6:-6].any()


def test_a_saturated_box_does_not_take_the_depth_behind_it():
    back, box = texture(np.random.default_rng(5), blur_px=2.0), np.zeros((80, 96))
    box[20:68, 24:76] = 1.0
    image = np.zeros((80, 96, 3))
    for name, (ux, uy) in LAYOUT["cy_halves"].items():
        before = cv2.GaussianBlur(np.roll(box, (-2 * uy, -2 * ux), (0, 1)), (0, 0), 1.5)
        behind = moved(back, ux, uy)
        image += ((1 - before) * behind + 4 * before)[..., None] * ideal_film("cy_halves")[name]
    image = np.minimum(0.6 * image, 1.0).astype(np.float32)
    found = estimate_disparity(image, aperture="cy_halves", config=SMALL)
    value, sigma = (part[30:58, 34:66] for part in (found.value_px, found.sigma_px))
    assert (np.isnan(value) | (np.abs(value + 2.0) <= 2 * sigma)).all()


def test_a_coloured_wall_is_found_by_channels_where_unmixing_sees_it_in_focus():
    """Red light reaches one channel only; unmixed, it is in all views, undisplaced."""
    picture = texture(np.random.default_rng(8), blur_px=2.0)
    white = capture(picture, "cmy_circles", 1.5)
    image = (white * np.array([1.0, 0.25, 0.2])).astype(np.float32)
    channels, unmixed = (
        np.nanmedian(estimate_disparity(image, aperture="cmy_circles", config=replace(SMALL, space=space)).value_px)
        for space in ("channels", "unmixed")
    )
    assert channels == pytest.approx(1.5, abs=0.1)
    assert abs(unmixed) < 0.5


def test_leaking_film_turns_the_displacements_of_channels():
    aperture = made_of(DESIGNS["cmy_circles"], "real")
    found = channel_space(DESIGNS["cmy_circles"], own_film_unmixing(aperture))
    expected = centroids(aperture) / view_reach(DESIGNS["cmy_circles"])  # of the film itself
    np.testing.assert_allclose(found.directions, expected, atol=6e-4)  # rounded to 1e-3
    np.testing.assert_array_equal(found.rows, np.eye(3))


def test_next_to_a_step_the_error_bar_is_wide():
    layer = np.full((20, 30), 4, np.float32)
    layer[:, 15:] = 8
    sure = np.full(layer.shape, 1.0, np.float32)
    winner = PathWinner(layer, sure, 2 * sure, sure, np.zeros_like(sure), sure, sure)
    much = np.full(layer.shape, 1e12, np.float32)  # information: no error bar of its own
    surface = halved_surface(winner, layer, much, np.arange(13) * 0.25, IDENTITY, np.ones(layer.shape, np.float32))
    np.testing.assert_allclose(surface.sigma_px[:, 12:18], EDGE_SHARE * 4 * 0.25, rtol=1e-6)
    assert (surface.sigma_px[:, : 15 - EDGE_REACH_PX] < 1e-5).all()


@pytest.mark.parametrize("information", [1e4, 4.0, 1e-4])
def test_the_error_bar_is_that_of_the_information(information):
    layer = np.full((3, 4), 4, np.float32)
    sure = np.ones_like(layer)
    winner = PathWinner(layer, sure, 2 * sure, sure, np.zeros_like(sure), sure, sure)
    layers_px = np.arange(13) * 0.25
    surface = halved_surface(winner, layer, information * sure, layers_px, IDENTITY, sure)
    expected = 0.25 * math.hypot(SCATTER / math.sqrt(information), BIAS / information)
    np.testing.assert_allclose(surface.sigma_px, min(expected, sigma_of_range(layers_px)), rtol=1e-5)  # float32


def test_a_cell_s_score_is_the_correlation_of_its_weighted_window():
    rng = np.random.default_rng(9)
    common = rng.normal(size=(30, 34))
    pictures = np.stack([common + 0.5 * rng.normal(size=common.shape) for _ in range(2)], axis=-1).astype(np.float32)
    even = np.ones(common.shape, np.float32)
    views = Views(pictures, np.array([[1.0, 0.0], [-1.0, 0.0]]), 0 * even, even)
    config = CorrelationConfig(sampling="catmull-rom", cell_px=2)
    score = stages.correlate(views, np.array([-1.0, 0.0, 1.0]), config=config)
    assert score.shape == (15, 17, 3)
    triangle = np.array([1, 2, 3, 2, 1])
    weights = np.outer(triangle, triangle).ravel()
    for y, x, layer in ((4, 5, 0), (7, 7, 1), (10, 9, 2)):
        moved = layer - 1  # px; by whole px these cubics read views as they are
        windows = [
            pictures[2 * y - 2 : 2 * y + 3, 2 * x - 2 + sign * moved : 2 * x + 3 + sign * moved, k].ravel()
            for k, sign in enumerate((1, -1))
        ]
        covariance = np.cov(windows, aweights=weights)
        expected = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
        # 1 / 64000, and a floor of 1e-6 of the view's variance.
        assert score[y, x, layer] == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize(("apart_px", "parts"), [(2.0, 2), (0.75, 1), (4.5, 5)])
def test_views_move_at_most_half_a_px_between_two_labels(apart_px, parts):
    layers_px = np.arange(-2.0, 2.1, 0.5)
    labels_px = labels_between(layers_px, np.array([[apart_px / 2, 0.0], [-apart_px / 2, 0.0]]))
    np.testing.assert_allclose(labels_px[::parts], layers_px, atol=1e-12)
    assert apart_px * (labels_px[1] - labels_px[0]) <= 0.5 + 1e-9


def test_views_that_lie_close_together_are_smoothed_more():
    config = RealTimeConfig()
    halves, circles = (
        config.for_views(np.array([[reach, 0.0], [-reach, 0.0]])).views.presmooth_sigma_px for reach in (1.0, 0.25)
    )
    assert halves == config.views.presmooth_sigma_px
    assert circles == pytest.approx(2 * halves)
    three = config.for_views(np.array([[0.25, 0.0], [-0.25, 0.0], [0.0, 0.25]])).views.presmooth_sigma_px
    assert three == pytest.approx(math.sqrt(2) * halves)


def test_layers_of_three_views_that_lie_close_together_are_farther_apart():
    config = RealTimeConfig()
    corners = np.array([[0.0, 1.0], [math.sqrt(0.75), -0.5], [-math.sqrt(0.75), -0.5]]) / math.sqrt(3)  # 1 px apart
    assert config.for_views(corners[:2]).layers == config.layers
    assert config.for_views(corners).layers == config.layers  # as CMY squares: no time for more labels
    wider = config.for_views(0.75 * corners).layers
    assert wider.step_px == pytest.approx(0.5 * 1.2 / 0.75)
    assert wider.values_px[0] == config.layers.min_px
    assert config.layers.max_px <= wider.values_px[-1] < config.layers.max_px + wider.step_px
    assert len(labels_between(wider.values_px / 2, 0.75 * corners, most_px=0.25)) == 2 * len(wider.values_px) - 1
    narrow = RealTimeConfig(layers=LayersConfig(-0.5, 0.5)).for_views(0.25 * corners).layers
    assert len(narrow.values_px) == 3

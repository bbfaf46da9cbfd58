"""Every stage compiled (``compiled/``) against the readable one (``readable/``), and every method in both executions.

Every design, every setting, borders, odd sizes and pictures one px wide, unknown and saturated pixels included.
"""

from __future__ import annotations

import inspect
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from chromaperture.color.noise import estimate_noise_variance
from chromaperture.matching import compiled as cpu
from chromaperture.matching import readable as stages
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.execution import Execution, execution_named
from chromaperture.matching.labels import IDENTITY, LabelMap, PathWinner, Surface, labels_between
from chromaperture.matching.readable.correlation import SCORE_PARTS, exponential_window
from chromaperture.matching.readable.cross_filter import Tile
from chromaperture.matching.readable.four_paths import log_likelihood, scores_at_labels, summed_costs
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.matching.views import Views, filtered_views, halved_views
from chromaperture.matching.whole_light import in_whole_units
from chromaperture.optics.lens_blur import BlurModel, Rays, splat
from chromaperture.settings.methods import AccurateConfig, PaperConfig, RealTimeConfig, preset
from chromaperture.settings.stages import (
    BilateralConfig,
    CorrelationConfig,
    FourPathsConfig,
    LayersConfig,
    SurfaceConfig,
    ViewsConfig,
)
from chromaperture.system.errors import InputError
from chromaperture.system.threads import limited_threads
from worlds import NARROW, lens_blur, space_of, wavy_capture

SLOW, FAST = execution_named("numpy"), execution_named("numba")
ALL_DESIGNS = ("rgb_circles", "rgb_squares", "cmy_squares", "cmy_circles", "cy_halves", "cy_open")
REAL_TIME = RealTimeConfig().with_range(-4.0, 4.0)
LAYERS_PX = np.arange(-3.0, 3.01, 0.5)

# float32 against float64: a variance is a difference of E[a^2] and E[a]^2, so a score carries the rounding 1e-7 over
# the fraction EVEN that an area's variance has of the whole view's: 1e-4. Even areas are not compared.
SCORE_TOLERANCE = 3e-4
EVEN = 1e-3
# Moving one score of a parabola of curvature 0.04 / px^2 by 1e-4, layers 0.5 px apart, moves the vertex by 0.0025 px.
# On flatter peaks the vertex is rounding divided by rounding.
DISPARITY_TOLERANCE_PX = 0.02
FLAT_CURVATURE = 0.04  # 1/px^2
BORDER_PX = 5
# Two layers whose costs differ by rounding may change places: log-likelihoods are kept to 1/5000 nat, path costs to
# 1/700, and the place between the layers by their ratio to a bend of some hundredths of a nat in weak texture.
OTHER_WINNERS = 0.01
TIE_NATS = 0.05  # four path costs to 1/700 nat, and scores to 1/32000, at a correlation of 0.99 worth 0.002 nats


def views_of(image: np.ndarray, design: str, config: ViewsConfig = NARROW.views) -> Views:
    return filtered_views(image, space_of(design), config=config, noise_variance=estimate_noise_variance(image))


def textured(views: Views, decay: float) -> np.ndarray:
    """Where every view's variance is well above rounding; (H, W) bool."""
    pictures = views.pictures.astype(np.float64)
    mean_square, mean = (exponential_window(maps, decay) for maps in (pictures**2, pictures))
    return ((mean_square - mean**2) > EVEN * pictures.var(axis=(0, 1))).all(axis=2)


def bilateral_winners(views, config):
    settings = {"correlation": config.correlation, "bilateral": config.bilateral}
    return [run.bilateral_winner(views, config.layers.values_px, **settings) for run in (FAST, SLOW)]


def assert_agree(views: Views, config: PaperConfig, tolerance: float = SCORE_TOLERANCE) -> None:
    found, expected = bilateral_winners(views, config)
    step = config.layers.step_px
    peaked = (expected.curvature > FLAT_CURVATURE) & textured(views, config.correlation.window_decay)
    assert peaked.mean() > 0.2  # else the comparison below means little
    error = np.abs(found.disparity_px - expected.disparity_px)
    # Two layers whose scores differ by rounding may swap; that shows as NaN only where one is an end of the range.
    same = np.isfinite(found.disparity_px) == np.isfinite(expected.disparity_px)
    good = same & ~(error > DISPARITY_TOLERANCE_PX)
    border = np.ones(good.shape, bool)
    border[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = False
    assert good[peaked].mean() > 0.999  # all of them are found to agree; 0.1 % for flat peaks that texture hides
    assert good[peaked & border].mean() > 0.998  # as above; the border has fewer pixels
    both = good & peaked & np.isfinite(expected.disparity_px)  # elsewhere the vertex lies beyond the layers
    peak_error = np.abs(found.peak - expected.peak)[both]
    bend_error = np.abs(found.curvature - expected.curvature)[both] * step**2
    assert np.quantile(peak_error, 0.999) < tolerance
    assert np.quantile(bend_error, 0.999) < 4 * tolerance  # a second difference: weights 1, 2, 1
    for maps in found:
        assert maps.dtype == np.float32
        assert maps.shape == views.mask.shape


# ---- the interface


def test_both_executions_have_the_stages_of_the_interface_and_no_more():
    names = {name for name in vars(Execution) if not name.startswith("_")}
    assert set(stages.__all__) == names
    assert set(cpu.__all__) == names
    assert execution_named("numpy") is stages
    assert execution_named("numba") is cpu


@pytest.mark.parametrize("run", [stages, cpu], ids=["stages", "cpu"])
@pytest.mark.parametrize("name", sorted(stages.__all__))
def test_every_stage_has_the_parameters_of_the_interface(run, name):
    function = getattr(run, name)
    parameters = inspect.signature(getattr(function, "py_func", function)).parameters
    wanted = list(inspect.signature(getattr(Execution, name)).parameters.values())[1:]  # without self
    for parameter in wanted:
        assert parameters[parameter.name].kind == parameter.kind
        assert parameters[parameter.name].default == parameter.default
    # What an execution has beyond the interface, such as a schedule, must have a default and be named.
    extra = [value for key, value in parameters.items() if key not in {p.name for p in wanted}]
    assert [p.name for p in wanted] == list(parameters)[: len(wanted)]
    assert all(p.kind == p.KEYWORD_ONLY and p.default is not p.empty for p in extra)


def test_an_unknown_execution_is_refused():
    with pytest.raises(InputError, match="numba or numpy"):
        execution_named("reference")


# ---- correlation and bilateral filter


@pytest.mark.parametrize("design", ALL_DESIGNS)
def test_scores_agree(design):
    views = views_of(wavy_capture(design), design)
    found, expected = (run.correlate(views, NARROW.layers.values_px, config=NARROW.correlation) for run in (FAST, SLOW))
    assert found.shape == expected.shape
    assert found.dtype == np.float32
    clear = textured(views, NARROW.correlation.window_decay)
    np.testing.assert_allclose(found[clear], expected[clear], atol=SCORE_TOLERANCE)  # derived at its definition


@pytest.mark.parametrize("design", ALL_DESIGNS)
def test_best_layers_agree_for_every_design(design):
    assert_agree(views_of(wavy_capture(design), design), NARROW)


@pytest.mark.parametrize("design", ["cy_halves", "cmy_squares"])
@pytest.mark.parametrize(
    "change",
    [
        {"correlation": CorrelationConfig(noise_debiasing=False)},
        {"bilateral": BilateralConfig(texture_weighting=False)},
        {"bilateral": BilateralConfig(sigma_px=0.0)},
        {
            "bilateral": BilateralConfig(sigma_px=30.0, texture_weighting=True),
            "correlation": CorrelationConfig(0.9, noise_debiasing=True),
        },
        {
            "correlation": CorrelationConfig(0.3, noise_debiasing=True, sampling="catmull-rom"),
            "views": ViewsConfig(presmooth_sigma_px=0.0),
        },
        {"layers": LayersConfig(-3.0, 4.0, 0.25)},
        {"layers": LayersConfig(-5.0, 3.0, 1.0)},
        {"layers": LayersConfig(-3.1, 4.0, 0.3)},
        {"layers": LayersConfig(-4.0, 4.0, 4.0)},
        {"layers": LayersConfig(1.0, 16.0, 0.5)},
        {"layers": LayersConfig(-12.0, 12.0, 0.5)},
    ],
    ids=lambda change: ",".join(f"{k}={v}" for k, v in change.items()),
)
def test_best_layers_agree_for_every_setting(design, change):
    config = replace(NARROW, **change)
    assert_agree(views_of(wavy_capture(design), design, config.views), config)


@pytest.mark.parametrize("design", ["cy_halves", "cmy_circles"])
@pytest.mark.parametrize("shape", [(8, 8), (8, 65), (33, 9), (50, 64), (47, 101)])
def test_best_layers_agree_for_every_size(design, shape):
    config = replace(NARROW, layers=LayersConfig(-3.0, 3.0))
    image = wavy_capture(design, shape=(64, 104), saturated=False)[: shape[0], : shape[1]]
    views = views_of(image, design)
    clear = textured(views, config.correlation.window_decay)
    scores = [run.correlate(views, config.layers.values_px, config=config.correlation) for run in (FAST, SLOW)]
    np.testing.assert_allclose(scores[0][clear], scores[1][clear], atol=SCORE_TOLERANCE)  # derived at its definition
    found, expected = bilateral_winners(views, config)
    peaked = clear & (expected.curvature > FLAT_CURVATURE)
    np.testing.assert_allclose(
        # Derived at its definition.
        found.disparity_px[peaked],
        expected.disparity_px[peaked],
        atol=DISPARITY_TOLERANCE_PX,
        equal_nan=True,
    )


@pytest.mark.parametrize("design", ["cy_halves", "rgb_circles"])
def test_texture_weights_agree(design):
    views = views_of(wavy_capture(design), design)
    found, expected = (run.texture_weights(views, config=NARROW.correlation) for run in (FAST, SLOW))
    # Signal is a difference of two variances; where it nearly vanishes, its cube root makes 5e-3 of 1e-7.
    np.testing.assert_allclose(found, expected, atol=5e-3)
    # The largest, of even noise over the whole frame, to the rounding of the variances, EVEN.
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3 * expected.max())


def test_noise_that_varies_over_the_frame_agrees():
    views = views_of(wavy_capture("cy_halves"), "cy_halves")
    ramp = np.linspace(0, 2, views.mask.shape[1], dtype=np.float32)[None, :, None]
    noise = replace(views.noise, variance=views.noise.variance * ramp, covariance=views.noise.covariance * ramp)
    assert_agree(replace(views, noise=noise), NARROW)


def test_a_large_offset_of_brightness_costs_no_precision():
    # Halves that differ by 0.6: the window's mean is far from zero, its variance a few 1e-3 of the view's. What 1e-7 of
    # rounding does to a correlation there is 1e-3.
    image = wavy_capture("cy_halves", saturated=False)
    image = 0.1 * (image - image.mean()) + 0.2
    image[:, 40:] += 0.6
    assert_agree(views_of(image.astype(np.float32), "cy_halves"), NARROW, tolerance=1e-3)


def test_the_views_are_not_changed():
    views = views_of(wavy_capture("cy_halves"), "cy_halves")
    before = {name: np.copy(value) for name, value in vars(views).items() if isinstance(value, np.ndarray)}
    FAST.bilateral_winner(views, LAYERS_PX, correlation=NARROW.correlation, bilateral=NARROW.bilateral)
    FAST.four_path_winner(views, LAYERS_PX, IDENTITY, correlation=NARROW.correlation, paths=FourPathsConfig())
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(views, name), value)


@pytest.mark.parametrize("design", ["cy_halves", "cmy_circles"])
@pytest.mark.parametrize("threads", [1, 2])
def test_bands_of_rows_leave_no_seams(design, threads):
    # Several bands of at most 180 rows: each takes over the windows of the band above, or starts with rows of its own.
    config = replace(NARROW, correlation=CorrelationConfig(0.6, noise_debiasing=True), layers=LayersConfig(-3, 3, 1.0))
    views = views_of(wavy_capture(design, shape=(421, 40))[:401], design)  # without the even area
    with limited_threads(threads):
        found = FAST.correlate(views, config.layers.values_px, config=config.correlation)
        assert_agree(views, config)
    expected = SLOW.correlate(views, config.layers.values_px, config=config.correlation)
    clear = textured(views, 0.6)
    np.testing.assert_allclose(found[clear], expected[clear], atol=SCORE_TOLERANCE)  # derived at its definition


@pytest.mark.parametrize("quality", ["paper", "real-time", "accurate"])
def test_the_number_of_threads_changes_no_bit(quality):
    # High enough for more than one run of bands; another number of threads once began other rows with another halo.
    config = preset(quality).with_range(-3.0, 3.0)
    image = wavy_capture("cmy_squares", shape=(1100 if quality == "real-time" else 521, 40))  # two and a half runs
    found = []
    for threads in (1, 2, 5):
        with limited_threads(threads):
            found.append(estimate_disparity(image, aperture="cmy_squares", config=config))
    for other in found[1:]:
        for name in ("value_px", "sigma_px", "confidence"):
            np.testing.assert_array_equal(getattr(other, name), getattr(found[0], name))


def test_calls_do_not_disturb_each_other():
    # Memory is used again by later calls and by calls of other sizes, also at the same time.
    sizes = (("cy_halves", (61, 83)), ("cmy_circles", (40, 50)))
    cases = [views_of(wavy_capture(design, shape=shape), design) for design, shape in sizes]

    def match(i):
        layers_px = NARROW.layers.values_px
        return FAST.bilateral_winner(
            cases[i % 2], layers_px, correlation=NARROW.correlation, bilateral=NARROW.bilateral
        )

    alone = [match(i) for i in range(2)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(match, range(8)))
    for i, winner in enumerate(together):
        for a, b in zip(winner, alone[i % 2], strict=True):
            np.testing.assert_array_equal(a, b)


@st.composite
def hostile_images(draw):
    """Noise of any size from 1 x 2 px, with unknown and saturated pixels; (H, W, 3) float32."""
    shape = draw(st.tuples(st.integers(1, 40), st.integers(1, 40)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    image = rng.uniform(0, 0.9, (*shape, 3)).astype(np.float32)
    for value in (1.0, np.nan, np.inf):
        image[rng.random(shape) < draw(st.sampled_from([0.0, 0.1]))] = value
    return image


@pytest.mark.parametrize("shape", [(1, 20), (20, 1), (2, 1), (1, 2)])
def test_pictures_one_px_wide_or_high_agree(shape):
    image = np.random.default_rng(1).uniform(0, 0.9, (*shape, 3)).astype(np.float32)
    views = filtered_views(image, space_of("cy_halves"), config=NARROW.views)
    found, expected = (run.correlate(views, LAYERS_PX, config=NARROW.correlation) for run in (FAST, SLOW))
    np.testing.assert_allclose(found, expected, atol=SCORE_TOLERANCE)  # derived at its definition


@settings(max_examples=40, deadline=None)
@given(hostile_images(), st.sampled_from(["cy_halves", "cmy_circles"]), st.sampled_from([0.3, 0.8]))
def test_hostile_pictures_have_the_same_scores_and_best_layers(image, design, decay):
    config = replace(NARROW, layers=LayersConfig(-2.0, 2.0), correlation=CorrelationConfig(decay))
    try:
        views = filtered_views(image, space_of(design), config=config.views)
    except InputError:
        assume(False)  # nothing to match
    clear = textured(views, decay)
    scores = [run.correlate(views, config.layers.values_px, config=config.correlation) for run in (FAST, SLOW)]
    assert np.isfinite(scores[0]).all()
    if views.pictures.shape[2] == 3:  # the root in 1 - sqrt(det) magnifies rounding near 0
        scores = [(1 - score) ** 2 for score in scores]
    np.testing.assert_allclose(scores[0][clear], scores[1][clear], atol=2 * SCORE_TOLERANCE)  # 2: of the square
    found, expected = bilateral_winners(views, config)
    peaked = clear & (expected.curvature > FLAT_CURVATURE)
    error = np.abs(found.disparity_px - expected.disparity_px)[peaked]
    same = np.isfinite(found.disparity_px) == np.isfinite(expected.disparity_px)
    other = (error > DISPARITY_TOLERANCE_PX) | ~same[peaked]
    assert other.sum() <= 2 + OTHER_WINNERS * other.size


# ---- four paths, smoothing along the surface, enlargement


def likelihoods(views, layers_px, labels_px, label_map, config):
    score = SLOW.correlate(views, layers_px, config=config.correlation)
    score = scores_at_labels(score, layers_px, labels_px, label_map)
    cell_px = config.correlation.cell_px
    return log_likelihood(score, view_count=views.pictures.shape[2]) * views.mask[::cell_px, ::cell_px, None]


def assert_path_winners_agree(views, layers_px, label_map, config):
    cell_px = config.correlation.cell_px
    labels_px, label_map = labels_between(layers_px, views.directions, most_px=0.25), label_map.of_cells(cell_px)
    settings_ = {"correlation": config.correlation, "paths": config.paths, "labels_px": labels_px}
    found, expected = (run.four_path_winner(views, layers_px, label_map, **settings_) for run in (FAST, SLOW))
    guide = views.guide[::cell_px, ::cell_px]
    cost = summed_costs(-likelihoods(views, layers_px, labels_px, label_map, config), guide, config.paths)
    chosen = np.take_along_axis(cost, found.layer.astype(int)[..., None], axis=2)[..., 0]
    size = chosen.size
    assert (chosen - cost.min(axis=2) > TIE_NATS).sum() <= 2 + OTHER_WINNERS * size
    same = found.layer == expected.layer
    for name in ("before", "at", "after"):
        fast, slow = getattr(found, name), getattr(expected, name)
        # Explained fractions: near 0 the log-likelihood's own rounding, 2e-4, is large for its root, the correlation.
        apart = np.abs(np.exp(-2 * fast) - np.exp(-2 * slow))
        assert np.sum((apart > 1e-3) & same) <= 2 + OTHER_WINNERS * size  # five times that rounding
    # Rounding of four path costs, 1/700 nat each, over a temperature of 1.5 nats, of a few px.
    assert np.sum((np.abs(found.sigma_px - expected.sigma_px) > 0.05) & same) <= 2 + OTHER_WINNERS * size
    assert all(maps.shape == guide.shape for maps in found)


def assert_real_time_agrees(image, design, config=REAL_TIME, label_map=IDENTITY):
    views, _ = halved_views(image, space_of(design), config=config.views)
    assert_path_winners_agree(views, config.layers.values_px / 2, label_map.halved(), config)
    fast, slow = (RealTimeMethod(config, space_of(design), label_map, run).match(image) for run in (FAST, SLOW))
    assert fast.value_px.shape == slow.value_px.shape == image.shape[:2]
    apart = np.abs(fast.value_px - slow.value_px)
    same = (apart < DISPARITY_TOLERANCE_PX) | (np.isnan(fast.value_px) & np.isnan(slow.value_px))
    # Without noise, labels between two layers reach the correlation 1 together: ties, which the rounding of scores to
    # 1 / 32000 decides. It is the scatter of the posterior that changes with them most. One tie moves the 4 x 4 px of
    # its cell and those between it and its neighbours.
    assert np.sum(~same) <= 36 + 3 * OTHER_WINNERS * same.size
    assert np.mean(np.abs(fast.sigma_px - slow.sigma_px)[same] > 0.05) <= 10 * OTHER_WINNERS


@pytest.mark.parametrize("shape", [(1, 7), (1, 8), (5, 13), (16, 16)])
@pytest.mark.parametrize("view_count", [2, 3])
@pytest.mark.parametrize("labelled", [False, True])
def test_places_and_surfaces_agree(rng, shape, view_count, labelled):
    layers_px = np.arange(9) * 0.25 - 1
    likelihoods = rng.exponential(0.5, (5, *shape)).astype(np.float32) * (rng.random(shape) > 0.1)
    sigma_px = rng.uniform(0, 0.9, shape).astype(np.float32)
    winner = PathWinner(rng.integers(0, 9, shape).astype(np.float32), *likelihoods[:3], sigma_px, *likelihoods[3:])
    labels = LabelMap(*rng.uniform(0.5, 1, (2, *shape)).astype(np.float32)) if labelled else IDENTITY
    fast, slow = (run.place_by_correlation(winner, 9, view_count=view_count) for run in (FAST, SLOW))
    # Float32: where all three correlations are alike, their rounding, 1e-7, is divided by their bend.
    settled = slow[1] > 2e-4
    np.testing.assert_allclose(fast[0][settled], slow[0][settled], atol=2e-3)
    np.testing.assert_allclose(fast[1], slow[1], rtol=1e-3, atol=1e-5)
    mask = (rng.random(shape) > 0.95).astype(np.float32)
    surfaces = (run.halved_surface(winner, *slow, layers_px, labels, mask) for run in (FAST, SLOW))
    for one, other in zip(*surfaces, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5)  # float32; the root of 1 - exp(-2 l) at 0


@pytest.mark.parametrize("shape", [(41, 57), (3, 5), (97, 20), (120, 8)])  # odd, small, and more than one band
@pytest.mark.parametrize("design", ["cy_halves", "cmy_circles"])
def test_cells_have_the_same_scores(rng, shape, design):
    directions = space_of(design).directions
    common = rng.normal(size=shape)
    pictures = np.stack([common + 0.5 * rng.normal(size=shape) for _ in directions], axis=-1).astype(np.float32)
    even = np.ones(shape, np.float32)
    unit = 2.0**-11  # of pictures of 0.1
    views = Views(in_whole_units(0.1 * pictures, unit), directions, 0 * even, even, unit=unit)
    layers_px, config = 0.25 * np.arange(-5, 6), replace(REAL_TIME.correlation, sampling="b-spline")
    fast, slow = (np.rint(SCORE_PARTS * run.correlate(views, layers_px, config=config)) for run in (FAST, SLOW))
    # Sums are whole numbers and exact; only the last steps of three views depend on how they are fused.
    assert (fast != slow).mean() <= (0 if design == "cy_halves" else 1e-3)
    assert np.abs(fast - slow).max() <= 1


@pytest.mark.parametrize("design", ALL_DESIGNS)
def test_real_time_agrees_for_every_design(design):
    assert_real_time_agrees(wavy_capture(design), design)


@pytest.mark.parametrize("shape", [(8, 8), (8, 65), (33, 9), (50, 64), (47, 101)])
def test_real_time_agrees_for_every_size(shape):
    image = wavy_capture("cy_halves", shape=shape, saturated=False)
    image += np.random.default_rng(1).normal(0, 0.02, shape).astype(np.float32)[..., None]
    assert_real_time_agrees(image, "cy_halves")


@pytest.mark.parametrize(
    "change", [{"jump_penalty": 3.0}, {"edge_floor": 1.0}, {"row_share": 0.0}, {"row_share": 1.0}, {"temperature": 0.5}]
)
def test_real_time_agrees_for_every_setting(change):
    config = replace(REAL_TIME, paths=FourPathsConfig(**change))
    assert_real_time_agrees(wavy_capture("cy_halves"), "cy_halves", config)


def test_real_time_agrees_with_labels_of_equal_depth():
    image = wavy_capture("cy_halves")
    y, x = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    assert_real_time_agrees(image, "cy_halves", label_map=LabelMap(0.02 * (x - 40) + 0.01 * y, 0.8 + 0.003 * x))


@settings(max_examples=30, deadline=None)
@given(hostile_images(), st.sampled_from(["cy_halves", "cmy_circles"]), st.booleans())
def test_hostile_pictures_have_the_same_path_winners(image, design, labelled):
    try:
        views = filtered_views(image, space_of(design), config=REAL_TIME.views)
        halved_views(image, space_of(design), config=REAL_TIME.views)
    except InputError:
        assume(False)  # nothing to match
    shape = views.mask.shape
    labels = LabelMap(np.full(shape, 0.1, np.float32), np.full(shape, 0.9, np.float32)) if labelled else IDENTITY
    assert_path_winners_agree(views, np.arange(-2.0, 2.1, 0.5), labels, REAL_TIME)
    found = RealTimeMethod(REAL_TIME, space_of(design), labels, FAST).match(image)
    known = np.isfinite(found.value_px)
    assert found.value_px.shape == shape
    assert (found.sigma_px[known] >= REAL_TIME.floor_px * 0.999).all()  # float32
    assert (found.confidence[~known] == 0).all()


SHAPES = st.tuples(st.integers(1, 30), st.integers(1, 30))
SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=40, deadline=None)
@given(SHAPES, SEEDS, st.sampled_from([0.0, 2.0, 60.0]))
def test_sums_along_a_surface_agree(shape, seed, sigma_px):
    rng = np.random.default_rng(seed)
    maps = [rng.uniform(0.1, 2, shape).astype(np.float32) for _ in range(2)]
    guide = rng.normal(0, 1, shape).astype(np.float32)
    layer = rng.integers(0, 4, shape).astype(np.float32)
    found, expected = (run.smooth_along_surface(maps, guide, layer, sigma_px=sigma_px) for run in (FAST, SLOW))
    for fast, slow in zip(found, expected, strict=True):
        # float32 recursions of positive terms; the compiled links are a power series good to 1e-5 for |guide| of 5.
        np.testing.assert_allclose(fast, slow, rtol=1e-4)


@settings(max_examples=60, deadline=None)
@given(SHAPES, SEEDS)
def test_enlarged_surfaces_agree(shape, seed):
    rng = np.random.default_rng(seed)
    small = tuple((n + 1) // 2 for n in shape)
    disparity = rng.uniform(-2, 2, small).astype(np.float32)
    disparity[rng.random(small) < 0.2] = np.nan
    surface = Surface(disparity, *(rng.uniform(0, 1, small).astype(np.float32) for _ in range(2)))
    guide = (rng.integers(-8, 9, shape) / 8).astype(np.float32)  # eighths: equal differences are equal in both
    for fast, slow in zip(FAST.enlarge(surface, guide), SLOW.enlarge(surface, guide), strict=True):
        assert fast.shape == shape
        np.testing.assert_allclose(fast, slow, atol=2e-6, equal_nan=True)  # float32 numbers up to 2, fused or not


# ---- volumes


@settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(2, 7)),
    SEEDS,
    st.sampled_from([4, 8]),
    st.floats(0.1, 20),
    st.floats(0.1, 20),
)
def test_path_costs_agree(shape, seed, paths, slope_penalty, jump_penalty):
    rng = np.random.default_rng(seed)
    likelihood, guide = rng.uniform(0, 5, shape), rng.uniform(0, 2, shape[:2])
    config = SurfaceConfig(paths=paths, slope_penalty=slope_penalty, jump_penalty=jump_penalty)
    layers_px = 0.25 * np.arange(shape[2])
    found, expected = (run.aggregate_paths(likelihood, guide, layers_px, config=config) for run in (FAST, SLOW))
    # float32 sums of 8 costs of at most 5 + 20 nats
    np.testing.assert_allclose(found, expected, atol=1.5e-4)


@settings(max_examples=50, deadline=None)
@given(SEEDS, st.integers(2, 9), st.floats(0.01, 6), st.sampled_from([1.0, 1.5, 2.0]), st.booleans())
@example(9, 9, 6.0, 1.0, False)  # 44 nats
def test_volumes_read_at_labels_agree(seed, layers, strength, factors, uniform):
    rng = np.random.default_rng(seed)
    # Beyond 43 nats e^-2l has no full precision as float32.
    likelihood = np.minimum(rng.gamma(0.5, strength, (3, 4, layers)), 40).astype(np.float32)
    shape = (1, 1) if uniform else (3, 4)
    label_map = LabelMap(rng.normal(0, 1, shape).astype(np.float32), rng.uniform(0.5, 2, shape).astype(np.float32))
    where = np.arange(layers) * 0.3 - 1, np.linspace(-1.5, layers * 0.3, 2 * layers + 3), label_map
    found, expected = (run.read_at_labels(likelihood, *where, factors=factors) for run in (FAST, SLOW))
    assert np.isfinite(expected).all()
    # float32 fractions e^-2l: what is lost near 1 is 1e-7 of a nat's slope, and places are float32 too
    np.testing.assert_allclose(found, expected, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("run", [FAST, SLOW], ids=["numba", "numpy"])
def test_labels_that_are_layers_read_the_volume_and_beyond_it_nothing(run):
    volume = np.random.default_rng(8).uniform(0, 1, (11, 13, len(LAYERS_PX))).astype(np.float32)
    same = run.read_at_labels(volume, LAYERS_PX, LAYERS_PX, IDENTITY)
    np.testing.assert_allclose(same, volume, atol=1e-6)  # float32
    beyond = run.read_at_labels(volume, LAYERS_PX, np.array([-3.1, 3.1]), IDENTITY)
    np.testing.assert_array_equal(beyond, 0)


@settings(max_examples=30, deadline=None)
@given(SHAPES, SEEDS, st.integers(1, 9), st.floats(0.2, 5))
def test_posteriors_agree(shape, seed, layers, temperature):
    rng = np.random.default_rng(seed)
    layers_px = np.arange(layers) * 0.5
    cost = rng.uniform(0, 50, (*shape, layers)).astype(np.float32)
    disparity_px = rng.uniform(0, 4, shape)
    found, expected = (run.posterior(cost, layers_px, temperature=temperature) for run in (FAST, SLOW))
    # Float32 exponents of up to 250 have errors of 1e-5; a variance of 0 keeps those of the mean.
    np.testing.assert_allclose(found.mean_px, expected.mean_px, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found.variance_px2, expected.variance_px2, rtol=1e-4, atol=1e-6)
    sigmas = (part.sigma_px(disparity_px) for part in (found, expected))
    np.testing.assert_allclose(*sigmas, rtol=1e-4, atol=1e-5)


# ---- blur


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.integers(1, 12), st.floats(1e-3, 1))
def test_cross_filtered_pictures_agree_with_the_formula(seed, half, damping):
    rng = np.random.default_rng(seed)
    size, count, pairs = 2 * half, 30, np.array([[0, 2], [1, 0]])
    light = rng.random((3, count))
    light /= light.sum(axis=1, keepdims=True)
    defocus = rng.normal(size=(count, 2))
    canvas = np.zeros((2, size + 3, size + 2, 2), np.float32)
    expected, tiles = np.zeros(canvas.shape), []
    for place in ((slice(0, half), slice(1, 1 + half)), (slice(2, 2 + half), slice(0, half))):
        inner, weight = slice(half // 2, half // 2 + half), rng.random((half, half, 1)).repeat(2, axis=2)
        rays, pictures = Rays(rng.normal(size=(3, count, 2)), light), rng.normal(size=(2, 2, size, size))
        spectra = np.fft.rfft2(pictures).astype(np.complex64)
        tiles.append(Tile(rays, spectra, inner, weight.astype(np.float32), place))
        spread = np.zeros((3, size, size), np.float32)
        for points, weights, picture in zip(rays.at_infinity_px - defocus, light, spread, strict=True):
            splat(points, weights, picture)
        transfers = np.fft.fft2(spread)
        for part, views, (i, j) in zip(expected, pictures, pairs, strict=True):
            (a, b), h_a, h_b = np.fft.fft2(views), transfers[i], transfers[j]
            q = np.sqrt((np.abs(h_a) ** 2 + np.abs(h_b) ** 2) / 2 + damping)
            both = np.fft.ifft2([a * h_b / q, b * h_a / q]).real.transpose(1, 2, 0)
            part[place] += weight * both[inner, inner]
    for run in (FAST, SLOW):
        canvas[:] = 0
        run.cross_filter(tiles, pairs, defocus, canvas, size_px=size, damping=damping)
        # float32: relative to the largest of a pixel's sums
        np.testing.assert_allclose(canvas, expected, atol=4e-6 * max(1.0, np.abs(expected).max()))


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.integers(1, 40), st.integers(1, 40), st.floats(0.3, 6))
def test_correlations_of_a_band_agree(seed, height, width, sigma):
    fine, coarse = np.random.default_rng(seed).normal(size=(2, height, width, 2)).astype(np.float32)
    found, expected = (run.band_correlation(fine, coarse, sigma=sigma) for run in (FAST, SLOW))
    assert found.shape == expected.shape == (-(-height // 2), -(-width // 2))
    np.testing.assert_allclose(found, expected, atol=1e-5)  # float32: sums in another order
    assert np.abs(found).max() <= 1 + 1e-5
    seen, powers = (run.band_powers(fine, coarse, sigma=sigma) for run in (FAST, SLOW))
    np.testing.assert_allclose(seen, powers, rtol=1e-4, atol=1e-6)
    # Four times the powers seen in focus, where twice is allowed: half of the correlation for each of both pictures.
    less, slow = (
        run.band_correlation(fine, coarse, sigma=sigma, seen=powers / 4, allowed_growth=2) for run in (FAST, SLOW)
    )
    np.testing.assert_allclose(less, slow, atol=1e-5)
    np.testing.assert_allclose(less, found / 4, atol=1e-4)
    same = FAST.band_correlation(fine[..., :1].repeat(2, axis=2), coarse[..., :1].repeat(2, axis=2), sigma=sigma)
    np.testing.assert_allclose(same, 1, atol=1e-4)  # a picture agrees with itself; 1e-12 of its power is added


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.floats(0.2, 0.9), st.integers(1, 400))
def test_the_plane_that_most_points_agree_with_agrees(seed, share, count):
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, 700, (2, count))
    true = np.array([0.002, -0.001, 1.3])
    on_it = rng.random(count) < share
    label = np.where(on_it, true[0] * x + true[1] * y + true[2], rng.uniform(-5, 5, count))
    weight = rng.uniform(0.5, 2, count)
    corners = rng.integers(0, count, (40, 3))
    if on_it.any():
        corners[30:] = rng.choice(np.nonzero(on_it)[0], (10, 3))
    found, expected = (
        run.agreed_plane(corners, x, y, label, weight, tolerance_px=0.1, rounds=4) for run in (FAST, SLOW)
    )
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    if count * share > 60:
        assert np.isfinite(expected).all()
    # At the corners; single precision keeps labels of 5 px to 5e-7, and a point at the tolerance may count in one only.
    corners = np.array([[0, 0, 1], [700, 0, 1], [0, 700, 1]])
    if np.isfinite(expected).all() and on_it.sum() > 60:
        np.testing.assert_allclose(corners @ found, corners @ expected, atol=0.01)
        np.testing.assert_allclose(corners @ expected, corners @ true, atol=0.05)


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.integers(1, 60), st.integers(1, 30), st.integers(1, 3), st.integers(0, 60), st.floats(0.1, 40))
def test_transforms_of_points_agree(seed, size, fewer, channels, count, spread):
    """Narrow ones are transformed directly, wide ones by fast transforms of tiles in which they wrap around."""
    rng = np.random.default_rng(seed)
    points, weights = rng.uniform(-spread, spread, (channels, count, 2)), rng.uniform(0, 1, (channels, count))
    for samples in (size, max(1, size - fewer)):
        fast, slow = (run.point_transforms(points, weights, size, samples) for run in (FAST, SLOW))
        assert fast.shape == slow.shape == (channels, samples, samples // 2 + 1)
        np.testing.assert_allclose(fast, slow, atol=1e-5 * max(1, count))  # float32 sums of weights of at most 1
        np.testing.assert_allclose(fast[:, 0, 0], weights.sum(axis=1), rtol=1e-5, atol=1e-6)  # nothing is lost


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.integers(1, 30), st.integers(1, 30), st.integers(1, 4))
def test_volumes_of_few_pixels_are_read_alike(seed, height, width, spacing_px):
    rng = np.random.default_rng(seed)
    volume = rng.gamma(0.5, 1, (-(-height // spacing_px), -(-width // spacing_px), 7)).astype(np.float32)
    layers_px = np.arange(7) * 0.3
    settings_ = {"factors": 1.5, "shape": (height, width), "spacing_px": spacing_px}
    fast, slow = (run.read_at_labels(volume, layers_px, layers_px, IDENTITY, **settings_) for run in (FAST, SLOW))
    np.testing.assert_allclose(fast, slow, atol=1e-3, rtol=1e-3)  # as above
    np.testing.assert_allclose(fast[::spacing_px, ::spacing_px], volume, atol=1e-4, rtol=1e-4)  # e^-2l in float32


# ---- whole measurements

SHAPE = (40, 56)
NUMPY_METHODS = {
    "paper": PaperConfig(layers=LayersConfig(-3.0, 3.0)),
    "real-time": RealTimeConfig(layers=LayersConfig(-3.0, 3.0)),
    "accurate": AccurateConfig(layers=LayersConfig(-2.0, 2.0)),
}


def blur_of(shape):
    return lens_blur(BlurModel(6.0, 12000.0), shape[1], shape[0])


def measured(name, execution):
    image = wavy_capture("cy_halves", shape=(80, 96), saturated=False)[: SHAPE[0], : SHAPE[1]]
    image[5:9, 20:26] = 1.0
    more = {}
    config = NUMPY_METHODS.get(name)
    if config is None:
        blur = blur_of(SHAPE)
        more = {"blur": blur, "label_maps": [IDENTITY], "noise_variance": np.full_like(image, 0.006**2)}
        config = AccurateConfig.for_blur(blur.reach).with_range(-3 * blur.reach, 3 * blur.reach)
    return estimate_disparity(image, aperture="cy_halves", config=config, execution=execution, **more)


@pytest.mark.parametrize("name", [*NUMPY_METHODS, "accurate with blur"])
def test_whole_measurements_agree(name):
    fast, slow = (measured(name, execution) for execution in ("numba", "numpy"))
    known = np.isfinite(slow.value_px)
    assert known.mean() > 0.5  # else the comparison below means little
    # 0.002 px is found, of scores kept to 1 / 32000; a layer that differs shows as 0.5 px or NaN.
    apart = np.abs(fast.value_px - slow.value_px)
    other = (apart > 0.005) | (np.isfinite(fast.value_px) != known)
    assert other.mean() <= OTHER_WINNERS
    same = known & ~other
    # Of the same rounding: error bars divide by what a correlation lacks to 1, by a curvature or by a sum of costs.
    assert np.quantile(np.abs(fast.sigma_px / slow.sigma_px - 1)[same], 0.98) < 2e-3
    assert np.quantile(np.abs(fast.confidence - slow.confidence)[same], 0.98) < 2e-3


WITHOUT_NUMBA = """
import sys, types
from pathlib import Path
sys.modules["numba"] = None  # importing it raises ImportError
package = types.ModuleType("chromaperture")  # without __init__.py, whose camera converts depth by compiled code
package.__path__ = [{package!r}]
sys.modules["chromaperture"] = package

import numpy as np
from chromaperture.settings.methods import AccurateConfig, PaperConfig, RealTimeConfig, preset
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.labels import IDENTITY
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil

image = np.random.default_rng(0).uniform(0, 0.9, (12, 16, 3)).astype(np.float32)
blur = LensBlur(BlurModel(6.0, 12000.0), sample_pupil(DESIGNS["cy_halves"]), 16, 12)
with_blur = AccurateConfig.for_blur(blur.reach).with_range(-blur.reach, blur.reach)
for config in (PaperConfig(), RealTimeConfig(), AccurateConfig(), with_blur):
    found = estimate_disparity(image, aperture="cy_halves", config=config.with_range(-1.0, 1.0), execution="numpy",
                               blur=blur, label_maps=[IDENTITY])
    assert found.value_px.shape == (12, 16)
assert not [name for name in sys.modules if name.startswith(("numba.", "llvmlite"))]
print("measured")
"""


def test_the_readable_execution_needs_no_compiled_code():
    package = str(__import__("chromaperture").__path__[0])
    script = WITHOUT_NUMBA.format(package=package)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "measured", done.stderr

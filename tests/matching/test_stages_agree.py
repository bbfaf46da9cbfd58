"""Every stage in every execution that has it: compiled and in shaders, against the readable one."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from chromaperture.color.noise import estimate_noise_variance
from chromaperture.matching import compiled, readable
from chromaperture.matching.execution import Execution, execution_named
from chromaperture.matching.labels import IDENTITY, LabelMap, PathWinner, Surface
from chromaperture.matching.planes.regions import borders_of
from chromaperture.matching.readable.correlation import exponential_window
from chromaperture.matching.readable.cross_filter import Tile
from chromaperture.matching.readable.pair_evidence import Fallback
from chromaperture.matching.readable.planes import PlaneCosts
from chromaperture.matching.readable.upsample import Coarse
from chromaperture.matching.views import Views, filtered_views
from chromaperture.optics.lens_blur import Rays, splat
from chromaperture.settings.methods import PaperConfig
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
from executions import COMPILED, READABLE, READABLE_AND_COMPILED, SHADERS, compiled_run, shaders_run, slanted_volume
from worlds import ALL_DESIGNS, NARROW, hostile_images, space_of, spectral_example, wavy_capture

LAYERS_PX = np.arange(-3.0, 3.01, 0.5)
SHAPES = st.tuples(st.integers(1, 30), st.integers(1, 30))
SEEDS = st.integers(0, 2**32 - 1)


# ---- the interface


def test_both_executions_have_the_stages_of_the_interface_and_no_more():
    names = {name for name in vars(Execution) if not name.startswith("_")}
    assert set(readable.__all__) == names
    assert set(compiled.__all__) == names
    assert execution_named("numpy") is readable
    assert execution_named("numba") is compiled


@pytest.mark.parametrize("name", sorted(readable.__all__))
def test_every_stage_has_the_parameters_of_the_interface(name):
    for run in (READABLE, COMPILED, SHADERS):
        function = getattr(run, name, None)
        if function is None:
            assert run is SHADERS
            continue
        parameters = inspect.signature(getattr(function, "py_func", function)).parameters
        wanted = list(inspect.signature(getattr(Execution, name)).parameters.values())[1:]  # without self
        for parameter in wanted:
            assert parameters[parameter.name].kind == parameter.kind
            assert parameters[parameter.name].default == parameter.default
        assert [p.name for p in wanted] == list(parameters)[: len(wanted)]
        # What an execution has beyond the interface, such as a schedule, must have a default and be named.
        extra = list(parameters.values())[len(wanted) :]
        assert all((p.kind == p.KEYWORD_ONLY and p.default is not p.empty) or p.kind == p.VAR_KEYWORD for p in extra)


def test_an_unknown_execution_is_refused():
    with pytest.raises(InputError, match="numba or numpy"):
        execution_named("reference")


# ---- one case, in every execution


class Given(NamedTuple):
    """What a stage is given."""

    arguments: tuple
    options: dict[str, Any]


def smoothed(rng, draw, shape):
    maps = [rng.uniform(0.1, 2, shape).astype(np.float32) for _ in range(2)]
    guide, layer = rng.normal(0, 1, shape).astype(np.float32), rng.integers(0, 4, shape).astype(np.float32)
    return Given((maps, guide, layer), {"sigma_px": draw.choice([0.0, 2.0, 60.0])})


def enlarged(rng, draw, shape):
    small = tuple((n + 1) // 2 for n in shape)
    disparity = rng.uniform(-2, 2, small).astype(np.float32)
    disparity[rng.random(small) < 0.2] = np.nan
    surface = Surface(disparity, *(rng.uniform(0, 1, small).astype(np.float32) for _ in range(2)))
    guide = (rng.integers(-8, 9, shape) / 8).astype(np.float32)  # eighths: equal differences are equal in both
    return Given((surface, guide), {})


def path_volume(rng, draw, shape):
    count = int(draw.choice([3, 9, 21, 70]))
    likelihood, guide = slanted_volume(rng, *shape, count)
    slope, jump = draw.uniform(0.4, 80, 2)
    config = SurfaceConfig(paths=int(draw.choice([4, 8])), slope_penalty=slope, jump_penalty=jump)
    return Given((likelihood, guide, 0.25 * np.arange(count)), {"config": config})


def path_costs(rng, draw, shape):
    layers = int(draw.integers(1, 10))
    cost = rng.uniform(0, 50, (*shape, layers)).astype(np.float32)
    return Given((cost, np.arange(layers) * 0.5), {"temperature": draw.uniform(0.2, 5)})


def read_volume(rng, draw, shape):
    layers, samples = int(draw.integers(2, 10)), tuple(draw.integers(1, 31, 2))
    # Beyond 43 nats e^-2l has no full precision as float32.
    likelihood = np.minimum(rng.gamma(0.5, rng.choice([0.01, 1.0, 6.0]), (*samples, layers)), 40).astype(np.float32)
    of = (1, 1) if rng.random() < 0.5 else samples
    label_map = LabelMap(rng.normal(0, 1, of).astype(np.float32), rng.uniform(0.5, 2, of).astype(np.float32))
    where = np.arange(layers) * 0.3 - 1, np.linspace(-1.5, layers * 0.3, 2 * layers + 3), label_map
    places = tuple(np.sort(rng.uniform(0, n + 1, count)) for n, count in zip(samples, shape, strict=True))
    options = {"factors": draw.choice([1.0, 1.5, 2.0]), "places": places if draw.random() < 0.8 else None}
    return Given((likelihood, *where), options)


def correlated_pairs(rng, draw, shape):
    """Secondary pairs have no numbers of layers that are read between every fourth."""
    numbers, (primary, other) = np.arange(1 + 2 * draw.integers(12)), draw.choice([(1, 0), (1, 2), (2, 1), (3, 0)])
    of_all = (numbers % 4 == 0) | (numbers == numbers[-1])
    computed = of_all | (numbers % 2 == 0) | (rng.random(len(numbers)) < 0.5)
    place = np.cumsum(computed) - 1
    correlation = rng.uniform(-1, 1, (computed.sum(), primary + other, 2, *shape)).astype(np.float32)
    correlation[place[computed & ~of_all], primary:] = np.nan
    options = {"primary": primary, "band_weights": (1.0, 0.5), "fallback": Fallback(0.7, 0.1)}
    return Given((correlation, np.where([computed, of_all], place, -1)), options)


def planes_of_labels(rng, draw, shape):
    labels_px = np.arange(-3.0, 3.01, 0.1)
    planes = rng.normal(0, (0.3, 0.3, 2), (int(draw.integers(1, 5)), 3))
    return Given((rng.random((*shape, len(labels_px)), np.float32), planes, labels_px, PlaneCosts(0.3, 0.05)), {})


def regions(rng, draw, shape):
    """With whole numbers many pairs gain as much: the same joins in the same order."""
    region = np.arange(shape[0] * shape[1]).reshape(shape)
    total, links = 4 * rng.random((region.size, 9)), 3 * rng.random((2, *shape))
    if rng.random() < 0.5:
        total, links = total.round(), links.round()
    return Given((total, *borders_of(region, links)), {"plane_penalty": draw.choice([0.0, 1.0, 10.0])})


def working_scale(rng, draw, shape):
    height, width = 4 * shape[0] + int(draw.integers(4)), 4 * shape[1] + int(draw.integers(4))
    disparity = rng.choice([-1.0, 0.05, 0.1, 1.5], shape).astype(np.float32)
    sigma, confidence, guide = rng.uniform(0, 1, (3, *shape)).astype(np.float32)
    maps = Coarse(disparity, sigma, confidence, rng.uniform(size=shape) < 0.1, 3 * guide)
    return Given((maps, rng.uniform(0, 3, (height, width, 3)).astype(np.float32), np.full(3, 1 / 3)), {})


def spectral_windows(rng, draw, shape):
    options = {"channel_error": 0.01, "rounds": int(draw.choice([1, 3]))}
    # Fixed: of ill-conditioned random colours float32 loses 0.01 nats of some hundred.
    return Given(spectral_example(np.random.default_rng(13), windows=shape[0]), options)


def alike_windows(rng, draw, shape):
    """Channels that have 0.002 of their power for themselves, and no noise: near singular."""
    # Seven windows: of others rounding decides whether a step is taken as a whole.
    (spectra, powers, node, noise), options = spectral_windows(rng, draw, (7, 1))
    alike = np.repeat(spectra[:, :1], 3, axis=1) * np.array([1, 0.9, 0.8], np.float32)[:, None]
    powers[:, :, 1:3], powers[:, :, 3::2], powers[:, :, 4::2] = powers[:, :, :1], powers[:, :, :1], 0
    given = (alike + 0.03 * spectra).astype(np.complex64), powers, node, np.full_like(noise, 1e-4)
    return Given(given, options | {"channel_error": 0.002})


def parts(found) -> list[np.ndarray]:
    """The arrays that a stage returns."""
    return [found] if isinstance(found, np.ndarray) else list(found)


class Stage(NamedTuple):
    """How the cases of a stage are made, and how far executions may be apart.

    ``make`` gets random numbers for arrays, others for settings, which are the same for a size, and the size.
    """

    make: Callable[[np.random.Generator, np.random.Generator, tuple[int, int]], Given]
    rtol: float | tuple[float, ...] = 0.0  # for every part, or one for each
    atol: float | tuple[float, ...] = 0.0
    other: float = 0.0  # share of the numbers that may differ by more
    finite: bool = True  # all that the stage returns
    in_shaders: tuple[float, float] | None = None  # ``rtol`` and ``atol`` of shaders, where they have the stage


STAGES = {
    # float32 recursions of positive terms; the compiled links are a power series good to 1e-5 for |guide| of 5.
    "smooth_along_surface": Stage(smoothed, rtol=1e-4, in_shaders=(1e-4, 0.0)),
    "enlarge": Stage(enlarged, atol=2e-6, finite=False),  # float32 numbers up to 2, fused or not
    "aggregate_paths": Stage(path_volume, atol=2e-4, in_shaders=(0.0, 2e-3)),  # float32 sums of 8 costs of some 30 nats
    # Mean and variance: float32 exponents of up to 250 have errors of 1e-5; a variance of 0 keeps those of the mean.
    "posterior": Stage(path_costs, rtol=(1e-5, 1e-4), atol=(1e-5, 1e-6)),
    # float32 fractions e^-2l: what is lost near 1 is 1e-7 of a nat's slope, and places are float32 too
    "read_at_labels": Stage(read_volume, rtol=1e-3, atol=1e-3),
    # float32: rounding of interpolated correlations, 4e-7 of their squares, over the .001 that is unexplained at least
    "pair_evidence": Stage(correlated_pairs, atol=4e-4),
    "plane_costs": Stage(planes_of_labels, atol=2e-4),  # float32 volumes between labels a tenth apart
    "join_regions": Stage(regions),
    # Sums in another order; where both sides of an edge weigh the same to rounding either may be taken.
    "upsample": Stage(working_scale, rtol=1e-5, atol=1e-6, other=1e-3, finite=False),
    # float32 sums of some hundred nats
    "spectral_likelihood": Stage(spectral_windows, rtol=1e-5, in_shaders=(0.0, 5e-4)),
    "spectral_likelihood of alike channels": Stage(alike_windows, rtol=2e-4, in_shaders=(0.0, 0.02)),
}
# Every size is compiled anew for shaders, and has its own settings.
FEW_SHAPES = st.sampled_from([(1, 2), (7, 1), (24, 20), (12, 31), (45, 70)])


def check_agreement(run, name: str, seed: int, shape: tuple[int, int]) -> None:
    stage, function = STAGES[name], name.split()[0]
    case = stage.make(np.random.default_rng(seed), np.random.default_rng(shape), shape)
    found, expected = (parts(getattr(each, function)(*case.arguments, **case.options)) for each in (run, READABLE))
    rtol, atol = (stage.rtol, stage.atol) if run is COMPILED else stage.in_shaders
    limits = (np.broadcast_to(limit, len(expected)) for limit in (rtol, atol))
    for one, other, relative, absolute in zip(found, expected, *limits, strict=True):
        assert one.shape == other.shape
        assert np.isfinite(other).all() or not stage.finite
        np.testing.assert_array_equal(np.isnan(one), np.isnan(other))
        differs = ~np.isclose(one, other, rtol=relative, atol=absolute, equal_nan=True)
        assert differs.mean() <= stage.other, np.nanmax(np.abs(one - other))


@pytest.mark.parametrize("name", STAGES)
@settings(max_examples=40, deadline=None)
@given(SEEDS, SHAPES)
def test_compiled_stages_agree(name, seed, shape):
    check_agreement(COMPILED, name, seed, shape)


@pytest.mark.extra("gpu", "wgpu")
@pytest.mark.parametrize("name", [name for name, stage in STAGES.items() if stage.in_shaders is not None])
@settings(max_examples=8, deadline=None)
@given(SEEDS, FEW_SHAPES)
def test_stages_in_shaders_agree(name, seed, shape):
    check_agreement(SHADERS, name, seed, shape)


@pytest.mark.parametrize("shape", [(1, 7), (1, 8), (5, 13), (16, 16)])
@pytest.mark.parametrize("view_count", [2, 3])
@pytest.mark.parametrize("labelled", [False, True])
def test_places_and_surfaces_agree(rng, shape, view_count, labelled):
    layers_px = np.arange(9) * 0.25 - 1
    likelihoods = rng.exponential(0.5, (5, *shape)).astype(np.float32) * (rng.random(shape) > 0.1)
    sigma_px = rng.uniform(0, 0.9, shape).astype(np.float32)
    winner = PathWinner(rng.integers(0, 9, shape).astype(np.float32), *likelihoods[:3], sigma_px, *likelihoods[3:])
    labels = LabelMap(*rng.uniform(0.5, 1, (2, *shape)).astype(np.float32)) if labelled else IDENTITY
    fast, slow = (run.place_by_correlation(winner, 9, view_count=view_count) for run in (COMPILED, READABLE))
    # Float32: where all three correlations are alike, their rounding, 1e-7, is divided by their bend.
    settled = slow[1] > 2e-4
    np.testing.assert_allclose(fast[0][settled], slow[0][settled], atol=2e-3)
    np.testing.assert_allclose(fast[1], slow[1], rtol=1e-3, atol=1e-5)
    mask = (rng.random(shape) > 0.95).astype(np.float32)
    surfaces = (run.halved_surface(winner, *slow, layers_px, labels, mask) for run in (COMPILED, READABLE))
    for one, other in zip(*surfaces, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5)  # float32; the root of 1 - exp(-2 l) at 0


@READABLE_AND_COMPILED
@pytest.mark.parametrize("places", [None, (np.arange(8) / 2, np.arange(10) / 2)])
def test_labels_that_are_layers_read_the_volume_and_beyond_it_nothing(run, places):
    volume = np.random.default_rng(8).uniform(0, 1, (4, 5, len(LAYERS_PX))).astype(np.float32)
    found = run.read_at_labels(volume, LAYERS_PX, LAYERS_PX, IDENTITY, places=places)
    every = len(found) // 4
    np.testing.assert_allclose(found[::every, ::every], volume, atol=1e-6)  # float32
    beyond = run.read_at_labels(volume, LAYERS_PX, np.array([-3.1, 3.1]), IDENTITY, places=places)
    np.testing.assert_array_equal(beyond, 0)


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
    for run in (COMPILED, READABLE):
        canvas[:] = 0
        run.cross_filter(tiles, pairs, defocus, canvas, size_px=size, damping=damping)
        # float32: relative to the largest of a pixel's sums
        np.testing.assert_allclose(canvas, expected, atol=4e-6 * max(1.0, np.abs(expected).max()))


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.integers(1, 40), st.integers(1, 40), st.floats(0.3, 6))
def test_correlations_of_a_band_agree(seed, height, width, sigma):
    fine, coarse = np.random.default_rng(seed).normal(size=(2, height, width, 2)).astype(np.float32)
    found, expected = (run.band_correlation(fine, coarse, sigma=sigma) for run in (COMPILED, READABLE))
    assert found.shape == expected.shape == (-(-height // 2), -(-width // 2))
    np.testing.assert_allclose(found, expected, atol=1e-5)  # float32: sums in another order
    assert np.abs(found).max() <= 1 + 1e-5
    seen, powers = (run.band_powers(fine, coarse, sigma=sigma) for run in (COMPILED, READABLE))
    np.testing.assert_allclose(seen, powers, rtol=1e-4, atol=1e-6)
    # Four times the powers seen in focus, where twice is allowed: half of the correlation for each of both pictures.
    less, slow = (
        run.band_correlation(fine, coarse, sigma=sigma, seen=powers / 4, allowed_growth=2)
        for run in (COMPILED, READABLE)
    )
    np.testing.assert_allclose(less, slow, atol=1e-5)
    np.testing.assert_allclose(less, found / 4, atol=1e-4)
    same = COMPILED.band_correlation(fine[..., :1].repeat(2, axis=2), coarse[..., :1].repeat(2, axis=2), sigma=sigma)
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
        run.agreed_plane(corners, x, y, label, weight, tolerance_px=0.1, rounds=4) for run in (COMPILED, READABLE)
    )
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    # A plane of eight points at least is fitted, and weights differ up to fourfold.
    if on_it.sum() >= 32:
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
        fast, slow = (run.point_transforms(points, weights, size, samples) for run in (COMPILED, READABLE))
        assert fast.shape == slow.shape == (channels, samples, samples // 2 + 1)
        np.testing.assert_allclose(fast, slow, atol=1e-5 * max(1, count))  # float32 sums of weights of at most 1
        np.testing.assert_allclose(fast[:, 0, 0], weights.sum(axis=1), rtol=1e-5, atol=1e-6)  # nothing is lost


# ---- correlation and bilateral filter

# float32 against float64: a variance is a difference of E[a^2] and E[a]^2, so a score carries the rounding 1e-7 over
# the fraction EVEN that an area's variance has of the whole view's: 1e-4. Even areas are not compared.
SCORE_TOLERANCE = 3e-4
EVEN = 1e-3
# Moving one score of a parabola of curvature 0.04 / px^2 by 1e-4, layers 0.5 px apart, moves the vertex by 0.0025 px.
# On flatter peaks the vertex is rounding divided by rounding.
DISPARITY_TOLERANCE_PX = 0.02
FLAT_CURVATURE = 0.04  # 1/px^2
BORDER_PX = 5
OTHER_WINNERS = 0.01  # two layers whose costs differ by rounding may change places
# A shader's window leaves out 1e-6 of its weights. Where it holds a thousandth of the view's variance, and what is left
# out has all of it, that is 1e-3 of the score.
SHADER_SCORE_TOLERANCE = 1e-3


def views_of(image: np.ndarray, design: str, config: ViewsConfig = NARROW.views) -> Views:
    return filtered_views(image, space_of(design), config=config, noise_variance=estimate_noise_variance(image))


def textured(views: Views, decay: float) -> np.ndarray:
    """Where every view's variance is well above rounding; (H, W) bool."""
    pictures = views.pictures.astype(np.float64)
    mean_square, mean = (exponential_window(maps, decay) for maps in (pictures**2, pictures))
    return ((mean_square - mean**2) > EVEN * pictures.var(axis=(0, 1))).all(axis=2)


def bilateral_winners(views, config):
    settings = {"correlation": config.correlation, "bilateral": config.bilateral}
    return [run.bilateral_winner(views, config.layers.values_px, **settings) for run in (COMPILED, READABLE)]


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


SIZES = [((20, 30), 9, 0.9), ((20, 30), 7, 0.3), ((1, 40), 5, 0.8), ((40, 1), 6, 0.8)]


@pytest.mark.parametrize("run", [compiled_run, shaders_run])
@pytest.mark.parametrize(
    ("design", "shape", "count", "decay"),
    [
        *((design, (45, 61), 32, 0.8) for design in ALL_DESIGNS),
        *((design, *size) for design in ("cy_halves", "rgb_squares", "cmy_circles") for size in SIZES),
    ],
)
def test_scores_agree(run, design, shape, count, decay):
    views = views_of(wavy_capture(design, shape=shape), design)
    config = replace(PaperConfig().correlation, window_decay=decay)
    layers_px = (np.arange(count) - count // 2) * 0.5
    found, expected = (each.correlate(views, layers_px, config=config) for each in (run, READABLE))
    assert found.shape == expected.shape
    assert found.dtype == np.float32
    if run is SHADERS:
        np.testing.assert_allclose(found, expected, atol=SHADER_SCORE_TOLERANCE)
    else:
        clear = textured(views, decay)
        np.testing.assert_allclose(found[clear], expected[clear], atol=SCORE_TOLERANCE)  # derived at its definition


CHANGES = [
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
    *({"layers": LayersConfig(-3.0, 4.0, step_px)} for step_px in (0.25, 0.3, 1.0, 3.5)),
    *({"layers": LayersConfig(*range_px, 0.5)} for range_px in ((-5.1, 2.9), (1.0, 16.0), (-12.0, 12.0))),
]


@pytest.mark.parametrize(
    ("design", "change"),
    [
        *((design, {}) for design in ALL_DESIGNS),
        *((design, change) for design in ("cy_halves", "cmy_squares") for change in CHANGES),
    ],
    ids=str,
)
def test_best_layers_agree(design, change):
    config = replace(NARROW, **change)
    assert_agree(views_of(wavy_capture(design), design, config.views), config)


@pytest.mark.parametrize("design", ["cy_halves", "rgb_circles"])
def test_texture_weights_agree(design):
    views = views_of(wavy_capture(design), design)
    found, expected = (run.texture_weights(views, config=NARROW.correlation) for run in (COMPILED, READABLE))
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
    COMPILED.bilateral_winner(views, LAYERS_PX, correlation=NARROW.correlation, bilateral=NARROW.bilateral)
    COMPILED.four_path_winner(views, LAYERS_PX, IDENTITY, correlation=NARROW.correlation, paths=FourPathsConfig())
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(views, name), value)


@pytest.mark.parametrize("design", ["cy_halves", "cmy_circles"])
@pytest.mark.parametrize("threads", [1, 2])
def test_bands_of_rows_leave_no_seams(design, threads):
    # Several bands of at most 180 rows: each takes over the windows of the band above, or starts with rows of its own.
    config = replace(NARROW, correlation=CorrelationConfig(0.6, noise_debiasing=True), layers=LayersConfig(-3, 3, 1.0))
    views = views_of(wavy_capture(design, shape=(421, 40))[:401], design)  # without the even area
    with limited_threads(threads):
        found = COMPILED.correlate(views, config.layers.values_px, config=config.correlation)
        assert_agree(views, config)
    expected = READABLE.correlate(views, config.layers.values_px, config=config.correlation)
    clear = textured(views, 0.6)
    np.testing.assert_allclose(found[clear], expected[clear], atol=SCORE_TOLERANCE)  # derived at its definition


def test_calls_do_not_disturb_each_other():
    # Memory is used again by later calls and by calls of other sizes, also at the same time.
    sizes = (("cy_halves", (61, 83)), ("cmy_circles", (40, 50)))
    cases = [views_of(wavy_capture(design, shape=shape), design) for design, shape in sizes]

    def match(i):
        layers_px = NARROW.layers.values_px
        return COMPILED.bilateral_winner(
            cases[i % 2], layers_px, correlation=NARROW.correlation, bilateral=NARROW.bilateral
        )

    alone = [match(i) for i in range(2)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(match, range(8)))
    for i, winner in enumerate(together):
        for a, b in zip(winner, alone[i % 2], strict=True):
            np.testing.assert_array_equal(a, b)


@settings(max_examples=40, deadline=None)
@given(hostile_images(), st.sampled_from(["cy_halves", "cmy_circles"]), st.sampled_from([0.3, 0.8]))
def test_hostile_pictures_have_the_same_scores_and_best_layers(image, design, decay):
    config = replace(NARROW, layers=LayersConfig(-2.0, 2.0), correlation=CorrelationConfig(decay))
    try:
        views = filtered_views(image, space_of(design), config=config.views)
    except InputError:
        assume(False)  # nothing to match
    clear = textured(views, decay)
    scores = [run.correlate(views, config.layers.values_px, config=config.correlation) for run in (COMPILED, READABLE)]
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

"""Every stage in WGSL against the readable one (``readable/``), on whatever device there is: the same shader files."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from chromaperture.depth.conversion import DepthModel, depth_and_sigma
from chromaperture.depth.field import DepthField, LocalField
from chromaperture.matching import readable as stages
from chromaperture.matching.device import correlation_stages, shader_text
from chromaperture.matching.device.device import Chain, open_device, pass_times_ms, stage_times_ms
from chromaperture.matching.device.measured import add_conversion
from chromaperture.matching.device.paper_chain import add_paper
from chromaperture.matching.device.real_time_chain import add_real_time
from chromaperture.matching.error_bar import without_two_views
from chromaperture.matching.estimate import method_for
from chromaperture.matching.labels import IDENTITY, LabelMap, PathWinner, Surface, labels_between
from chromaperture.matching.paper import CELL_PX, mixed_share, unlike_share
from chromaperture.matching.readable.correlation import SCORE_PARTS, exponential_window
from chromaperture.matching.readable.place import halved_surface, place_by_correlation
from chromaperture.matching.result import Conversion
from chromaperture.matching.views import FILL_UNITS, Views, filtered_views, halved_views
from chromaperture.settings.methods import PaperConfig, RealTimeConfig
from devices import needs_device
from worlds import wavy_capture

pytestmark = [pytest.mark.extra("gpu", "wgpu"), needs_device]

SHAPE = (45, 61)  # odd, and larger than any filter reaches; each size is compiled anew, which takes seconds
REAL_TIME, PAPER = RealTimeConfig().with_range(-4.0, 4.0), PaperConfig().with_range(-4.0, 4.0)
DESIGNS = ("cy_halves", "rgb_squares")  # two views, three views

# 32 bits: views are sums of 25 products of order 1.
VIEW_TOLERANCE = 1e-6
# A window leaves out 1e-6 of its weights. Where it holds a thousandth of the view's variance, and what is left out has
# all of it, that is 1e-3 of the score.
SCORE_TOLERANCE = 1e-3
EVEN = 1e-3
# Four path costs in 1 / 65535 of 14 nats, and the logarithm of the correlation at 0.99, whose error counts 50 times.
TIE_NATS = 0.02
OTHER_WINNERS = 0.005


class Ran(NamedTuple):
    """What a chain left in its arrays."""

    arrays: dict[str, np.ndarray]
    height: int
    width: int

    def map(self, name: str, count: int, index: int = 0) -> np.ndarray:
        return self.arrays[name].reshape(-1, self.height, self.width)[index : index + count]

    def layers(self, name: str) -> np.ndarray:
        return self.arrays[name].reshape(self.height, self.width, -1)


def labels_of(shape: tuple[int, int]) -> LabelMap:
    """A lens that bends a flat wall by half a px and more at the right."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    return LabelMap(0.6 * (x / shape[1]) ** 2 - 0.2 * y / shape[0], 1 + 0.1 * x / shape[1])


@cache
def real_time_chain(design: str, labelled: bool, cell_px: int = 2) -> tuple[Chain, LabelMap]:
    chain = Chain(open_device("gpu"))
    label_map = labels_of(SHAPE) if labelled else IDENTITY
    image = chain.array("image", 3 * SHAPE[0] * SHAPE[1])
    add_real_time(
        chain, image, SHAPE, replace(method_of(design), config=real_time_of(design, cell_px), label_map=label_map)
    )
    return chain, label_map


def real_time_of(design: str, cell_px: int = 2) -> RealTimeConfig:
    config = method_of(design).config
    return replace(config, correlation=replace(config.correlation, cell_px=cell_px))


def method_of(design: str, config=REAL_TIME):
    return method_for(config, aperture=design, execution="numpy")


def run(chain: Chain, image: np.ndarray, shape: tuple[int, int], names: list[str]) -> Ran:
    return Ran(chain.run({"image": image}, names), *shape)


def correlations(likelihood: np.ndarray, view_count: int) -> np.ndarray:
    unexplained = np.exp(-likelihood.astype(np.float64) * (2 if view_count == 2 else 1))
    return np.sqrt(np.maximum(1 - unexplained, 0)) if view_count == 2 else 1 - unexplained


def halved(shape: tuple[int, int]) -> tuple[int, int]:
    return -(-shape[0] // 2), -(-shape[1] // 2)


@st.composite
def pictures(draw, shape=SHAPE, design=None):
    """A capture with or without clipped and unknown pixels, anywhere."""
    design = design or draw(st.sampled_from(DESIGNS))
    image = wavy_capture(design, shape=shape, seed=draw(st.integers(0, 10_000)), saturated=draw(st.booleans()))
    for value in draw(st.lists(st.sampled_from([np.nan, np.inf, -np.inf, 1.0, -0.01]), max_size=3)):
        y, x = draw(st.integers(0, shape[0] - 1)), draw(st.integers(0, shape[1] - 1))
        image[y, x, draw(st.integers(0, 2))] = value
    return design, image


def assume_same_fill(found: Ran, views: Views) -> None:
    """Views agree, or a mean that fills unusable pixels lay half-way between two multiples and fell to either side."""
    planes = np.moveaxis(found.map("planes", views.pictures.shape[2]), 0, -1)
    planes = planes - planes.mean(axis=(0, 1)) + views.pictures.mean(axis=(0, 1))  # windows do not see the mean
    error = np.abs(planes - views.pictures).max()
    if error >= VIEW_TOLERANCE:
        assert not views.mask.all()
        assert error < FILL_UNITS * views.unit + VIEW_TOLERANCE
    assume(error < VIEW_TOLERANCE)


@settings(max_examples=15, deadline=None)
@given(pictures())
def test_halved_views_guide_and_mask(case):
    design, image = case
    chain, _ = real_time_chain(design, False)
    views, full_guide = halved_views(image, method_of(design).space, config=real_time_of(design).views)
    found = run(chain, image, halved(SHAPE), ["planes", "stats", "full_guide"])
    count = views.pictures.shape[2]
    assume_same_fill(found, views)
    np.testing.assert_array_equal(found.map("planes", 1, count + 1)[0], views.mask)
    scale, full_scale = found.arrays["stats"][12:14]
    # In units of guide_range a guide is of order 10, and its percentiles carry the guide's own rounding.
    np.testing.assert_allclose(found.map("planes", 1, count)[0] * scale, views.guide, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(found.arrays["full_guide"].reshape(SHAPE) * full_scale, full_guide, rtol=1e-5, atol=1e-4)


@settings(max_examples=20, deadline=None)
@given(pictures(), st.booleans(), st.sampled_from([1, 2]))
def test_scores_paths_and_the_surface_behind_them(case, labelled, cell_px):
    design, image = case
    chain, label_map = real_time_chain(design, labelled, cell_px)
    config, space, half = real_time_of(design, cell_px), method_of(design).space, halved(SHAPE)
    views, guide = halved_views(image, space, config=config.views)
    cells = half if cell_px == 1 else halved(half)
    layers_px = config.layers.values_px / 2
    labels_px = labels_between(layers_px, space.directions, most_px=0.25)
    layer_count, count = len(labels_px), len(space.rows)
    at_once = cell_px == 1 and not labelled and layer_count == len(layers_px)  # log-likelihoods, without scores
    names = ["likelihood", "winner", "places", "surface", "disparity", "sigma", "confidence", "lacking"]
    found = run(chain, image, cells, names if at_once else [*names, "score"])
    assume_same_fill(run(chain, image, half, ["planes"]), views)

    score = stages.correlate(views, layers_px, config=config.correlation)
    own = views.pictures.astype(np.float64)
    mean_square, mean = (exponential_window(maps, config.correlation.window_decay) for maps in (own**2, own))
    textured = ((mean_square - mean**2) > EVEN * own.var(axis=(0, 1))).all(axis=2)[::cell_px, ::cell_px]
    compared = np.repeat(textured[..., None], len(layers_px), axis=2)
    if at_once:
        found_score = correlations(found.layers("likelihood")[..., :layer_count], count)
        # Next to 0 the logarithm's last bits are a thousandth of a score, next to 1 it is cut off.
        compared &= (views.mask[..., None] > 0) & (score > 0.1) & (score < 0.99)
    else:
        found_score = found.layers("score")[..., : len(layers_px)] / (SCORE_PARTS if cell_px == 2 else 1)
    error = np.abs(found_score - score)[compared]
    assert np.quantile(error, 0.999) < SCORE_TOLERANCE

    # From here on each stage gets what the device made before it, so that a layer that flips counts once.
    small_map = label_map if label_map.is_identity else label_map.halved().of_cells(cell_px)
    likelihood = found.layers("likelihood")[..., :layer_count].astype(np.float64)
    settings_ = {"correlation": config.correlation, "paths": config.paths, "labels_px": labels_px}
    expected = stages.four_path_winner(views, layers_px, small_map, **settings_)
    layer, at, sigma_layers = found.map("winner", 3)
    same = layer == expected.layer
    tied = np.abs(np.take_along_axis(likelihood, layer.astype(int)[..., None], 2)[..., 0] - expected.at) < TIE_NATS
    assert (~(same | tied)).sum() <= 2 + OTHER_WINNERS * same.size  # a cell of 192 is more than that share
    assert np.quantile(np.abs(at - expected.at)[same & textured], 0.99) < TIE_NATS
    step = labels_px[1] - labels_px[0]
    assert np.quantile(np.abs(step * sigma_layers - expected.sigma_px)[same], 0.99) < 0.01  # px; half a layer is 0.06

    inside = np.clip(layer.astype(int), 1, layer_count - 2)
    at = [np.clip(inside + o, 0, layer_count - 1)[..., None] for o in (-1, 0, 1, -2, 2)]
    around = [np.take_along_axis(likelihood, place, 2)[..., 0].astype(np.float32) for place in at]
    winner = PathWinner(layer, *around[:3], (step * sigma_layers).astype(np.float32), *around[3:])
    place, weight = place_by_correlation(winner, layer_count, view_count=count)
    even = views.guide[::cell_px, ::cell_px] / np.float32(config.smoothing_edge_range)
    sigma_px = config.smoothing_sigma_px / cell_px
    sums = stages.smooth_along_surface((weight, place * weight), even, layer, sigma_px=sigma_px)
    smoothed = found.arrays["places"].reshape(*cells, 2)
    # Sums of a thousand terms, each a place of up to 32 labels.
    np.testing.assert_allclose(smoothed[..., 1] / smoothed[..., 0], sums[1] / sums[0], atol=2e-3)

    places = (smoothed[..., 1] / smoothed[..., 0]).astype(np.float32)
    mask = views.mask[::cell_px, ::cell_px]
    surface = halved_surface(winner, places, smoothed[..., 0], labels_px, small_map, mask, cell_px=cell_px)
    disparity, sigma, peak = np.moveaxis(found.layers("surface")[..., :3], 2, 0)
    disparity = np.where(disparity > 1e38, np.nan, disparity)
    np.testing.assert_allclose(disparity / 2, surface.disparity_px, atol=1e-5)
    np.testing.assert_allclose(sigma / 2, surface.sigma_px, atol=1e-5)
    np.testing.assert_allclose(peak, surface.peak, atol=1e-3)  # the root of 1 - exp(-2 l) is steep at 0

    wide = Surface(disparity, sigma, peak)
    for steered_by in [views.guide, guide][1 - (cell_px == 2) :]:
        wide = stages.enlarge(wide, steered_by)
    found_px = found.arrays["disparity"].reshape(SHAPE)
    np.testing.assert_array_equal(np.isnan(found_px), np.isnan(wide.disparity_px))
    # Two surfaces: a weight of 0.5 takes either.
    assert np.nanquantile(np.abs(found_px - wide.disparity_px), 0.999) < 1e-3
    lacking = found.arrays["lacking"].reshape(max(1, SHAPE[0] // 8), max(1, SHAPE[1] // 8))
    known = np.where(np.isneginf(image), np.nan, image)  # the mean of minus infinity counts as dark on the CPU
    expected_lacking = without_two_views(known, space.rows)[4::8, 4::8][: lacking.shape[0], : lacking.shape[1]]
    np.testing.assert_array_equal(lacking > 0, expected_lacking)


@settings(max_examples=10, deadline=None)
@given(st.sampled_from([*DESIGNS, "cmy_circles"]).flatmap(lambda design: pictures(design=design)))
def test_paper_as_a_whole(case):
    design, image = case
    chain, method = paper_chain(design), method_of(design, PAPER)
    views = filtered_views(image, method.space, config=PAPER.views)
    kept = {"correlation": PAPER.correlation, "bilateral": PAPER.bilateral}
    winner = stages.bilateral_winner(views, PAPER.layers.values_px, **kept)
    expected = method.match(image)
    found = run(chain, image, SHAPE, ["disparity", "sigma", "confidence", "unlike_share"])
    disparity, sigma, confidence = (found.arrays[name].reshape(SHAPE) for name in ("disparity", "sigma", "confidence"))
    assert (np.isnan(disparity) == np.isnan(expected.value_px)).mean() > 0.999
    both = np.isfinite(disparity) & np.isfinite(expected.value_px)
    peaked = both & (winner.curvature > 0.01)  # 1/px^2: flatter tops place their vertex by rounding
    assert np.quantile(np.abs(disparity - expected.value_px)[peaked], 0.999) < 2e-3
    assert np.quantile((np.abs(sigma - expected.sigma_px) / expected.sigma_px)[peaked], 0.99) < 0.01
    assert np.quantile(np.abs(confidence - expected.confidence)[peaked], 0.99) < 0.01
    if mixed_share(method.space.rows) == 0:
        return
    unlike = unlike_share(views.pictures, disparity, method.space.directions)
    cells = found.arrays["unlike_share"].reshape([max(1, size // CELL_PX) for size in SHAPE])
    error = np.abs(cv2.resize(cells, SHAPE[::-1], interpolation=cv2.INTER_LINEAR) - unlike)
    assert np.quantile(error, 0.99) < 1e-3  # even areas, whose variance is rounding, aside


@cache
def paper_chain(design: str) -> Chain:
    chain = Chain(open_device("gpu"))
    add_paper(chain, chain.array("image", 3 * SHAPE[0] * SHAPE[1]), SHAPE, method_of(design, PAPER))
    return chain


@pytest.mark.parametrize("design", DESIGNS)
def test_chunks_of_cells_change_nothing(design, monkeypatch):
    image = wavy_capture(design, shape=SHAPE)
    whole = run(real_time_chain(design, False)[0], image, SHAPE, ["disparity"]).arrays["disparity"]
    monkeypatch.setattr(correlation_stages, "_CHUNK_BYTES", 4 * 40 * 50 * 4)  # some four entries, with what is padded
    chain, method = Chain(open_device("gpu")), method_of(design)
    add_real_time(chain, chain.array("image", image.size), SHAPE, method)
    assert len(chain.dispatches) > len(real_time_chain(design, False)[0].dispatches)
    np.testing.assert_array_equal(run(chain, image, SHAPE, ["disparity"]).arrays["disparity"], whole)


def test_stages_and_passes_are_timed():
    chain, image = paper_chain("cy_halves"), wavy_capture("cy_halves", shape=SHAPE)
    if not chain.device.timestamps:
        pytest.skip("this device keeps no timestamps: timing is NOT tested")
    before = chain.run({"image": image}, ["disparity"])["disparity"]
    stages, passes = stage_times_ms(chain, {"image": image}), pass_times_ms(chain, {"image": image}, [chain.dispatches])
    assert [name for name, _ in stages] == [dispatch.stage for dispatch in chain.dispatches]
    assert min(ms for _, ms in stages) >= 0
    assert len(passes) == 1
    assert passes[0] > 0
    np.testing.assert_array_equal(chain.run({"image": image}, ["disparity"])["disparity"], before)


def test_paths_need_no_subgroups():
    image = wavy_capture("cy_halves", shape=SHAPE)
    device = open_device("gpu")
    if not device.subgroups:
        pytest.skip("this device has no subgroups: the form with them is NOT tested")
    names = ["winner", "places"]  # what is between layers is smoothed, and its sums are reordered
    quad = real_time_chain("cy_halves", False)[0].run({"image": image}, names)
    chain = Chain(replace(device, subgroups=False))  # invocations of a path share memory
    method = method_of("cy_halves")
    add_real_time(chain, chain.array("image", image.size), SHAPE, method)
    for name, values in chain.run({"image": image}, names).items():
        np.testing.assert_allclose(values, quad[name], rtol=0 if name == "winner" else 1e-5)


def test_loops_are_written_out():
    text = """fn main() {
    for (var k = 0u; k < count; k++) {  // unrolled
        for (var n = 0u; n < 2; n++) {  // unrolled
            use(k, n);
        }
    }
}
"""
    written = shader_text.unrolled(text, {"count": 2})
    counts = {part: written.count(part) for part in ("for", "use(k, n);", "const k = 1u;", "const n = 1u;")}
    assert counts == {"for": 0, "use(k, n);": 4, "const k = 1u;": 1, "const n = 1u;": 2}


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([(1, 1), SHAPE]))
def test_conversion_to_depth(seed, field_shape):
    rng = np.random.default_rng(seed)
    disparity = rng.uniform(-6, 5, SHAPE).astype(np.float32)
    sigma = rng.uniform(0.01, 0.3, SHAPE).astype(np.float32)
    disparity[rng.uniform(size=SHAPE) < 0.1] = np.nan
    root = rng.normal(size=(3, 3)) * (1e-3, 5.0, 0.5)
    a, b = 4.3 + rng.normal(0, 0.02, field_shape), 8200 + rng.normal(0, 10, field_shape)
    a, b = (part if part.size > 1 else float(part[0, 0]) for part in (a, b))
    model = DepthModel(a, b, 52.0, root.T @ root)
    expected, expected_sigma = depth_and_sigma(disparity, sigma, model, max_depth_mm=20_000)
    fields, curve = model.tables
    parts = (fields.infinity_px, fields.scale_px_mm, fields.pupil_mm, *fields.covariance)
    check_millimetres(disparity, sigma, Conversion(parts, curve, 20_000), expected, expected_sigma)


def check_millimetres(disparity, sigma, conversion, expected, expected_sigma) -> Chain:
    chain = Chain(open_device("gpu"))
    arrays = [chain.array(name, disparity.size) for name in ("disparity", "sigma")]
    add_conversion(chain, *arrays, conversion)
    found = chain.run({"disparity": disparity, "sigma": sigma}, ["depth_mm", "sigma_mm"])
    near_limit = np.abs(expected - 20_000) < 20  # and there one of the two may call it too far
    depth = found["depth_mm"].reshape(expected.shape)
    assert (np.isnan(depth) == np.isnan(expected))[~near_limit].all()
    both = np.isfinite(depth) & np.isfinite(expected)
    assert both.mean() > 0.5
    np.testing.assert_allclose(depth[both], expected[both], rtol=2e-4)  # A - d in 32 bits where 0.4 px are left of 4
    # Covariances that nearly cancel in 32 bits.
    np.testing.assert_allclose(found["sigma_mm"].reshape(expected.shape)[both], expected_sigma[both], rtol=5e-3)
    return chain


@pytest.mark.parametrize("local", [False, True], ids=["polynomials", "with corrections"])
@pytest.mark.parametrize("known", ["in the middle", "over the frame"])
def test_conversion_by_numbers_in_place_of_maps(local, known, rng):
    """Frames of many megapixels: the device computes the curve of every pixel, `DepthField.model` is the oracle."""
    height, width, count = 66, 92, 10  # total degree 3
    infinity = np.concatenate([[4.3], rng.normal(0, 0.02, count - 1)])
    scale = np.concatenate([[8200.0], rng.normal(0, 10, count - 1)])
    size = 3 if known == "in the middle" else 2 * count + 1
    root = rng.normal(size=(size, size)) * np.repeat((1e-3, 5.0, 0.5), (1, 1, 1) if size == 3 else (count, count, 1))
    grid = (5, 7)
    corrections = LocalField(
        8.0, 14.0, rng.normal(0, 0.01, grid).astype(np.float32), rng.normal(0, 9, grid).astype(np.float32),
        np.diag([1e-6, 25.0]),
    )  # fmt: skip
    field = DepthField(infinity, scale, 52.0, root.T @ root / size, local=corrections if local else None)
    disparity = rng.uniform(-6, 3.5, (height, width)).astype(np.float32)
    sigma = rng.uniform(0.01, 0.3, disparity.shape).astype(np.float32)
    expected = depth_and_sigma(disparity, sigma, field.model(width, height), max_depth_mm=20_000)
    chain = check_millimetres(disparity, sigma, Conversion(*field.in_numbers(width, height), 20_000), *expected)
    assert chain.arrays["fields"].size < disparity.size + 6 * 33 * 33  # of a frame so small: no maps


def test_what_sections_use_is_there():
    known = shader_text.sections()
    assert {name for used, _ in known.values() for name in used} <= set(known)

"""Semi-global optimisation: exact on a chain, equal in both implementations, and a world asked back."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.config import OptimiserConfig
from chromaperture.disparity import semiglobal as plain
from chromaperture.disparity import semiglobal_kernels as kernels
from chromaperture.errors import InputError

LAYERS_PX = np.arange(-2.0, 3.01, 0.5)


def flat_world(rng, shape=(48, 64)):
    """A slanted wall with a square before it, and a likelihood too weak to decide a single pixel."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    near = (abs(y - shape[0] / 2) < 12) & (abs(x - shape[1] / 2) < 16)
    truth = np.where(near, -1.3, 0.5 + 1.5 * x / shape[1])
    guide = np.where(near, 4.0, 0.0)
    likelihood = -((LAYERS_PX - truth[..., None]) ** 2) * 0.5 + rng.normal(0, 1.0, (*shape, len(LAYERS_PX)))
    return truth, guide, likelihood.astype(np.float32)


@pytest.mark.parametrize("shape", [(9, 13, 7), (13, 9, 5), (1, 8, 3), (6, 1, 4)])
@pytest.mark.parametrize("paths", [4, 8])
def test_kernel_adds_the_same_paths_as_the_reference(shape, paths):
    rng = np.random.default_rng(1)
    likelihood, guide = rng.uniform(0, 5, shape), rng.uniform(0, 2, shape[:2])
    config = OptimiserConfig(paths=paths, slope_penalty=3, jump_penalty=2)
    # float32 sums of 8 costs of at most 7 nats
    np.testing.assert_allclose(
        kernels.aggregate(likelihood, guide, 0.25, config=config),
        plain.aggregate(likelihood, guide, 0.25, config=config),
        atol=5e-5,
    )


def test_two_opposed_paths_find_the_best_labelling_of_a_row():
    """On a single row the two opposed paths are exact dynamic programming: try every labelling instead."""
    rng = np.random.default_rng(2)
    length, layers, step = 6, 4, 0.5
    likelihood = rng.uniform(0, 2, (1, length, layers))
    guide = rng.uniform(0, 1, (1, length))
    config = OptimiserConfig(paths=4, slope_penalty=1.5, jump_penalty=1.2)
    best = {}
    for labels in product(range(layers), repeat=length):
        cost = -sum(likelihood[0, i, k] for i, k in enumerate(labels))
        for i in range(1, length):
            change = min(abs(labels[i] - labels[i - 1]) * step * 1.5, 1.2)
            cost += change * (
                config.edge_floor
                + (1 - config.edge_floor) * np.exp(-abs(guide[0, i] - guide[0, i - 1]) / config.edge_range)
            )
        for i, k in enumerate(labels):
            best[i, k] = min(best.get((i, k), np.inf), cost)
    least = np.array([[best[i, k] for k in range(layers)] for i in range(length)])
    total = kernels.aggregate(likelihood, guide, step, config=config)[0]
    np.testing.assert_allclose(
        total - total.min(axis=1, keepdims=True), least - least.min(axis=1, keepdims=True), atol=1e-5
    )


def test_lines_of_a_family_visit_every_pixel_once():
    for height, width in ((5, 8), (8, 5), (1, 4), (4, 1)):
        for dx, dy in plain.LINES:
            seen = np.zeros((height, width), int)
            for x, y, count in kernels.line_starts(height, width, dx, dy):
                for i in range(count):
                    seen[y + i * dy, x + i * dx] += 1
            assert (seen == 1).all()


@pytest.mark.parametrize("fidelity", [0.02, 0.5])
def test_kernel_decouples_like_the_reference(fidelity):
    rng = np.random.default_rng(3)
    likelihood = rng.uniform(0, 3, (7, 9, 6)).astype(np.float32)
    u = rng.uniform(0, 5, (7, 9)).astype(np.float32)
    np.testing.assert_allclose(
        kernels.nearest_likely(u, likelihood, fidelity),
        plain.nearest_likely(u, likelihood, fidelity),
        atol=1e-5,  # a quotient of float32 differences
    )


def test_kernel_and_reference_agree_on_the_coupled_variation():
    _, guide, likelihood = flat_world(np.random.default_rng(4), (12, 15))
    config = OptimiserConfig(slope_penalty=4, coupling_rounds=4, variation_iterations=10)
    start = np.zeros(guide.shape)
    fast = kernels.coupled_variation(start, likelihood, guide, LAYERS_PX, config=config)
    slow = plain.coupled_variation(start, likelihood, guide, LAYERS_PX, config=config)
    # 40 float32 iterations; a tie between two layers would show as half a step, but noise leaves none
    np.testing.assert_allclose(fast, slow, atol=1e-4)


def test_a_world_too_weak_for_single_pixels_comes_back():
    truth, guide, likelihood = flat_world(np.random.default_rng(5))
    config = OptimiserConfig(slope_penalty=6, jump_penalty=6)
    alone = LAYERS_PX[likelihood.argmax(axis=2)]
    paths = LAYERS_PX[kernels.aggregate(likelihood, guide, 0.5, config=config).argmin(axis=2)]
    smooth = kernels.coupled_variation(paths, likelihood, guide, LAYERS_PX, config=config)
    wrong = [np.mean(abs(d - truth) > 0.4) for d in (alone, paths, smooth)]
    assert wrong[0] > 0.4
    assert wrong[1] < 0.35 * wrong[0]
    assert wrong[2] < 0.01
    # Between the layers only the variation can answer: errors well below half a step of 0.5 px.
    assert np.abs(smooth - truth).mean() < 0.12
    assert np.abs(paths - truth).mean() > np.abs(smooth - truth).mean()


def test_penalties_do_not_depend_on_the_layer_step():
    """The same likelihood on layers twice as fine: the surface found stays, because penalties count in px."""
    y, x = np.mgrid[:24, :32]
    truth = 0.02 * x + 0.01 * y
    nothing = np.zeros(truth.shape)
    found = []
    for step in (0.5, 0.25):
        layers = np.arange(-1.0, 2.01, step)
        likelihood = -2.0 * (layers - truth[..., None]) ** 2
        config = OptimiserConfig(slope_penalty=4, jump_penalty=4)
        found.append(kernels.coupled_variation(nothing, likelihood, nothing, layers, config=config))
    # The Huber corner and theta count in layers, so the two differ by less than the finer step only.
    assert np.abs(found[0] - found[1]).mean() < 0.05
    assert np.abs(found[1] - truth).mean() < 0.1


@pytest.mark.parametrize(
    "settings",
    [
        {"paths": 6},
        {"slope_penalty": 0.0},
        {"edge_range": -1.0},
        {"edge_floor": 1.5},
        {"coupling_rounds": -1},
        {"variation_iterations": 0},
    ],
)
def test_impossible_settings_are_refused(settings):
    with pytest.raises(InputError):
        OptimiserConfig(**settings)


def test_layers_between_layers_are_those_of_a_smooth_correlation():
    """Correlations up to 0.99, where the likelihood has a cusp: its own interpolation would be off by half a nat."""
    fine, peak = np.arange(0, 8.01, 0.5), np.linspace(3.0, 5.0, 21)[None, :, None]
    correlation = 0.99 * np.exp(-((fine - peak) ** 2) / (2 * 5.0**2))
    likelihood = (-0.5 * np.log1p(-(correlation**2))).astype(np.float32)
    found = plain.at_labels(likelihood[..., ::2], fine[::2], fine, plain.even_field(1, 21))
    # The cubic leaves the share's fourth derivative: 9/384 h^4 of about 12 / 25^2 of it, against 0.02 at the peak.
    np.testing.assert_allclose(found[..., 2:-2], likelihood[..., 2:-2], atol=0.06)
    np.testing.assert_allclose(found[..., ::2], likelihood[..., ::2], atol=1e-6)


def test_the_product_of_two_correlations_needs_both_factors():
    """Evidence of two bands, s^1 s^0.5 with s a parabola in the layer: with 1.5 factors the cubic is exact."""
    layers, peak = np.arange(0, 8.01, 1.0), np.linspace(3.0, 4.0, 11)[None, :, None]

    def likelihood(at):
        return (-0.5 * 1.5 * np.log(0.002 + 0.01 * (at - peak) ** 2)).astype(np.float32)

    labels = np.arange(1.0, 7.01, 0.25)
    both = plain.at_labels(likelihood(layers), layers, labels, plain.even_field(1, 11), factors=1.5)
    np.testing.assert_allclose(both, likelihood(labels), atol=2e-4)  # float32 shares down to 0.002
    single = plain.at_labels(likelihood(layers), layers, labels, plain.even_field(1, 11))
    assert np.abs(single - likelihood(labels)).max() > 0.1


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 9), st.floats(0.01, 6), st.sampled_from([1.0, 1.5, 2.0]))
def test_kernel_reads_labels_like_the_reference(seed, layers, strength, factors):
    rng = np.random.default_rng(seed)
    likelihood = rng.gamma(0.5, strength, (3, 4, layers)).astype(np.float32)
    offset, scale = rng.normal(0, 1, (3, 4)), rng.uniform(0.5, 2, (3, 4))
    field = plain.LayerField(offset.astype(np.float32), scale.astype(np.float32))
    where = np.arange(layers) * 0.3 - 1, np.linspace(-1.5, layers * 0.3, 2 * layers + 3), field
    slow = plain.at_labels(likelihood, *where, factors=factors)
    assert np.isfinite(slow).all()
    # float32 shares of e^-2l: what is lost near 1 is 1e-7 of a nat's slope, and places are float32 too
    np.testing.assert_allclose(kernels.at_labels(likelihood, *where, factors=factors), slow, atol=1e-3, rtol=1e-3)

"""Semi-global matching of a volume: exact on a chain, and surfaces too weak for single pixels are found."""

from itertools import product

import numpy as np
import pytest

from chromaperture.matching import compiled as cpu
from chromaperture.matching import readable as stages
from chromaperture.matching.accurate import least_cost
from chromaperture.matching.labels import IDENTITY
from chromaperture.settings.stages import SurfaceConfig


@pytest.mark.parametrize("run", [stages, cpu])
def test_two_opposed_paths_find_the_best_layers_of_a_row(run):
    """On a single row the two opposed paths are exact dynamic programming: against every choice of layers.

    A block is four pixels along a path that say the same, and is left by one change; costs are a quarter of that.
    """
    rng = np.random.default_rng(2)
    length, layers, step = 6, 4, 0.5
    likelihood = rng.uniform(0, 2, (1, length, layers))
    guide = rng.uniform(0, 1, (1, length))
    config = SurfaceConfig(paths=4, slope_penalty=6.0, jump_penalty=4.8)
    best = {}
    for chosen in product(range(layers), repeat=length):
        cost = -4 * sum(likelihood[0, i, k] for i, k in enumerate(chosen))
        for i in range(1, length):
            change = min(abs(chosen[i] - chosen[i - 1]) * step * config.slope_penalty, config.jump_penalty)
            cost += change * (
                config.edge_floor
                + (1 - config.edge_floor) * np.exp(-abs(guide[0, i] - guide[0, i - 1]) / config.edge_range)
            )
        for i, k in enumerate(chosen):
            best[i, k] = min(best.get((i, k), np.inf), cost)
    least = np.array([[best[i, k] for k in range(layers)] for i in range(length)])
    total = run.aggregate_paths(likelihood, guide, step * np.arange(layers), config=config)[0]
    np.testing.assert_allclose(
        4 * (total - total.min(axis=1, keepdims=True)),
        least - least.min(axis=1, keepdims=True),
        atol=4e-5,  # float32
    )


def test_penalties_do_not_depend_on_the_layer_step():
    """The same likelihood on layers twice as fine: the surface stays, because penalties count in px."""
    y, x = np.mgrid[:24, :32]
    truth = 0.02 * x + 0.01 * y
    nothing = np.zeros(truth.shape)
    found = []
    for step in (0.5, 0.25):
        layers = np.arange(-1.0, 2.01, step)
        likelihood = (-2.0 * (layers - truth[..., None]) ** 2).astype(np.float32)
        config = SurfaceConfig(slope_penalty=16, jump_penalty=16)
        found.append(least_cost(cpu.aggregate_paths(likelihood, nothing, layers, config=config), layers))
    # Differences of half a step of the finer layers are what each leaves to chance.
    assert np.abs(found[0] - found[1]).mean() < 0.125
    assert np.abs(found[1] - truth).mean() < 0.1


def test_layers_between_layers_are_those_of_a_smooth_correlation():
    """Correlations up to 0.99, where the likelihood has a cusp: its own interpolation would be off by half a nat."""
    fine, peak = np.arange(0, 8.01, 0.5), np.linspace(3.0, 5.0, 21)[None, :, None]
    correlation = 0.99 * np.exp(-((fine - peak) ** 2) / (2 * 5.0**2))
    likelihood = (-0.5 * np.log1p(-(correlation**2))).astype(np.float32)
    found = stages.read_at_labels(likelihood[..., ::2], fine[::2], fine, IDENTITY)
    # Next to the ends a straight continuation is one of the six layers, and errs as a cubic does: 9/384 h^4 of about
    # 12 / 25^2, against 0.02 at the peak.
    np.testing.assert_allclose(found[..., 2:-2], likelihood[..., 2:-2], atol=0.06)
    np.testing.assert_allclose(found[..., ::2], likelihood[..., ::2], atol=1e-6)  # float32


def test_the_product_of_two_correlations_needs_both_factors():
    """Evidence of two bands, s^1 s^0.5 with s a parabola in the layer: with 1.5 factors a polynomial is exact."""
    layers, peak = np.arange(0, 8.01, 1.0), np.linspace(3.0, 4.0, 11)[None, :, None]

    def likelihood(at):
        return (-0.5 * 1.5 * np.log(0.002 + 0.01 * (at - peak) ** 2)).astype(np.float32)

    labels = np.arange(2.0, 6.01, 0.25)  # six layers around each lie in the volume
    both = stages.read_at_labels(likelihood(layers), layers, labels, IDENTITY, factors=1.5)
    np.testing.assert_allclose(both, likelihood(labels), atol=2e-4)  # float32 fractions down to 0.002
    single = stages.read_at_labels(likelihood(layers), layers, labels, IDENTITY)
    # 0.85 nats are found: a straight line between layers errs by much more.
    assert np.abs(single - likelihood(labels)).max() > 0.1

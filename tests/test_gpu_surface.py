"""The stages of quality "accurate" on a GPU agree with their NumPy twins, from the volume to the surface."""

import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.disparity import stages
from chromaperture.disparity.stages.between_layers import between_layers
from chromaperture.disparity.winner import parabola_winner
from chromaperture.stage_config import SurfaceConfig
from devices import EXPECTED

pytestmark = pytest.mark.extra("gpu", "wgpu")


def any_device():
    """Any device: a rasteriser in software where there is no GPU."""
    from chromaperture.disparity.gpu.device import DeviceError, open_device

    try:
        return open_device()
    except DeviceError as error:
        if os.environ.get(EXPECTED):
            raise
        pytest.skip(f"{error}: this is NOT tested")


def device_as(*, software):
    """Any device, for which stages take the form for software, where invocations share nothing, or that for GPUs."""
    device = any_device()
    return replace(device, info=device.info._replace(kind="CPU" if software else "DiscreteGPU"))


def volume(rng, height, width, count):
    """Peaks about a slanted surface with a step, as correlations make them, and a guide with an edge there."""
    y, x = np.mgrid[:height, :width]
    truth = 1.5 + (count - 4) * (0.2 + 0.4 * x / width + 0.1 * y / height) + (x > width // 2) * count * 0.2
    away = np.arange(count) - truth[..., None]
    likelihood = 2.0 * np.exp(-0.5 * (away / 1.3) ** 2) + rng.gamma(0.3, 0.3, (height, width, count))
    guide = (x > width // 2) * 1.5 + rng.normal(0, 0.1, (height, width))
    return likelihood.astype(np.float32), guide.astype(np.float32)


def path_costs(likelihood, guide, layers, config, **options):
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.surface_stages import Grid, add_paths

    chain = Chain(any_device())
    arrays = [chain.array(name, likelihood[..., :n].size) for name, n in (("l", None), ("g", 1), ("t", None))]
    add_paths(chain, *arrays, Grid(*likelihood.shape), layers, config=config, **options)
    return chain.run({"l": likelihood, "g": guide}, ["t"])["t"].reshape(likelihood.shape)


# Few sizes, because every size compiles eight shaders; the pictures are hypothesis's.
SIZES = [(1, 2, 3, 1, 4, 1), (7, 1, 9, 4, 8, 4), (24, 20, 70, 8, 8, 1), (12, 31, 65, 16, 8, 3)]


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(SIZES), st.integers(0, 2**32 - 1))
def test_path_costs_agree(size, seed):
    height, width, count, lanes, paths, ahead = size
    rng = np.random.default_rng(seed)
    likelihood, guide = volume(rng, height, width, count)
    layers = np.linspace(-4, 4, count)
    config = SurfaceConfig(paths=paths)
    found = path_costs(likelihood, guide, layers, config, lanes=lanes, ahead=ahead)
    expected = stages.aggregate_paths(likelihood, guide, layers, config=config)
    # The same operations in single precision: eight sums of some 30 nats.
    np.testing.assert_allclose(found, expected, atol=2e-3)


def surface_of(likelihood, guide, layers, config):
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.surface_stages import (
        Grid,
        add_paths,
        add_posterior,
        add_start,
        add_variation,
        surface_arrays,
    )

    chain, grid = Chain(any_device()), Grid(*likelihood.shape)
    a = surface_arrays(chain, grid, config)
    add_paths(chain, a.likelihood, a.guide, a.cost, grid, layers, config=config)
    add_start(chain, a, grid, config=config)
    add_variation(chain, a, grid, layers, config=config)
    add_posterior(chain, a, grid, config=config)
    got = chain.run({"likelihood": likelihood, "guide": guide}, ["surface", "sigma", "winner", "offset"])
    shape = likelihood.shape[:2]
    step = layers[1] - layers[0]
    start = layers[0] + step * (got["winner"].reshape(*shape, 4)[..., 0] + got["offset"].reshape(shape))
    surface = layers[0] + step * got["surface"].reshape(*shape, 4)[..., 0]
    return start, surface, step * got["sigma"].reshape(shape)


@pytest.mark.parametrize(("height", "width", "count"), [(37, 53, 65), (33, 70, 21)])
def test_the_surface_and_its_error_bar_agree(rng, height, width, count):
    likelihood, guide = volume(rng, height, width, count)
    layers = np.linspace(-4, 4, count)
    config = SurfaceConfig(coupling_rounds=12, variation_iterations=20)
    start, surface, sigma = surface_of(likelihood, guide, layers, config)

    cost = stages.aggregate_paths(likelihood, guide, layers, config=config)
    paths = parabola_winner(cost, layers, lower_is_better=True)
    first = np.where(np.isfinite(paths.disparity_px), paths.disparity_px, layers[cost.argmin(axis=2)])
    first = between_layers(first, likelihood, layers, sigma_px=config.interpolation_sigma_px)
    # Two layers of one cost may be told apart by rounding; everything else is the same arithmetic.
    step = layers[1] - layers[0]
    assert (np.abs(start - first) < 1e-3 * step).mean() > 0.99
    varied = stages.coupled_variation(first, likelihood, guide, layers, config=config)
    assert (np.abs(surface - varied) < 0.01 * step).mean() > 0.99
    posterior = stages.posterior(cost, layers, temperature=config.temperature * config.paths)
    np.testing.assert_allclose(sigma, posterior.sigma_px(surface), rtol=2e-3, atol=1e-4)


def test_iterations_do_not_depend_on_the_squares(rng):
    """A map of several squares, iterated in parts of one to five: the same as pixel by pixel."""
    likelihood, guide = volume(rng, 60, 47, 9)
    layers = np.linspace(0, 2, 9)
    for iterations in (1, 7, 23):
        config = SurfaceConfig(coupling_rounds=2, variation_iterations=iterations)
        start, surface, _ = surface_of(likelihood, guide, layers, config)
        varied = stages.coupled_variation(start, likelihood, guide, layers, config=config)
        assert (np.abs(surface - varied) < 1e-4).mean() > 0.998, iterations

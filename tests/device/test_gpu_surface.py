"""The stages of quality "accurate" on a GPU agree with their NumPy twins, from the volume to the surface."""

import cv2
import numpy as np
import pytest

from chromaperture.matching.accurate import PathSurface, path_surface
from chromaperture.matching.blocks import BLOCK_PX, block_means
from chromaperture.matching.device.device import Chain
from chromaperture.matching.device.surface_stages import (
    Grid,
    add_block_means,
    add_gaussian,
    add_path_surface,
    gaussian_taps,
)
from chromaperture.matching.execution import execution_named
from chromaperture.matching.readable.paths import Posterior
from chromaperture.settings.methods import AccurateConfig
from devices import any_device
from executions import slanted_volume

pytestmark = pytest.mark.extra("gpu", "wgpu")


def path_surface_on_device(likelihood, guide, layers, config):
    """Label, and mean and variance of the posterior, as `accurate.path_surface` has them."""
    chain, grid = Chain(any_device()), Grid(*likelihood.shape)
    arrays = [chain.array(name, n) for name, n in (("likelihood", grid.size), ("guide", grid.pixels))]
    add_path_surface(chain, *arrays, grid, layers, config=config)
    got = chain.run({"likelihood": likelihood, "guide": guide}, ["label", "posterior"])
    shape, step = likelihood.shape[:2], layers[1] - layers[0]
    mean, variance = np.moveaxis(got["posterior"].reshape(*shape, 2), 2, 0)
    posterior = Posterior(layers[0] + step * mean, step**2 * variance)
    return PathSurface(layers[0] + step * got["label"].reshape(shape), posterior, likelihood)


# The second is wider than a path's invocations hold at once.
@pytest.mark.parametrize(("height", "width", "count"), [(36, 52, 65), (33, 70, 21), (40, 25, 3), (1, 9, 5)])
def test_the_surface_and_its_posterior_agree(rng, height, width, count):
    likelihood, guide = slanted_volume(rng, height, width, count)
    layers = np.linspace(-4, 4, count)
    config = AccurateConfig()
    found = path_surface_on_device(likelihood, guide, layers, config.surface)
    expected = path_surface(likelihood, guide, layers, config=config, run=execution_named("numpy"))
    step = layers[1] - layers[0]
    # Two layers of one cost may be told apart by rounding; everything else is the same arithmetic.
    assert (np.abs(found.label_px - expected.label_px) < 1e-3 * step).mean() > 0.99
    for at in (found.label_px, expected.posterior.mean_px):
        np.testing.assert_allclose(found.posterior.sigma_px(at), expected.posterior.sigma_px(at), rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize(("height", "width"), [(36, 52), (33, 70), (4, 9)])  # the second leaves pixels at two borders
def test_means_of_blocks_agree(rng, height, width):
    volume = rng.normal(size=(height, width, 5)).astype(np.float32)
    usable = rng.random((height // BLOCK_PX, width // BLOCK_PX)).astype(np.float32)
    chain, grid = Chain(any_device()), Grid(height, width, 5)
    sizes = dict(volume=volume.size, usable=usable.size, likelihood=usable.size * 5)
    add_block_means(chain, *(chain.array(*size) for size in sizes.items()), grid, BLOCK_PX)
    found = chain.run({"volume": volume, "usable": usable}, ["likelihood"])["likelihood"]
    expected = usable[..., None] * block_means(volume)
    np.testing.assert_allclose(found.reshape(expected.shape), expected, atol=1e-6)  # sums of 16 numbers of order 1


@pytest.mark.parametrize(("sigma", "planes", "parts"), [(1.5, 1, 2), (4.0, 3, 3)])
@pytest.mark.parametrize("shape", [(19, 30), (1, 13), (40, 1)])
def test_gaussians_are_those_of_opencv(rng, shape, planes, parts, sigma):
    values = rng.normal(size=(planes, *shape, parts)).astype(np.float32)
    chain = Chain(any_device())
    arrays = [chain.array(name, values.size) for name in ("values", "between")]
    add_gaussian(chain, *arrays, shape, gaussian_taps(sigma), parts=parts, planes=planes)
    found = chain.run({"values": values}, ["values"])["values"].reshape(values.shape)
    border = cv2.BORDER_REFLECT_101
    expected = [cv2.GaussianBlur(plane, (0, 0), sigma, borderType=border).reshape(plane.shape) for plane in values]
    np.testing.assert_allclose(found, expected, atol=2e-6)

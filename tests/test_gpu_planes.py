"""Planes on a GPU agree with the CPU's: refined candidates, costs, beliefs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.disparity import stages
from chromaperture.disparity.planar import _scaled, block_costs, block_links, block_sums
from chromaperture.disparity.plane_fit import Volume, candidates, proposals
from chromaperture.disparity.stages.planes import PlaneCosts
from chromaperture.disparity.stages.variation import edge_weights
from chromaperture.planes_config import PlanesConfig
from test_gpu_surface import any_device, device_as

pytestmark = pytest.mark.extra("gpu", "wgpu")

LABELS = np.linspace(-3, 3, 41)
COSTS = PlaneCosts(slope=0.3, outside=0.05)


def two_walls(rng, height=96, width=120, noise=0.1):
    """Peaks about two planes, and the labels of the planes."""
    y, x = np.mgrid[:height, :width]
    label = np.where(x < width // 2, 0.012 * x - 0.004 * y, 1.5 - 0.006 * y)
    away = (LABELS - label[..., None]) / 0.25
    likelihood = 1.5 * np.exp(-0.5 * away**2) + rng.gamma(0.5, noise, (height, width, len(LABELS)))
    return likelihood.astype(np.float32), label


def candidate_chain(rng, device, shape):
    """A chain that finds planes, the volume, and a first surface with its error bar, px."""
    from chromaperture.disparity.gpu.candidate_stages import add_candidates
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.surface_stages import Grid

    likelihood, label = two_walls(rng, *shape)
    step = LABELS[1] - LABELS[0]
    noisy = label + rng.normal(0, 0.7 * step, label.shape)
    sigma = rng.uniform(0.5, 2, label.shape) * step
    chain = Chain(device)
    maps = [chain.constant("label", (noisy - LABELS[0]) / step), chain.constant("sigma", sigma / step)]
    array = chain.constant("likelihood", likelihood)
    options = dict(tiles_px=(24, 48, 96), slope_penalty=COSTS.slope)
    add_candidates(chain, *maps, array, Grid(*likelihood.shape), **options)
    return chain, likelihood, noisy, sigma


def candidates_of(found):
    """The distinct planes, (K, 3), px, of what `add_candidates` leaves in its `OUTPUTS`."""
    kept = found["distinct"][1 : 1 + found["distinct"][0]]
    planes = found["candidates"].reshape(-1, 4)[kept, :3].astype(float)
    middles = np.ascontiguousarray(found["candidate_parts"].reshape(-1, 4)[kept, 2:]).view(np.float32).astype(float)
    step = LABELS[1] - LABELS[0]
    planes[:, 2] += LABELS[0] / step - (planes[:, :2] * middles).sum(axis=1)
    return planes * step


@pytest.mark.parametrize("software", [True, False])
@pytest.mark.parametrize("shape", [(96, 120), (131, 70)])
def test_candidates_agree(rng, software, shape):
    from chromaperture.disparity.gpu.candidate_stages import OUTPUTS

    step = LABELS[1] - LABELS[0]
    chain, likelihood, noisy, sigma = candidate_chain(rng, device_as(software=software), shape)
    expected = candidates(noisy, sigma, Volume(likelihood, LABELS, COSTS, stages), (24, 48, 96))
    found = chain.run({}, OUTPUTS)
    planes = candidates_of(found)
    assert len(expected) > 3
    assert abs(len(planes) - len(expected)) <= 1 + len(expected) // 10
    # A plane of the CPU's has one of the device's beside it, all over its tile or nearly: Newton's method stops when a
    # step gains a hundred thousandth of the value, and of two planes that are as alike as may be one is left out.
    at = np.stack([*(c.ravel() for c in np.meshgrid(*(np.linspace(0, n, 5) for n in shape[::-1]))), np.ones(25)])
    apart = np.abs((planes[:, None] - expected) @ at).max(axis=2).min(axis=0)
    assert np.median(apart) < 0.1 * step
    # What agrees in a tile is found alike: the same points but for those just at the tolerance.
    parts = found["candidate_parts"].reshape(-1, 4)
    sets = proposals(noisy, sigma, step, (24, 48, 96), run=stages)
    assert (parts[:, 1] > 0).sum() == len(sets)
    assert len(sets) > 10
    counts = np.array([len(part.x) for part in sets])
    assert (np.abs(parts[parts[:, 1] > 0, 1] - counts) <= 1 + 0.01 * counts).mean() > 0.9
    values = []
    for planes_of in (planes, expected):
        cost = stages.plane_costs(likelihood, planes_of, LABELS, COSTS)
        values.append(cost.min(axis=2).mean())
    assert values[0] == pytest.approx(values[1], rel=2e-3)


@settings(max_examples=10, deadline=None)
@given(st.booleans(), st.integers(1, 70), st.integers(0, 2**32 - 1))
def test_beliefs_agree(software, count, seed):
    from chromaperture.disparity.gpu.plane_stages import PlaneChoice

    rng = np.random.default_rng(seed)
    cost = rng.gamma(1.0, 2.0, (9, 14, count)).astype(np.float32)
    links = rng.uniform(0.1, 3, (2, 9, 14)).astype(np.float32)
    found = PlaneChoice(device_as(software=software), (9, 14), 70, sweeps=3).beliefs_of(cost, links)
    # Sums of some twenty numbers up to 30 in single precision.
    np.testing.assert_allclose(found, stages.potts_beliefs(cost, links, sweeps=3), atol=1e-4)


def test_blocks_choose_alike(rng):
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.plane_stages import BlockChoice
    from chromaperture.disparity.gpu.surface_stages import Grid

    likelihood, _ = two_walls(rng, 24, 30)
    planes = np.concatenate([rng.normal(0, 0.02, (20, 3)), [[0.012, -0.004, 0], [0, -0.006, 1.5]]])
    planes[:20, 2] = rng.uniform(-3.5, 3.5, 20)
    links = rng.uniform(0.5, 3, (2, 24, 30)).astype(np.float32)
    chain = Chain(any_device())
    blocks = chain.constant("blocks", likelihood)
    chooser = BlockChoice(chain.device, blocks, Grid(*likelihood.shape), 32, 4, LABELS, COSTS)
    chooser.chain.write(chooser.links, links)
    for few in (planes, planes[18:], planes[21:]):
        cost = stages.plane_costs(likelihood, few, LABELS, COSTS)
        beliefs = stages.potts_beliefs(cost, links, sweeps=4)
        found = chooser.choose(few)
        lost = np.take_along_axis(beliefs, found[..., None], 2)[..., 0] - beliefs.min(axis=2)
        assert lost.max() < 1e-3  # another choice only where both cost the same but for rounding


@pytest.mark.parametrize("shape", [(96, 120), (43, 70)])
def test_blocks_choose_among_what_was_found(rng, shape):
    """The first choice, whose planes and links never leave the device."""
    from chromaperture.disparity.gpu.candidate_stages import OUTPUTS, add_first_choice, most_candidates
    from chromaperture.disparity.gpu.plane_stages import BlockChoice
    from chromaperture.disparity.gpu.surface_stages import Grid

    config = PlanesConfig(tiles_px=(24, 48, 96))
    chain, likelihood, _, _ = candidate_chain(rng, any_device(), shape)
    sums = block_sums(likelihood, config.block_px)
    guide = rng.normal(0, 1, shape)
    weights = edge_weights(guide, edge_range=1.0).transpose(1, 2, 0)
    arrays = chain.constant("blocks", sums), chain.constant("weights", weights)
    grid, capacity = Grid(*sums.shape), most_candidates(shape, config.tiles_px)
    chooser = BlockChoice(chain.device, arrays[0], grid, capacity, config.sweeps, LABELS, block_costs(config))
    add_first_choice(chain, chooser, arrays[1], shape, config=config, factor=0.7)
    found = chain.run({}, [*OUTPUTS, chooser.choice.name])
    links = 0.7 * config.boundary_penalty * config.block_px * block_links(weights.transpose(2, 0, 1), config.block_px)
    on_device = chooser.chain.run({"plane_count": np.zeros(1, np.uint32)}, ["plane_links"])["plane_links"]
    np.testing.assert_allclose(on_device.reshape(links.shape), links, rtol=1e-5)
    planes = _scaled(candidates_of(found), config.block_px)
    beliefs = stages.potts_beliefs(
        stages.plane_costs(sums, planes, LABELS, block_costs(config)), links, sweeps=config.sweeps
    )
    choice = found[chooser.choice.name].reshape(grid.height, grid.width).astype(int)
    lost = np.take_along_axis(beliefs, choice[..., None], 2)[..., 0] - beliefs.min(axis=2)
    assert lost.max() < 0.02  # of some tens of nats a block, in single precision

"""Planes on a GPU agree with the CPU's: refined candidates, costs, beliefs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.disparity import stages
from chromaperture.disparity.plane_fit import Volume, best_planes, proposals
from chromaperture.disparity.stages.planes import PlaneCosts
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


def test_refined_planes_agree(rng):
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.plane_stages import refined_planes
    from chromaperture.disparity.gpu.surface_stages import Grid

    likelihood, label = two_walls(rng)
    step = LABELS[1] - LABELS[0]
    noisy = label + rng.normal(0, 0.7 * step, label.shape)
    found = proposals(noisy, np.full(label.shape, step), step, (48, 96), run=stages)
    assert len(found) > 5
    chain = Chain(any_device())
    array = chain.constant("likelihood", likelihood)
    planes = refined_planes(chain.device, array, Grid(*likelihood.shape), found, LABELS, slope_penalty=COSTS.slope)
    volume = Volume(likelihood, LABELS, COSTS, stages)
    for got, part in zip(planes, found, strict=True):
        sets = [(part.y, part.x)]
        (expected,), _ = best_planes(part.plane[None, None], sets, volume)
        values = [best_planes(plane[None, None], sets, volume, steps=0)[1][0] for plane in (got, expected)]
        # Newton's method stops when a step gains a hundred thousandth of the value.
        assert values[0] == pytest.approx(values[1], rel=2e-4)
        at = np.stack([part.x, part.y, np.ones(len(part.x))])
        assert np.abs((got - expected) @ at).max() < 0.1 * step


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
    for few in (planes, planes[18:], planes[21:]):
        cost = stages.plane_costs(likelihood, few, LABELS, COSTS)
        beliefs = stages.potts_beliefs(cost, links, sweeps=4)
        found = chooser.choose(few, links)
        lost = np.take_along_axis(beliefs, found[..., None], 2)[..., 0] - beliefs.min(axis=2)
        assert lost.max() < 1e-3  # another choice only where both cost the same but for rounding

"""Which pixels are known, and the learned error bar, on a GPU as on the CPU."""

import math

import cv2
import numpy as np
import pytest

from chromaperture.disparity import stages
from chromaperture.disparity.accurate import BIAS_OF_PLANES, judged
from chromaperture.disparity.error_bar import local_range
from chromaperture.disparity.planar import BORDER_APART_LABELS, block_sums
from chromaperture.disparity.plane_fit import Volume
from chromaperture.disparity.stages.planes import PlaneCosts
from chromaperture.disparity.winner import Surface
from chromaperture.stage_config import SurfaceConfig
from test_gpu_agreement import planes_and_surface
from test_gpu_surface import any_device

pytestmark = pytest.mark.extra("gpu", "wgpu")

LABELS = np.linspace(-3, 3, 41)
STEP, BLOCK = 0.15, 4


def judging(rng, device, shape, known_within):
    """A chain that judges a surface of planes, what goes into it, and the surface that the CPU makes of it."""
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.judging_stages import OfPlanes, add_judged
    from chromaperture.disparity.gpu.surface_stages import Grid, surface_arrays

    planes, first, sigma = planes_and_surface(rng, *shape)
    sigma = cv2.GaussianBlur(sigma, (0, 0), 6) * np.where(planes.choice == 1, 3.0, 1.0)
    there = planes.label_px
    taken = np.where(cv2.GaussianBlur(np.abs(first - there), (0, 0), 3) > 0.3, first, there)
    away = (LABELS - first[..., None]) / 0.3
    likelihood = np.exp(-0.5 * away**2) + rng.gamma(0.5, 0.1, (*shape, len(LABELS)))
    likelihood = likelihood.astype(np.float32)
    blocks = Volume(block_sums(likelihood, BLOCK), LABELS, PlaneCosts(0.3, 0.05), stages)
    layer = np.clip(np.rint((taken - LABELS[0]) / STEP), 0, len(LABELS) - 1).astype(int)
    peak = np.sqrt(-np.expm1(-2 * np.take_along_axis(likelihood, layer[..., None], axis=2)[..., 0]))
    expected = judged(
        Surface(taken, sigma, peak), local_range(taken, 8), LABELS, first_px=first,
        explained_by=planes._replace(blocks=blocks), learned=True, known_within_px=known_within,
    )  # fmt: skip
    grid, chain = Grid(*shape, len(LABELS)), Chain(device)
    a = surface_arrays(chain, grid, SurfaceConfig())
    of_planes = OfPlanes(
        7, chain.constant("plane_count", np.array([5], np.uint32)),
        chain.constant("choice", planes.choice.astype(np.uint32)),
        *(chain.constant(name, (label - LABELS[0]) / STEP) for name, label in (("there", there), ("before", first))),
    )  # fmt: skip
    add_judged(
        chain, a, chain.constant("blocks", blocks.likelihood), of_planes, grid, block=BLOCK, apart=BORDER_APART_LABELS,
        known_within=min(known_within / STEP, 1e6), bias=BIAS_OF_PLANES,
    )  # fmt: skip
    surface = np.zeros((*shape, 4))
    # What is taken of a plane is its label to the bit, on a device as well.
    surface[..., 0] = np.where(taken == there, (there - LABELS[0]) / STEP, (taken - LABELS[0]) / STEP)
    given = {"surface": surface, "sigma": sigma / STEP, "likelihood": likelihood}
    return chain, {name: np.asarray(values, np.float32) for name, values in given.items()}, expected


@pytest.mark.parametrize("shape", [(9, 8), (61, 78), (122, 150)])
@pytest.mark.parametrize("known_within", [0.3, math.inf])
def test_error_bars_agree(rng, shape, known_within):
    chain, given, expected = judging(rng, any_device(), shape, known_within)
    found = chain.run(given, ["judged"])["judged"].reshape(*shape, 4)
    np.testing.assert_array_equal(found[..., 3] > 0, np.isfinite(expected.disparity_px))
    if shape[0] > 100 and known_within < 1:
        assert 0.05 < (found[..., 3] > 0).mean() < 0.95  # both occur
    np.testing.assert_allclose(found[..., 2], expected.peak, atol=1e-5)
    # Logarithms of sums in single precision.
    np.testing.assert_allclose(STEP * found[..., 1], expected.sigma_px, rtol=1e-3)

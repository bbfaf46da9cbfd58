"""Which pixels are known, and the learned error bar, on a GPU as on the CPU."""

import math

import cv2
import numpy as np
import pytest

from chromaperture.config import AccurateConfig
from chromaperture.disparity import stages
from chromaperture.disparity.accurate import judged, median_filtered
from chromaperture.disparity.error_bar import local_range
from chromaperture.disparity.estimate import method_for
from chromaperture.disparity.labels import IDENTITY, LabelMap
from chromaperture.disparity.planar import block_sums
from chromaperture.disparity.plane_fit import Volume
from chromaperture.disparity.stages.planes import PlaneCosts
from chromaperture.disparity.winner import Surface
from chromaperture.stage_config import SurfaceConfig
from test_gpu_agreement import planes_and_surface
from test_gpu_surface import any_device

pytestmark = pytest.mark.extra("gpu", "wgpu")

LABELS = np.linspace(-3, 3, 41)
STEP, BLOCK = 0.15, 4


def judging(rng, device, shape, known_within, *, of_planes=True, learned=True, fit_count=4):
    """A chain that judges a surface, what goes into it, and the surface that the CPU makes of it."""
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.judging_stages import OfPlanes, add_judged
    from chromaperture.disparity.gpu.surface_stages import Grid, surface_arrays

    planes, first, sigma = planes_and_surface(rng, *shape)
    sigma = cv2.GaussianBlur(sigma, (0, 0), 6) * np.where(planes.choice == 1, 3.0, 1.0)
    there = planes.label_px
    taken = np.where(cv2.GaussianBlur(np.abs(first - there), (0, 0), 3) > 0.3, first, there)
    away = (LABELS - first[..., None]) / 0.3
    likelihood = np.exp(-0.5 * away**2) + rng.gamma(0.5, 0.1, (*shape, len(LABELS)))
    likelihood[planes.choice == 1] = 0.5  # evidence that is alike everywhere: a plane that is not known
    likelihood = likelihood.astype(np.float32)
    of_blocks = [n // BLOCK for n in shape]
    fits = rng.normal(np.median(first), 0.3, (fit_count, *of_blocks)).astype(np.float32) if fit_count else None
    blocks = Volume(block_sums(likelihood, BLOCK), LABELS, PlaneCosts(0.3, 0.05), stages)
    layer = np.clip(np.rint((taken - LABELS[0]) / STEP), 0, len(LABELS) - 1).astype(int)
    peak = np.sqrt(-np.expm1(-2 * np.take_along_axis(likelihood, layer[..., None], axis=2)[..., 0]))
    expected = judged(
        Surface(taken, sigma, peak), local_range(taken, 8), LABELS, first_px=first,
        explained_by=planes._replace(blocks=blocks, fits_px=fits) if of_planes else None, learned=learned,
        known_within_px=known_within, known_from_nats=3e-4, edge_share=0.4,
    )  # fmt: skip
    grid, chain = Grid(*shape, len(LABELS)), Chain(device)
    a = surface_arrays(chain, grid, SurfaceConfig())
    on_device = OfPlanes(
        7, chain.constant("plane_count", np.array([5], np.uint32)),
        chain.constant("choice", planes.choice.astype(np.uint32)),
        *(chain.constant(name, (label - LABELS[0]) / STEP) for name, label in (("there", there), ("before", first))),
        chain.constant("blocks", blocks.likelihood), BLOCK,
        # A map that is no fit goes first, as where fits vote on the device.
        None if fits is None else chain.constant("fits", np.concatenate([fits[:1], (fits - LABELS[0]) / STEP])), 1,
    )  # fmt: skip
    add_judged(
        chain, a, grid, planes=on_device if of_planes else None, learned=learned,
        known_within=min(known_within / STEP, 1e6), known_from_nats=3e-4, edge_share=0.4,
    )  # fmt: skip
    surface = np.zeros((*shape, 4))
    # What is taken of a plane is its label to the bit, on a device as well.
    surface[..., 0] = np.where(taken == there, (there - LABELS[0]) / STEP, (taken - LABELS[0]) / STEP)
    given = {"surface": surface, "sigma": sigma / STEP, "likelihood": likelihood}
    return chain, {name: np.asarray(values, np.float32) for name, values in given.items()}, expected


def assert_judged_alike(shape, known_within, chain, given, expected):
    found = chain.run(given, ["judged"])["judged"].reshape(*shape, 4)
    np.testing.assert_array_equal(found[..., 3] > 0, np.isfinite(expected.disparity_px))
    if shape[0] > 100 and known_within < 1:
        assert 0.05 < (found[..., 3] > 0).mean() < 0.95  # both occur
    np.testing.assert_allclose(found[..., 2], expected.peak, atol=1e-5)
    # Logarithms of sums in single precision.
    np.testing.assert_allclose(STEP * found[..., 1], expected.sigma_px, rtol=1e-3)


@pytest.mark.parametrize("shape", [(9, 8), (61, 78), (122, 150)])
@pytest.mark.parametrize("known_within", [0.3, math.inf])
def test_error_bars_agree(rng, shape, known_within):
    assert_judged_alike(shape, known_within, *judging(rng, any_device(), shape, known_within))


def test_error_bars_of_one_fit_agree(rng):
    assert_judged_alike((61, 78), 0.3, *judging(rng, any_device(), (61, 78), 0.3, fit_count=0))


@pytest.mark.parametrize(("of_planes", "learned"), [(False, True), (False, False), (True, False)])
@pytest.mark.parametrize("shape", [(5, 9), (122, 150)])
def test_error_bars_without_planes_and_by_the_posterior_agree(rng, shape, of_planes, learned):
    judged_alike = judging(rng, any_device(), shape, 0.3, of_planes=of_planes, learned=learned)
    assert_judged_alike(shape, 0.3, *judged_alike)


@pytest.mark.parametrize("shape", [(1, 1), (3, 70), (61, 78)])
def test_medians_agree(rng, shape):
    """To the bit, for a median is one of the values; three in four of them occur more than once."""
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.judging_stages import add_median
    from chromaperture.disparity.gpu.surface_stages import Grid

    judged = rng.uniform(0, 40, (*shape, 4)).astype(np.float32)
    judged[..., 0] = np.where(rng.random(shape) < 0.75, judged[..., 0].round(), judged[..., 0])
    chain, grid = Chain(any_device()), Grid(*shape, len(LABELS))
    out = add_median(chain, chain.array("judged", judged.size), grid)
    found = chain.run({"judged": judged}, [out.name])[out.name].reshape(judged.shape)
    np.testing.assert_array_equal(found[..., 0], median_filtered(judged[..., 0]))
    np.testing.assert_array_equal(found[..., 1:], judged[..., 1:])


@pytest.mark.parametrize("shape", [(1, 7), (23, 40), (64, 91)])
@pytest.mark.parametrize("is_bent", [True, False])
def test_labels_become_disparities_alike(rng, shape, is_bent):
    """A field of labels, areas without light in two channels, clipped areas wider than a window, unknown pixels."""
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.judging_stages import Light, add_label_maps
    from chromaperture.disparity.gpu.surface_stages import Grid
    from chromaperture.disparity.gpu.view_stages import add_two_views

    image = rng.uniform(0.1, 0.9, (*shape, 3)).astype(np.float32)
    image[:, : shape[1] // 3, 1:] = 0.0  # red alone
    usable = np.ones(shape, np.float32)
    usable[:, shape[1] // 2 : shape[1] // 2 + 14] = 0.0
    field = LabelMap(*(rng.uniform(low, low + 0.2, shape).astype(np.float32) for low in (-0.1, 0.9)))
    label_map = field if is_bent else IDENTITY
    method = method_for(AccurateConfig().with_range(-3, 3), aperture="cy_halves", label_maps=[label_map] * 2)
    layer, bar = rng.uniform(0, 40, shape), np.exp(rng.uniform(-3, 5, shape))  # up to more than the longest
    peak, known = rng.uniform(0, 1, shape), rng.random(shape) < 0.8
    label = np.where(known, LABELS[0] + STEP * layer, np.nan)
    expected = method.of_labels(Surface(label, STEP * bar, peak), image, usable, LABELS)
    chain, grid = Chain(any_device()), Grid(*shape, len(LABELS))
    picture, used, judged = (chain.array(n, k * grid.pixels) for n, k in (("image", 3), ("usable", 1), ("judged", 4)))
    light = Light(used, *add_two_views(chain, picture, shape, np.eye(3)))
    add_label_maps(chain, judged, light, grid, label_map, LABELS)
    given = np.stack([layer, bar, peak, known], axis=-1).astype(np.float32)
    found = chain.run({"image": image, "usable": usable, "judged": given}, ["disparity", "sigma", "confidence"])
    if shape[0] > 8:
        widest = np.isclose(expected.sigma_px, np.nanmax(expected.sigma_px))
        assert 0.05 < widest.mean() < 0.8
    for values, name in zip((expected.value_px, expected.sigma_px, expected.confidence), found, strict=True):
        np.testing.assert_allclose(found[name].reshape(shape), values, rtol=1e-5, atol=2e-6)

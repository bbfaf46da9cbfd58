"""Planes or their surface on a GPU: the same choice, pixel by pixel, as on the CPU."""

import cv2
import numpy as np
import pytest

from chromaperture.disparity.planar import trust_of_moved
from chromaperture.disparity.plane_agreement import where_they_agree
from chromaperture.disparity.plane_fit import Planes
from chromaperture.disparity.plane_voting import planes_or_surface
from chromaperture.stage_config import SurfaceConfig
from test_gpu_surface import any_device

pytestmark = pytest.mark.extra("gpu", "wgpu")

STEP = 0.15


def planes_and_surface(rng, height, width):
    """Planes in blobs, a surface that follows them but for areas, spots and streaks of its own."""
    coarse = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), 9)
    choice = (coarse > 0.02).astype(int) + (coarse > 0.05) + 2 * (np.arange(width) > 0.8 * width)
    planes = np.stack([rng.normal(0, 0.004, 5), rng.normal(0, 0.004, 5), rng.uniform(-2, 2, 5)], axis=1)
    label = Planes(planes, choice).label_px
    off = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), 5)
    off = np.where(off > 0.7 * off.std(), 1.0, 0) + (rng.random((height, width)) < 0.1)
    surface = label + off * rng.choice([-0.8, 0.8]) + rng.normal(0, 0.03, label.shape)
    return Planes(planes, choice), surface.astype(np.float32), rng.uniform(0.02, 0.25, label.shape)


BLOCK = 4


def agreement(rng, device, shape, *, voted=True):
    """A chain that takes planes or their surface, what goes into it, the planes, the CPU's agreement and its labels."""
    from chromaperture.disparity.gpu.agreement_stages import add_planes_or_surface
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.surface_stages import Grid, surface_arrays
    from chromaperture.disparity.gpu.voting_stages import Voted

    planes, surface, sigma = planes_and_surface(rng, *shape)
    surface[planes.choice == 0] += 2  # all of a plane is contradicted
    label = where_they_agree(planes, surface, np.hypot(sigma, STEP))
    agreed = label == planes.label_px
    rows, columns = (np.minimum(np.arange(n) // BLOCK, n // BLOCK - 1) for n in shape)
    before = planes.choice[BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK][: shape[0] // BLOCK, : shape[1] // BLOCK]
    trusted = rng.random(before.shape) < np.array([0.3, 0.7, 0.3, 0.7, 0.3])[before]  # of some planes most is
    if voted:
        spread = np.ix_(rows, columns)
        allowed = trust_of_moved(trusted[spread], before[spread], planes.choice)
        label = planes_or_surface(planes._replace(trusted=allowed), surface, STEP)
    expected = agreed, label
    grid, chain = Grid(*shape, 2), Chain(device)
    a = surface_arrays(chain, grid, SurfaceConfig())
    choice = chain.constant("choice", planes.choice.astype(np.uint32))
    in_layers = np.concatenate([planes.planes / STEP, np.zeros((5, 1))], axis=1)
    blocks = chain.constant("before", before.astype(np.uint32))
    found = Voted(choice, choice, blocks, chain.constant("trusted", trusted.astype(np.uint32)) if voted else None)
    add_planes_or_surface(chain, a, choice, chain.constant("planes", in_layers), grid, voted=found, block_px=BLOCK)
    given = np.zeros((*shape, 4), np.float32)
    given[..., 0] = surface / STEP
    return chain, {"surface": given, "sigma": (sigma / STEP).astype(np.float32)}, planes, expected


@pytest.mark.parametrize("shape", [(9, 40), (37, 61), (150, 200)])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("voted", [True, False])
def test_planes_are_taken_alike(shape, seed, voted):
    chain, given, planes, expected = agreement(np.random.default_rng(seed), any_device(), shape, voted=voted)
    found = chain.run(given, ["surface"] if voted else ["surface", "planes_agreed"])
    # Layers up to 20 in single precision; a difference of just two error bars, or one layer, may fall to either side.
    if not voted:
        assert (found["planes_agreed"].reshape(shape).view(np.uint32) == expected[0]).mean() > 0.9995
    surface = STEP * found["surface"].reshape(*shape, 4)[..., 0]
    assert (np.abs(surface - expected[1]) < 1e-4).mean() > 0.999
    if shape[0] > 100:
        assert 0.1 < (np.abs(expected[1] - planes.label_px) < 1e-6).mean() < 0.99  # both occur

"""Fits of planes vote on a GPU as on the CPU."""

from types import SimpleNamespace

import numpy as np
import pytest

from chromaperture.disparity.plane_fit import Planes
from chromaperture.disparity.plane_voting import OF_GUIDED, voted_planes
from chromaperture.stage_config import SurfaceConfig
from test_gpu_agreement import planes_and_surface
from test_gpu_surface import any_device

pytestmark = pytest.mark.extra("gpu", "wgpu")

STEP, BLOCK, FACTORS = 0.15, 4, (1.0, 0.7, 1.4)


def fits_of(rng, height, width):
    """Three fits of 5, 6 and 5 planes, one a block, and a surface that follows the first in parts."""
    planes, surface, sigma = planes_and_surface(rng, height, width)
    rows, columns = (np.minimum(np.arange(n) // BLOCK * BLOCK + 1, n // BLOCK * BLOCK - 1) for n in (height, width))
    first = Planes(planes.planes, planes.choice[np.ix_(rows, columns)])
    moved = Planes(np.vstack([first.planes + np.array([0, 0, 0.3]), [[0, 0, 1.0]]]), np.roll(first.choice, 8, axis=1))
    moved.choice[: height // 8 * 4] = 5
    return [first, moved, Planes(first.planes[::-1].copy(), first.choice)], surface, sigma


@pytest.mark.parametrize("shape", [(9, 40), (37, 61), (150, 200)])
@pytest.mark.parametrize("seed", range(3))
def test_fits_vote_alike(shape, seed):
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.surface_stages import Grid, surface_arrays
    from chromaperture.disparity.gpu.voting_stages import add_voted_planes

    device = any_device()
    fits, surface, sigma = fits_of(np.random.default_rng(seed), *shape)
    expected = voted_planes(fits, surface, sigma, STEP, BLOCK, trust=OF_GUIDED)
    grid, chain = Grid(*shape, 2), Chain(device)
    small = Grid(shape[0] // BLOCK, shape[1] // BLOCK, 2)
    a = surface_arrays(chain, grid, SurfaceConfig())
    chooser = SimpleNamespace(shape=small[:2], capacity=8)
    found_by = iter(fits)

    def add_fit(factor):
        """Leave what a fit leaves in the arrays of blocks that choose."""
        fit = next(found_by)
        planes = np.zeros((8, 4))
        planes[: len(fit.planes), :3] = fit.planes / STEP
        planes[:, 2] += planes[:, :2].sum(axis=1) * (BLOCK - 1) / 2  # at the middle of the first block
        planes[:, :2] *= BLOCK
        chooser.planes = chain.constant(f"planes_{factor}", planes)
        chooser.count = chain.constant(f"number_{factor}", np.array([len(fit.planes)], np.uint32))
        of_blocks = fit.choice[::BLOCK, ::BLOCK][: small.height, : small.width]
        chooser.choice = chain.constant(f"choice_{factor}", of_blocks.astype(np.uint32))

    voted = add_voted_planes(chain, chooser, add_fit, a, grid, factors=FACTORS, block_px=BLOCK)
    given = np.zeros((*shape, 4), np.float32)
    given[..., 0] = surface / STEP
    found = chain.run(
        {"surface": given, "sigma": (sigma / STEP).astype(np.float32)},
        [array.name for array in (voted.planes, voted.choice, voted.trusted, voted.number, voted.fits)],
    )
    of_fits = STEP * found[voted.fits.name].reshape(-1, *small[:2])[voted.skipped :]
    np.testing.assert_allclose(of_fits, expected.fits_px, atol=1e-4)  # single precision of labels up to 10
    assert found[voted.number.name][0] == 16
    planes = found[voted.planes.name].reshape(-1, 4)[found[voted.choice.name].view(np.uint32)]
    y, x = np.mgrid[: small.height, : small.width]
    label = STEP * (planes[:, 0] * x.ravel() + planes[:, 1] * y.ravel() + planes[:, 2]).reshape(small[:2])
    at = np.s_[BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK]
    middle = expected.label_px[at][: small.height, : small.width]
    slope = np.abs(expected.planes[:, :2]).max()  # half a pixel from the middle of a block
    # Where two places have nearly the same votes, rounding decides.
    assert (np.abs(label - middle) < 1e-4 + slope).mean() > 0.995
    trusted = found[voted.trusted.name].view(np.uint32).reshape(small[:2])
    assert (trusted == expected.trusted[at][: small.height, : small.width]).mean() > 0.995
    if shape[0] > 100:
        assert 0.1 < trusted.mean() < 0.99  # both occur
        assert len(expected.planes) > 8  # of more than one fit

"""Planes between the photograph's depth edges, for a device: the CPU finds them between two submissions to it.

A network finds depth edges, and regions join one by one: there are no stages for either. The surface, the planes that
it proposes and the volume's sums of blocks come down; planes, which block has which, and which are trusted go up. Sums
of blocks of 4 px have a sixteenth of the volume's entries.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from chromaperture.disparity.execution import Execution
from chromaperture.disparity.gpu.candidate_stages import add_planes_of_blocks, most_candidates
from chromaperture.disparity.gpu.device import Chain
from chromaperture.disparity.gpu.surface_stages import Grid
from chromaperture.disparity.gpu.voting_stages import Voted
from chromaperture.disparity.planar import block_costs, costs_of_fits, voted_regions
from chromaperture.disparity.plane_fit import Planes, Volume
from chromaperture.planes_config import PlanesConfig

PROPOSED = ("proposed_planes", "proposed_count")
DOWN = ("blocks", "label", "sigma", *PROPOSED)


def add_proposed(chain: Chain, grid: Grid, *, config: PlanesConfig) -> None:
    """Append the distinct planes in the coordinates of pixels; all of `DOWN` is then in the chain.

    Parameters
    ----------
    chain : Chain
        With `add_block_sums` and `add_candidates`.
    grid : Grid
    config : PlanesConfig
    """
    capacity = most_candidates(grid[:2], config.tiles_px)
    planes, count = chain.array(PROPOSED[0], 4 * capacity), chain.array(PROPOSED[1], 1, np.uint32)
    add_planes_of_blocks(chain, planes, count, capacity, block_px=1, slope_penalty=config.slope_penalty)


def voted_arrays(chain: Chain, grid: Grid, *, config: PlanesConfig) -> Voted:
    """Make the arrays of what goes up: every fit may leave every candidate, those of one label among them."""
    blocks = (grid.height // config.block_px) * (grid.width // config.block_px)
    most = len(config.learned_border_nats) * (most_candidates(grid[:2], config.tiles_px) + grid.layers)
    choice, trusted = (chain.array(name, blocks, np.uint32) for name in ("voted_choice", "planes_trusted"))
    fits = chain.array("fits", len(costs_of_fits(config.learned_border_nats)) * blocks)
    return Voted(chain.array("voted_planes", 4 * most), chain.array("plane_count", 1, np.uint32), choice, trusted, fits)


def regions_found(
    down: Mapping[str, np.ndarray],
    depth_edges: np.ndarray | None,
    voted: Voted,
    grid: Grid,
    labels_px: np.ndarray,
    *,
    config: PlanesConfig,
    run: Execution,
) -> dict[str, np.ndarray]:
    """Find planes by what came down; return what goes up.

    Parameters
    ----------
    down : dict of str to array
        `DOWN`, flat; layers.
    depth_edges : (2, h, w) float
        As `AccurateMethod.depth_edges`, which are there where planes need them.
    voted : Voted
        Arrays that are filled. Where no plane was found their number is 0.
    grid : Grid
        Of the picture.
    labels_px : (N,) float, px
    config : PlanesConfig
    run : Execution
    """
    first, step = float(labels_px[0]), float(labels_px[1] - labels_px[0])
    assert voted.fits is not None
    assert depth_edges is not None
    size = config.block_px
    rows, columns = grid.height // size, grid.width // size
    count = int(down[PROPOSED[1]][0])
    proposed = down[PROPOSED[0]].reshape(-1, 4)[:count, :3] * step + np.array([0, 0, first])
    if not count:
        nowhere = np.zeros((rows, columns), bool)
        fits = np.zeros((voted.fits.size // nowhere.size, *nowhere.shape), np.float32)
        return _filled(voted, Planes(np.zeros((0, 3)), nowhere.astype(np.intp), None, nowhere, fits))
    blocks = Volume(down["blocks"].reshape(rows, columns, grid.layers), labels_px, block_costs(config), run)
    label_px, sigma_px = (down[name].reshape(grid.height, grid.width) * np.float32(step) for name in ("label", "sigma"))
    found = voted_regions(proposed, blocks, depth_edges, label_px + np.float32(first), sigma_px, config=config)
    layers = (found.planes - np.array([0, 0, first])) / step
    of_blocks = np.s_[: rows * size : size, : columns * size : size]
    assert found.trusted is not None
    assert found.fits_px is not None
    fits = (found.fits_px - np.float32(first)) / np.float32(step)
    return _filled(voted, Planes(layers, found.choice[of_blocks], None, found.trusted[of_blocks], fits))


def _filled(voted: Voted, planes: Planes) -> dict[str, np.ndarray]:
    """Return planes of pixels and fits, in layers, and the choice of blocks as arrays of full size."""
    assert voted.trusted is not None
    assert voted.fits is not None
    of_pixels = np.zeros((voted.planes.size // 4, 4), np.float32)
    of_pixels[: len(planes.planes), :3] = planes.planes
    values = (
        (voted.planes, of_pixels), (voted.number, len(planes.planes)), (voted.choice, planes.choice),
        (voted.trusted, planes.trusted), (voted.fits, planes.fits_px),
    )  # fmt: skip
    return {array.name: np.asarray(part, array.dtype).ravel() for array, part in values}

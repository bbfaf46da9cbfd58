"""Planes that a first surface proposes, refined by the volume, on a device: the stages of `plane_fit.candidates`.

Random numbers do not depend on the picture, so they go up once.
"""

from __future__ import annotations

import numpy as np

from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.plane_stages import BlockChoice
from chromaperture.disparity.gpu.surface_stages import Grid
from chromaperture.disparity.gpu.workgroups import groups_for
from chromaperture.disparity.plane_fit import (
    DISTINCT_LAYERS,
    DRAW_BITS,
    INLIER_LAYERS,
    LEAST_LEFT,
    LEAST_SHARE,
    MOST_PLANES,
    NEWTON_STEPS,
    PLANES_OF_A_TILE,
    ROUNDS,
    TRIALS,
    draws_of,
    tiles_of,
)
from chromaperture.disparity.stages.plane_refining import CONDITION, GAINED, LEAST_BEND, REACH
from chromaperture.disparity.stages.planes import LEAST_AREA, LEAST_POINTS, NEAR
from chromaperture.planes_config import PlanesConfig

LANES, LANES_IN_SOFTWARE = 64, 8  # invocations of a tile; in software one vector, whose barriers cost nothing
OUTPUTS = ("candidates", "candidate_parts", "distinct")  # planes, their points, which are distinct


def add_candidates(
    chain: Chain,
    label: Array,
    sigma: Array,
    likelihood: Array,
    grid: Grid,
    *,
    tiles_px: tuple[int, ...],
    slope_penalty: float,
) -> None:
    """Append the consensus of points in tiles, `stages.best_planes` of what they agree on, and which are distinct.

    Parameters
    ----------
    chain : Chain
    label, sigma : Array
        A first surface and its error bar, (h, w), layers.
    likelihood : Array
        (h, w, layers), nats a pixel.
    grid : Grid
    tiles_px : tuple of int
    slope_penalty : float
        `PlaneCosts.slope`.
    """
    tiles = tiles_of((grid.height, grid.width), tiles_px)
    sizes = np.array([tile.rows * tile.columns for tile in tiles])
    total, slots = int(sizes.sum()), PLANES_OF_A_TILE * len(tiles)
    about = np.zeros((len(tiles), 8), np.uint32)
    about[:, :5] = [(tile.top, tile.left, tile.rows, tile.columns, tile.every) for tile in tiles]
    about[:, 5] = np.cumsum(sizes) - sizes
    lanes = LANES_IN_SOFTWARE if chain.device.info.is_software else LANES
    points, parts = chain.array("candidate_points", total, np.uint32), chain.array(OUTPUTS[1], 4 * slots, np.uint32)
    planes = chain.array(OUTPUTS[0], 4 * slots)
    chain.add(
        "agreed_planes",
        [
            label, sigma, chain.constant("tiles", about),
            chain.constant("draws", np.stack([draws_of(i) for i in range(len(tiles))])),
            chain.array("points_left", 8 * total), points, parts, planes,
        ],
        groups=(len(tiles),), width=grid.width, lanes=lanes, rounds=PLANES_OF_A_TILE, trials=TRIALS,
        draw_bits=DRAW_BITS, point_count=total, tolerance=INLIER_LAYERS, near=NEAR, fits=ROUNDS,
        least_left=float(LEAST_LEFT), least_share=LEAST_SHARE, least_points=float(LEAST_POINTS),
        least_area=float(LEAST_AREA),
    )  # fmt: skip
    chain.add(
        "plane_refining", [likelihood, points, parts, planes], groups=(slots,), uses=("plane_newton",), lanes=lanes,
        width=grid.width, count=grid.layers, reach=REACH, slope_penalty=slope_penalty, newton_steps=NEWTON_STEPS,
        condition=CONDITION, least_bend=LEAST_BEND, gained=GAINED,
    )  # fmt: skip
    side = np.repeat([tile.size_px for tile in tiles], PLANES_OF_A_TILE)
    order = np.argsort(-side, kind="stable")
    chain.add(
        "distinct_planes",
        [
            planes, parts, chain.constant("tile_order", np.stack([order, side[order]], axis=1).astype(np.uint32)),
            chain.array(OUTPUTS[2], slots + 1, np.uint32),
        ],
        groups=(1,), lanes=lanes, slots=slots, tolerance=DISTINCT_LAYERS, most=MOST_PLANES,
    )  # fmt: skip


def most_candidates(shape: tuple[int, int], tiles_px: tuple[int, ...]) -> int:
    """Return how many distinct planes there may be of a picture (height, width)."""
    return min(MOST_PLANES, PLANES_OF_A_TILE * len(tiles_of(shape, tiles_px)))


def add_first_choice(
    chain: Chain, chooser: BlockChoice, weights: Array, shape: tuple[int, int], *, config: PlanesConfig, factor: float
) -> None:
    """Append the choice of blocks among the distinct planes, and the links that all later choices of the fit use.

    Planes, their number and the choice are the chooser's arrays, and the chain's too.

    Parameters
    ----------
    chain : Chain
        With `add_candidates`.
    chooser : BlockChoice
    weights : Array
        Of the links between pixels, (h, w, 2).
    shape : (int, int)
        Height and width of the picture.
    config : PlanesConfig
    factor : float
        Of ``boundary_penalty``.
    """
    size, pixels = config.block_px, chooser.shape[0] * chooser.shape[1]
    chain.add(
        "block_links", [weights, chooser.links], groups=groups_for(pixels), uses=("indexing",), height=shape[0],
        width=shape[1], block=size, penalty=float(config.boundary_penalty * size * factor),
    )  # fmt: skip
    add_planes_of_blocks(
        chain, chooser.planes, chooser.count, chooser.capacity, block_px=size, slope_penalty=float(chooser.costs.slope)
    )
    chain.dispatches += chooser.chain.dispatches
    chain.arrays |= {array.name: array for array in (chooser.planes, chooser.count, chooser.choice)}


def add_planes_of_blocks(
    chain: Chain, planes: Array, count: Array, capacity: int, *, block_px: int, slope_penalty: float
) -> None:
    """Append the distinct planes in the coordinates of blocks of ``block_px``, which may be 1, and their number.

    Parameters
    ----------
    chain : Chain
        With `add_candidates`.
    planes : Array
        (capacity, 4).
    count : Array
    capacity : int
    block_px : int
    slope_penalty : float
        `PlaneCosts.slope`.
    """
    candidates, parts, distinct = (chain.arrays[name] for name in OUTPUTS)
    chain.add(
        "planes_of_blocks", [distinct, candidates, parts, planes, count], groups=groups_for(capacity),
        uses=("indexing",), block=block_px, slope_penalty=slope_penalty,
    )  # fmt: skip

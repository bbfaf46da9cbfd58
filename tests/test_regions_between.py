"""What goes up to a device of planes that the CPU found between depth edges: the world's planes, spoilt by noise."""

from __future__ import annotations

import numpy as np
import pytest

from chromaperture.disparity.execution import execution_named
from chromaperture.disparity.gpu.device import Array
from chromaperture.disparity.gpu.regions_between import PROPOSED, regions_found
from chromaperture.disparity.gpu.surface_stages import Grid
from chromaperture.disparity.gpu.voting_stages import Voted
from chromaperture.disparity.planar import costs_of_fits
from chromaperture.planes_config import PlanesConfig

SIZE = 4  # px of a block
CONFIG = PlanesConfig(learned_border_nats=(5.0, 2.5), block_px=SIZE)
LABELS_PX = np.arange(-3.0, 3.01, 0.1)
CAPACITY = 6
FITS = len(costs_of_fits(CONFIG.learned_border_nats))


def room(name: str, size: int, dtype: type = np.float32) -> Array:
    return Array(name, None, size, np.dtype(dtype))


def world(rng: np.random.Generator) -> tuple[Grid, np.ndarray, np.ndarray]:
    """A wall that leans and a level card: the picture, its labels in layers, and which blocks are the card's."""
    grid = Grid(98, 130, len(LABELS_PX))  # two px below and at the right belong to no block
    card = np.zeros((24, 32), bool)
    card[8:18, 10:22] = True
    y, x = np.mgrid[: grid.height, : grid.width]
    layer = 20 + 0.05 * x + 0.02 * y
    layer[32:72, 40:88] = 45.3
    return grid, layer + rng.normal(0, 0.3, layer.shape), card


@pytest.mark.parametrize("proposed", [2, 1])
def test_the_planes_of_the_world_go_up(proposed: int) -> None:
    """Without the card's plane among those proposed, a level one is found all the same."""
    rng = np.random.default_rng(3)
    grid, layer, card = world(rng)
    y, x = np.mgrid[:24, :32]
    of_blocks = 20 + 0.05 * (4 * x + 1.5) + 0.02 * (4 * y + 1.5)
    of_blocks[card] = 45.3
    at = np.arange(grid.layers)
    blocks = -0.5 * SIZE**2 * ((at - of_blocks[..., None]) / 3) ** 2 * 0.2
    blocks += rng.normal(0, 0.1, blocks.shape)
    edges = np.full((2, 24, 32), -5.0, np.float32)
    edges[0, :-1][card[1:] != card[:-1]] = edges[1, :, :-1][card[:, 1:] != card[:, :-1]] = 4.0
    planes = np.zeros((CAPACITY, 4), np.float32)
    planes[:2, :3] = [(0.05, 0.02, 20), (0, 0, 45)]
    down = {"blocks": blocks.astype(np.float32).ravel(), "label": layer.astype(np.float32).ravel()}
    down |= {"sigma": np.full(layer.size, 1.0, np.float32)}
    down |= {PROPOSED[0]: planes.ravel(), PROPOSED[1]: np.array([proposed], np.uint32)}
    voted = Voted(
        room("voted_planes", 4 * 40), room("plane_count", 1, np.uint32),
        room("voted_choice", card.size, np.uint32), room("planes_trusted", card.size, np.uint32),
        room("fits", FITS * card.size),
    )  # fmt: skip
    up = regions_found(down, edges, voted, grid, LABELS_PX, config=CONFIG, run=execution_named("numba"))
    assert {name: values.size for name, values in up.items()} == {
        "voted_planes": 160, "plane_count": 1, "voted_choice": card.size, "planes_trusted": card.size,
        "fits": FITS * card.size,
    }  # fmt: skip
    assert up["voted_choice"].max() < up["plane_count"][0]
    choice = up["voted_choice"].reshape(card.shape)
    rows, columns = np.mgrid[: 24 * SIZE, : 32 * SIZE]
    a, b, c = np.moveaxis(up["voted_planes"].reshape(-1, 4)[choice.repeat(4, 0).repeat(4, 1)][..., :3], -1, 0)
    found = a * columns + b * rows + c
    true = np.where(card.repeat(4, 0).repeat(4, 1), 45.3, 20 + 0.05 * columns + 0.02 * rows)
    np.testing.assert_allclose(found, true, atol=0.1)  # layers; .04 is found, of blocks' noise
    assert up["planes_trusted"].dtype == np.uint32
    # Single precision of labels up to 60.
    for fit in up["fits"].reshape(FITS, *card.shape):
        assert (np.abs(fit - found[SIZE // 2 :: SIZE, SIZE // 2 :: SIZE]) < 0.5).mean() > 0.9


def test_nothing_proposed_is_no_plane() -> None:
    grid = Grid(16, 24, len(LABELS_PX))
    blocks = 24
    down = {"blocks": np.zeros(blocks * grid.layers, np.float32), "label": np.zeros(16 * 24, np.float32)}
    down |= {"sigma": np.ones(16 * 24, np.float32)}
    down |= {PROPOSED[0]: np.zeros(4 * CAPACITY, np.float32), PROPOSED[1]: np.zeros(1, np.uint32)}
    voted = Voted(
        room("voted_planes", 400), room("plane_count", 1, np.uint32), room("voted_choice", blocks, np.uint32),
        room("planes_trusted", blocks, np.uint32), room("fits", FITS * blocks),
    )  # fmt: skip
    up = regions_found(
        down, np.zeros((2, 4, 6), np.float32), voted, grid, LABELS_PX, config=CONFIG, run=execution_named("numba")
    )
    assert up["plane_count"].tolist() == [0]
    assert not up["voted_choice"].any()

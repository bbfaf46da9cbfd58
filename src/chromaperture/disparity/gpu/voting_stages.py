"""Several fits of planes and the surface that they explain vote on a device: the stages of `plane_voting.py`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.plane_stages import BlockChoice
from chromaperture.disparity.gpu.surface_stages import Grid, SurfaceArrays, add_gaussian, gaussian_taps
from chromaperture.disparity.gpu.workgroups import groups_for
from chromaperture.disparity.learned_error_bar import POOLED_PX
from chromaperture.disparity.plane_agreement import AGREEMENT_SIGMAS
from chromaperture.disparity.plane_voting import ALIKE, LEAST, MOST_DIFFERENCE, NEAR_LABELS, OF_GUIDED, ROUGH_PX


class Voted(NamedTuple):
    """Planes of blocks on a device.

    Attributes
    ----------
    planes : Array
        (most, 4); layers.
    number : Array
        How many there are.
    choice : Array
        Plane of every block, uint32.
    trusted : Array or None
        1 where the block's plane is to be taken rather than the surface; None where no fits voted.
    fits : Array or None
        Layers of every block by each fit, (skipped + fits, blocks); None where there was one fit.
    skipped : int
        How many maps of ``fits`` come before the first fit.
    """

    planes: Array
    number: Array
    choice: Array
    trusted: Array | None = None
    fits: Array | None = None
    skipped: int = 0


def add_voted_planes(
    chain: Chain, chooser: BlockChoice, add_fit: Callable[[float], None], a: SurfaceArrays, grid: Grid, *,
    factors: tuple[float, ...], block_px: int,
) -> Voted:  # fmt: skip
    """Append fits and `plane_voting.voted_planes`.

    Parameters
    ----------
    chain : Chain
    chooser : BlockChoice
        Whose planes and choice a fit writes.
    add_fit : callable
        Appends the fit whose borders cost so many times the penalty.
    a : SurfaceArrays
    grid : Grid
        Of the picture.
    factors : tuple of float
        One a fit.
    block_px : int
    """
    fits, shape = len(factors), chooser.shape
    blocks, most = shape[0] * shape[1], fits * chooser.capacity
    groups, uses = groups_for(blocks), ("indexing",)
    kept, firsts = chain.array("voted_planes", 4 * most), chain.array("fit_firsts", fits + 1, np.uint32)
    sizes = {"fit_choices": fits * blocks, "fit_counts": 2 * most, "plane_count": 1}
    choices, counts, number = (chain.array(name, size, np.uint32) for name, size in sizes.items())
    maps, maps_room = (chain.array(f"trust_{name}", (1 + fits) * blocks) for name in ("maps", "maps_room"))
    differences, room, heights = (
        chain.array(f"trust_{name}", blocks) for name in ("differences", "differences_room", "heights")
    )
    chain.add("fill_zero", [counts], groups=groups_for(counts.size), uses=uses, size=counts.size)
    for k, factor in enumerate(factors):
        add_fit(factor)
        chain.add(
            "fit_kept", [chooser.planes, chooser.count, chooser.choice, kept, firsts, choices, number],
            groups=groups_for(max(blocks, chooser.capacity)), uses=uses, blocks=blocks, fit=k,
        )  # fmt: skip
        chain.add(
            "trust_maps", [choices, kept, a.surface, a.sigma, maps, differences, heights, counts], groups=groups,
            uses=uses, height=grid.height, width=grid.width, block=block_px, fit=k, sigmas=AGREEMENT_SIGMAS,
            most_difference=MOST_DIFFERENCE,
        )  # fmt: skip
    add_gaussian(chain, maps, maps_room, shape, gaussian_taps(POOLED_PX / block_px), parts=1, planes=1 + fits)
    add_gaussian(chain, differences, room, shape, gaussian_taps(ROUGH_PX / block_px), parts=1)
    choice, trusted = (chain.array(name, blocks, np.uint32) for name in ("voted_choice", "planes_trusted"))
    weights: dict[str, Any] = dict(OF_GUIDED.weights)
    chain.add(
        "planes_voted", [choices, kept, maps, differences, heights, counts, choice, trusted],
        groups=groups, uses=uses, height=shape[0], width=shape[1], fits=fits, least=LEAST, near=NEAR_LABELS,
        alike=ALIKE, constant=OF_GUIDED.constant, **weights,
    )  # fmt: skip
    return Voted(kept, number, choice, trusted, maps, 1)

"""Where near planes end, on a device: which planes a pixel may lie on, lines across borders, the choice.

The stages of `plane_edges.placed_edges`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from chromaperture.disparity.edge_likelihood import GRID_PX, SHIFTS
from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.line_stages import LineArrays, add_line_costs, add_listed
from chromaperture.disparity.gpu.plane_stages import add_potts
from chromaperture.disparity.gpu.workgroups import groups_for
from chromaperture.disparity.plane_edges import CORE, FORBIDDEN, OUTWARD_PX, SWEEPS


class EdgeGrid(NamedTuple):
    """A picture of height and width, its blocks of ``block`` px, its grid of points ``GRID_PX`` apart."""

    height: int
    width: int
    block: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return -(-self.height // GRID_PX), -(-self.width // GRID_PX)


class EdgePlanes(NamedTuple):
    """Planes on a device, in layers.

    Attributes
    ----------
    of_pixels, of_points : Array
        (most, 4), in the coordinates of pixels and of grid points.
    number : Array
        How many there are.
    most : int
    """

    of_pixels: Array
    of_points: Array
    number: Array
    most: int


def add_planes_of_pixels(
    chain: Chain, planes: Array, count: Array, unfinished: Array, *, block: int, most: int
) -> EdgePlanes:
    """Append the planes of blocks in the coordinates of pixels and of grid points.

    Parameters
    ----------
    chain : Chain
    planes : Array
        (K, 4); layers.
    count : Array
    unfinished : Array
        Grows where there are more than ``most``.
    block : int
    most : int
    """
    found = EdgePlanes(
        chain.array("planes", 4 * most), chain.array("edge_planes", 4 * most),
        chain.array("edge_planes_count", 1, np.uint32), most,
    )  # fmt: skip
    chain.add(
        "planes_of_pixels", [planes, count, found.of_pixels, found.of_points, found.number, unfinished],
        groups=groups_for(most), uses=("indexing",), block=block, spacing=GRID_PX, most=most,
    )  # fmt: skip
    return found


class HeardLines(NamedTuple):
    """That lines tell where edges are: what they need, room for how many, and what grows where there are more."""

    arrays: LineArrays
    most: int
    unfinished: Array


def add_placed_edges(
    chain: Chain,
    blocks: Array,
    planes: EdgePlanes,
    links: Array,
    heard: HeardLines | None,
    grid: EdgeGrid,
    *,
    reach_px: int,
    apart: float,
) -> Array:
    """Append `plane_edges.placed_edges`; return the plane of every pixel, (h, w) uint32.

    Parameters
    ----------
    chain : Chain
    blocks : Array
        Plane of every block.
    planes : EdgePlanes
    links : Array
        (2, h, w): `plane_edges.edge_links`.
    heard : HeardLines or None
    grid : EdgeGrid
    reach_px : int
    apart : float
        As `placed_edges`, in layers.
    """
    (height, width), most, count = grid.shape, planes.most, planes.number
    points = height * width
    of_picture: dict[str, Any] = dict(height=grid.height, width=grid.width, block=grid.block, spacing=GRID_PX)
    of_grid: dict[str, Any] = dict(height=height, width=width)
    groups, uses = groups_for(points), ("indexing",)
    coarse, free = (chain.array(name, points, np.uint32) for name in ("edge_choice", "edge_free"))
    inside, cost = chain.array("edge_inside", points), chain.array("edge_cost", points * most)
    meeting = chain.array("planes_meeting", most * most, np.uint32)
    chain.add(
        "chosen_on_grid", [blocks, coarse], groups=groups, uses=("indexing", "blocks_of_pixels"), **of_picture,
    )  # fmt: skip
    chain.add("fill_zero", [meeting], groups=groups_for(meeting.size), uses=uses, size=meeting.size)
    chain.add("planes_meeting", [coarse, count, meeting], groups=groups, uses=uses, **of_grid)
    outward_px = OUTWARD_PX if reach_px > 0 else 0  # without a band edges stay where blocks have them
    around = math.floor(max(reach_px, outward_px) / GRID_PX)
    chain.add("edge_inside", [coarse, inside], groups=groups, uses=("indexing", "chamfer"), **of_grid, around=around)
    chain.add(
        "edge_possible", [coarse, planes.of_points, count, meeting, inside, cost],
        groups=groups, uses=("indexing", "chamfer"), **of_grid, around=around, reach=reach_px / GRID_PX, core=CORE,
        outward=outward_px / GRID_PX, apart=float(apart), forbidden=FORBIDDEN,
    )  # fmt: skip
    if heard is not None:
        listed = add_listed(
            chain, coarse, planes.of_points, heard.arrays, heard.unfinished, apart=apart, most=heard.most
        )
        costs = add_line_costs(chain, coarse, listed, heard.arrays)
        arrays = [listed.at, listed.about, costs, count, cost]
        chain.add("lines_heard", arrays, groups=groups, uses=uses, **of_grid, shifts=SHIFTS, forbidden=FORBIDDEN)
    chain.add("edge_free", [cost, count, free], groups=groups, uses=uses, points=points, forbidden=FORBIDDEN)
    moved = add_potts(chain, cost, count, links, grid.shape, most, SWEEPS)
    choice = chain.array("plane_of_pixel", grid.height * grid.width, np.uint32)
    chain.add(
        "edges_taken", [blocks, moved, free, choice], groups=groups_for(grid.height * grid.width),
        uses=("indexing", "blocks_of_pixels"), **of_picture,
    )  # fmt: skip
    return choice

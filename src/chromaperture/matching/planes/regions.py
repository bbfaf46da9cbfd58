"""Let regions of a photograph choose planes and join: areas end where the photograph shows depth edges.

Blocks of pixels say little each, and those beside a near thing speak for it. What the photograph shows of depth edges
(`depth_edges.py`) cuts it into regions, whose evidence is summed; neighbours are joined while that saves more than it
costs. The sum is the energy of planes (Isack and Boykov 2012): what the planes miss of the evidence, and what borders
cost, which is less where an edge is likely. Belief propagation over blocks stops far from its least value where borders
are sharp; joining moves whole areas.

References
----------
H. Isack, Y. Boykov: Energy-based geometric multi-model fitting. IJCV 97, 2012. doi:10.1007/s11263-011-0474-7
J. Cousty, G. Bertrand, L. Najman, M. Couprie: Watershed cuts: minimum spanning forests and the drop of water principle.
IEEE TPAMI 31, 2009. doi:10.1109/TPAMI.2008.173
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from scipy import ndimage, sparse

from chromaperture.matching.blocks import BLOCK_PX
from chromaperture.matching.execution import Execution
from chromaperture.matching.planes.depth_edges import strongest_links
from chromaperture.matching.readable.joining import summed_pairs
from chromaperture.matching.readable.planes import PlaneCosts
from chromaperture.settings.stages import PlanesConfig
from chromaperture.system.threads import each_band

# docs/decisions.md, *Depth edges in the photograph*, has .4 and 1 for the one, 4 and 9 for the other.
SMOOTH_BLOCKS = 0.7  # sigma of what edges are smoothed by before regions are cut
MOST_LOG_ODDS = 6.0  # of no edge that a border costs
OF_LINK = 1e-3  # of a link's own log odds: tells apart what is alike otherwise, and changes nothing else
# Whose costs are gathered at once: .8 MB of 350 planes. All together are 30 MB of new memory, which in a measurement of
# 720x480 px took .2 to .38 s in place of .02 to .03 s.
_REGIONS_AT_ONCE = 32


# Share of its evidence that a sloped plane loses beside level ones: that of a far wall hardly tells whether it leans.
SLOPED_LESS = 0.012
LEAST_CORE = 0.25  # share of a region's blocks away from depth edges below which all of them count; chosen by hand


class Regions(NamedTuple):
    """Regions that have one plane."""

    region: np.ndarray  # (h, w) int, from 0 on
    label: np.ndarray  # (h, w) float; of their planes, which stay within the labels


def planes_of_regions(
    nats: np.ndarray, planes: np.ndarray, log_odds: np.ndarray, *, config: PlanesConfig, run: Execution
) -> Regions:
    """Let regions between depth edges choose planes, level ones of every label among them, and join.

    ``nats`` (h, w, N) float32: sums of the evidence of blocks; ``planes`` (K, 3) float: ``label = a x + b y + c``,
    labels from 0 on; ``log_odds`` (2, h, w) float: as `edge_log_odds`, of the same blocks.
    """
    labels = np.arange(nats.shape[2], dtype=float)
    every = np.concatenate([planes, np.stack([0 * labels, 0 * labels, labels], axis=1)])
    region = regions_between_edges(log_odds)
    costs = PlaneCosts(config.slope_penalty, config.outside_penalty * BLOCK_PX**2)
    cost = run.plane_costs(nats, every, labels, costs)
    cost[..., : len(planes)] *= np.float32(1 - SLOPED_LESS)
    shares = shares_of_blocks(region, log_odds, config.edge_block_weight)
    total = costs_of_regions(region, cost, most_block_nats=config.max_block_nats, shares=shares)
    pairs, border = borders_of(region, border_costs(log_odds, config.border_nats))
    into, total = run.join_regions(total, pairs, border, plane_penalty=config.plane_penalty)
    left, numbers = np.unique(into, return_inverse=True)
    joined = numbers[region]
    a, b, c = every[total[left].argmin(axis=1)].T[:, joined]
    label = a * np.arange(joined.shape[1]) + b * np.arange(joined.shape[0])[:, None] + c
    return Regions(joined, np.clip(label, 0, len(labels) - 1))


def regions_between_edges(log_odds: np.ndarray) -> np.ndarray:
    """Cut a picture of blocks into regions that no likely edge crosses.

    They are the watersheds of the log odds: trees of least edges, one from every lowest place, which are the minimum
    spanning tree of all blocks and of a root beside them (Cousty et al. 2009).

    ``log_odds`` (2, h, w) float: as `edge_log_odds`. Returns (h, w) int: from 0 on.
    """
    of_block = cv2.GaussianBlur(strongest_links(log_odds), (0, 0), SMOOTH_BLOCKS)
    lowest, _ = ndimage.label(of_block == ndimage.minimum_filter(of_block, size=3), structure=np.ones((3, 3)))
    starts = np.unique(lowest, return_index=True)[1]
    starts = starts[lowest.ravel()[starts] > 0].astype(np.int32)
    # SciPy 1.13 finds trees of 32-bit indices only.
    one, other = _ends_of_links(np.arange(of_block.size, dtype=np.int32).reshape(of_block.shape))
    # Both links of a block on a ridge are as high as the block: their own log odds tell to which side it belongs.
    above = np.maximum(*_ends_of_links(of_block)) + OF_LINK * _of_links(log_odds)
    above -= above.min() - 2  # a sparse 0 is no edge
    rows = np.concatenate([one, np.full(len(starts), of_block.size, np.int32)])
    weights = np.concatenate([above, np.ones(len(starts))])
    graph = sparse.coo_array((weights, (rows, np.concatenate([other, starts]))), shape=(of_block.size + 1,) * 2)
    tree = sparse.csgraph.minimum_spanning_tree(graph.tocsr())[: of_block.size, : of_block.size]
    return np.asarray(sparse.csgraph.connected_components(tree, directed=False)[1].reshape(of_block.shape))


def border_costs(log_odds: np.ndarray, nats: float) -> np.ndarray:
    """Return what a border between two blocks costs: so many nats a unit of the log odds of no edge; (2, h, w)."""
    return np.asarray(nats * np.clip(-log_odds, 0, MOST_LOG_ODDS))


def shares_of_blocks(region: np.ndarray, log_odds: np.ndarray, share: float) -> np.ndarray:
    """Return how much a block counts in the sums of its region: less beside a likely depth edge.

    Windows there see both sides, and the evidence is that of the stronger texture. In a region that has hardly any
    other blocks all count fully.

    ``region`` (h, w) int, from 0 on; ``log_odds`` (2, h, w) float: as `edge_log_odds`. An edge is likely where they are
    above 0; ``share``: of blocks that such an edge touches. Returns (h, w) float32.
    """
    away = strongest_links(log_odds) <= 0
    # As in fits: where the rest of a region is less than this share of it, all of its blocks count.
    is_thin = np.bincount(region.ravel(), away.ravel()) < LEAST_CORE * np.bincount(region.ravel())
    return np.where(away | is_thin[region], 1, share).astype(np.float32)


def costs_of_regions(
    region: np.ndarray, cost: np.ndarray, *, most_block_nats: float = 0.0, shares: np.ndarray | None = None
) -> np.ndarray:
    """Sum what every plane costs the blocks of a region.

    ``region`` (h, w) int, from 0 on; ``cost`` (h, w, K) float32: of every plane, nats; ``most_block_nats``: as
    `bounded`; ``shares`` (h, w) float32: how much blocks count; see `shares_of_blocks`. Returns (R, K) float64, nats.
    """
    order = np.argsort(region, axis=None, kind="stable")
    starts = np.searchsorted(region.ravel()[order], np.arange(int(region.max()) + 2))
    of_block = cost.reshape(-1, cost.shape[2])
    out = np.empty((len(starts) - 1, cost.shape[2]))

    def add(some: slice) -> None:
        first, *_, end = starts[some.start : some.stop + 1]
        costs = bounded(of_block[order[first:end]], most_block_nats)
        if shares is not None:
            costs *= shares.ravel()[order[first:end], None]
        np.add.reduceat(costs, starts[some] - first, axis=0, dtype=np.float64, out=out[some])

    each_band(add, len(out), rows_a_band=_REGIONS_AT_ONCE)
    return out


def bounded(cost: np.ndarray, most_nats: float) -> np.ndarray:
    """Bound what any plane costs a block more than the block's best plane, smoothly.

    Windows of blocks beside a near thing see it, and its strong texture can outweigh all other blocks of a weakly
    textured region. A loss c becomes m (1 - exp(-c / m)): about c where that is small, m at most.

    ``cost`` (..., K) float32: of every plane, nats; ``most_nats``: m; 0 leaves costs as they are.
    """
    if most_nats == 0:
        return cost
    least = cost.min(axis=-1, keepdims=True)
    out = (least - cost) / np.float32(most_nats)
    np.exp(out, out=out)  # in float32 several times as fast as expm1, and exact to 1e-7 of the bound
    out *= -np.float32(most_nats)
    out += least + np.float32(most_nats)
    return np.asarray(out)


def borders_of(region: np.ndarray, links: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of regions that meet, (P, 2) int, the lower first, and what their borders cost, (P,)."""
    return summed_pairs(np.stack(_ends_of_links(region), axis=1), _of_links(links))[:2]


def _ends_of_links(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what a map (h, w) has at both ends of every link, those between rows first; (L,) each."""
    ends = (values[:-1], values[1:]), (values[:, :-1], values[:, 1:])
    one, other = (np.concatenate([pair[side].ravel() for pair in ends]) for side in (0, 1))
    return one, other


def _of_links(links: np.ndarray) -> np.ndarray:
    """Return the links (2, h, w) that have two ends, in the same order; (L,)."""
    return np.concatenate([links[0, :-1].ravel(), links[1, :, :-1].ravel()])

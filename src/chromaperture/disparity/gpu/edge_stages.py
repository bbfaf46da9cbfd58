"""Where near planes end, on a device: which planes a pixel may lie on, lines across borders, the choice.

The stages of `plane_edges.placed_edges`. What stays on the CPU: which lines are heard, and which of them share their
covariances; see `plane_edges.border_lines` and `edge_likelihood.py`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from chromaperture.disparity.edge_likelihood import (
    GRID_PX,
    HALF,
    SHADES_EVERY,
    SHADES_PX,
    SHIFTS,
    EdgeLikelihood,
    Groups,
    Photograph,
    TextureKey,
    noise_covariance,
)
from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.plane_stages import add_potts
from chromaperture.disparity.gpu.surface_stages import add_gaussian, gaussian_taps
from chromaperture.disparity.gpu.workgroups import groups_for
from chromaperture.disparity.plane_edges import CORE, FORBIDDEN, OUTWARD_PX, SWEEPS, BorderLines, border_lines
from chromaperture.disparity.stages.edge_costs import LEAST_OF_TRACE

SAMPLES = 2 * HALF  # of a line and channel
PLACES = 2 * SHIFTS + 1
MOST_LINES = 16  # eliminated at once: with the matrix 15 of the 16 KB that a workgroup shares
LANES, LANES_IN_SOFTWARE = 64, 8  # invocations of a matrix; in software one vector, whose barriers cost nothing
SHADES = "shade_products"
_SHADE_PARTS = 64  # workgroups that sum the shades
_DIFFERENCES = np.eye(SAMPLES) - np.eye(SAMPLES, k=-1)  # the first sample, then differences of neighbours


class EdgeGrid(NamedTuple):
    """A picture of height and width, its blocks of ``block`` px, its grid of points ``GRID_PX`` apart."""

    height: int
    width: int
    block: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return -(-self.height // GRID_PX), -(-self.width // GRID_PX)


class LinesHeard(NamedTuple):
    """Lines across borders as a device takes them; P lines, of G groups in C parts of at most `MOST_LINES`.

    Attributes
    ----------
    at : (2, h, w) uint32
        1 + the line that crosses the border behind a grid point, 0 for none; along rows and along columns.
    about : (P, 4) uint32
        Near and far plane, the points of the pair (bits) and whether near comes first (bit 31), weight (bits).
    samples : (P, 6 HALF) float32
        First samples and differences, the lines of a group one after the other.
    numbers : (C, 8) uint32
    values : (C, 8) float32
    textures : (T, 9, 4 * 2 HALF - 1, 4) float32
        See `_texture`.
    shares : (T, PLACES, 6 HALF) float32
    """

    at: np.ndarray
    about: np.ndarray
    samples: np.ndarray
    numbers: np.ndarray
    values: np.ndarray
    textures: np.ndarray
    shares: np.ndarray


def lines_heard(
    choice: np.ndarray, planes: np.ndarray, apart_px: float, edges: EdgeLikelihood, photograph: Photograph
) -> LinesHeard | None:
    """Find the lines across borders; None where there are none.

    Parameters
    ----------
    choice : (h, w) int
        Of the grid.
    planes : (K, 3) float
        Of grid points.
    apart_px : float
    edges : EdgeLikelihood
    photograph : Photograph
    """
    at = np.zeros((2, *choice.shape), np.uint32)
    about, samples, numbers, values = [], [], [], []
    known: dict[TextureKey, int] = {}
    count = 0
    for i, along_rows in enumerate((True, False)):
        found = border_lines(choice, planes, along_rows, apart_px)
        if found is None:
            continue
        lines = found.lines
        given = photograph.samples(lines)
        groups = edges.groups(photograph, lines, given)
        order = np.argsort(groups.of_line, kind="stable")
        at[i, lines.y[order], lines.x[order]] = 1 + count + np.arange(len(order))
        about.append(_about(found)[order])
        samples.append((given[order] @ _DIFFERENCES.T).reshape(len(order), -1))
        parts = _parts(groups, edges, photograph.colours, known, count)
        numbers.append(parts[0])
        values.append(parts[1])
        count += len(order)
    if not count:
        return None
    textures = np.stack([_texture(edges, key) for key in known])
    shares = np.stack([edges.texture(key).before.reshape(PLACES, -1) for key in known])
    return LinesHeard(
        at, np.concatenate(about), np.concatenate(samples), np.concatenate(numbers), np.concatenate(values), textures,
        shares,
    )  # fmt: skip


def _about(found: BorderLines) -> np.ndarray:
    bits = (found.of_pair << np.arange(2 * SHIFTS)).sum(axis=1) | found.lines.near_first.astype(np.int64) << 31
    weight = found.weight.astype(np.float32).view(np.uint32)
    return np.stack([found.near, found.far, bits, weight], axis=1).astype(np.uint32)


def _parts(
    groups: Groups, edges: EdgeLikelihood, colours: np.ndarray, known: dict[TextureKey, int], first: int
) -> tuple[np.ndarray, np.ndarray]:
    """Cut groups into parts; what `line_costs.wgsl` reads of them, (C, 8) each."""
    sizes = np.bincount(groups.of_line)
    near, far = (np.array([known.setdefault(key, len(known)) for key in keys]) for keys in (groups.near, groups.far))
    group = np.repeat(np.arange(len(sizes)), -(-sizes // MOST_LINES))
    part = np.arange(len(group)) - np.searchsorted(group, group)
    start = first + (np.cumsum(sizes) - sizes)[group] + MOST_LINES * part
    numbers = np.zeros((len(group), 8), np.uint32)
    numbers[:, :4] = np.stack([near[group], far[group], groups.near_first[group], start], axis=1)
    numbers[:, 4] = np.minimum(sizes[group] - MOST_LINES * part, MOST_LINES)
    values = np.zeros((len(group), 8), np.float32)
    values[:, :3] = np.stack([groups.near_power, groups.far_power, groups.level], axis=1)[group]
    values[:, 3] = _least_variances(groups, edges, colours)[group]
    values[:, 4:7] = groups.noise[group]
    return numbers, values


def _least_variances(groups: Groups, edges: EdgeLikelihood, colours: np.ndarray) -> np.ndarray:
    """Return what `stages.edge_costs` adds to the variances of every group; (G,)."""
    before = np.stack([edges.texture(key).before[0] for key in groups.near])
    share = np.where(groups.near_first[:, None, None], 1 - before, before)
    total = SAMPLES * noise_covariance()[0, 0] * groups.noise.sum(axis=1)
    for keys, power, of_side in ((groups.near, groups.near_power, share), (groups.far, groups.far_power, 1 - share)):
        of_unit = np.stack([np.diagonal(edges.texture(key).covariance[:, :, 0, 0]) for key in keys])
        variances = np.diag(colours) * (power[:, None] * of_unit + groups.level[:, None])
        total += (variances * np.square(of_side).sum(axis=2)).sum(axis=1)
    return np.asarray(LEAST_OF_TRACE / (3 * SAMPLES) * total)


def _texture(edges: EdgeLikelihood, key: TextureKey) -> np.ndarray:
    """Covariances of pairs of channels as a difference of neighbours, and the sample before it, have them.

    Of samples i and j those of both differences, of the first with the sample before the second, of the sample before
    the first with the second, of both samples before. They depend on i - j = 1 - 2 HALF ... 2 HALF - 1; behind these
    are those of i = 0, whose difference is the sample itself, with all j, and of all i with j = 0.
    """
    whole = edges.texture(key).covariance
    before = np.eye(SAMPLES, k=-1)
    parts = (_DIFFERENCES, _DIFFERENCES), (_DIFFERENCES, before), (before, _DIFFERENCES), (before, before)
    each = np.stack([one @ whole @ other.T for one, other in parts], axis=-1)  # (3, 3, i, j, 4)
    # Row and column 1 hold the distances without the first sample; the greatest ones are not met.
    edge = np.zeros((3, 3, 1, len(parts)))
    distances = [edge, each[:, :, 1, :0:-1], each[:, :, 2:, 1], edge]
    found = np.concatenate([*distances, each[:, :, 0], each[:, :, :, 0]], axis=2)
    return found.reshape(9, -1, len(parts)).astype(np.float32)


def add_shades(chain: Chain, image: Array, shape: tuple[int, int]) -> None:
    """Append `edge_likelihood.products_of_shades` of an image (h, w, 3); read `SHADES` by `products_of`."""
    size = 3 * shape[0] * shape[1]
    fine, coarse, room = (chain.array(f"shades_{name}", size) for name in ("fine", "coarse", "room"))
    for blurred, sigma in zip((fine, coarse), SHADES_PX, strict=True):
        add_gaussian(chain, blurred, room, shape, gaussian_taps(sigma), parts=3, source=image)
    chain.add(
        "shade_products", [fine, coarse, chain.array(SHADES, 8 * _SHADE_PARTS)], groups=(_SHADE_PARTS,),
        height=shape[0], width=shape[1], every=SHADES_EVERY, parts=_SHADE_PARTS,
    )  # fmt: skip


def products_of(shades: np.ndarray) -> np.ndarray:
    """Return (3, 3) float64 of what `add_shades` left."""
    squares, (rg, rb, gb) = shades.reshape(-1, 2, 4)[..., :3].sum(axis=0, dtype=float)
    return np.diag(squares) + np.array([[0, rg, rb], [rg, 0, gb], [rb, gb, 0]])


def add_line_costs(chain: Chain, heard: LinesHeard, colours: np.ndarray) -> Array:
    """Append `stages.edge_costs` of all groups; (P, PLACES)."""
    noise = _DIFFERENCES @ noise_covariance() @ _DIFFERENCES.T
    costs = chain.array("line_costs", PLACES * len(heard.samples))
    arrays = [
        chain.constant("line_textures", heard.textures), chain.constant("line_shares", heard.shares),
        chain.constant("line_numbers", heard.numbers), chain.constant("line_values", heard.values),
        chain.constant("line_noise", np.concatenate([colours.ravel(), noise.ravel()])),
        chain.constant("line_samples", heard.samples), costs,
    ]  # fmt: skip
    chain.add(
        "line_costs", arrays, groups=(len(heard.numbers), PLACES),
        lanes=LANES_IN_SOFTWARE if chain.device.info.is_software else LANES, samples=SAMPLES, places=PLACES,
        most_lines=MOST_LINES,
    )  # fmt: skip
    return costs


def add_placed_edges(
    chain: Chain,
    blocks: Array,
    planes: np.ndarray,
    links: np.ndarray,
    heard: tuple[LinesHeard, np.ndarray] | None,
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
    planes : (K, 3) float
        Of pixels; labels count in layers.
    links : (2, h, w) float
        `plane_edges.edge_links`.
    heard : tuple or None
        Lines, and the covariance of the colours.
    grid : EdgeGrid
    reach_px : int
    apart : float
        As `placed_edges`, in layers.
    """
    (height, width), number = grid.shape, len(planes)
    points = height * width
    of_picture: dict[str, Any] = dict(height=grid.height, width=grid.width, block=grid.block, spacing=GRID_PX)
    of_grid: dict[str, Any] = dict(height=height, width=width)
    groups, uses = groups_for(points), ("indexing",)
    coarse, free = (chain.array(name, points, np.uint32) for name in ("edge_choice", "edge_free"))
    inside, cost = chain.array("edge_inside", points), chain.array("edge_cost", points * number)
    meeting = chain.array("planes_meeting", number * number, np.uint32)
    count = chain.constant("edge_planes_count", np.array([number], np.uint32))
    of_points = np.concatenate([planes * (GRID_PX, GRID_PX, 1), np.zeros((number, 1))], axis=1)
    chain.add(
        "chosen_on_grid", [blocks, coarse], groups=groups, uses=("indexing", "blocks_of_pixels"), **of_picture,
    )  # fmt: skip
    chain.add("fill_zero", [meeting], groups=groups_for(meeting.size), uses=uses, size=meeting.size)
    chain.add("planes_meeting", [coarse, count, meeting], groups=groups, uses=uses, **of_grid)
    outward_px = OUTWARD_PX if reach_px > 0 else 0  # without a band edges stay where blocks have them
    around = math.floor(max(reach_px, outward_px) / GRID_PX)
    chain.add("edge_inside", [coarse, inside], groups=groups, uses=("indexing", "chamfer"), **of_grid, around=around)
    chain.add(
        "edge_possible", [coarse, chain.constant("edge_planes", of_points), count, meeting, inside, cost],
        groups=groups, uses=("indexing", "chamfer"), **of_grid, around=around, reach=reach_px / GRID_PX, core=CORE,
        outward=outward_px / GRID_PX, apart=float(apart), forbidden=FORBIDDEN,
    )  # fmt: skip
    if heard is not None:
        lines, colours = heard
        costs = add_line_costs(chain, lines, colours)
        arrays = [chain.constant("line_at", lines.at), chain.constant("line_about", lines.about), costs, count, cost]
        chain.add("lines_heard", arrays, groups=groups, uses=uses, **of_grid, shifts=SHIFTS, forbidden=FORBIDDEN)
    chain.add("edge_free", [cost, count, free], groups=groups, uses=uses, points=points, forbidden=FORBIDDEN)
    moved = add_potts(chain, cost, count, chain.constant("edge_links", links), grid.shape, number, SWEEPS)
    choice = chain.array("plane_of_pixel", grid.height * grid.width, np.uint32)
    chain.add(
        "edges_taken", [blocks, moved, free, choice], groups=groups_for(grid.height * grid.width),
        uses=("indexing", "blocks_of_pixels"), **of_picture,
    )  # fmt: skip
    return choice

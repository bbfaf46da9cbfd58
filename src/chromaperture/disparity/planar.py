"""A surface of few planes: where the evidence is weak, only pixels of the whole plane together say where it is.

Windows and paths pool tens of pixels, a wall has tens of thousands. Planes are proposed from a first surface. Where the
camera's blur is known, regions between the photograph's depth edges choose planes and join (`plane_regions.py`). Else
every block of pixels chooses one by belief propagation, neighbours that one plane explains as well are joined, and the
choice is made again (multi-model fitting by energy). Curved surfaces become as many planes as their evidence can tell
apart. Several such fits vote (`plane_voting.py`).

References
----------
H. Isack, Y. Boykov: Energy-based geometric multi-model fitting. IJCV 97, 2012. doi:10.1007/s11263-011-0474-7
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from chromaperture.disparity.depth_edges import BLOCK_PX
from chromaperture.disparity.execution import Execution
from chromaperture.disparity.plane_edges import LineCosts, choices_of, placed_edges
from chromaperture.disparity.plane_fit import Planes, Volume, candidates, of_pixels
from chromaperture.disparity.plane_merging import away_from_borders, counted, merged_planes
from chromaperture.disparity.plane_regions import (
    border_costs,
    costs_of_regions,
    joined_regions,
    regions_between_edges,
    shares_of_blocks,
)
from chromaperture.disparity.plane_voting import OF_GUIDED, labels_of_blocks, voted_planes
from chromaperture.disparity.stages.planes import PlaneCosts
from chromaperture.disparity.stages.variation import edge_weights
from chromaperture.planes_config import PlanesConfig
from chromaperture.stage_config import SurfaceConfig
from chromaperture.threads import BAND_ROWS, each_band, parallel_map

# Areas that end where the photograph has edges need less of a border left out: docs/measurements.md, "Depth edges in
# the photograph".
BORDER_OF_REGIONS = 2 / 3  # of ``border_px``
# Share of its evidence that a sloped plane loses beside level ones: that of a far wall hardly tells whether it leans.
# docs/measurements.md, "Rooms as people photograph them", has 0, .025 and .05.
SLOPED_LESS = 0.012
# Factors on the least and on the greatest cost of borders: two fits that do not vote, but tell how sure the answer is.
# docs/measurements.md, "Fits that disagree", has other factors and other fits.
JUDGING_FACTORS = (0.5, 2.0)
PARABOLA_LABELS = 2  # either side, as derivatives of `stages.best_planes`
BORDER_APART_LABELS = 1.5  # by which two planes differ for their border to be a depth edge; chosen by hand


def planes_of_surface(
    label_px: np.ndarray,
    sigma_px: np.ndarray,
    likelihood: np.ndarray,
    guide: np.ndarray,
    labels_px: np.ndarray,
    *,
    config: PlanesConfig,
    surface: SurfaceConfig,
    run: Execution,
    line_costs: LineCosts | None = None,
    depth_edges: np.ndarray | None = None,
) -> Planes | None:
    """Explain a surface by planes.

    Parameters
    ----------
    label_px, sigma_px : (H, W) float, px
        A first surface, without NaN, and its standard deviation.
    likelihood : (H, W, N) float32, nats a pixel
    guide : (H, W) float
        In units of ``guide_range``: boundaries are cheaper on its edges.
    labels_px : (N,) float, px
    config : PlanesConfig
    surface : SurfaceConfig
        How the guide leads.
    run : Execution
    line_costs : callable, optional
        See `placed_edges`.
    depth_edges : (2, H // 4, W // 4) float, optional
        As `edge_log_odds`, which ``learned_border_nats`` need.

    Returns
    -------
    Planes or None
        None where planes are switched off or no plane was found.
    """
    size = config.block_px
    if config.rounds == 0 or min(label_px.shape) < 2 * size:
        return None
    pixels = Volume(likelihood, labels_px, PlaneCosts(config.slope_penalty, config.outside_penalty), run)
    planes = candidates(label_px, sigma_px, pixels, config.tiles_px)
    if not len(planes):
        return None
    blocks = Volume(block_sums(likelihood, size), labels_px, block_costs(config), run)
    if depth_edges is not None and needs_depth_edges(config):
        found = voted_regions(planes, blocks, depth_edges, label_px, sigma_px, config=config)
    else:
        links = links_of_blocks(guide, config=config, surface=surface)
        fits = fits_of_blocks(planes, blocks, links, guide.shape, config=config)
        found = fits[0]
        if config.vote_factors:
            found = voted_planes(fits, label_px, sigma_px, blocks.step_px, size, trust=OF_GUIDED)
    if config.edge_band_px == 0:
        return found
    choice = placed_edges(
        found.choice, found.planes, guide, reach_px=config.edge_band_px, apart_px=BORDER_APART_LABELS * blocks.step_px,
        choices=choices_of(run.potts_beliefs), line_costs=line_costs,
    )  # fmt: skip
    trusted = None if found.trusted is None else trust_of_moved(found.trusted, found.choice, choice)
    return found._replace(choice=choice, trusted=trusted)


def needs_depth_edges(config: PlanesConfig) -> bool:
    """Return whether planes end at the photograph's depth edges, not where the guide has some."""
    return config.rounds > 0 and bool(config.learned_border_nats) and config.block_px == BLOCK_PX


def voted_regions(
    planes: np.ndarray,
    blocks: Volume,
    depth_edges: np.ndarray,
    label_px: np.ndarray,
    sigma_px: np.ndarray,
    *,
    config: PlanesConfig,
) -> Planes:
    """Let regions between depth edges choose planes and join, and the fits vote; more fits tell how sure the answer is.

    Parameters
    ----------
    planes : (K, 3) float
        Candidates, of pixels.
    blocks : Volume
        Sums of blocks.
    depth_edges : (2, h, w) float
        As `edge_log_odds`, of the same blocks.
    label_px, sigma_px : (H, W) float, px
        The surface that the planes explain.
    config : PlanesConfig
    """
    of_fits = replace(config, learned_border_nats=costs_of_fits(config.learned_border_nats))
    fits = fits_of_regions(planes, blocks, depth_edges, label_px.shape, config=of_fits)
    voting = len(config.learned_border_nats)
    found = voted_planes(fits[:voting], label_px, sigma_px, blocks.step_px, config.block_px)
    assert found.fits_px is not None
    others = [labels_of_blocks(fit, config.block_px) for fit in fits[voting:]]
    return found._replace(fits_px=np.stack([*found.fits_px, *others]))


def trust_of_moved(trusted: np.ndarray, before: np.ndarray, choice: np.ndarray) -> np.ndarray:
    """Trust a plane also where an edge moved to it, if most of what it had before is trusted; all (H, W).

    Windows of the surface see both sides of an edge.
    """
    count = int(before.max()) + 1
    pixels, of_these = (np.bincount(part, minlength=count) for part in (before.ravel(), before[trusted]))
    return np.asarray(trusted | ((choice != before) & (2 * of_these > pixels)[choice]))


def block_costs(config: PlanesConfig) -> PlaneCosts:
    """Return what a plane costs a block.

    A block stands for size^2 pixels; its px is size px wide, so slopes between blocks are size times as large.
    """
    return PlaneCosts(config.slope_penalty, config.outside_penalty * config.block_px**2)


def links_of_blocks(guide: np.ndarray, *, config: PlanesConfig, surface: SurfaceConfig) -> np.ndarray:
    """Return what a border between two blocks costs; (2, H // size, W // size), nats."""
    weights = edge_weights(guide, edge_range=surface.edge_range, floor=surface.edge_floor)
    return np.asarray(config.boundary_penalty * config.block_px * block_links(weights, config.block_px))


def fitting_planes(
    planes: np.ndarray,
    blocks: Volume,
    shape: tuple[int, int],
    choose: Callable[[np.ndarray], np.ndarray],
    *,
    config: PlanesConfig,
) -> Planes:
    """Let blocks choose planes, join planes, and let blocks choose again.

    Parameters
    ----------
    planes : (K, 3) float
        Candidates.
    blocks : Volume
        Sums of blocks.
    shape : (int, int)
        Height and width of the picture.
    choose : callable
        From planes of blocks to the best choice of every block.
    config : PlanesConfig
    """
    size = config.block_px
    planes = _scaled(planes, size)
    for left in range(config.rounds - 1, -1, -1):
        choice = choose(planes)
        if left == 0 or len(planes) == 1:
            break
        planes, choice = merged_planes(choice, planes, blocks, config=config, border=-(-config.border_px // size))
    return planes_of_pixels(planes, choice, shape, size)._replace(blocks=blocks)


def fits_of_blocks(
    planes: np.ndarray, blocks: Volume, links: np.ndarray, shape: tuple[int, int], *, config: PlanesConfig
) -> list[Planes]:
    """Let blocks choose planes by belief propagation, a fit for each of ``vote_factors``, or one.

    Parameters are those of `fits_of_regions`, and ``links``, (2, h, w) float: as `links_of_blocks`.
    """

    def fit(factor: float) -> Planes:
        def choose(planes: np.ndarray) -> np.ndarray:
            cost = blocks.run.plane_costs(blocks.likelihood, planes, blocks.labels_px, blocks.costs)
            return np.asarray(blocks.run.potts_beliefs(cost, links * factor, sweeps=config.sweeps).argmin(axis=2))

        return fitting_planes(planes, blocks, shape, choose, config=config)

    return [fit(factor) for factor in config.vote_factors or (1.0,)]


def fits_of_regions(
    planes: np.ndarray, blocks: Volume, log_odds: np.ndarray, shape: tuple[int, int], *, config: PlanesConfig
) -> list[Planes]:
    """Let regions between depth edges choose planes and join, a fit for each of ``learned_border_nats``.

    Parameters
    ----------
    planes : (K, 3) float
        Candidates.
    blocks : Volume
        Sums of blocks.
    log_odds : (2, h, w) float
        As `edge_log_odds`, of the same blocks.
    shape : (int, int)
        Height and width of the picture.
    config : PlanesConfig
    """
    size, sloped = config.block_px, len(planes)
    planes = np.concatenate([_scaled(planes, size), level_planes(blocks.labels_px)])
    region = regions_between_edges(log_odds)
    cost = blocks.run.plane_costs(blocks.likelihood, planes, blocks.labels_px, blocks.costs)
    cost[..., :sloped] *= np.float32(1 - SLOPED_LESS)
    shares = shares_of_blocks(region, log_odds, config.share_beside_edges)
    total = costs_of_regions(region, cost, most_block_nats=config.most_block_nats, shares=shares)
    border = max(1, round(config.border_px * BORDER_OF_REGIONS / size))

    def fit(nats: float) -> Planes:
        links = border_costs(log_odds, nats)
        joined = joined_regions(region, total, links, plane_penalty=config.plane_penalty, run=blocks.run)
        merged, choice = merged_planes(
            joined.region, planes[joined.plane], blocks, config=config, border=border, of_missed=config.slope_of_missed
        )  # fmt: skip
        merged = between_labels(merged, choice, blocks, border=border)
        return planes_of_pixels(merged, choice, shape, size)._replace(blocks=blocks)

    return parallel_map(fit, config.learned_border_nats)


def costs_of_fits(border_nats: tuple[float, ...]) -> tuple[float, ...]:
    """Return what borders cost in every fit: first those that vote, then those that only tell how sure a plane is."""
    less, more = JUDGING_FACTORS
    return (*border_nats, less * min(border_nats), more * max(border_nats))


def level_planes(labels_px: np.ndarray) -> np.ndarray:
    """Return a plane of one label for every label; (N, 3)."""
    return np.stack([np.zeros_like(labels_px), np.zeros_like(labels_px), labels_px], axis=1)


def between_labels(planes: np.ndarray, choice: np.ndarray, blocks: Volume, *, border: int) -> np.ndarray:
    """Place level planes between labels, by a parabola through the sums of their evidence at five labels.

    Elsewhere evidence is interpolated linearly, so that of a level plane is always largest at a label: boards at known
    distances were off by up to half a label, 1.1 % at 2.9 m.

    Parameters
    ----------
    planes : (K, 3) float
        Of blocks; label ``a x + b y + c``, px.
    choice : (h, w) int
    blocks : Volume
    border : int
        Blocks next to another plane that do not count, unless too few are left.

    Returns
    -------
    (K, 3) float
    """
    out = planes.copy()
    core = away_from_borders(choice, border)
    steps = np.arange(-PARABOLA_LABELS, PARABOLA_LABELS + 1)
    for k in np.flatnonzero(~planes[:, :2].any(axis=1)):
        label = round((planes[k, 2] - float(blocks.labels_px[0])) / blocks.step_px)
        if PARABOLA_LABELS <= label < len(blocks.labels_px) - PARABOLA_LABELS:
            sums = blocks.likelihood[counted(choice == k, core)][:, label + steps].sum(axis=0, dtype=float)
            bend, slope, _ = np.polyfit(steps, sums, 2)
            if bend < 0:
                moved = float(np.clip(-slope / (2 * bend), -1, 1))
                out[k, 2] = blocks.labels_px[label] + moved * blocks.step_px
    return out


def planes_of_pixels(planes: np.ndarray, choice: np.ndarray, shape: tuple[int, int], size: int) -> Planes:
    """Express planes of blocks in pixels, and the choice of blocks of ``size`` px as that of a picture's pixels."""
    return Planes(_scaled(planes, 1 / size), of_pixels(choice, shape, size))


def block_sums(likelihood: np.ndarray, size: int) -> np.ndarray:
    """Sum a volume over squares of pixels; what is left over at the right and below is left out."""
    height, width, count = (n // size for n in (*likelihood.shape[:2], likelihood.shape[2] * size))
    out = np.empty((height, width, count), np.float32)

    def add(rows: slice) -> None:
        whole = likelihood[rows.start * size : rows.stop * size, : width * size]
        np.sum(whole.reshape(-1, size, width, size, count), axis=(1, 3), out=out[rows])

    each_band(add, height, rows_a_band=max(1, BAND_ROWS // size))
    return out


def block_links(weights: np.ndarray, size: int) -> np.ndarray:
    """Return the links between the middles of blocks: the weakest on the way, averaged over the side.

    Parameters
    ----------
    weights : (2, H, W) float
        Of the links between pixels, see `edge_weights`.
    size : int

    Returns
    -------
    (2, H // size, W // size) float32
    """
    height, width = (n // size for n in weights.shape[1:])
    out = np.ones((2, height, width), np.float32)
    for axis in (0, 1):
        part = weights[axis, : height * size, : width * size]
        along = part if axis == 0 else part.T
        lines, count = along.shape[0] // size, along.shape[1] // size
        between = (
            along[:, size // 2 : size // 2 + (count - 1) * size].reshape(lines * size, count - 1, size).min(axis=2)
        )
        mean = between.reshape(lines, size, count - 1).mean(axis=1)
        if axis == 0:
            out[0, :, :-1] = mean
        else:
            out[1, :-1] = mean.T
    return out


def _scaled(planes: np.ndarray, size: float) -> np.ndarray:
    """Express planes in the coordinates of blocks of ``size`` px, whose middles are whole numbers; and back."""
    a, b, c = planes.T
    middle = (size - 1) / 2
    return np.stack([a * size, b * size, c + (a + b) * middle], axis=1)

"""Where a near plane ends: the place of its edge is decided anew, not by windows.

A window beside a depth edge sees both sides, and the near side's outline, which is as sharp as the picture and belongs
to the near side. So near planes come out too large by up to the window's reach. Inside a band along their border no
evidence of windows counts. Where the camera's blur is known, lines across the border tell how likely every place of the
edge is (`edge_likelihood.py`); a border is cheaper where the picture changes most.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import cv2
import numpy as np

from chromaperture.disparity.edge_likelihood import GRID_PX, HALF, SHIFTS, Lines
from chromaperture.disparity.plane_merging import neighbouring_pairs
from chromaperture.threads import parallel_map

LineCosts = Callable[[Lines], np.ndarray]  # `EdgeLikelihood.costs` of a photograph


class Choices(Protocol):
    """Choices of least cost by `stages.potts_beliefs`."""

    def __call__(self, cost: np.ndarray, links: np.ndarray, *, sweeps: int) -> np.ndarray:
        """Return the best choice of every pixel, with the best of all others; (H, W) int."""


def choices_of(beliefs: Callable[..., np.ndarray]) -> Choices:
    """Return the choices of least cost by an execution's `potts_beliefs`."""

    def choose(cost: np.ndarray, links: np.ndarray, *, sweeps: int) -> np.ndarray:
        return np.asarray(beliefs(cost, links, sweeps=sweeps).argmin(axis=2))

    return choose


OUTWARD_PX = 3  # by which a near plane may also grow
STEEPNESS = 4.0  # a border on the steepest edge in reach costs exp(-4) of one on an even guide
LEAST_LINK = 0.03  # keeps borders short on the steepest edges
SMOOTHING_PX = 2.0  # of the guide; its noise is no edge
CORE = 0.75  # of the half-width of a thin plane: so much of it stays, however wide the band
# Weight of a line's log-likelihood: lines are 2 px apart, and textures and outlines of neighbours are alike.
# docs/measurements.md has .02 to .3.
LINE_WEIGHT = 0.03
LEAST_OF_PAIR = 0.7  # share of a line's middle that must lie on its two planes; .5 and .9 do as well
LEAST_ACROSS = 0.3  # of the squared cosine between a line and the border's normal; chosen by hand
NORMAL_SIGMA = 4.0  # grid points, over which a border's normal is found; chosen by hand
FORBIDDEN = 1e3  # more than all links and lines of a pixel together
SWEEPS = 10


def placed_edges(
    choice: np.ndarray,
    planes: np.ndarray,
    guide: np.ndarray,
    *,
    reach_px: int,
    apart_px: float,
    choices: Choices,
    line_costs: LineCosts | None = None,
) -> np.ndarray:
    """Move the borders of near planes to where their edges are.

    Parameters
    ----------
    choice : (H, W) int
        Plane of every pixel.
    planes : (K, 3) float
    guide : (H, W) float
    reach_px : int
        Width of the band inside a near plane's border.
    apart_px : float
        Labels by which two planes must differ for one to be near.
    choices : callable
        See `choices_of`.
    line_costs : callable, optional
        Costs of the places of edges; without, the guide alone decides.

    Returns
    -------
    (H, W) int
    """
    used, coarse, planes = on_grid(choice, planes)
    possible = _possible(coarse, planes, reach_px / GRID_PX, apart_px)
    if np.count_nonzero(possible) == coarse.size:
        return choice
    cost = np.zeros(possible.shape, np.float32)
    if line_costs is not None:
        for along_rows in (True, False):
            _add_lines(cost, possible, coarse, planes, along_rows, apart_px, line_costs)
    np.putmask(cost, ~possible, np.float32(FORBIDDEN))
    moved = choices(cost, edge_links(guide, reach_px), sweeps=SWEEPS)
    rows, columns = (np.arange(n) // GRID_PX for n in choice.shape)
    free = (np.count_nonzero(possible, axis=2) > 1)[rows[:, None], columns]
    return np.where(free, used[moved[rows[:, None], columns]], choice)


def on_grid(choice: np.ndarray, planes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the numbers of the planes that are used, and choices and planes of these on the grid."""
    coarse = choice[::GRID_PX, ::GRID_PX]
    used, numbers = np.unique(coarse, return_inverse=True)
    return used, numbers.reshape(coarse.shape), planes[used] * (GRID_PX, GRID_PX, 1)


def _label(planes: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Labels of planes (..., 3) at grid points, px."""
    a, b, c = np.moveaxis(planes, -1, 0)
    return np.asarray(a * x + b * y + c)


def _add_lines(
    cost: np.ndarray,
    possible: np.ndarray,
    choice: np.ndarray,
    planes: np.ndarray,
    along_rows: bool,
    apart_px: float,
    line_costs: LineCosts,
) -> None:
    """Add what lines across borders say of the pixels beside these, which may lie on either plane.

    Parameters
    ----------
    cost : (h, w, K) float32
        Is added to.
    possible : (h, w, K) bool
        Is added to.
    choice : (h, w) int
    planes : (K, 3) float
        Of grid points.
    along_rows : bool
    apart_px : float
    line_costs : callable
    """
    found = border_lines(choice, planes, along_rows, apart_px)
    if found is None:
        return
    if not along_rows:
        cost, possible = (part.transpose(1, 0, 2) for part in (cost, possible))
    costs = found.weight[:, None] * line_costs(found.lines)
    # A pixel that becomes near moves the edge beyond it.
    rise = np.diff(costs, axis=1) * np.where(found.lines.near_first, 1, -1)[:, None]
    at = found.y[:, None], found.x[:, None] + np.arange(1 - SHIFTS, SHIFTS + 1)
    of_pair = found.of_pair
    rows, columns, steps = at[0].repeat(rise.shape[1], axis=1)[of_pair], at[1][of_pair], rise[of_pair]
    for side, sign in ((found.near, 0.5), (found.far, -0.5)):
        plane = side[:, None].repeat(rise.shape[1], axis=1)[of_pair]
        np.add.at(cost, (rows, columns, plane), sign * steps)
        possible[rows, columns, plane] = True


class BorderLines(NamedTuple):
    """Lines across borders of near planes, P of one direction.

    Attributes
    ----------
    lines : Lines
    y, x : (P,) int
        Grid point before the border; of lines along columns of the turned grid, in which they are rows.
    near, far : (P,) int
        Planes of both sides.
    weight : (P,) float
        Of a line's log-likelihood.
    of_pair : (P, 2 SHIFTS) bool
        Which of the points between the places of the edge lie on either plane.
    """

    lines: Lines
    y: np.ndarray
    x: np.ndarray
    near: np.ndarray
    far: np.ndarray
    weight: np.ndarray
    of_pair: np.ndarray


def border_lines(choice: np.ndarray, planes: np.ndarray, along_rows: bool, apart_px: float) -> BorderLines | None:
    """Find the lines that tell where the borders of near planes are; None where there are none.

    Parameters
    ----------
    choice : (h, w) int
    planes : (K, 3) float
        Of grid points.
    along_rows : bool
    apart_px : float
    """
    if not along_rows:
        choice, planes = choice.T, planes[:, [1, 0, 2]]
    width = choice.shape[1]
    y, x = np.nonzero(choice[:, :-1] != choice[:, 1:])
    here, beyond = choice[y, x], choice[y, x + 1]
    gap = _label(planes[beyond], y, x) - _label(planes[here], y, x)  # of both planes at one pixel
    near_first = gap > 0
    near, far = np.where(near_first, here, beyond), np.where(near_first, beyond, here)
    across = _across(choice, y, x, near)
    inside = (x >= HALF - 1) & (x + HALF < width)
    kept = (np.abs(gap) > apart_px) & inside & (across > LEAST_ACROSS)
    y, x, near, far, near_first, across = (part[kept] for part in (y, x, near, far, near_first, across))
    middle = choice[y[:, None], x[:, None] + np.arange(-SHIFTS, SHIFTS + 2)]
    of_pair = (middle == near[:, None]) | (middle == far[:, None])
    kept = of_pair.mean(axis=1) >= LEAST_OF_PAIR
    if not kept.any():
        return None
    y, x, near, far, near_first, across = (part[kept] for part in (y, x, near, far, near_first, across))
    near_px, far_px = (_label(planes[side], y, x) for side in (near, far))
    row, column = (y, x) if along_rows else (x, y)
    lines = Lines(along_rows, row, column, near_px, far_px, near_first)
    return BorderLines(lines, y, x, near, far, LINE_WEIGHT * across, of_pair[kept][:, 1:-1])


def _across(choice: np.ndarray, y: np.ndarray, x: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Squared cosine between rows and the normals of near planes' borders at grid points; (P,)."""
    out = np.empty(len(y))
    for k in np.unique(near):
        inside = cv2.GaussianBlur((choice == k).astype(np.float32), (0, 0), NORMAL_SIGMA)
        of_plane = near == k
        along, down = (cv2.Sobel(inside, cv2.CV_32F, *order)[y[of_plane], x[of_plane]] for order in ((1, 0), (0, 1)))
        out[of_plane] = along**2 / (along**2 + down**2 + np.finfo(np.float32).tiny)
    return out


def _possible(choice: np.ndarray, planes: np.ndarray, reach: float, apart_px: float) -> np.ndarray:
    """Planes that a pixel may lie on: its own, and next to a border between near and far the other; (h, w, K)."""
    possible = np.arange(len(planes))[:, None, None] == choice
    pairs = neighbouring_pairs(choice)
    wide = np.ones((2 * int(reach) + 1,) * 2, np.uint8)
    y, x = np.arange(choice.shape[0])[:, None], np.arange(choice.shape[1])

    def of_plane(k: int) -> _Area:
        here = possible[k].copy()
        inside = _distance(here)
        half_width = cv2.dilate(inside, wide)
        thin_core = (inside >= CORE * half_width) & (half_width < reach)
        return _Area(here, _distance(~here), thin_core, _label(planes[k], y, x))

    each = sorted({k for pair in pairs for k in pair})
    areas = dict(zip(each, parallel_map(of_plane, each), strict=True))

    def add(k: int) -> None:
        one = areas[k]
        for other in (areas[i if j == k else j] for i, j in pairs if k in (i, j)):
            near = (one.label_px > other.label_px + apart_px) & (one.away <= reach) & ~other.thin_core
            far = (other.label_px > one.label_px + apart_px) & (one.away <= OUTWARD_PX / GRID_PX)
            possible[k] |= other.here & (near | far)

    parallel_map(add, each)
    return np.ascontiguousarray(possible.transpose(1, 2, 0))


class _Area(NamedTuple):
    """Where a plane is, the distance of all pixels from it, the core that stays of it where it is thin, its labels."""

    here: np.ndarray
    away: np.ndarray
    thin_core: np.ndarray
    label_px: np.ndarray


def edge_links(guide: np.ndarray, reach_px: int) -> np.ndarray:
    """Return the cost of a border between two grid points, by the steepest edge in reach; (2, h, w) float32."""
    smooth = cv2.GaussianBlur(np.asarray(guide, np.float32), (0, 0), SMOOTHING_PX)
    steps = np.abs(
        np.stack([np.diff(smooth, axis=1, append=smooth[:, -1:]), np.diff(smooth, axis=0, append=smooth[-1:])])
    )
    steepest = cv2.dilate(np.hypot(*steps), np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8))
    steepest = cv2.GaussianBlur(steepest, (0, 0), reach_px / 2) + np.float32(1e-6)  # 1e-6: an even guide
    steps, steepest = (part[..., ::GRID_PX, ::GRID_PX] for part in (steps, steepest))
    return np.asarray(np.exp(-STEEPNESS * steps / steepest) + np.float32(LEAST_LINK))


def _distance(inside: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5))

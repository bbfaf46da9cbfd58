"""Fit planes of labels: to a map of labels by random samples, to a volume of log-likelihoods by Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from chromaperture.disparity.execution import Execution
from chromaperture.disparity.stages.plane_refining import PointSets
from chromaperture.disparity.stages.planes import NEAR, PlaneCosts
from chromaperture.threads import parallel_map

TRIALS = 80  # of random samples: a plane on a quarter of a tile is missed once in 3.5 tiles; larger tiles see it too
INLIER_LAYERS = 1.5  # half a label's own place, and the slopes that a surface of steps hides; chosen by hand
DRAW_BITS = 16  # of a random number: with the number of a tile's points below 32
LEAST_LEFT = 60  # points in which a plane is looked for; chosen by hand
LEAST_SHARE = 0.12  # of a tile; chosen by hand
SAMPLES_ACROSS = 32  # points of a tile along each side
PLANES_OF_A_TILE = 2
# That blocks choose from, those of large tiles first: a device has room for as many. Of 720 x 480 px 190 are distinct.
MOST_PLANES = 512
DISTINCT_LAYERS = 0.7  # by which planes differ somewhere on their tile; chosen by hand
ROUNDS = 4  # of least squares on the inliers
NEWTON_STEPS = 6

Pixels = tuple[np.ndarray, np.ndarray]  # y and x


class Candidate(NamedTuple):
    """A plane, and where and on how large a square it was found."""

    plane: np.ndarray
    x: float
    y: float
    size_px: float


class Volume(NamedTuple):
    """Log-likelihoods, and what belongs to them.

    Attributes
    ----------
    likelihood : (H, W, N) float32, nats
    labels_px : (N,) float, px
    costs : PlaneCosts; of what one entry of the volume stands for
    run : Execution
    """

    likelihood: np.ndarray
    labels_px: np.ndarray
    costs: PlaneCosts
    run: Execution

    @property
    def step_px(self) -> float:
        """Distance of two labels, px."""
        return float(self.labels_px[1] - self.labels_px[0])


class Planes(NamedTuple):
    """Planes of labels, and which one every pixel lies on.

    Attributes
    ----------
    planes : (K, 3) float64; ``label = a x + b y + c``, px
    choice : (H, W) int
    blocks : Volume or None
        Sums over blocks of pixels of the evidence that chose them.
    trusted : (H, W) bool, or None
        Where the plane is to be taken rather than the surface that it explains; None where no fits voted.
    fits_px : (F, h, w) float, px, or None
        Labels of every block by several fits of planes; None where there was one fit.
    """

    planes: np.ndarray
    choice: np.ndarray
    blocks: Volume | None = None
    trusted: np.ndarray | None = None
    fits_px: np.ndarray | None = None

    @property
    def label_px(self) -> np.ndarray:
        """Return the label of every pixel; (H, W) float32, px."""
        a, b, c = (self.planes[:, i][self.choice] for i in range(3))
        height, width = self.choice.shape
        return (a * np.arange(width) + b * np.arange(height)[:, None] + c).astype(np.float32)


def blocks_of_pixels(shape: tuple[int, ...], blocks: tuple[int, ...], size: int) -> Pixels:
    """Return the row (H,) and the column (W,) of blocks of ``size`` px that rows and columns of pixels are in.

    What is left over at the right and below belongs to the last block.
    """
    rows, columns = (np.minimum(np.arange(n) // size, m - 1) for n, m in zip(shape, blocks, strict=True))
    return rows, columns


def of_pixels(of_blocks: np.ndarray, shape: tuple[int, ...], size: int) -> np.ndarray:
    """Give pixels what their block of ``size`` px has, (h, w) to (H, W), as `blocks_of_pixels`."""
    rows, columns = blocks_of_pixels(shape, of_blocks.shape, size)
    return np.asarray(of_blocks[:, columns][rows])  # whole rows: .28 ms in place of .81 at 720x480


class Proposal(NamedTuple):
    """A plane through points that agree on it, (P,) int each, of a square tile."""

    plane: np.ndarray
    x: np.ndarray
    y: np.ndarray
    size_px: int


def candidates(label_px: np.ndarray, sigma_px: np.ndarray, volume: Volume, tiles_px: tuple[int, ...]) -> np.ndarray:
    """Fit planes to tiles of several sizes, and refine each by the volume.

    Parameters
    ----------
    label_px : (H, W) float, px
        A first surface, without NaN.
    sigma_px : (H, W) float, px
    volume : Volume
    tiles_px : tuple of int

    Returns
    -------
    (K, 3) float64
    """
    found = proposals(label_px, sigma_px, volume.step_px, tiles_px, run=volume.run)
    starts = np.array([part.plane for part in found]).reshape(-1, 1, 3)
    planes, _ = best_planes(starts, [(part.y, part.x) for part in found], volume)
    return distinct_of(found, planes, volume.step_px)


def proposals(
    label_px: np.ndarray, sigma_px: np.ndarray, step_px: float, tiles_px: tuple[int, ...], *, run: Execution
) -> list[Proposal]:
    """Fit planes to tiles of a first surface; see `candidates`."""
    weight = 1 / (np.square(sigma_px, dtype=float) + (step_px / 2) ** 2)
    tiles = tiles_of(label_px.shape, tiles_px)

    def of_tile(i: int) -> list[Proposal]:
        y, x = tiles[i].points
        return [
            Proposal(plane, x[inliers], y[inliers], tiles[i].size_px)
            for inliers, plane in _planes_of_points(x, y, label_px[y, x], weight[y, x], step_px, draws_of(i), run)
        ]

    return [proposal for part in parallel_map(of_tile, range(len(tiles))) for proposal in part]


class Tile(NamedTuple):
    """Points on a grid over a square: every so manyth of so many rows and columns."""

    size_px: int
    top: int
    left: int
    rows: int
    columns: int
    every: int

    @property
    def points(self) -> Pixels:
        """Row after row; (P,) int each."""
        y, x = np.mgrid[: self.rows, : self.columns] * self.every
        return (self.top + y).ravel(), (self.left + x).ravel()


def tiles_of(shape: tuple[int, int], tiles_px: tuple[int, ...]) -> list[Tile]:
    """Return the squares of several sizes that cover a picture."""
    height, width = shape
    out = []
    for size in tiles_px:
        every = max(1, size // SAMPLES_ACROSS)
        for top in range(0, max(1, height - size // 2), size):
            for left in range(0, max(1, width - size // 2), size):
                rows, columns = (-(-min(n - start, size) // every) for n, start in ((height, top), (width, left)))
                out.append(Tile(size, top, left, rows, columns, every))
    return out


def draws_of(tile: int) -> np.ndarray:
    """Return the random numbers of a tile, of which `drawn` makes points; (PLANES_OF_A_TILE, TRIALS, 3) uint32."""
    rng = np.random.default_rng(tile)
    return rng.integers(0, 1 << DRAW_BITS, (PLANES_OF_A_TILE, TRIALS, 3)).astype(np.uint32)


def drawn(draws: np.ndarray, count: int) -> np.ndarray:
    """Return points of so many: random numbers that do not depend on the picture are the same on every device."""
    return draws.astype(np.int64) * count >> DRAW_BITS


def distinct_of(found: list[Proposal], planes: Sequence[np.ndarray] | np.ndarray, step_px: float) -> np.ndarray:
    """Drop refined planes that agree with one of a larger tile; (K, 3)."""
    each = [
        Candidate(plane, part.x.mean(), part.y.mean(), part.size_px) for plane, part in zip(planes, found, strict=True)
    ]
    return distinct(each, DISTINCT_LAYERS * step_px)[:MOST_PLANES]


def distinct(found: list[Candidate], tolerance_px: float) -> np.ndarray:
    """Drop planes that agree with a larger one all over the square on which they were found; (K, 3)."""
    kept = np.empty((len(found), 3))
    count = 0
    for plane, x, y, size in sorted(found, key=lambda c: -c.size_px):
        corners = np.array([[x + i * size / 2, y + j * size / 2, 1] for i in (-1, 1) for j in (-1, 1)] + [[x, y, 1]])
        gaps = np.abs((plane - kept[:count]) @ corners.T).max(axis=1)
        if (gaps > tolerance_px).all():
            kept[count] = plane
            count += 1
    return kept[:count]


def _planes_of_points(
    x: np.ndarray,
    y: np.ndarray,
    label: np.ndarray,
    weight: np.ndarray,
    step_px: float,
    draws: np.ndarray,
    run: Execution,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Find the planes of points that most agree on, each with the places of its points."""
    out = []
    left = np.arange(len(x))
    for of_plane in draws:
        if len(left) < max(LEAST_LEFT, LEAST_SHARE * len(x)):
            break
        places = x[left], y[left], label[left], weight[left]
        tolerance = INLIER_LAYERS * step_px
        plane = run.agreed_plane(drawn(of_plane, len(left)), *places, tolerance_px=tolerance, rounds=ROUNDS)
        if not np.isfinite(plane[2]):
            break
        near = np.abs(_at(plane, *places[:2]) - places[2]) < NEAR * INLIER_LAYERS * step_px
        if near.sum() >= LEAST_SHARE * len(x):
            out.append((left[near], plane))
        left = left[~near]
    return out


def _at(plane: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(plane[0] * x + plane[1] * y + plane[2])


def best_planes(
    starts: np.ndarray, sets: Sequence[Pixels], volume: Volume, *, steps: int = NEWTON_STEPS, even: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Move planes to the most likely places near them; see `stages.best_planes`.

    Parameters
    ----------
    starts : (S, M, 3) float
        Planes from which every set starts.
    sets : sequence of (y, x)
        Points, (P,) int each.
    volume : Volume
    steps : int
    even : bool

    Returns
    -------
    planes : (S, 3) float64
    values : (S,) float64, nats
    """
    if not len(sets):
        return np.empty((0, 3)), np.empty(0)
    return volume.run.best_planes(
        volume.likelihood, PointSets.of(sets), starts, volume.labels_px, volume.costs, steps=steps, even=even
    )

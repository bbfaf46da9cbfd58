"""Propose planes of labels: fitted to tiles of a first surface by random samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.matching.execution import Execution
from chromaperture.matching.readable.planes import NEAR
from chromaperture.system.threads import parallel_map

TRIALS = 80  # of random samples: a plane on a quarter of a tile is missed once in 3.5 tiles; larger tiles see it too
INLIER_LABELS = 1.5  # half a label's own place, and the slopes that a surface of steps hides; chosen by hand
DRAW_BITS = 16  # of a random number: with the number of a tile's points below 32
LEAST_LEFT = 16  # points in which a plane is looked for; chosen by hand
LEAST_SHARE = 0.12  # of a tile; chosen by hand
SAMPLES_ACROSS = 32  # points of a tile along each side
PLANES_OF_A_TILE = 2
MOST_PLANES = 512  # that blocks choose from, those of large tiles first; of 720 x 480 px 190 are distinct
DISTINCT_LABELS = 0.7  # by which planes differ somewhere on their tile; chosen by hand
ROUNDS = 4  # of least squares on the inliers

Points = tuple[np.ndarray, np.ndarray]  # y and x


class Proposal(NamedTuple):
    """A plane of a square tile, and the middle of the points that agree on it."""

    plane: np.ndarray
    x: float
    y: float
    size: int


def plane_proposals(label: np.ndarray, sigma: np.ndarray, sizes: tuple[int, ...], *, run: Execution) -> np.ndarray:
    """Fit planes to tiles of several sizes of a first surface, without those that agree with one of a larger tile.

    ``label``, ``sigma`` (h, w) float, labels of blocks: without NaN, and its standard deviation; ``sizes``: blocks.
    Returns (K, 3) float64: ``label = a x + b y + c``.
    """
    weight = 1 / (np.square(sigma, dtype=float) + 0.5**2)
    tiles = tiles_of(label.shape, sizes)

    def of_tile(i: int) -> list[Proposal]:
        y, x = tiles[i].points
        return [
            Proposal(plane, x[inliers].mean(), y[inliers].mean(), tiles[i].size)
            for inliers, plane in _planes_of_points(x, y, label[y, x], weight[y, x], draws_of(i), run)
        ]

    return distinct([proposal for part in parallel_map(of_tile, range(len(tiles))) for proposal in part])[:MOST_PLANES]


class Tile(NamedTuple):
    """Blocks on a grid over a square: every so manyth of so many rows and columns."""

    size: int
    top: int
    left: int
    rows: int
    columns: int
    every: int

    @property
    def points(self) -> Points:
        """Row after row; (P,) int each."""
        y, x = np.mgrid[: self.rows, : self.columns] * self.every
        return (self.top + y).ravel(), (self.left + x).ravel()


def tiles_of(shape: tuple[int, int], sizes: tuple[int, ...]) -> list[Tile]:
    """Return the squares of several sizes, in blocks, that cover a picture."""
    height, width = shape
    out = []
    for size in sizes:
        every = -(-size // SAMPLES_ACROSS)
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


def distinct(found: list[Proposal]) -> np.ndarray:
    """Drop planes that agree with a larger one all over the square on which they were found; (K, 3)."""
    kept = np.empty((len(found), 3))
    count = 0
    for plane, x, y, size in sorted(found, key=lambda proposal: -proposal.size):
        corners = np.array([[x + i * size / 2, y + j * size / 2, 1] for i in (-1, 1) for j in (-1, 1)] + [[x, y, 1]])
        gaps = np.abs((plane - kept[:count]) @ corners.T).max(axis=1)
        if (gaps > DISTINCT_LABELS).all():
            kept[count] = plane
            count += 1
    return kept[:count]


def _planes_of_points(
    x: np.ndarray, y: np.ndarray, label: np.ndarray, weight: np.ndarray, draws: np.ndarray, run: Execution
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Find the planes of points that most agree on, each with the places of its points."""
    out = []
    left = np.arange(len(x))
    for of_plane in draws:
        if len(left) < max(LEAST_LEFT, LEAST_SHARE * len(x)):
            break
        places = x[left], y[left], label[left], weight[left]
        tolerance = INLIER_LABELS
        plane = run.agreed_plane(drawn(of_plane, len(left)), *places, tolerance_px=tolerance, rounds=ROUNDS)
        if not np.isfinite(plane[2]):
            break
        near = np.abs(_at(plane, *places[:2]) - places[2]) < NEAR * INLIER_LABELS
        if near.sum() >= LEAST_SHARE * len(x):
            out.append((left[near], plane))
        left = left[~near]
    return out


def _at(plane: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(plane[0] * x + plane[1] * y + plane[2])

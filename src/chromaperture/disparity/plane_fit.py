"""Fit planes of labels: to a map of labels by random samples, to a volume of log-likelihoods by Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from chromaperture.disparity.execution import Execution
from chromaperture.disparity.stages.planes import NEAR, PlaneCosts
from chromaperture.threads import parallel_map

TRIALS = 80  # of random samples: a plane on a quarter of a tile is missed once in 3.5 tiles; larger tiles see it too
INLIER_LAYERS = 1.5  # half a label's own place, and the slopes that a surface of steps hides; chosen by hand
LEAST_SHARE = 0.12  # of a tile; chosen by hand
SAMPLES_ACROSS = 32  # points of a tile along each side
PLANES_OF_A_TILE = 2
REACH = 2  # labels to either side in a difference of log-likelihoods
MOST_POINTS = 4000  # of a fit; more change a plane by less than its standard deviation
_ROUNDS = 4  # of least squares on the inliers
NEWTON_STEPS = 6
SHORTENED = (1.0, 0.5, 0.25)
CONDITION = 1e-3  # of the largest eigenvalue: directions that the evidence says nothing of move little
GAINED = 1e-5  # share of the value below which another step is not worth it


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
    planes = parallel_map(lambda i: refined(found[i].plane, found[i].x, found[i].y, volume), range(len(found)))
    return distinct_of(found, planes, volume.step_px)


def proposals(
    label_px: np.ndarray, sigma_px: np.ndarray, step_px: float, tiles_px: tuple[int, ...], *, run: Execution
) -> list[Proposal]:
    """Fit planes to tiles of a first surface; see `candidates`."""
    height, width = label_px.shape
    weight = 1 / (np.square(sigma_px, dtype=float) + (step_px / 2) ** 2)
    tiles = [
        (size, top, left)
        for size in tiles_px
        for top in range(0, max(1, height - size // 2), size)
        for left in range(0, max(1, width - size // 2), size)
    ]

    def of_tile(i: int) -> list[Proposal]:
        size, top, left = tiles[i]
        every = max(1, size // SAMPLES_ACROSS)
        y, x = (
            a.ravel() for a in np.mgrid[top : min(height, top + size) : every, left : min(width, left + size) : every]
        )
        rng = np.random.default_rng(i)
        return [
            Proposal(plane, x[inliers], y[inliers], size)
            for inliers, plane in _planes_of_points(x, y, label_px[y, x], weight[y, x], step_px, rng, run)
        ]

    return [proposal for part in parallel_map(of_tile, range(len(tiles))) for proposal in part]


def distinct_of(found: list[Proposal], planes: Sequence[np.ndarray], step_px: float) -> np.ndarray:
    """Drop refined planes that agree with one of a larger tile; (K, 3)."""
    each = [
        Candidate(plane, part.x.mean(), part.y.mean(), part.size_px) for plane, part in zip(planes, found, strict=True)
    ]
    return distinct(each, 0.7 * step_px)


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
    rng: np.random.Generator,
    run: Execution,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Find the planes of points that most agree on, each with the places of its points."""
    out = []
    left = np.arange(len(x))
    for _ in range(PLANES_OF_A_TILE):
        if len(left) < max(60, LEAST_SHARE * len(x)):
            break
        plane = _consensus(x[left], y[left], label[left], weight[left], INLIER_LAYERS * step_px, rng, run)
        if plane is None:
            break
        near = np.abs(_at(plane, x[left], y[left]) - label[left]) < NEAR * INLIER_LAYERS * step_px
        if near.sum() >= LEAST_SHARE * len(x):
            out.append((left[near], plane))
        left = left[~near]
    return out


def _consensus(
    x: np.ndarray,
    y: np.ndarray,
    label: np.ndarray,
    weight: np.ndarray,
    tolerance_px: float,
    rng: np.random.Generator,
    run: Execution,
) -> np.ndarray | None:
    """Return the plane through three random points that most points agree with, fitted to these; None without."""
    picked = rng.integers(0, len(x), (TRIALS, 3))
    corners = np.stack([x[picked], y[picked], np.ones(picked.shape)], axis=-1)
    picked, corners = (part[np.abs(np.linalg.det(corners)) > 50] for part in (picked, corners))  # 25 px^2: no sliver
    if not len(picked):
        return None
    planes = np.linalg.solve(corners, label[picked][..., None].astype(float))[..., 0]
    plane = run.agreed_plane(planes, x, y, label, weight, tolerance_px=tolerance_px, rounds=_ROUNDS)
    return plane if np.isfinite(plane).all() else None


def _at(plane: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(plane[0] * x + plane[1] * y + plane[2])


def spread(count: int) -> slice:
    """Pick at most `MOST_POINTS` of so many points, evenly."""
    return slice(None, None, max(1, -(-count // MOST_POINTS)))


def log_likelihood(plane: np.ndarray, x: np.ndarray, y: np.ndarray, volume: Volume) -> float:
    """Sum the log-likelihood of a plane over points, less what it costs besides; nats."""
    likelihood, labels_px, costs, _ = volume
    place = (_at(plane, x, y) - labels_px[0]) / volume.step_px
    below = np.clip(place.astype(np.intp), 0, len(labels_px) - 2)
    t = place - below
    value = (1 - t) * likelihood[y, x, below] + t * likelihood[y, x, below + 1]
    inside = (place >= 0) & (place <= len(labels_px) - 1)
    return float(np.where(inside, value, -costs.outside).sum()) - _slope_cost(plane, len(x), volume)


def refined(
    plane: np.ndarray, x: np.ndarray, y: np.ndarray, volume: Volume, *, steps: int = NEWTON_STEPS, even: bool = False
) -> np.ndarray:
    """Move a plane to the most likely place near it, by Newton's method with shortened steps.

    Parameters
    ----------
    plane : (3,) float
    x, y : (P,) int
        Its points.
    volume : Volume
    steps : int
    even : bool
        Keep its slope.

    Returns
    -------
    (3,) float64
    """
    few = spread(len(x))
    x, y = x[few], y[few]
    centred = np.array([[1, 0, 0], [0, 1, 0], [-x.mean(), -y.mean(), 1]])  # (a, b, c) of a plane about the middle
    slope_bend = volume.costs.slope * len(x) / volume.step_px**2
    plane = np.asarray(plane, float)

    def value_of(trial: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        sums = volume.run.plane_sums(volume.likelihood, x, y, trial, volume.labels_px, reach=REACH)
        return sums.value - _slope_cost(trial, len(x), volume), sums.gradient, sums.hessian

    value, gradient, hessian = value_of(plane)
    for _ in range(steps):
        uphill = centred.T @ gradient - slope_bend * np.array([plane[0], plane[1], 0])
        bend = slope_bend * np.diag([1.0, 1.0, 0.0]) - centred.T @ hessian @ centred
        if even:
            uphill[:2], bend[:2, 2], bend[2, :2], bend[:2, :2] = 0, 0, 0, np.eye(2)
        size, axes = np.linalg.eigh(bend)
        size = np.maximum(size, CONDITION * max(size[-1], 1e-9)) if not even else np.maximum(size, 1e-9)
        move = centred @ (axes @ ((axes.T @ uphill) / size))
        before = value
        for shorter in SHORTENED:
            trial = value_of(plane + shorter * move)
            if trial[0] > value:
                plane, (value, gradient, hessian) = plane + shorter * move, trial
                break
        if value - before <= GAINED * abs(value):
            break
    return plane


def _slope_cost(plane: np.ndarray, points: int, volume: Volume) -> float:
    return volume.costs.slope / 2 * points * float(plane[0] ** 2 + plane[1] ** 2) / volume.step_px**2

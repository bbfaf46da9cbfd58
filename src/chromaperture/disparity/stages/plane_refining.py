"""Most likely planes near given ones, in plain NumPy: the oracle of ``cpu/plane_refining.py``.

Newton's method with shortened steps on the sum of log-likelihoods over a set of points. Derivatives are differences
over `REACH` labels to either side, which smooths the noise of a single label's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from chromaperture.disparity.stages.planes import PlaneCosts

REACH = 2  # labels to either side in a difference of log-likelihoods
MOST_POINTS = 4000  # of a fit; more change a plane by less than its standard deviation
SHORTENED = (1.0, 0.5, 0.25)
CONDITION = 1e-3  # of the largest eigenvalue: directions that the evidence says nothing of move little
GAINED = 1e-5  # share of the value below which another step is not worth it
LEAST_BEND = 1e-9  # second derivative, nats a label^2 and px^2: none at all


class PointSets(NamedTuple):
    """Sets of points, one after the other.

    Attributes
    ----------
    x, y : (P,) int64
    starts : (S + 1,) int64
        Where each set starts, and where the last one ends.
    """

    x: np.ndarray
    y: np.ndarray
    starts: np.ndarray

    @classmethod
    def of(cls, sets: Sequence[tuple[np.ndarray, np.ndarray]]) -> PointSets:
        """Join sets of points, y and x each."""
        y, x = (np.concatenate([part[i] for part in sets]).astype(np.int64, copy=False) for i in (0, 1))
        return cls(x, y, np.cumsum([0, *(len(part[0]) for part in sets)], dtype=np.int64))


class PlaneSums(NamedTuple):
    """Log-likelihood of a plane over points, and its derivatives by (a, b, c)."""

    value: float
    gradient: np.ndarray  # (3,)
    hessian: np.ndarray  # (3, 3)


def best_planes(
    likelihood: np.ndarray,
    points: PointSets,
    planes: np.ndarray,
    labels_px: np.ndarray,
    costs: PlaneCosts,
    *,
    steps: int,
    even: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Move planes to the most likely places near them, and return the best of every set of points.

    Parameters
    ----------
    likelihood : (H, W, N) float, nats
    points : PointSets
    planes : (S, M, 3) float
        From which each set starts: its best comes of one of them.
    labels_px : (N,) float, px
    costs : PlaneCosts
    steps : int
        At most this many.
    even : bool
        Keep slopes.

    Returns
    -------
    planes : (S, 3) float64
    values : (S,) float64, nats
        Log-likelihoods over all points, less what the planes cost besides.
    """
    out, values = np.empty((len(planes), 3)), np.empty(len(planes))
    for i, (first, last) in enumerate(zip(points.starts, points.starts[1:], strict=False)):
        x, y = points.x[first:last], points.y[first:last]
        each = [_refined(plane, x, y, likelihood, labels_px, costs, steps, even) for plane in planes[i]]
        found = [_log_likelihood(plane, x, y, likelihood, labels_px, costs) for plane in each]
        best = int(np.argmax(found))
        out[i], values[i] = each[best], found[best]
    return out, values


def _refined(
    plane: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    likelihood: np.ndarray,
    labels_px: np.ndarray,
    costs: PlaneCosts,
    steps: int,
    even: bool,
) -> np.ndarray:
    few = slice(None, None, max(1, -(-len(x) // MOST_POINTS)))
    x, y = x[few], y[few]
    centred = np.array([[1, 0, 0], [0, 1, 0], [-x.mean(), -y.mean(), 1]])  # (a, b, c) of a plane about the middle
    slope_bend = costs.slope * len(x) / (labels_px[1] - labels_px[0]) ** 2
    plane = np.asarray(plane, float)

    def value_of(trial: np.ndarray) -> PlaneSums:
        sums = plane_sums(likelihood, x, y, trial, labels_px)
        return sums._replace(value=sums.value - _slope_cost(trial, len(x), labels_px, costs))

    value, gradient, hessian = value_of(plane)
    for _ in range(steps):
        uphill = centred.T @ gradient - slope_bend * np.array([plane[0], plane[1], 0])
        bend = slope_bend * np.diag([1.0, 1.0, 0.0]) - centred.T @ hessian @ centred
        if even:
            move = np.array([0, 0, uphill[2] / max(bend[2, 2], LEAST_BEND)])
        else:
            size, axes = np.linalg.eigh(bend)
            move = centred @ (axes @ ((axes.T @ uphill) / np.maximum(size, CONDITION * max(size[-1], LEAST_BEND))))
        before = value
        for shorter in SHORTENED:
            trial = value_of(plane + shorter * move)
            if trial.value > value:
                plane, (value, gradient, hessian) = plane + shorter * move, trial
                break
        if value - before <= GAINED * abs(value):
            break
    return plane


def plane_sums(
    likelihood: np.ndarray, x: np.ndarray, y: np.ndarray, plane: np.ndarray, labels_px: np.ndarray
) -> PlaneSums:
    """Sum the log-likelihood of a plane and its derivatives over points.

    Points whose label lies closer to an end of the range than `REACH` labels count nothing.

    Parameters
    ----------
    likelihood : (H, W, N) float, nats a pixel
    x, y : (P,) int
    plane : (3,) float
    labels_px : (N,) float, px
    """
    step = float(labels_px[1] - labels_px[0])
    place = (plane[0] * x + plane[1] * y + plane[2] - labels_px[0]) / step
    inside = (place >= REACH) & (place < likelihood.shape[2] - 1 - REACH)
    x, y, place = x[inside], y[inside], place[inside]
    below = np.floor(place).astype(np.intp)
    t = place - below
    before, here, after = (
        (1 - t) * likelihood[y, x, below + o] + t * likelihood[y, x, below + o + 1] for o in (-REACH, 0, REACH)
    )
    first, second = (after - before) / (2 * REACH * step), (after + before - 2 * here) / (REACH * step) ** 2
    terms = np.stack([x, y, np.ones_like(x)]).astype(float)
    return PlaneSums(float(here.sum()), terms @ first, (terms * second) @ terms.T)


def _log_likelihood(
    plane: np.ndarray, x: np.ndarray, y: np.ndarray, likelihood: np.ndarray, labels_px: np.ndarray, costs: PlaneCosts
) -> float:
    """Sum the log-likelihood of a plane over points, less what it costs besides; nats."""
    place = (plane[0] * x + plane[1] * y + plane[2] - labels_px[0]) / (labels_px[1] - labels_px[0])
    below = np.clip(place.astype(np.intp), 0, len(labels_px) - 2)
    t = place - below
    value = (1 - t) * likelihood[y, x, below] + t * likelihood[y, x, below + 1]
    inside = (place >= 0) & (place <= len(labels_px) - 1)
    return float(np.where(inside, value, -costs.outside).sum()) - _slope_cost(plane, len(x), labels_px, costs)


def _slope_cost(plane: np.ndarray, points: int, labels_px: np.ndarray, costs: PlaneCosts) -> float:
    return costs.slope / 2 * points * float(plane[0] ** 2 + plane[1] ** 2) / float(labels_px[1] - labels_px[0]) ** 2

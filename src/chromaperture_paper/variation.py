"""Total variation by the first-order primal-dual algorithm, in plain NumPy.

The oracle of ``compiled/variation.py``. Minimises over ``lo <= u <= hi`` the energy ::

    sum |(ex du/dx, ey du/dy)|_h  +  fidelity * sum w * |u - f|        data_term "absolute" (Huber-L1)
    sum |(ex du/dx, ey du/dy)|_h  +  fidelity / 2 * sum w * (u - f)^2   data_term "quadratic" (Huber-ROF)

with the Huber norm ``|g|_h = g^2 / (2 h)`` up to ``h`` and ``|g| - h / 2`` beyond. ``w`` = 0 inpaints a pixel, and the
edge weights ``ex``, ``ey`` in [0, 1] let the map break where the picture does.

References
----------
A. Chambolle, T. Pock: A first-order primal-dual algorithm for convex problems with applications to imaging.
J. Math. Imaging Vis. 40, 2011. doi:10.1007/s10851-010-0251-1 (the paper's reference [6])
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

OPERATOR_NORM_SQUARED = 8.0  # of the forward-difference gradient; edge weights up to 1 do not raise it


@dataclass(frozen=True)
class Problem:
    """One convex problem, checked and without NaN."""

    target: np.ndarray  # (H, W) float32; f, inside the bounds
    weight: np.ndarray  # (H, W) float32; fidelity * w >= 0
    edges: np.ndarray | None  # (2, H, W) float32 or None; ex and ey of the links to the right and downwards, in [0, 1]
    bounds: tuple[float, float]  # (float, float); lo and hi
    huber: float  # float; h, in the unit of u a px
    quadratic: bool


@dataclass
class State:
    """State of the iteration: changed in place."""

    # ``u``, ``extrapolated``: (H, W) float32.
    u: np.ndarray
    extrapolated: np.ndarray
    dual: np.ndarray  # (2, H, W) float32

    @classmethod
    def start(cls, u: np.ndarray) -> State:
        """Begin at ``u`` with a dual of zero."""
        return cls(u.copy(), u.copy(), np.zeros((2, *u.shape), u.dtype))


class Steps(NamedTuple):
    """Step sizes of successive iterations; (N,) float64 each."""

    primal: np.ndarray
    dual: np.ndarray
    extrapolation: np.ndarray


def edge_weights(guide: np.ndarray, *, edge_range: float, floor: float = 0.05) -> np.ndarray:
    """Weights of the links to the right and downwards: 1 on an even guide, ``floor`` across its edges.

    ``guide`` (H, W) float; ``edge_range``: guide difference at which the weight has fallen to 1/e, in the guide's unit.
    Returns (2, H, W) float32: the last column and the last row have no link and hold 1.
    """
    edges = np.ones((2, *guide.shape), np.float32)
    edges[0, :, :-1] = floor + (1 - floor) * np.exp(-np.abs(np.diff(guide, axis=1)) / edge_range)
    edges[1, :-1] = floor + (1 - floor) * np.exp(-np.abs(np.diff(guide, axis=0)) / edge_range)
    return edges


def step_sizes(iterations: int, *, primal_step: float, strong_convexity: float = 0.0) -> Steps:
    """Return the steps of every iteration; a strongly convex data term makes them converge as O(1/N^2)."""
    primal = np.full(iterations, float(primal_step))
    extrapolation = np.ones(iterations)
    if strong_convexity > 0:
        for n in range(iterations):
            extrapolation[n] = 1 / math.sqrt(1 + 2 * strong_convexity * primal[n])
            if n + 1 < iterations:
                primal[n + 1] = extrapolation[n] * primal[n]
    return Steps(primal, 1 / (OPERATOR_NORM_SQUARED * primal), extrapolation)


def gradient(u: np.ndarray) -> np.ndarray:
    """Forward differences, 0 in the last column and row; (2, H, W)."""
    g = np.zeros((2, *u.shape), u.dtype)
    g[0, :, :-1] = np.diff(u, axis=1)
    g[1, :-1] = np.diff(u, axis=0)
    return g


def divergence(p: np.ndarray) -> np.ndarray:
    """Minus the adjoint of `gradient`; (H, W)."""
    out = np.zeros(p.shape[1:], p.dtype)
    out[:, :-1] += p[0, :, :-1]
    out[:, 1:] -= p[0, :, :-1]
    out[:-1] += p[1, :-1]
    out[1:] -= p[1, :-1]
    return out


def iterate(problem: Problem, state: State, steps: Steps) -> None:
    """Run the primal-dual iterations on ``state``, in plain NumPy: the oracle of ``compiled/variation.py``."""
    f, lo, hi = problem.target, *problem.bounds
    for tau, sigma, theta in zip(*(s.astype(f.dtype) for s in steps), strict=True):
        p = state.dual + sigma * _weighted(gradient(state.extrapolated), problem.edges)
        p /= 1 + sigma * f.dtype.type(problem.huber)
        p /= np.maximum(1, np.sqrt(p[0] ** 2 + p[1] ** 2))
        v = state.u + tau * divergence(_weighted(p, problem.edges))
        pull = tau * problem.weight
        u = (v + pull * f) / (1 + pull) if problem.quadratic else v - np.clip(v - f, -pull, pull)
        u = np.clip(u, lo, hi)
        state.extrapolated = u + theta * (u - state.u)
        state.u, state.dual = u, p


def _weighted(field: np.ndarray, edges: np.ndarray | None) -> np.ndarray:
    return field if edges is None else field * edges


def energy(problem: Problem, u: np.ndarray) -> float:
    """Energy of a map, summed in float64."""
    u = u.astype(np.float64)
    g = _weighted(gradient(u), problem.edges)
    norm = np.sqrt(g[0] ** 2 + g[1] ** 2)
    h = problem.huber
    prior = np.where(norm <= h, norm**2 / (2 * h), norm - h / 2) if h > 0 else norm
    away = u - problem.target
    data = problem.weight * (away**2 / 2 if problem.quadratic else np.abs(away))
    return float(prior.sum() + data.sum())


def dual_energy(problem: Problem, dual: np.ndarray) -> float:
    """Lower bound of the energy of every map inside the bounds that a dual field proves, summed in float64.

    ``D(p) = -(h / 2) sum |p|^2 - sum G*(q)`` with ``q = div p``. The conjugate G* of the data term is finite
    because of the bounds; a piecewise linear or quadratic function is greatest where it is evaluated here.
    """
    p = dual.astype(np.float64)
    q = divergence(_weighted(p, problem.edges))
    f, w, (lo, hi) = problem.target.astype(np.float64), problem.weight.astype(np.float64), problem.bounds
    if problem.quadratic:
        best = np.where(w > 0, np.clip(f + q / np.where(w > 0, w, 1), lo, hi), np.where(q > 0, hi, lo))
        conjugate = q * best - w / 2 * (best - f) ** 2
    else:
        conjugate = np.maximum(np.maximum(q * lo - w * (f - lo), q * f), q * hi - w * (hi - f))
    return float(-problem.huber / 2 * (p**2).sum() - conjugate.sum())


def gap_per_px(problem: Problem, state: State) -> float:
    """Primal-dual gap per pixel: how far the energy can be above the least one; >= 0 up to rounding."""
    return (energy(problem, state.u) - dual_energy(problem, state.dual)) / state.u.size

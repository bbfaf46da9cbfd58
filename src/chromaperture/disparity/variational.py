"""Total variation on a disparity map: the first-order primal-dual algorithm (the paper's reference [6]).

Minimises over ``lo <= u <= hi`` the energy ::

    sum |(ex du/dx, ey du/dy)|_h  +  fidelity * sum w * |u - f|        data_term "absolute" (Huber-L1)
    sum |(ex du/dx, ey du/dy)|_h  +  fidelity / 2 * sum w * (u - f)^2   data_term "quadratic" (Huber-ROF)

with the Huber norm ``|g|_h = g^2 / (2 h)`` up to ``h`` and ``|g| - h / 2`` beyond. ``w`` = 0 inpaints a
pixel, and the edge weights ``ex``, ``ey`` in [0, 1] let the map break where the picture does. Regularise
disparity, which is affine in inverse depth, never depth itself.

References
----------
A. Chambolle, T. Pock: A first-order primal-dual algorithm for convex problems with applications to imaging.
J. Math. Imaging Vis. 40, 2011. doi:10.1007/s10851-010-0251-1
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np

from chromaperture.errors import InputError

DataTerm = Literal["absolute", "quadratic"]
OPERATOR_NORM_SQUARED = 8.0  # of the forward-difference gradient; edge weights up to 1 do not raise it
CHECK_EVERY = 25


class Smoothed(NamedTuple):
    """A regularised disparity map and how far it is from the optimum.

    Attributes
    ----------
    disparity_px : (H, W) float32, px; known everywhere, holes are inpainted.
    gap_per_px : float; upper bound of (energy - least possible energy) / (H W).
    iterations : int
    """

    disparity_px: np.ndarray
    gap_per_px: float
    iterations: int


@dataclass(frozen=True)
class Problem:
    """One convex problem, checked and without NaN.

    Attributes
    ----------
    target : (H, W) float32; f, inside the bounds.
    weight : (H, W) float32; fidelity * w >= 0.
    edges : (2, H, W) float32 or None; ex and ey of the links to the right and downwards, in [0, 1].
    bounds : (float, float); lo and hi.
    huber : float; h, in the unit of u a px.
    quadratic : bool
    """

    target: np.ndarray
    weight: np.ndarray
    edges: np.ndarray | None
    bounds: tuple[float, float]
    huber: float
    quadratic: bool


@dataclass
class State:
    """Where the iteration stands: changed in place.

    Attributes
    ----------
    u, extrapolated : (H, W) float32
    dual : (2, H, W) float32
    """

    u: np.ndarray
    extrapolated: np.ndarray
    dual: np.ndarray

    @classmethod
    def start(cls, u: np.ndarray) -> State:
        """Begin at ``u`` with a dual of zero."""
        return cls(u.copy(), u.copy(), np.zeros((2, *u.shape), u.dtype))


class Steps(NamedTuple):
    """Step sizes of successive iterations; (N,) float64 each."""

    primal: np.ndarray
    dual: np.ndarray
    extrapolation: np.ndarray


Solver = Callable[[Problem, State, Steps], None]


def smooth_disparity(
    disparity_px: np.ndarray,
    weights: np.ndarray | None = None,
    *,
    edges: np.ndarray | None = None,
    bounds_px: tuple[float, float] | None = None,
    data_term: DataTerm = "absolute",
    fidelity: float = 1.0,
    huber_px: float = 0.02,
    iterations: int = 300,
    tolerance: float = 0.0,
    primal_step: float = 1 / math.sqrt(OPERATOR_NORM_SQUARED),
    backend: Literal["numba", "reference"] = "numba",
) -> Smoothed:
    """Regularise a disparity map by its total variation.

    Parameters
    ----------
    disparity_px : (H, W) float, px
        NaN is unknown and is filled in.
    weights : (H, W) float, optional
        Confidence >= 0 of each pixel; NaN counts as 0. All 1 when absent.
    edges : (2, H, W) float, optional
        Weights in [0, 1] of the links to the right and downwards, see `edge_weights`.
    bounds_px : (float, float), optional
        Range of the result; the range of the known values when absent.
    data_term : {"absolute", "quadratic"}
        The first is unmoved by outliers, the second fits Gaussian errors.
    fidelity : float
        Per px ("absolute") or per px^2 ("quadratic"), against a total variation of weight 1.
    huber_px : float
        Slopes below are smoothed, not flattened into steps, px per px.
    iterations : int
        The most iterations.
    tolerance : float
        Stop when the primal-dual gap per pixel falls below; 0 runs all iterations.
    primal_step : float
        Affects the speed of convergence, not the result.
    backend : {"numba", "reference"}

    Returns
    -------
    Smoothed

    Raises
    ------
    InputError
        Shapes differ, nothing is known, or a parameter is out of range.
    """
    if not (fidelity > 0 and huber_px >= 0 and iterations >= 1 and primal_step > 0):
        raise InputError("fidelity and primal_step must be positive, huber_px >= 0 and iterations >= 1")
    problem = make_problem(
        disparity_px,
        weights,
        edges,
        bounds_px=bounds_px,
        fidelity=fidelity,
        huber=huber_px,
        data_term=data_term,
    )
    solve, gap = _backend(backend)
    # The quadratic term is strongly convex only where every pixel has a weight.
    convexity = float(problem.weight.min()) if problem.quadratic else 0.0
    steps = step_sizes(iterations, primal_step=primal_step, strong_convexity=convexity)
    state = State.start(problem.target)
    chunk = CHECK_EVERY if tolerance > 0 else iterations
    done = 0
    distance = math.inf
    while done < iterations and distance > tolerance:
        until = min(done + chunk, iterations)
        solve(problem, state, Steps(*(s[done:until] for s in steps)))
        done = until
        distance = gap(problem, state)
    return Smoothed(state.u, distance, done)


def edge_weights(guide: np.ndarray, *, edge_range: float, floor: float = 0.05) -> np.ndarray:
    """Weights of the links to the right and downwards: 1 on an even guide, ``floor`` across its edges.

    Parameters
    ----------
    guide : (H, W) float
    edge_range : float
        Guide difference at which the weight has fallen to 1/e, in the guide's unit.
    floor : float

    Returns
    -------
    (2, H, W) float32
        The last column and the last row have no link and hold 1.
    """
    edges = np.ones((2, *guide.shape), np.float32)
    edges[0, :, :-1] = floor + (1 - floor) * np.exp(-np.abs(np.diff(guide, axis=1)) / edge_range)
    edges[1, :-1] = floor + (1 - floor) * np.exp(-np.abs(np.diff(guide, axis=0)) / edge_range)
    return edges


def make_problem(
    disparity_px: np.ndarray,
    weights: np.ndarray | None,
    edges: np.ndarray | None,
    *,
    bounds_px: tuple[float, float] | None,
    fidelity: float,
    huber: float,
    data_term: DataTerm,
) -> Problem:
    """Check a map and its weights, and replace the unknown; raises InputError."""
    target = np.array(disparity_px, np.float32)  # a copy
    if target.ndim != 2 or min(target.shape) < 2:
        raise InputError(f"expected a disparity map of shape (height, width), got {target.shape}")
    if weights is not None and np.shape(weights) != target.shape:
        raise InputError(f"weights must have the map's shape {target.shape}, got {np.shape(weights)}")
    if edges is not None and np.shape(edges) != (2, *target.shape):
        raise InputError(f"edge weights must have shape {(2, *target.shape)}, got {np.shape(edges)}")
    unknown = ~np.isfinite(target)
    weight = np.full(target.shape, fidelity, np.float32)
    if weights is not None:
        weight *= np.maximum(np.nan_to_num(np.asarray(weights, np.float32)), 0)
    weight[unknown] = 0
    if not weight.any():
        raise InputError("no pixel of the map is known, or all weights are 0: nothing to regularise")
    known = weight > 0
    all_known = bool(known.all())
    if bounds_px is None:
        inside = target if all_known else target[known]
        bounds_px = float(inside.min()), float(inside.max())
    if not bounds_px[0] <= bounds_px[1]:
        raise InputError(f"the bounds {bounds_px[0]:g}..{bounds_px[1]:g} px are the wrong way round")
    if not all_known:
        target = _fill(target, known)
    np.clip(target, *bounds_px, out=target)
    links = None if edges is None else np.ascontiguousarray(edges, np.float32)
    return Problem(target, weight, links, bounds_px, huber, data_term == "quadratic")


def _fill(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Fill holes from an image pyramid: a start near the optimum, for a small hole and for a large one."""
    mass = known.astype(np.float32)
    total = np.where(known, values, 0).astype(np.float32)
    if min(values.shape) > 1 and not known.all():
        half = ((values.shape[1] + 1) // 2, (values.shape[0] + 1) // 2)
        coarse_mass = cv2.resize(mass, half, interpolation=cv2.INTER_AREA)
        coarse = cv2.resize(total, half, interpolation=cv2.INTER_AREA) / np.maximum(coarse_mass, 1e-6)
        coarse = _fill(coarse, coarse_mass > 1e-6)
        size = (values.shape[1], values.shape[0])
        return np.where(known, values, cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR))
    return np.where(known, values, total.sum() / max(float(mass.sum()), 1.0)).astype(np.float32)


def step_sizes(iterations: int, *, primal_step: float, strong_convexity: float = 0.0) -> Steps:
    """Give the steps of every iteration; a strongly convex data term makes them converge as O(1/N^2)."""
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
    """Run the primal-dual iterations on ``state``, in plain NumPy: the oracle of `variational_kernels`."""
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


def _backend(name: str) -> tuple[Solver, Callable[[Problem, State], float]]:
    if name == "reference":
        return iterate, gap_per_px
    from chromaperture.disparity import variational_kernels as kernels  # compiling starts here, not at import

    return kernels.iterate, kernels.gap_per_px

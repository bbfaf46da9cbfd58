"""Total variation on a disparity map, the regularisation of the paper's Figure 10 (its reference [6]).

`readable/variation.py` has the energy and its minimisation. Regularise disparity, which is affine in inverse depth,
never depth itself.
"""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np

from chromaperture.settings.methods import ExecutionName
from chromaperture.system.errors import InputError
from chromaperture_paper import variation
from chromaperture_paper.variation import OPERATOR_NORM_SQUARED, Problem, State, Steps, step_sizes

DataTerm = Literal["absolute", "quadratic"]
CHECK_EVERY = 25  # iterations between two evaluations of the gap; chosen by hand


class Smoothed(NamedTuple):
    """A regularised disparity map and how far it is from the optimum."""

    disparity_px: np.ndarray  # (H, W) float32, px; known everywhere, holes are inpainted
    gap_per_px: float  # float; upper bound of (energy - least possible energy) / (H W)
    iterations: int


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
    execution: ExecutionName = "numba",
) -> Smoothed:
    """Regularise a disparity map by its total variation.

    ``disparity_px`` (H, W) float, px: NaN is unknown and is filled in; ``weights`` (H, W) float: confidence >= 0 of
    each pixel; NaN counts as 0. All 1 when absent; ``edges`` (2, H, W) float: weights in [0, 1] of the links to the
    right and downwards, see `edge_weights`; ``bounds_px`` (float, float): range of the result; the range of the known
    values when absent; ``data_term`` {"absolute", "quadratic"}: the first is unmoved by outliers, the second fits
    Gaussian errors; ``fidelity``: per px ("absolute") or per px^2 ("quadratic"), against a total variation of weight 1;
    ``huber_px``: slopes below are smoothed, not flattened into steps, px per px; ``iterations``: the most iterations;
    ``tolerance``: stop when the primal-dual gap per pixel falls below; 0 runs all iterations; ``primal_step``: affects
    the speed of convergence, not the result; ``execution`` {"numba", "numpy"}. Raises InputError: shapes differ,
    nothing is known, or a parameter is out of range.
    """
    if not (fidelity > 0 and huber_px >= 0 and iterations >= 1 and primal_step > 0):
        raise InputError("fidelity and primal_step must be positive, huber_px >= 0 and iterations >= 1")
    problem = make_problem(
        disparity_px, weights, edges, bounds_px=bounds_px, fidelity=fidelity, huber=huber_px, data_term=data_term
    )
    run = _execution(execution)
    # The quadratic term is strongly convex only where every pixel has a weight.
    convexity = float(problem.weight.min()) if problem.quadratic else 0.0
    steps = step_sizes(iterations, primal_step=primal_step, strong_convexity=convexity)
    state = State.start(problem.target)
    chunk = CHECK_EVERY if tolerance > 0 else iterations
    done = 0
    distance = math.inf
    while done < iterations and distance > tolerance:
        until = min(done + chunk, iterations)
        run.iterate(problem, state, Steps(*(s[done:until] for s in steps)))
        done = until
        distance = run.gap_per_px(problem, state)
    return Smoothed(state.u, distance, done)


def _execution(name: ExecutionName) -> Any:
    """Return the module of an execution."""
    if name == "numpy":
        return variation
    from chromaperture_paper import variation_kernels  # compiling starts here, not at import

    return variation_kernels


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

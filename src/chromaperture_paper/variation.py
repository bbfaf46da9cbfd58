"""Total variation of a disparity map, the regularisation of the paper's Figure 10 (its reference [6]).

Minimises over ``lo <= u <= hi`` by the first-order primal-dual algorithm the energy (Huber-L1) ::

    sum |(du/dx, du/dy)|_h  +  fidelity * sum |u - f| over the known pixels,

with the Huber norm ``|g|_h = g^2 / (2 h)`` up to ``h`` and ``|g| - h / 2`` beyond. Regularise disparity, which is
affine in inverse depth, never depth itself. `iterate` is the oracle of ``variation_kernels.py``.

References
----------
A. Chambolle, T. Pock: A first-order primal-dual algorithm for convex problems with applications to imaging.
J. Math. Imaging Vis. 40, 2011. doi:10.1007/s10851-010-0251-1 (the paper's reference [6])
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from chromaperture.system.errors import InputError

OPERATOR_NORM_SQUARED = 8.0  # of the forward-difference gradient
PRIMAL_STEP = 1 / math.sqrt(OPERATOR_NORM_SQUARED)  # affects the speed of convergence, not the result


@dataclass(frozen=True)
class Problem:
    """One convex problem, checked and without NaN."""

    target: np.ndarray  # (H, W) float32; f, inside the bounds
    weight: np.ndarray  # (H, W) float32; the fidelity, 0 where f is unknown
    bounds: tuple[float, float]  # lo and hi
    huber: float  # h, in the unit of u a px


@dataclass
class State:
    """State of the iteration: changed in place."""

    u: np.ndarray  # (H, W) float32
    extrapolated: np.ndarray  # (H, W) float32
    dual: np.ndarray  # (2, H, W) float32

    @classmethod
    def start(cls, u: np.ndarray) -> State:
        """Begin at ``u`` with a dual of zero."""
        return cls(u.copy(), u.copy(), np.zeros((2, *u.shape), u.dtype))


def smooth_disparity(
    disparity_px: np.ndarray,
    *,
    fidelity: float = 1.0,
    bounds_px: tuple[float, float] | None = None,
    huber_px: float = 0.02,
    iterations: int = 300,
) -> np.ndarray:
    """Regularise a disparity map by its total variation; (H, W) float32, px, known everywhere.

    ``disparity_px`` (H, W) float, px: NaN is unknown and is filled in; ``fidelity``: per px, against a total variation
    of weight 1; ``bounds_px``: range of the result, that of the known values when absent; ``huber_px``: slopes below
    are smoothed, not flattened into steps, px per px. Raises InputError: nothing is known, or a parameter is out of
    range.
    """
    from chromaperture_paper import variation_kernels  # compiling starts here, not at import

    problem = make_problem(disparity_px, fidelity=fidelity, bounds_px=bounds_px, huber=huber_px)
    state = State.start(problem.target)
    variation_kernels.iterate(problem, state, iterations)
    return state.u


def make_problem(
    disparity_px: np.ndarray, *, fidelity: float, bounds_px: tuple[float, float] | None, huber: float
) -> Problem:
    """Check a map, and replace the unknown; raises InputError."""
    if not (fidelity > 0 and huber >= 0):
        raise InputError("fidelity must be positive and huber_px >= 0")
    target = np.array(disparity_px, np.float32)  # a copy
    if target.ndim != 2 or min(target.shape) < 2:
        raise InputError(f"expected a disparity map of shape (height, width), got {target.shape}")
    known = np.isfinite(target)
    if not known.any():
        raise InputError("no pixel of the map is known: nothing to regularise")
    if bounds_px is None:
        bounds_px = float(target[known].min()), float(target[known].max())
    if not bounds_px[0] <= bounds_px[1]:
        raise InputError(f"the bounds {bounds_px[0]:g}..{bounds_px[1]:g} px are the wrong way round")
    if not known.all():
        target = _fill(target, known)
    np.clip(target, *bounds_px, out=target)
    return Problem(target, np.where(known, np.float32(fidelity), np.float32(0)), bounds_px, huber)


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


def iterate(problem: Problem, state: State, iterations: int, *, primal_step: float = PRIMAL_STEP) -> None:
    """Run the primal-dual iterations on ``state``, in plain NumPy."""
    f, lo, hi = problem.target, *problem.bounds
    tau, sigma, huber = (f.dtype.type(v) for v in (*step_sizes(primal_step), problem.huber))
    for _ in range(iterations):
        p = (state.dual + sigma * gradient(state.extrapolated)) / (1 + sigma * huber)
        p /= np.maximum(1, np.sqrt(p[0] ** 2 + p[1] ** 2))
        v, pull = state.u + tau * divergence(p), tau * problem.weight
        u = np.clip(v - np.clip(v - f, -pull, pull), lo, hi)
        state.extrapolated = 2 * u - state.u
        state.u, state.dual = u, p


def step_sizes(primal_step: float) -> tuple[float, float]:
    """Return the primal and the dual step, whose product the norm of the gradient bounds."""
    return primal_step, 1 / (OPERATOR_NORM_SQUARED * primal_step)

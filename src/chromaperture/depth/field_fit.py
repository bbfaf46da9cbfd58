"""Fit of the depth curve's fields to boards at known distances, with covariance (paper sections 3.3 and 3.4).

Measured disparity is linear in the coefficients of A and B, d = A(x, y) - B(x, y) q, and in those of the matcher's
nonlinearity once the linear disparity is roughly known, so that a few rounds of linear least squares fit everything.
Boards pass one by one; nothing of the size of all of them together is kept but the disparities themselves.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import chebyshev

from chromaperture.depth.distances import BoardDistances
from chromaperture.depth.field import DepthField, polynomials
from chromaperture.depth.nonlinearity import Nonlinearity, scaled
from chromaperture.errors import InputError

_HUBER = 1.345
_ROUNDS = 8
_GROSS = 6.0
_SMALLEST_PX = 1e-9
_RIDGE_PX = 1.0  # a coefficient of the nonlinearity is some tenths of a px; this only keeps idle ones at zero


def fit_depth_field(
    x_px: np.ndarray,
    y_px: np.ndarray,
    disparity_px: np.ndarray,
    distances: BoardDistances,
    *,
    size_px: tuple[int, int],
    degree: int,
    nonlinear_terms: int = 0,
    samples_per_window: float = 1.0,
    boards: np.ndarray | None = None,
) -> tuple[DepthField, np.ndarray]:
    """Fit both fields, and the matcher's nonlinearity, to the disparities of boards.

    Parameters
    ----------
    x_px, y_px : (P,) float
        Where in the frame.
    disparity_px : (N, P) float
        Measured on each of N boards; NaN is left out.
    distances : BoardDistances
        Of all N boards.
    size_px : (width, height)
    degree : int
        Total degree of the fields.
    nonlinear_terms : int
        Chebyshev terms of the nonlinearity; 0 for none.
    samples_per_window : float
        How many neighbouring samples share their errors, because they share the matcher's window.
    boards : (N,) bool, optional
        Which boards to use; all when absent.

    Returns
    -------
    field : DepthField
        With the covariance of all its coefficients.
    residual_px : (N, P) float64, measured minus fitted, for boards that were left out too

    Raises
    ------
    InputError
        Too few measurements, or all at one distance.
    """
    disparity = np.asarray(disparity_px, float)
    used = np.ones(len(disparity), bool) if boards is None else np.asarray(boards, bool)
    known = np.isfinite(disparity) & used[:, None]
    basis = polynomials(x_px, y_px, *size_px, degree)
    count = basis.shape[-1]
    z = distances.from_pupil_mm
    inverse = 1 / z
    seen = known.any(axis=1)
    if known.sum() < 20 * count or seen.sum() < 2 or np.ptp(inverse[seen]) == 0:
        raise InputError(
            f"{known.sum()} measurements do not fix depth fields of degree {degree}: photograph more boards, with "
            "texture in the whole frame"
        )
    mean_q, spread_q = float(np.mean(inverse[seen])), float(np.std(inverse[seen]))
    standard_q = (inverse - mean_q) / spread_q  # keeps the equations well conditioned
    share = z / z[seen].mean()  # one px is z^2 / B mm, and what counts is the relative error of depth
    share = np.where(known.any(axis=1), share, 0.0)

    trust = known.astype(float)
    solution = np.zeros(2 * count)
    curve: Nonlinearity | None = None
    terms = 0
    low, high = 0.0, 1.0
    for turn in range(_ROUNDS):  # iteratively reweighted least squares with Huber's weights
        if turn == 1 and nonlinear_terms:
            fitted = np.stack([_linear(basis, solution, t) for t in standard_q[seen]])
            low, high = float(fitted.min()), float(fitted.max())
            terms = nonlinear_terms
            solution = np.concatenate([solution, np.zeros(terms)])
        equations = _equations(basis, standard_q, solution, terms, (low, high))
        normal, right = np.zeros((len(solution), len(solution))), np.zeros(len(solution))
        for i in np.flatnonzero(seen).tolist():
            rows = equations(i)
            weighted = rows * (share[i] ** 2 * trust[i])[:, None]
            normal += weighted.T @ rows
            right += weighted.T @ np.where(known[i], disparity[i], 0.0)
        normal[2 * count :, 2 * count :] += np.eye(terms) * share.mean() ** 2 / _RIDGE_PX**2
        solution = np.linalg.lstsq(normal, right, rcond=None)[0]
        residual = np.stack([disparity[i] - equations(i) @ solution for i in range(len(disparity))])
        standard = np.abs(residual) * share[:, None]
        scale = max(1.4826 * float(np.median(standard[known])), _SMALLEST_PX)
        with np.errstate(invalid="ignore"):
            trust = np.where(standard > _HUBER * scale, _HUBER * scale / np.maximum(standard, 1e-12), 1.0)
            trust = np.where(known & (standard <= _GROSS * scale), trust, 0.0)  # a wrong layer tells nothing
    if terms:
        curve = Nonlinearity(low, high, solution[2 * count :])
    # d = a - b (q - mean) / spread = (a + b mean / spread) - (b / spread) q
    slope = solution[count : 2 * count] / spread_q
    covariance = _covariance(
        equations, seen, residual, share[:, None] ** 2 * trust, normal, distances,
        slope_at=lambda i: basis @ slope / z[i] ** 2, samples=samples_per_window,
    )  # fmt: skip
    back = np.eye(2 * count + 1)
    back[:count, count : 2 * count] = np.eye(count) * mean_q / spread_q
    back[count : 2 * count, count : 2 * count] = np.eye(count) / spread_q
    keep = np.r_[0 : 2 * count, len(covariance) - 1]
    covariance = back @ covariance[np.ix_(keep, keep)] @ back.T
    field = DepthField(
        solution[:count] + slope * mean_q, slope, distances.sensor_to_pupil_mm, covariance, curve
    )
    return field, residual


def _linear(basis: np.ndarray, solution: np.ndarray, standard_q: float) -> np.ndarray:
    """Linear disparity of one board; (P,)."""
    count = basis.shape[-1]
    return np.asarray(basis @ (solution[:count] - standard_q * solution[count : 2 * count]))


def _equations(
    basis: np.ndarray, standard_q: np.ndarray, solution: np.ndarray, terms: int, limits: tuple[float, float]
) -> Callable[[int], np.ndarray]:
    """Give the rows of the linear problem, board by board, each (P, unknowns)."""
    before = solution.copy()

    def rows(board: int) -> np.ndarray:
        parts = [basis, -standard_q[board] * basis]
        if terms:
            place = scaled(_linear(basis, before, standard_q[board]), *limits)
            parts.append(chebyshev.chebvander(place, terms + 1)[:, 2:])
        return np.concatenate(parts, axis=1)

    return rows


def _covariance(
    equations: Callable[[int], np.ndarray],
    seen: np.ndarray,
    residual: np.ndarray,
    weights: np.ndarray,
    normal: np.ndarray,
    distances: BoardDistances,
    *,
    slope_at: Callable[[int], np.ndarray],
    samples: float,
) -> np.ndarray:
    """Covariance of all unknowns and of delta: noise of the disparities, and errors of the boards' distances.

    A board's distance is wrong by the same mm at all its pixels, so that more pixels do not help against it.
    """
    noise = np.zeros_like(normal)
    by_distance = np.zeros((len(normal), len(distances.from_pupil_mm)))
    for i in np.flatnonzero(seen).tolist():
        rows = equations(i)
        own = residual[i][weights[i] > 0]
        if own.size == 0:
            continue
        spread = 1.4826 * float(np.median(np.abs(own - np.median(own))))
        weighted = rows * weights[i][:, None]
        noise += spread**2 * samples * weighted.T @ weighted
        by_distance[:, i] = weighted.T @ slope_at(i)  # px by which a board 1 mm farther than thought reads more
    # A board thought too near by dz reads B / z^2 dz more than expected, and the unknowns follow.
    inverse = np.linalg.pinv(normal, hermitian=True)
    follow = inverse @ by_distance
    among = distances.covariance[:-1, :-1]
    with_delta = -follow @ distances.covariance[:-1, -1]
    found = inverse @ noise @ inverse + follow @ among @ follow.T
    return np.block([[found, with_delta[:, None]], [with_delta[None], distances.covariance[-1:, -1:]]])

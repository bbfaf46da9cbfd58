"""Fit of the depth curve's fields to boards at known distances, with covariance (paper sections 3.3 and 3.4).

Measured disparity is linear in the coefficients of A and B, d = A(x, y) - B(x, y) q, and in those of the matcher's
nonlinearity once the linear disparity is roughly known, so that a few rounds of linear least squares fit everything.
Boards pass one by one; nothing of the size of all of them together is kept but the disparities themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import chebyshev

from chromaperture.calibration.board_distances import BoardDistances
from chromaperture.depth.field import DepthField, polynomials
from chromaperture.depth.nonlinearity import Nonlinearity, scaled
from chromaperture.errors import InputError

_HUBER = 1.345
_ROUNDS = 8
_GROSS = 6.0
_SMALLEST_PX = 1e-9
_TILES = 4  # across the frame: wider ones find no more covariance, so that errors are not alike any further
_LEAST_LEFT = 0.05  # of a residual that the fit has not drawn to itself
_RIDGE_PX = 1.0  # a coefficient of the nonlinearity is some tenths of a px; this only keeps idle ones at zero


def fit_depth_field(
    x_px: np.ndarray,
    y_px: np.ndarray,
    disparity_px: np.ndarray,
    distances: BoardDistances,
    *,
    size_px: tuple[int, int],
    degree: int,
    nonlinearity: int | Nonlinearity = 0,
    boards: np.ndarray | None = None,
    covariance: bool = True,
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
    nonlinearity : int or Nonlinearity
        Chebyshev terms of it to fit, 0 for none; or the nonlinearity itself where it is known.
    boards : (N,) bool, optional
        Which boards to use; all when absent.
    covariance : bool
        Find the field's covariance, which takes a third of the time; NaN without.

    Returns
    -------
    field : DepthField
        With the covariance of all its coefficients, and those of a nonlinearity that was fitted.
    residual_px : (N, P) float64
        Measured minus fitted, for boards that were left out too; of linear disparities where the nonlinearity is known.

    Raises
    ------
    InputError
        Too few measurements, or all at one distance.
    """
    known_curve = nonlinearity if isinstance(nonlinearity, Nonlinearity) else None
    terms = nonlinearity if isinstance(nonlinearity, int) else 0
    disparity = np.asarray(disparity_px, float) if known_curve is None else known_curve.linear(disparity_px)
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
    problem = _Problem(basis, standard_q, np.zeros((0, *disparity.shape)))
    solution = np.zeros(2 * count)
    low, high = 0.0, 1.0
    for turn in range(_ROUNDS):  # iteratively reweighted least squares with Huber's weights
        if turn and terms:
            linear = problem.linear(solution)
            # The curve's range goes with A and B: then a change of theirs moves the reading as their rows say.
            low, high = float(linear[seen].min()), float(linear[seen].max())
            powers = chebyshev.chebvander(scaled(linear, low, high), terms + 1)
            problem = _Problem(basis, standard_q, np.moveaxis(powers[..., 2:], -1, 0))
        weights = share[:, None] ** 2 * trust
        normal, right = problem.normal(weights), problem.project(weights * np.where(known, disparity, 0.0)).sum(axis=0)
        idle = np.arange(2 * count, len(normal))
        normal[idle, idle] += share.mean() ** 2 / _RIDGE_PX**2
        solution = np.linalg.lstsq(normal, right, rcond=None)[0]
        residual = disparity - problem.predict(solution)
        standard = np.abs(residual) * share[:, None]
        scale = max(1.4826 * float(np.median(standard[known])), _SMALLEST_PX)
        with np.errstate(invalid="ignore"):
            trust = np.where(standard > _HUBER * scale, _HUBER * scale / np.maximum(standard, 1e-12), 1.0)
            trust = np.where(known & (standard <= _GROSS * scale), trust, 0.0)  # a wrong layer tells nothing
    curve = Nonlinearity(low, high, solution[2 * count :]) if len(problem.powers) else known_curve
    # d = a - b (q - mean) / spread = (a + b mean / spread) - (b / spread) q
    slope = solution[count : 2 * count] / spread_q
    field = DepthField(
        solution[:count] + slope * mean_q, slope, distances.sensor_to_pupil_mm, np.full((3, 3), np.nan), curve
    )
    if not covariance:
        return field, residual
    per_mm = (basis @ slope) / z[:, None] ** 2  # px that a board 1 mm farther than thought reads more
    found = _covariance(problem, weights, normal, residual, per_mm, distances, _tilings(x_px, y_px, size_px[0]))
    unknowns = len(found)
    back = np.eye(unknowns)
    back[:count, count : 2 * count] = np.eye(count) * mean_q / spread_q
    back[count : 2 * count, count : 2 * count] = np.eye(count) / spread_q
    order = np.r_[0 : 2 * count, unknowns - 1, 2 * count : unknowns - 1]  # delta before the nonlinearity
    return replace(field, covariance=back @ found[np.ix_(order, order)] @ back.T), residual


@dataclass(frozen=True)
class _Problem:
    """The linear problem: (N, P) samples of N boards, unknowns A, B and the nonlinearity.

    Its rows, ``basis``, ``-q basis`` and ``powers``, are never written out: boards share the basis.
    """

    basis: np.ndarray  # (P, C)
    standard_q: np.ndarray  # (N,)
    powers: np.ndarray  # (K, N, P)

    def linear(self, solution: np.ndarray) -> np.ndarray:
        """Give the linear disparity; (N, P)."""
        count = self.basis.shape[1]
        infinity, scale = self.basis @ solution[:count], self.basis @ solution[count : 2 * count]
        return np.asarray(infinity - self.standard_q[:, None] * scale)

    def predict(self, solution: np.ndarray) -> np.ndarray:
        """Give what is measured; (N, P)."""
        return self.linear(solution) + np.tensordot(solution[2 * self.basis.shape[1] :], self.powers, axes=1)

    def project(self, values: np.ndarray) -> np.ndarray:
        """Multiply the transposed rows of every board with (N, P) values; (N, unknowns)."""
        smooth = values @ self.basis
        curved = np.einsum("np,knp->nk", values, self.powers)
        return np.concatenate([smooth, -self.standard_q[:, None] * smooth, curved], axis=1)

    def normal(self, weights: np.ndarray) -> np.ndarray:
        """Give the normal matrix for (N, P) weights; (unknowns, unknowns)."""
        count, terms = self.basis.shape[1], len(self.powers)
        products = (self.basis[:, :, None] * self.basis[:, None, :]).reshape(len(self.basis), -1)
        boards = weights @ products
        found = np.zeros((2 * count + terms, 2 * count + terms))
        a, b = slice(0, count), slice(count, 2 * count)
        q = self.standard_q
        for rows, columns, factor in ((a, a, q**0), (a, b, -q), (b, a, -q), (b, b, q**2)):
            found[rows, columns] = (factor @ boards).reshape(count, count)
        for k, power in enumerate(self.powers):
            column = self.project(weights * power).sum(axis=0)
            found[:, 2 * count + k] = found[2 * count + k] = column
        return found


def _covariance(
    problem: _Problem,
    weights: np.ndarray,
    normal: np.ndarray,
    residual: np.ndarray,
    per_mm: np.ndarray,
    distances: BoardDistances,
    tilings: list[np.ndarray],
) -> np.ndarray:
    """Covariance of all unknowns and of delta: errors of the disparities, and errors of the boards' distances.

    Neighbours share the matcher's window and the board's texture, so their errors are added up by tile before they are
    squared (a sandwich estimator with tiles for clusters: Liang and Zeger, Biometrika 73, 1986; it must not matter
    where the tiles lie, hence several ways to lay them: Conley, Journal of Econometrics 92, 1999). A board's distance
    is wrong by the same mm at all its pixels, so that more pixels do not help against it; nor do they against a matcher
    that reads all of a board a little wrong, which is what boards are off by beyond their distances' errors.
    """
    used = np.where(weights > 0, residual, np.nan)
    errors, shared = np.zeros(used.shape), np.zeros(len(used))
    seen = np.flatnonzero((weights > 0).any(axis=1))
    for i in seen.tolist():
        shared[i] = np.nanmedian(used[i])
        errors[i] = np.nan_to_num(used[i] - shared[i])
    inverse = np.linalg.pinv(normal, hermitian=True)
    # The fit has drawn the residuals to itself, those of the nearest and farthest boards most (leverage: Bell and
    # McCaffrey, Survey Methodology 28, 2002); of what tiles say, as much as the fields' coefficients can follow.
    total = weights.sum(axis=1)[seen]
    lines = np.stack([np.ones(len(seen)), problem.standard_q[seen]], axis=1)
    freely = min(problem.basis.shape[1] / np.mean([len(np.unique(tiles)) for tiles in tilings]), 1.0)
    errors[seen] /= np.sqrt(np.maximum(1 - freely * _leverage(lines, total), _LEAST_LEFT))[:, None]
    middle = np.zeros_like(normal)
    by_tiles = np.zeros(len(used))
    for tiles in tilings:
        for tile in np.unique(tiles):
            own = np.where(tiles == tile, weights * errors, 0)
            pull = problem.project(own)
            middle += pull.T @ pull / len(tilings)
            by_tiles += own.sum(axis=1) ** 2 / len(tilings)
    by_distance = np.median(per_mm, axis=1) ** 2 * distances.covariance.diagonal()[:-1]
    by_tiles /= np.maximum(weights.sum(axis=1), 1e-30) ** 2
    # A, B and the nonlinearity follow what a board's pixels share.
    curves = np.column_stack([lines, *(np.median(power, axis=1)[seen] for power in problem.powers)])
    left = 1 - _leverage(curves, total)
    found_px2 = (total * shared[seen] ** 2).sum() / max((total * left).sum(), _LEAST_LEFT * total.sum())
    excess = found_px2 - (total * (by_distance + by_tiles)[seen]).sum() / total.sum()
    pull = problem.project(weights)
    middle += max(excess, 0.0) * pull.T @ pull
    # A board thought too far by dz reads B / z^2 dz less than expected, and the unknowns follow.
    follow = -inverse @ problem.project(weights * per_mm).T
    found = inverse @ middle @ inverse + follow @ distances.covariance[:-1, :-1] @ follow.T
    with_delta = follow @ distances.covariance[:-1, -1]
    return np.block([[found, with_delta[:, None]], [with_delta[None], distances.covariance[-1:, -1:]]])


def _tilings(x_px: np.ndarray, y_px: np.ndarray, width_px: int) -> list[np.ndarray]:
    """Tile of every place, for tiles that start at the frame's corner and half a tile off it either way; (P,) int."""
    column, row = (np.asarray(place) * _TILES / width_px for place in (x_px, y_px))
    ways = [(down, right) for down in (0, 0.5) for right in (0, 0.5)]
    return [(row + down).astype(int) * (_TILES + 1) + (column + right).astype(int) for down, right in ways]


def _leverage(rows: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Share of each residual that a weighted least-squares fit of ``rows`` (N, unknowns) draws to itself; (N,)."""
    weighted = np.sqrt(weights)[:, None] * rows
    return np.asarray((np.linalg.qr(weighted)[0] ** 2).sum(axis=1))

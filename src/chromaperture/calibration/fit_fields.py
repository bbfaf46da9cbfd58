"""Fit of the depth curve's fields to boards at known distances, with covariance (paper sections 3.3 and 3.4).

Measured disparity is linear in the coefficients of A and B, d = A(x, y) - B(x, y) q with q = 1 / z, and in those of the
nonlinearity once the linear disparity is roughly known: a few rounds of linear least squares fit all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy.optimize import least_squares

from chromaperture.calibration.place_boards import BoardDistances
from chromaperture.depth.conversion import DepthModel, depth_to_disparity, disparity_to_depth
from chromaperture.depth.field import DepthField, LocalField, polynomials
from chromaperture.depth.nonlinearity import Nonlinearity, scaled
from chromaperture.system.errors import InputError
from chromaperture.system.robust import HUBER, huber_weights, robust_sigma

# B at its smallest, of its median over the frame: less is a runaway polynomial. Vignetting takes the rim of the pupil,
# where an open design has its film, so that its B falls to a third at the sides. Chosen by hand.
_LEAST_SCALE = 0.1
_ROUNDS = 8  # of reweighting; chosen by hand
_GROSS = 6.0  # standard deviations beyond which a reading is a wrong match and has no weight; chosen by hand
_SMALLEST_PX = 1e-9  # residual scale of exact data, against division by 0
_SAMPLES_A_TERM = 20  # least measurements for a coefficient of A; chosen by hand
_TILES = 4  # across the frame: wider tiles find no more covariance, errors are not correlated farther than that
_LEAST_LEFT = 0.05  # least of 1 - leverage, which errors are divided by the root of; chosen by hand
_RIDGE_PX = 1.0  # prior of a coefficient of the nonlinearity, tenths of a px as a rule: only determines unused ones
_MIN_BOARDS = 3  # as many as unknowns
_LEAST_RANGE = 0.05  # of 1 / distance, relative to the nearest board: less is one distance; chosen by hand
_FOLDS = 8  # of the cross-validation; chosen by hand, not tuned
_TRIALS = (2, 3, 4, 5, 6, 7, 8)  # terms; mirrored halves of a pupil always bias a shift matcher, see `Nonlinearity`
_BOARDS_A_TERM = 3  # with fewer boards for a term, it follows the error of single distances; chosen by hand
MANY_BOARDS = _TRIALS[-1] * _BOARDS_A_TERM  # enough for every trial; measured beats rendered nonlinearity from here on
_POINTS = 400  # samples of the frame: the nonlinearity is the same everywhere; chosen by hand
_AS_GOOD = 1.25  # ratio of errors that is chance: two standard errors of a root mean square over thirty boards
_GROSS_PX = 0.5  # a larger residual is a wrong match, not the lens; chosen by hand
_RIDGE = 4.0  # weight of the smooth fields, in boards: it predicted left-out boards best


def check_scale(field: DepthField, size_px: tuple[int, int]) -> None:
    """Raise InputError where B is not positive, or far below its median: boards that tell little let it run away."""
    scale = np.asarray(field.model(*size_px).scale_px_mm)
    if not np.min(scale) > _LEAST_SCALE * np.median(scale):
        raise InputError("the depth curve runs away over the frame: photograph more boards, with texture all over them")


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

    Returns the field with the covariance of all fitted coefficients, and measured minus fitted disparity (N, P) of all
    boards, used or not; of linear disparities where the nonlinearity is known.

    ``x_px``, ``y_px`` (P,) float: image positions; ``disparity_px`` (N, P) float: measured on each of N boards; NaN is
    left out; ``distances``: of all N boards; ``size_px`` (width, height); ``degree``: total degree of the fields;
    ``nonlinearity``: number of Chebyshev terms to fit, or a known nonlinearity; ``boards`` (N,) bool: boards to use;
    all when absent; ``covariance``: without, the covariance is NaN, and sums are rougher: for many trials of which one
    is chosen. Raises InputError: too few measurements, or all at one distance.
    """
    known_curve = nonlinearity if isinstance(nonlinearity, Nonlinearity) else None
    terms = nonlinearity if isinstance(nonlinearity, int) else 0
    disparity = np.asarray(disparity_px, float) if known_curve is None else known_curve.linear(disparity_px)
    used = np.ones(len(disparity), bool) if boards is None else np.asarray(boards, bool)
    known = np.isfinite(disparity) & used[:, None]
    basis = polynomials(x_px, y_px, *size_px, degree)
    z = distances.from_pupil_mm
    inverse, seen = 1 / z, known.any(axis=1)
    if known.sum() < _SAMPLES_A_TERM * basis.shape[-1] or seen.sum() < 2 or np.ptp(inverse[seen]) == 0:
        raise InputError(
            f"{known.sum()} measurements do not determine depth fields of degree {degree}: photograph more boards, "
            "with texture in the whole frame"
        )
    mean_q, std_q = float(np.mean(inverse[seen])), float(np.std(inverse[seen]))
    standard_q = (inverse - mean_q) / std_q  # keeps the equations well conditioned
    # 1 px is z^2 / B mm: weights proportional to z equalise the relative error of depth.
    board_weight = np.where(seen, z / z[seen].mean(), 0.0)
    problem = (_Problem if covariance else _RoughProblem)(basis, standard_q, np.zeros((0, *disparity.shape)))
    fit = _reweighted(problem, disparity, known, board_weight, terms)
    infinity, scale, series = np.split(fit.solution, [basis.shape[-1], 2 * basis.shape[-1]])
    # d = a - b (q - mean) / std = (a + b mean / std) - (b / std) q
    slope = scale / std_q
    curve = Nonlinearity(*fit.range_px, series) if terms else known_curve
    field = DepthField(infinity + slope * mean_q, slope, distances.sensor_to_pupil_mm, np.full((3, 3), np.nan), curve)
    if not covariance:
        return field, fit.residual
    per_mm = (basis @ slope) / z[:, None] ** 2  # dd / dz: px for 1 mm of distance
    found = _covariance(fit, per_mm, distances, _tilings(x_px, y_px, size_px[0]))
    return replace(field, covariance=_of_coefficients(found, basis.shape[-1], mean_q, std_q)), fit.residual


def _of_coefficients(covariance: np.ndarray, count: int, mean_q: float, std_q: float) -> np.ndarray:
    """Transform the covariance of the unknowns and delta to A, B (``count`` coefficients each), delta and the rest."""
    unknowns = len(covariance)
    back = np.eye(unknowns)
    back[:count, count : 2 * count] = np.eye(count) * mean_q / std_q
    back[count : 2 * count, count : 2 * count] = np.eye(count) / std_q
    order = np.r_[0 : 2 * count, unknowns - 1, 2 * count : unknowns - 1]  # delta before the nonlinearity
    return np.asarray(back @ covariance[np.ix_(order, order)] @ back.T)


@dataclass(frozen=True)
class _Problem:
    """The linear problem: (N, P) samples of N boards, unknowns A, B and the nonlinearity.

    The rows ``basis``, ``-q basis`` and ``powers`` are never stored: the basis is the same for all boards.
    """

    basis: np.ndarray  # (P, C)
    standard_q: np.ndarray  # (N,)
    powers: np.ndarray  # (K, N, P)

    def linear(self, solution: np.ndarray) -> np.ndarray:
        """Return the linear disparity; (N, P)."""
        count = self.basis.shape[1]
        infinity, scale = self.basis @ solution[:count], self.basis @ solution[count : 2 * count]
        return np.asarray(infinity - self.standard_q[:, None] * scale)

    def predict(self, solution: np.ndarray) -> np.ndarray:
        """Return the measured disparity; (N, P)."""
        return self.linear(solution) + self.curved(solution[2 * self.basis.shape[1] :])

    def curved(self, series: np.ndarray) -> np.ndarray:
        """Return the nonlinearity's part of the disparity; (N, P)."""
        return np.tensordot(series, self.powers, axes=1)

    def project(self, values: np.ndarray) -> np.ndarray:
        """Multiply the transposed rows of every board by (N, P) values; (N, unknowns)."""
        smooth = values @ self.basis
        curved = np.einsum("np,knp->nk", values, self.powers)
        return np.concatenate([smooth, -self.standard_q[:, None] * smooth, curved], axis=1)

    def normal(self, weights: np.ndarray) -> np.ndarray:
        """Return the normal matrix for (N, P) weights; (unknowns, unknowns)."""
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

    def right(self, values: np.ndarray) -> np.ndarray:
        """Return the right-hand side for weighted disparities (N, P); (unknowns,)."""
        return self.project(values).sum(axis=0)


class _RoughProblem(_Problem):
    """The same sums but for rounding, boards first: a tenth of the work, and too small for BLAS to start threads."""

    def curved(self, series: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("k,knp->np", series, self.powers))

    def normal(self, weights: np.ndarray) -> np.ndarray:
        q = self.standard_q
        aa, ab, bb = ((self.basis.T * total) @ self.basis for total in np.stack([q**0, -q, q**2]) @ weights)
        columns = [self.right(weights * power) for power in self.powers]
        smooth = np.block([[aa, ab], [ab, bb]])
        if not columns:
            return smooth
        mixed, own = np.split(np.array(columns), [len(smooth)], axis=1)
        return np.block([[smooth, mixed.T], [mixed, own]])

    def right(self, values: np.ndarray) -> np.ndarray:
        smooth = np.stack([self.standard_q**0, -self.standard_q]) @ values @ self.basis
        return np.concatenate([smooth.ravel(), np.einsum("np,knp->k", values, self.powers)])


class _Fit(NamedTuple):
    """The last round of `_reweighted`; range of linear disparity that the nonlinearity was fitted in."""

    problem: _Problem
    solution: np.ndarray
    weights: np.ndarray  # (N, P)
    normal: np.ndarray
    residual: np.ndarray  # (N, P), px
    range_px: tuple[float, float]


def _reweighted(
    problem: _Problem, disparity: np.ndarray, known: np.ndarray, board_weight: np.ndarray, terms: int
) -> _Fit:
    """Fit A, B and ``terms`` Chebyshev terms by iteratively reweighted least squares with Huber's weights."""
    count, seen, robust = problem.basis.shape[1], known.any(axis=1), known.astype(float)
    solution, low, high = np.zeros(2 * count), 0.0, 1.0
    for turn in range(_ROUNDS):
        if turn and terms:
            linear = problem.linear(solution)
            # The range of the nonlinearity follows A and B, so that their rows are the derivatives of the reading.
            low, high = float(linear[seen].min()), float(linear[seen].max())
            powers = chebyshev.chebvander(scaled(linear, low, high), terms + 1)
            problem = replace(problem, powers=np.moveaxis(powers[..., 2:], -1, 0))
        weights = board_weight[:, None] ** 2 * robust
        normal, right = problem.normal(weights), problem.right(weights * np.where(known, disparity, 0.0))
        own = np.arange(2 * count, len(normal))
        normal[own, own] += board_weight.mean() ** 2 / _RIDGE_PX**2
        solution = np.linalg.lstsq(normal, right, rcond=None)[0]
        residual = disparity - problem.predict(solution)
        relative = np.abs(residual) * board_weight[:, None]
        standard = relative / max(robust_sigma(relative[known]), _SMALLEST_PX)
        robust = np.where(known & (standard <= _GROSS), huber_weights(standard), 0.0)
    return _Fit(problem, solution, weights, normal, residual, (low, high))


def _covariance(fit: _Fit, per_mm: np.ndarray, distances: BoardDistances, tilings: list[np.ndarray]) -> np.ndarray:
    """Compute the covariance of all unknowns and of delta from errors of the disparities and of the boards' distances.

    Errors of neighbours are correlated by the matcher's window and the texture: they are summed by tile before they are
    squared (sandwich estimator with tiles for clusters: Liang and Zeger, Biometrika 73, 1986), averaged over several
    tilings (Conley, Journal of Econometrics 92, 1999). Two errors are common to all pixels of a board: that of its
    distance, and a bias of the matcher, which is estimated as the scatter of boards beyond their distance errors.
    """
    problem, weights = fit.problem, fit.weights
    used = np.where(weights > 0, fit.residual, np.nan)
    errors, common = np.zeros(used.shape), np.zeros(len(used))
    seen = np.flatnonzero((weights > 0).any(axis=1))
    for i in seen.tolist():
        common[i] = np.nanmedian(used[i])
        errors[i] = np.nan_to_num(used[i] - common[i])
    inverse = np.linalg.pinv(fit.normal, hermitian=True)
    # Residuals are smaller than errors by the leverage, which is largest for the nearest and the farthest board (Bell
    # and McCaffrey, Survey Methodology 28, 2002), times the fraction of the tiles that the coefficients can follow.
    total = weights.sum(axis=1)[seen]
    lines = np.stack([np.ones(len(seen)), problem.standard_q[seen]], axis=1)
    followed = min(problem.basis.shape[1] / np.mean([len(np.unique(tiles)) for tiles in tilings]), 1.0)
    errors[seen] /= np.sqrt(np.maximum(1 - followed * _leverage(lines, total), _LEAST_LEFT))[:, None]
    middle = np.zeros_like(fit.normal)
    by_tiles = np.zeros(len(used))
    for tiles in tilings:
        for tile in np.unique(tiles):
            own = np.where(tiles == tile, weights * errors, 0)
            gradient = problem.project(own)
            middle += gradient.T @ gradient / len(tilings)
            by_tiles += own.sum(axis=1) ** 2 / len(tilings)
    by_distance = np.median(per_mm, axis=1) ** 2 * distances.covariance.diagonal()[:-1]
    by_tiles /= np.maximum(weights.sum(axis=1), 1e-30) ** 2
    # Bias common to the pixels of a board: beyond what A, B and the nonlinearity followed, distances and tiles explain.
    curves = np.column_stack([lines, *(np.median(power, axis=1)[seen] for power in problem.powers)])
    left = 1 - _leverage(curves, total)
    found_px2 = (total * common[seen] ** 2).sum() / max((total * left).sum(), _LEAST_LEFT * total.sum())
    excess = found_px2 - (total * (by_distance + by_tiles)[seen]).sum() / total.sum()
    gradient = problem.project(weights)
    middle += max(excess, 0.0) * gradient.T @ gradient
    # A board assumed dz too far has a disparity B / z^2 dz below the expected one: d unknowns / d distances.
    by_mm = -inverse @ problem.project(weights * per_mm).T
    found = inverse @ middle @ inverse + by_mm @ distances.covariance[:-1, :-1] @ by_mm.T
    with_delta = by_mm @ distances.covariance[:-1, -1]
    return np.block([[found, with_delta[:, None]], [with_delta[None], distances.covariance[-1:, -1:]]])


def _tilings(x_px: np.ndarray, y_px: np.ndarray, width_px: int) -> list[np.ndarray]:
    """Return the tile of every sample, (P,) int, for tiles from the frame's corner on and half a tile off it."""
    column, row = (np.asarray(position) * _TILES / width_px for position in (x_px, y_px))
    ways = [(down, right) for down in (0, 0.5) for right in (0, 0.5)]
    return [(row + down).astype(int) * (_TILES + 1) + (column + right).astype(int) for down, right in ways]


def _leverage(rows: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the leverages of a weighted least-squares fit of ``rows`` (N, unknowns); (N,)."""
    weighted = np.sqrt(weights)[:, None] * rows
    return np.asarray((np.linalg.qr(weighted)[0] ** 2).sum(axis=1))


@dataclass(frozen=True)
class DepthFit:
    """A fitted curve and its residuals."""

    model: DepthModel  # A, B, delta and their covariance
    residual_mm: np.ndarray  # (N,) float64, mm; measured minus true distance of every board; NaN not measured
    residual_px: np.ndarray  # (N,) float64, px
    rms_mm: float


def fit_depth_model(
    distance_mm: np.ndarray,
    disparity_px: np.ndarray,
    *,
    disparity_sigma_px: np.ndarray,
    distance_sigma_mm: float,
    sensor_to_pupil_mm: float,
    sensor_to_pupil_sigma_mm: float,
) -> DepthFit:
    """Fit d = A - B / (distance - delta) to N >= 3 boards, robustly, with a prior on delta (paper section 3.4).

    Distances are from the sensor plane, disparities half ones; (N,) float each. Delta is the worst determined of the
    three (to 3 mm where A is to 0.03 px); its prior comes from the boards' poses or from the lens's focal length.
    Raises InputError where the boards do not determine the curve, or disparity falls with distance.
    """
    all_distances, all_disparities = np.asarray(distance_mm, float), np.asarray(disparity_px, float)
    sigma = np.asarray(disparity_sigma_px, float)
    good = np.isfinite(all_distances) & np.isfinite(all_disparities) & np.isfinite(sigma)
    distance, disparity, sigma = all_distances[good], all_disparities[good], sigma[good]
    if len(distance) < _MIN_BOARDS or np.ptp(1 / distance) * distance.min() < _LEAST_RANGE:
        raise InputError(
            f"{len(distance)} usable boards do not fix the depth curve: photograph the board at three or more "
            "distances, nearer and farther than the focus"
        )
    # Start with delta at its prior: the curve is then linear in inverse depth.
    inverse = 1 / (distance - sensor_to_pupil_mm)
    slope, offset = np.polyfit(inverse, disparity, 1)
    if slope >= 0:
        raise InputError(
            "disparity falls with distance: the filters are swapped (is cyan on the left, seen from behind the "
            "camera?), or the design is not the one in the pupil"
        )

    def residuals(p: np.ndarray) -> np.ndarray:
        z = distance - p[2]
        error = np.hypot(sigma, -slope / z**2 * distance_sigma_mm)
        prior = (p[2] - sensor_to_pupil_mm) / sensor_to_pupil_sigma_mm
        return np.append((disparity - (p[0] - p[1] / z)) / error, prior)

    start = np.array([offset, -slope, sensor_to_pupil_mm])
    scale = np.maximum(np.abs(start), 1e-3)
    fit = least_squares(residuals, start, x_scale=scale, loss="huber", f_scale=HUBER)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    model = DepthModel(float(fit.x[0]), float(fit.x[1]), float(fit.x[2]), covariance)
    residual_mm = disparity_to_depth(all_disparities, model)[0].astype(float) - all_distances
    residual_px = all_disparities - depth_to_disparity(all_distances, model)
    return DepthFit(model, residual_mm, residual_px, float(np.sqrt(np.nanmean(residual_mm**2))))


def ranked_curves(
    x_px: np.ndarray,
    y_px: np.ndarray,
    disparity_px: np.ndarray,
    distances: BoardDistances,
    *,
    size_px: tuple[int, int],
    degree: int,
    boards: np.ndarray,
    known: Nonlinearity | None = None,
) -> list[int | Nonlinearity]:
    """Rank numbers of Chebyshev terms, and a known nonlinearity, by cross-validation over boards.

    The error is the median over the frame of each left-out board, relative to its distance, which excludes the noise of
    single pixels. ``known`` is of rendered boards, and tried where there are fewer than ``MANY_BOARDS``; the other
    parameters are those of `fit_depth_field`.

    First comes the known nonlinearity or, if it is worse than the best by more than chance, the fewest terms that are
    not. Then the others, best first. Last 0 terms, because a curve that was monotonic without some boards may not be
    with all of them.
    """
    thin = slice(None, None, max(1, len(x_px) // _POINTS))
    x, y, disparity = x_px[thin], y_px[thin], disparity_px[:, thin]
    tried = [n for n in _TRIALS if n * _BOARDS_A_TERM <= boards.sum()]
    errors: dict[int | Nonlinearity, float] = {}  # simplest first
    candidates: list[int | Nonlinearity] = [*([] if known is None or boards.sum() >= MANY_BOARDS else [known]), *tried]
    for curve in candidates:
        try:
            biases = []
            for left_out in _folds(boards):
                _, residual = fit_depth_field(
                    x, y, disparity, distances, size_px=size_px, degree=degree, nonlinearity=curve,
                    boards=boards & ~left_out, covariance=False,
                )  # fmt: skip
                seen = left_out & np.isfinite(residual).any(axis=1)
                # 1 px is z^2 / B mm: the relative error of depth is proportional to z times the residual.
                biases.append(distances.from_pupil_mm[seen] * np.nanmedian(residual[seen], axis=1))
        except InputError:  # not monotonic, or too few boards
            continue
        errors[curve] = float(np.sqrt(np.mean(np.concatenate(biases) ** 2)))
    ranked = sorted(errors, key=errors.__getitem__)
    simplest = [curve for curve, error in errors.items() if error <= _AS_GOOD * errors[ranked[0]]][:1]
    return [*simplest, *(curve for curve in ranked if curve not in simplest), 0]


def _folds(boards: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the left-out boards of every fold: each n-th of those in use; (N,) bool."""
    used = np.flatnonzero(boards)
    for fold in range(min(_FOLDS, len(used))):
        left_out = np.zeros(len(boards), bool)
        left_out[used[fold::_FOLDS]] = True
        yield left_out


def with_local(
    field: DepthField,
    x_px: np.ndarray,
    y_px: np.ndarray,
    disparity_px: np.ndarray,
    distances: BoardDistances,
    *,
    size_px: tuple[int, int],
    boards: np.ndarray,
) -> DepthField:
    """Fit corrections of A and B at every point of a grid by ridge regression (paper Figure 7).

    ``field`` is fitted to the same boards; the grid (w,), (h,) has one pitch; disparities are (N, h, w), NaN unknown.
    """
    x, y = np.meshgrid(x_px, y_px)
    model = field.at(x, y, *size_px)
    inverse = 1 / distances.from_pupil_mm
    middle, width = float(inverse[boards].mean()), float(inverse[boards].std())
    q = ((inverse - middle) / width)[:, None, None]
    expected = model.infinity_disparity_px - model.scale_px_mm * inverse[:, None, None]
    linear = np.asarray(disparity_px, float) if model.nonlinearity is None else model.nonlinearity.linear(disparity_px)
    residual = linear - expected
    known = np.isfinite(residual) & boards[:, None, None]
    known &= np.abs(np.where(known, residual, 0)) < _GROSS_PX
    residual = np.where(known, residual, 0.0)
    # Normal equations of residual = a - b q at every point; q is standardised, so that one ridge suits both.
    n, s, ss = known.sum(axis=0) + _RIDGE, (known * q).sum(axis=0), (known * q**2).sum(axis=0) + _RIDGE
    r, rq = residual.sum(axis=0), (residual * q).sum(axis=0)
    determinant = n * ss - s**2
    a, b = (ss * r - s * rq) / determinant, (s * r - n * rq) / determinant
    left = np.where(known, residual - a + b * q, 0.0)
    variance = float((left**2).sum() / max(known.sum() - 2 * n.size, 1))
    inverted = np.median([[ss, s], [s, n]] / determinant, axis=(2, 3)) * variance
    back = np.array([[1, middle / width], [0, 1 / width]])  # residual = (a + b middle / width) - (b / width) / z
    local = LocalField(
        float(x_px[0]), float(x_px[1] - x_px[0]), (a + b * middle / width).astype(np.float32),
        (b / width).astype(np.float32), back @ inverted @ back.T,
    )  # fmt: skip
    return replace(field, local=local)

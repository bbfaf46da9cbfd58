"""Which curve of a matcher's nonlinearity a camera needs: the one that foretells boards that were left out best."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from chromaperture.calibration.board_distances import BoardDistances
from chromaperture.calibration.fit_fields import fit_depth_field
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.errors import InputError

_FOLDS = 8
_TRIALS = (2, 3, 4, 5, 6, 7, 8)  # mirrored halves of a pupil never read straight, see `Nonlinearity`
_BOARDS_A_TERM = 3  # fewer would be drawn by the error of each board's distance
MANY_BOARDS = _TRIALS[-1] * _BOARDS_A_TERM  # enough for every trial: what they show beats a curve from a model of blur
_POINTS = 400  # of the frame suffice: the nonlinearity is one curve for all of it
_AS_GOOD = 1.25  # two standard errors of a root mean square over thirty boards: so much is chance


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
    """Rank numbers of Chebyshev terms, and a curve known beforehand, by cross-validation over boards.

    What is judged is the median over the frame of each board that was left out, relative to its distance: noise of
    single pixels does not come into it.

    Parameters
    ----------
    x_px, y_px : (P,) float
    disparity_px : (N, P) float
        Measured on each of N boards; NaN is left out.
    distances : BoardDistances
        Of all N boards.
    size_px : (width, height)
    degree : int
        Total degree of the fields.
    boards : (N,) bool
        Which boards to use.
    known : Nonlinearity, optional
        A curve that the boards need not fix; for where they are few.

    Returns
    -------
    list of int or Nonlinearity
        What asks least of the boards among those that are as good as any: the known curve, else the fewest terms. Then
        the others from the best on, and last 0, which always fits: all boards together may refuse what most of them
        allowed.
    """
    thin = slice(None, None, max(1, len(x_px) // _POINTS))
    x, y, disparity = x_px[thin], y_px[thin], disparity_px[:, thin]
    tried = [n for n in _TRIALS if n * _BOARDS_A_TERM <= boards.sum()]
    errors: dict[int | Nonlinearity, float] = {}  # what asks least of the boards comes first
    foreseen = [] if known is None or boards.sum() >= MANY_BOARDS else [known]
    candidates: list[int | Nonlinearity] = [*foreseen, *tried]
    for curve in candidates:
        try:
            biases = []
            for left_out in _folds(boards):
                _, residual = fit_depth_field(
                    x, y, disparity, distances, size_px=size_px, degree=degree, nonlinearity=curve,
                    boards=boards & ~left_out, covariance=False,
                )  # fmt: skip
                seen = left_out & np.isfinite(residual).any(axis=1)
                # One px is z^2 / B mm: the relative error of depth goes with z times the residual.
                biases.append(distances.from_pupil_mm[seen] * np.nanmedian(residual[seen], axis=1))
        except InputError:  # a nonlinearity that turns back, or too few boards
            continue
        errors[curve] = float(np.sqrt(np.mean(np.concatenate(biases) ** 2)))
    ranked = sorted(errors, key=errors.__getitem__)
    modest = [curve for curve, error in errors.items() if error <= _AS_GOOD * errors[ranked[0]]][:1]
    return [*modest, *(curve for curve in ranked if curve not in modest), 0]


def _folds(boards: np.ndarray) -> Iterator[np.ndarray]:
    """Every n-th of the boards in use, by turns; (N,) bool each."""
    used = np.flatnonzero(boards)
    for fold in range(min(_FOLDS, len(used))):
        left_out = np.zeros(len(boards), bool)
        left_out[used[fold::_FOLDS]] = True
        yield left_out

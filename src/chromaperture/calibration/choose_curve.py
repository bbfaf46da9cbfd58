"""Choice of the nonlinearity: the one that predicts left-out boards best."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from chromaperture.calibration.board_distances import BoardDistances
from chromaperture.calibration.fit_fields import fit_depth_field
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.system.errors import InputError

_FOLDS = 8  # of the cross-validation; chosen by hand, not tuned
_TRIALS = (2, 3, 4, 5, 6, 7, 8)  # terms; mirrored halves of a pupil always bias a shift matcher, see `Nonlinearity`
_BOARDS_A_TERM = 3  # with fewer boards for a term, it follows the error of single distances; chosen by hand
MANY_BOARDS = _TRIALS[-1] * _BOARDS_A_TERM  # enough for every trial; measured beats rendered nonlinearity from here on
_POINTS = 400  # samples of the frame: the nonlinearity is the same everywhere; chosen by hand
_AS_GOOD = 1.25  # ratio of errors that is chance: two standard errors of a root mean square over thirty boards


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
    single pixels.

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
        From rendered boards; tried where there are fewer than ``MANY_BOARDS``.

    Returns
    -------
    list of int or Nonlinearity
        First the known nonlinearity or, if it is worse than the best by more than chance, the fewest terms that are
        not. Then the others, best first. Last 0 terms, because a curve that was monotonic without some boards may not
        be with all of them.
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

"""Corrections to the smooth depth fields at every point of a grid (paper Figure 7)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from chromaperture.calibration.board_distances import BoardDistances
from chromaperture.depth.field import DepthField, LocalField

_GROSS_PX = 0.5  # a larger residual is a wrong match, not the lens; chosen by hand
_RIDGE = 4.0  # weight of the smooth fields, in boards: it predicted left-out boards best


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
    """Fit corrections of A and B at every point of a grid by ridge regression.

    Parameters
    ----------
    field : DepthField
        Smooth fields, fitted to the same boards.
    x_px : (w,) float, y_px : (h,) float
        The grid, of one pitch along both.
    disparity_px : (N, h, w) float
        Measured on each of N boards; NaN is left out.
    distances : BoardDistances
        Of all N boards.
    size_px : (width, height)
    boards : (N,) bool
        Which boards to use.

    Returns
    -------
    DepthField
        With ``local``.
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

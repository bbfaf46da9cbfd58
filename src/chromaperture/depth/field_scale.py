"""Depth curves of the same camera with fewer or more pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.polynomial import chebyshev

from chromaperture.depth.field import DepthField, LocalField, degree_of
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.system.errors import InputError


def resized_field(field: DepthField, before_px: tuple[int, int], after_px: tuple[int, int]) -> DepthField:
    """Return the curves for a picture of another size that shows the same frame.

    Disparities count px of the picture's width. Polynomials over the frame are of the centres of its outermost pixels,
    which move when pixels grow: the polynomials are expanded anew, exactly.

    ``before_px``, ``after_px`` (int, int): width and height, px.
    """
    factor = before_px[0] / after_px[0]  # px before in a px after
    shares = [_share(before, after) for before, after in zip(before_px, after_px, strict=True)]
    change = _substitution(degree_of(len(field.scale_px_mm)), *shares)
    return replace(
        field,
        infinity_disparity_px=change @ field.infinity_disparity_px / factor,
        scale_px_mm=change @ field.scale_px_mm / factor,
        covariance=_covariance(field, change, factor),
        nonlinearity=None if field.nonlinearity is None else _nonlinearity(field.nonlinearity, factor),
        local=None if field.local is None else _local(field.local, factor),
    )


def _share(before: int, after: int) -> float:
    """Return how far the outermost pixels' centres lie from the middle, in the distance of those before."""
    return before / after * (after - 1) / max(before - 1, 1)


def _substitution(degree: int, along_x: float, along_y: float) -> np.ndarray:
    """Return the matrix from coefficients in (u, v) to those in (u / along_x, v / along_y); (N, N)."""
    i, j = np.divmod(np.arange((degree + 1) ** 2), degree + 1)
    kept = i + j <= degree
    i, j = i[kept], j[kept]
    x, y = _expansion(degree, along_x), _expansion(degree, along_y)
    return x[i][:, i].T * y[j][:, j].T


def _expansion(degree: int, share: float) -> np.ndarray:
    """Return the coefficients of T_n(share * u) in T_0(u), T_1(u), ..., row n; (degree + 1, degree + 1)."""
    rows = np.zeros((degree + 1, degree + 1))
    for n, unit in enumerate(np.eye(degree + 1)):
        powers = chebyshev.cheb2poly(unit)
        found = chebyshev.poly2cheb(powers * share ** np.arange(len(powers)))
        rows[n, : len(found)] = found
    return rows


def _covariance(field: DepthField, change: np.ndarray, factor: float) -> np.ndarray:
    covariance, n = np.asarray(field.covariance, float), len(change)
    if len(covariance) == 3 and n != 1:
        units = np.array([1 / factor, 1 / factor, 1])
        return covariance * np.outer(units, units)
    curve = np.eye(len(covariance) - 2 * n - 1) / factor
    whole = np.zeros_like(covariance)
    for start, block in ((0, change / factor), (n, change / factor), (2 * n, np.eye(1)), (2 * n + 1, curve)):
        stop = start + len(block)
        whole[start:stop, start:stop] = block
    return np.asarray(whole @ covariance @ whole.T)


def _nonlinearity(curve: Nonlinearity, factor: float) -> Nonlinearity:
    return Nonlinearity(curve.low_px / factor, curve.high_px / factor, np.asarray(curve.coefficients) / factor)


def _local(local: LocalField, factor: float) -> LocalField:
    shrunk = np.float32(1 / factor)
    return LocalField(
        (local.start_px + 0.5) / factor - 0.5, local.step_px / factor, local.infinity_disparity_px * shrunk,
        local.scale_px_mm * shrunk, local.covariance / factor**2,
    )  # fmt: skip


def with_scale_error(field: DepthField, relative: float) -> DepthField:
    """Add a relative error of the disparity to the covariance of a curve.

    Disparities that are all wrong by the same factor are those of a curve whose A and B are wrong by that factor: the
    covariance grows by ``relative^2 c c^T``, c being the coefficients of both. The standard deviation of the disparity
    d grows to hypot(sigma, relative |d|), in focus not at all.

    ``relative``: one standard deviation of the factor; 0 changes nothing. Raises InputError: it is negative or not
    finite.
    """
    if not (np.isfinite(relative) and relative >= 0):
        raise InputError(f"the relative error of the disparity must be 0 or more, got {relative:g}")
    if relative == 0:
        return field
    covariance = np.asarray(field.covariance, float)
    count = len(field.scale_px_mm)
    if len(covariance) == 3 and count > 1:  # of A, B and delta in the middle of the frame
        middle = field.on_axis(3, 3)  # of any frame
        parts = np.array([middle.infinity_disparity_px, middle.scale_px_mm])
    else:
        parts = np.concatenate([field.infinity_disparity_px, field.scale_px_mm])
    whole = np.zeros(len(covariance))
    whole[: len(parts)] = parts
    return replace(field, covariance=covariance + relative**2 * np.outer(whole, whole))

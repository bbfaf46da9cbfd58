"""A relative error that all disparities of a depth curve share, added to its covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from chromaperture.depth.field import DepthField
from chromaperture.system.errors import InputError


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

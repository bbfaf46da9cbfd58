"""Depth fit for pictures: no holes, no speckle, edges where the colours have theirs.

A wrong depth is a small error of measurement but an ugly stain in a sharpened picture. So the disparity is averaged
with its own precision as weight, along the picture's surfaces: recursively, with a reach that ends at colour edges
(the domain transform of Gastal and Oliveira 2011).
"""

from __future__ import annotations

import cv2
import numba
import numpy as np

from chromaperture.color.alignment import fill_unknown
from chromaperture.errors import InputError

_REACH_PX = 10.0
_COLOUR_RANGE = 0.10  # of the square root of light; a step that size ends the reach
_LEAST_SIGMA_PX = 0.05
_ROUNDS = 3


def steady_disparity(
    disparity_px: np.ndarray, sigma_px: np.ndarray | None, guide: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fill and smooth a disparity map along the surfaces of the picture.

    Parameters
    ----------
    disparity_px : (H, W) float, px; NaN unknown
    sigma_px : (H, W) float, px, or None
        Its standard deviation; equal for all where None.
    guide : (H, W, 3) float, linear RGB, channels aligned

    Returns
    -------
    disparity_px : (H, W) float32, no NaN
    spread_px : (H, W) float32
        How much the disparities that went into each value differ: where it is large, two depths compete.

    Raises
    ------
    InputError
        No disparity is known at all, or sizes differ.
    """
    d = np.asarray(disparity_px, np.float32)
    if guide.shape[:2] != d.shape:
        raise InputError(f"disparity {d.shape} and image {guide.shape[:2]} differ in size: of two photographs")
    known = np.isfinite(d)
    if not known.any():
        raise InputError("the disparity is unknown everywhere: there is nothing to focus by")
    sigma = np.full(d.shape, _LEAST_SIGMA_PX, np.float32) if sigma_px is None else np.asarray(sigma_px, np.float32)
    precise = known & np.isfinite(sigma)
    weight = np.where(precise, 1 / (np.square(np.where(precise, sigma, 1)) + _LEAST_SIGMA_PX**2), 0)
    if not weight.any():
        weight = known.astype(np.float64)
    weight = (weight / weight.max()).astype(np.float32)
    value = np.where(known, d, 0)
    # A lone outlier must not weigh: it leaves before the average.
    median = cv2.medianBlur(np.where(known, d, np.float32(np.median(d[known]))), 5)
    weight *= np.where(np.abs(value - median) < 0.5, np.float32(1), np.float32(0.05))
    planes = np.stack([weight, weight * value, weight * value * value], axis=-1) + np.float32(0)
    tone = np.sqrt(np.maximum(cv2.GaussianBlur(np.asarray(guide, np.float32), (0, 0), 1.0), 0))
    tone /= max(float(np.percentile(tone, 99)), 1e-6)
    across = np.abs(np.diff(tone, axis=1, prepend=tone[:, :1])).sum(axis=2) / np.float32(_COLOUR_RANGE)
    down = np.abs(np.diff(tone, axis=0, prepend=tone[:1])).sum(axis=2) / np.float32(_COLOUR_RANGE)
    for i in range(_ROUNDS):
        reach = _REACH_PX * np.sqrt(3) * 2.0 ** (_ROUNDS - 1 - i) / np.sqrt(4.0**_ROUNDS - 1)
        decay = np.float32(np.exp(-np.sqrt(2) / reach))
        _rows(planes, decay ** (1 + across * np.float32(_REACH_PX)))
        planes = np.ascontiguousarray(planes.transpose(1, 0, 2))
        _rows(planes, np.ascontiguousarray((decay ** (1 + down * np.float32(_REACH_PX))).T))
        planes = np.ascontiguousarray(planes.transpose(1, 0, 2))
    total, first, second = (planes[..., i] for i in range(3))
    reached = total > 1e-7
    mean = np.where(reached, first / np.maximum(total, 1e-7), np.nan)
    spread = np.sqrt(np.maximum(second / np.maximum(total, 1e-7) - mean**2, 0))
    if not reached.all():
        mean, spread = fill_unknown(mean), np.where(reached, spread, 1.0)
    return mean.astype(np.float32), spread.astype(np.float32)


@numba.njit(cache=True, parallel=True)
def _rows(planes, decay):  # type: ignore[no-untyped-def]
    """Recursive average along the rows, there and back, in place; decay is that of the step from the left."""
    height, width, count = planes.shape
    for y in numba.prange(height):
        for x in range(1, width):
            a = decay[y, x]
            for c in range(count):
                planes[y, x, c] += a * (planes[y, x - 1, c] - planes[y, x, c])
        for x in range(width - 2, -1, -1):
            a = decay[y, x + 1]
            for c in range(count):
                planes[y, x, c] += a * (planes[y, x + 1, c] - planes[y, x, c])

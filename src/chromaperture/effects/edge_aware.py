"""Fill and smooth a disparity map for picture effects: no holes, no specks, edges where the colours have theirs.

A wrong depth is a small error of measurement but a visible stain in a sharpened picture. So the disparity is averaged
with its inverse variance as weight, recursively, with a decay that ends at colour edges (the domain transform of
Gastal and Oliveira 2011).
"""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.color.alignment import fill_unknown
from chromaperture.effects.refocusing_kernels import over_rows
from chromaperture.system.compilation import compiled
from chromaperture.system.errors import InputError
from chromaperture.system.threads import each_band

# Chosen by hand; not tuned.
_REACH_PX = 10.0  # standard deviation of the filter inside a surface: a longer one rounds depth, a shorter keeps specks
_COLOUR_RANGE = 0.10  # step of the square root of light (1 is the 99th percentile) that counts as `_REACH_PX`
_MIN_SIGMA_PX = 0.05  # error added to every disparity, so that no pixel dominates
_ROUNDS = 3  # of rows and columns; the number Gastal and Oliveira recommend
_OUTLIER_PX, _OUTLIER_WEIGHT = 0.5, 0.05  # distance from the median of 5 x 5 px that makes an outlier, and its weight


def filter_disparity(
    disparity_px: np.ndarray, sigma_px: np.ndarray | None, guide: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fill and smooth a disparity along the surfaces of the picture; returns it and its local scatter."""
    d = np.asarray(disparity_px, np.float32)
    if guide.shape[:2] != d.shape:
        raise InputError(f"disparity {d.shape} and image {guide.shape[:2]} differ in size: of two photographs")
    known = np.isfinite(d)
    if not known.any():
        raise InputError("the disparity is unknown everywhere: there is nothing to focus by")
    weight, value = _weights(d, known, sigma_px), np.where(known, d, 0)
    planes = np.stack([weight, weight * value, weight * value * value], axis=-1) + np.float32(0)
    total, first, second = np.moveaxis(_domain_transform(planes, guide), -1, 0)
    reached = total > 1e-7  # below lies rounding
    mean = np.where(reached, first / np.maximum(total, 1e-7), np.nan)
    scatter = np.sqrt(np.maximum(second / np.maximum(total, 1e-7) - mean**2, 0))
    if not reached.all():
        mean, scatter = fill_unknown(mean), np.where(reached, scatter, 1.0)
    return mean.astype(np.float32), scatter.astype(np.float32)


def _weights(d: np.ndarray, known: np.ndarray, sigma_px: np.ndarray | None) -> np.ndarray:
    """Return inverse variances with a maximum of 1, reduced for outliers; (H, W) float32."""
    sigma = np.full(d.shape, _MIN_SIGMA_PX, np.float32) if sigma_px is None else np.asarray(sigma_px, np.float32)
    precise = known & np.isfinite(sigma)
    weight = np.where(precise, 1 / (np.square(np.where(precise, sigma, 1)) + _MIN_SIGMA_PX**2), 0)
    if not weight.any():
        weight = known.astype(np.float64)
    weight = (weight / weight.max()).astype(np.float32)
    median = cv2.medianBlur(np.where(known, d, np.float32(np.median(d[known]))), 5)
    weight *= np.where(np.abs(np.where(known, d, 0) - median) < _OUTLIER_PX, np.float32(1), np.float32(_OUTLIER_WEIGHT))
    return weight


def _domain_transform(planes: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """Average planes (H, W, C) along rows and columns in turn; the recursive filter of Gastal and Oliveira 2011."""
    tone = np.sqrt(np.maximum(cv2.GaussianBlur(np.asarray(guide, np.float32), (0, 0), 1.0), 0))
    tone /= max(float(np.percentile(tone, 99)), 1e-6)
    across, down = _steps(tone)
    del tone  # of many megapixels it is large
    for i in range(_ROUNDS):
        reach = _REACH_PX * np.sqrt(3) * 2.0 ** (_ROUNDS - 1 - i) / np.sqrt(4.0**_ROUNDS - 1)
        decay = np.float32(np.exp(-np.sqrt(2) / reach))
        for step in (across, down.T):  # rows, then columns
            along = np.ascontiguousarray(decay ** (1 + step * np.float32(_REACH_PX)))
            over_rows(_average_rows, len(planes), planes, along)
            planes = np.ascontiguousarray(planes.transpose(1, 0, 2))
    return planes


def _steps(tone: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps of tone from the left and from above, in units of `_COLOUR_RANGE`; two (H, W) float32."""
    across, down = np.zeros((2, *tone.shape[:2]), np.float32)

    def fill(band: slice) -> None:
        part = tone[max(band.start - 1, 0) : band.stop]
        across[band, 1:] = np.abs(np.diff(tone[band], axis=1)).sum(axis=2) / np.float32(_COLOUR_RANGE)
        steps = np.abs(np.diff(part, axis=0)).sum(axis=2) / np.float32(_COLOUR_RANGE)
        down[band.stop - len(steps) : band.stop] = steps

    each_band(fill, len(tone))
    return across, down


@compiled()
def _average_rows(planes, decay, first, last):  # type: ignore[no-untyped-def]
    """Average along the rows, forwards and backwards, in place; decay is that of the step from the left."""
    _, width, count = planes.shape
    for y in range(first, last):
        for x in range(1, width):
            a = decay[y, x]
            for c in range(count):
                planes[y, x, c] += a * (planes[y, x - 1, c] - planes[y, x, c])
        for x in range(width - 2, -1, -1):
            a = decay[y, x + 1]
            for c in range(count):
                planes[y, x, c] += a * (planes[y, x + 1, c] - planes[y, x, c])

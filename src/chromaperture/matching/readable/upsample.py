"""From the working scale to the photograph's pixels, in NumPy: the oracle of ``compiled/upsample.py``.

Within a surface the maps are interpolated linearly. Where the four working pixels around a pixel are not of one
surface, the photograph decides, in its own pixels: the pixel belongs to the side whose working pixels are nearer and
more like it, and takes their mean. No mean is taken over a depth edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Px of the working scale by which disparities of four neighbours differ where they are of two surfaces; chosen by hand:
# the steepest slants of bench50's scenes have 0.05.
JUMP_PX = 0.25
LEAST_WEIGHT = 1e-3  # of a neighbour, of 1: where all of a side are as far away as they can be, their mean is taken


class Coarse(NamedTuple):
    """Maps at the working scale, (h, w) float32 each and without NaN."""

    disparity_px: np.ndarray
    sigma_px: np.ndarray
    confidence: np.ndarray  # in [0, 1]
    unknown: np.ndarray  # bool; there the maps hold what was filled in
    guide: np.ndarray  # centre view, in units of ``guide_range``


def places(count: int, coarse_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return, for every pixel along a side, the working pixel before it and the share of the one after.

    Returns ``before`` (count,) int32, at most ``coarse_count - 2``, at least 0; ``share`` (count,) float32 in [0, 1].
    """
    at = (np.arange(count) + 0.5) * (coarse_count / count) - 0.5
    before = np.clip(np.floor(at), 0, max(coarse_count - 2, 0)).astype(np.int32)
    return before, np.clip(at - before, 0, 1).astype(np.float32)


def upsample(coarse: Coarse, image: np.ndarray, guide_rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bring maps to the pixels of the photograph.

    Parameters
    ----------
    coarse : Coarse
    image : (H, W, 3) float32, linear RGB
    guide_rgb : (3,) float
        Weights of R, G, B in the guide, in units of ``guide_range``.

    Returns
    -------
    disparity_px, sigma_px, confidence : (H, W) float32; px of the photograph, NaN and 0 where unknown
    """
    height, width = image.shape[:2]
    h, w = coarse.guide.shape
    (rows, down), (columns, right) = places(height, h), places(width, w)
    below, beside = np.minimum(rows + 1, h - 1), np.minimum(columns + 1, w - 1)
    corners = [(r[:, None], c[None]) for r in (rows, below) for c in (columns, beside)]
    shares = [a[:, None] * b[None] for a in (1 - down, down) for b in (1 - right, right)]

    guide = image @ np.asarray(guide_rgb, np.float32)
    disparity = np.stack([coarse.disparity_px[at] for at in corners])
    low, high = disparity.min(axis=0), disparity.max(axis=0)
    one_surface, middle = high - low <= JUMP_PX, (low + high) / 2
    near = np.stack(shares) + np.where(one_surface, np.float32(0), np.float32(LEAST_WEIGHT))
    like = near / (1 + np.stack([guide - coarse.guide[at] for at in corners]) ** 2)
    nearer = disparity < middle
    first = (like * nearer).sum(axis=0) > (like * ~nearer).sum(axis=0)
    weight = np.where(one_surface | (nearer == first), near, 0)
    weight /= weight.sum(axis=0)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray((weight * np.stack([values[at] for at in corners])).sum(axis=0), np.float32)

    unknown = coarse.unknown[rows + (down >= 0.5) * (below - rows)][:, columns + (right >= 0.5) * (beside - columns)]
    factor, nan = np.float32(width / w), np.float32(np.nan)
    return (
        np.where(unknown, nan, mean(coarse.disparity_px) * factor),
        np.where(unknown, nan, mean(coarse.sigma_px) * factor),
        np.where(unknown, np.float32(0), mean(coarse.confidence)),
    )

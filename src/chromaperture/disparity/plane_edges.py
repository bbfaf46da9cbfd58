"""Where a near plane ends: the guide decides next to its border, not the evidence.

A window beside a depth edge sees both sides, and the near side's outline, which is as sharp as the picture and belongs
to the near side. So near planes come out too large by up to the window's reach. Inside a band along their border no
evidence counts: the border lies where the picture changes most.
"""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np

from chromaperture.disparity.plane_merging import neighbouring_pairs
from chromaperture.threads import parallel_map


class Beliefs(Protocol):
    """`stages.potts_beliefs`."""

    def __call__(self, cost: np.ndarray, links: np.ndarray, *, sweeps: int) -> np.ndarray:
        """Cost of every choice at every pixel, with the best of all others; (H, W, K)."""


OUTWARD_PX = 3  # by which a near plane may also grow
STEEPNESS = 4.0  # a border on the steepest edge in reach costs exp(-4) of one on an even guide
LEAST_LINK = 0.03  # keeps borders short on the steepest edges
SMOOTHING_PX = 2.0  # of the guide; its noise is no edge
CORE = 0.75  # of the half-width of a thin plane: so much of it stays, however wide the band
GRID = 2  # px; borders are found on every second pixel
_FORBIDDEN = 1e3
_SWEEPS = 10


def edges_by_guide(
    choice: np.ndarray, planes: np.ndarray, guide: np.ndarray, *, reach_px: int, apart_px: float, beliefs: Beliefs
) -> np.ndarray:
    """Move the borders of near planes to the guide's edges.

    Parameters
    ----------
    choice : (H, W) int
        Plane of every pixel.
    planes : (K, 3) float
    guide : (H, W) float
    reach_px : int
        Width of the band inside a near plane's border.
    apart_px : float
        Labels by which two planes must differ for one to be near.
    beliefs : callable
        `stages.potts_beliefs`.

    Returns
    -------
    (H, W) int
    """
    height, width = choice.shape
    coarse = choice[::GRID, ::GRID]
    used, coarse = np.unique(coarse, return_inverse=True)
    coarse = coarse.reshape(-(-height // GRID), -(-width // GRID))
    y, x = np.mgrid[0:height:GRID, 0:width:GRID]
    label = planes[used, 0] * x[..., None] + planes[used, 1] * y[..., None] + planes[used, 2]
    possible = _possible(coarse, label, reach_px / GRID, apart_px)
    if not (possible.sum(axis=2) > 1).any():
        return choice
    cost = np.where(possible, 0, _FORBIDDEN).astype(np.float32)
    believed = beliefs(cost, _links(guide, reach_px)[:, ::GRID, ::GRID], sweeps=_SWEEPS)
    moved = np.where(possible, believed, np.inf).argmin(axis=2)
    rows, columns = np.arange(height) // GRID, np.arange(width) // GRID
    free = (possible.sum(axis=2) > 1)[rows[:, None], columns]
    return np.where(free, used[moved[rows[:, None], columns]], choice)


def _possible(choice: np.ndarray, label: np.ndarray, reach: float, apart_px: float) -> np.ndarray:
    """Planes that a pixel may lie on: its own, and next to a border between near and far the other; (h, w, K)."""
    possible = np.zeros(label.shape, bool)
    np.put_along_axis(possible, choice[..., None], True, axis=2)
    pairs = neighbouring_pairs(choice)
    if not pairs:
        return possible
    wide = np.ones((int(2 * reach) + 1, int(2 * reach) + 1), np.uint8)

    def of_plane(k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the plane is, the distance of all pixels from it, and the core that stays of it where it is thin."""
        here = choice == k
        inside = _distance(here)
        half_width = cv2.dilate(inside, wide)
        return here, _distance(~here), (inside >= CORE * half_width) & (half_width < reach)

    each = sorted({k for pair in pairs for k in pair})
    parts = parallel_map(of_plane, each)
    here, away, thin_core = (dict(zip(each, maps, strict=True)) for maps in zip(*parts, strict=True))
    for i, j in sorted(pairs):
        for near, far in ((i, j), (j, i)):
            nearer = label[..., far] > label[..., near] + apart_px
            possible[..., far] |= here[near] & nearer & (away[far] <= reach) & ~thin_core[near]
            possible[..., near] |= here[far] & nearer & (away[near] <= OUTWARD_PX / GRID)
    return possible


def _links(guide: np.ndarray, reach_px: int) -> np.ndarray:
    """Cost of a border between two pixels, by the steepest edge in reach; (2, H, W) float32."""
    smooth = cv2.GaussianBlur(np.asarray(guide, np.float32), (0, 0), SMOOTHING_PX)
    steps = np.abs(
        np.stack([np.diff(smooth, axis=1, append=smooth[:, -1:]), np.diff(smooth, axis=0, append=smooth[-1:])])
    )
    steepest = cv2.dilate(np.hypot(*steps), np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8))
    steepest = cv2.GaussianBlur(steepest, (0, 0), reach_px / 2) + np.float32(1e-6)  # 1e-6: an even guide
    return np.exp(-STEEPNESS * steps / steepest) + np.float32(LEAST_LINK)


def _distance(inside: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5))

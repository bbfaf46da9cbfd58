"""Remove from a view what would spoil a model: wide error bars, far points, flying pixels."""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.depth.error_limit import within_error
from chromaperture.products.rectified import View
from chromaperture.reconstruction.settings import ReconstructionConfig


def cleaned(view: View, config: ReconstructionConfig) -> View:
    """Remove wide error bars, far points and pixels at a step of depth: they become NaN."""
    z = view.z_mm
    certain = within_error(z, view.sigma_mm, config.max_relative_sigma)
    with np.errstate(invalid="ignore"):
        kept = (certain > 0) & (certain <= config.max_distance_mm)
    kept &= ~near_steps(z, jump=config.edge_jump, reach_px=config.edge_px)
    nan = np.float32(np.nan)
    return View(view.color, np.where(kept, z, nan), np.where(kept, view.sigma_mm, nan), view.time_s, view.index)


def near_steps(z_mm: np.ndarray, *, jump: float, reach_px: int) -> np.ndarray:
    """Find flying pixels: those near a relative step of depth.

    ``z_mm`` (H, W) float32, NaN unknown; ``jump``: least step relative to the distance; ``reach_px``: half width of the
    neighbourhood. Returns (H, W) bool.
    """
    known = np.isfinite(z_mm) & (z_mm > 0)
    inverse = np.where(known, 1.0 / np.where(known, z_mm, 1.0), np.nan).astype(np.float32)  # planes are linear in 1 / z
    window = np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)
    nearest = cv2.dilate(np.where(known, inverse, -1.0), window, borderType=cv2.BORDER_REPLICATE)
    farthest = cv2.erode(np.where(known, inverse, 1e9), window, borderType=cv2.BORDER_REPLICATE)
    return known & (nearest - farthest > jump * np.where(known, inverse, 1.0))


def scaled(camera_matrix: np.ndarray, scale: int) -> np.ndarray:
    """Return the camera matrix of the reduced picture, whose pixel centres lie at (scale - 1) / 2 of the full one's."""
    matrix = np.array(camera_matrix, float)
    matrix[:2] /= scale
    matrix[:2, 2] -= (scale - 1) / (2 * scale)
    return matrix

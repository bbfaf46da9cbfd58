"""Convert maps to pictures, fast enough for a live page."""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.color.color_maps import DISTANCE, draw_levels

BAR_PX = 70  # width of the colour bar with its labels


def depth_picture(depth_mm: np.ndarray, *, near_mm: float, far_mm: float) -> np.ndarray:
    """Colour a depth map as `color_maps` says, and add a bar in mm; (H, W + BAR_PX, 3) uint8 sRGB.

    Colours are linear in 1 / distance, in which the error of a measurement is uniform.

    Parameters
    ----------
    depth_mm : (H, W) float, NaN or not positive where unknown
    near_mm, far_mm : float
        Distances of the ends of the bar, 0 < near < far.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(depth_mm > 0, 1 / depth_mm, np.nan)
    span = 1 / near_mm - 1 / far_mm
    picture = draw_levels((1 / near_mm - inverse) / span, DISTANCE)
    height = depth_mm.shape[0]
    bar = draw_levels(np.repeat(np.linspace(0, 1, height)[:, None], BAR_PX, axis=1), DISTANCE)
    bar[:, 16:] = 32
    for row in np.linspace(8, height - 8, 6).astype(int):
        distance = 1 / (1 / near_mm - row / (height - 1) * span)
        cv2.putText(bar, f"{distance:.0f}", (20, int(row) + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1)
    return np.hstack([picture, bar])


def confidence_picture(confidence: np.ndarray) -> np.ndarray:
    """Return a grey picture of confidence, white is 1; (H, W, 3) uint8."""
    grey = np.rint(np.clip(np.nan_to_num(confidence), 0, 1) * 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)

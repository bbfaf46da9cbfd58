"""Maps as pictures, fast enough for a live page."""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.color.srgb import linear_to_srgb_bytes

_BAR_PX = 70


def depth_picture(depth_mm: np.ndarray, *, near_mm: float, far_mm: float) -> np.ndarray:
    """Colour a depth map, near is red, unknown is black, and put a bar with mm beside it; (H, W + 70, 3) uint8 RGB.

    Colours are even in 1 / distance, as the error of a measurement is.
    """
    known = np.isfinite(depth_mm) & (depth_mm > 0)
    span = 1 / near_mm - 1 / far_mm
    share = (1 / np.where(known, depth_mm, far_mm) - 1 / far_mm) / span
    picture = _turbo(np.clip(share, 0, 1))
    picture[~known] = 0
    height = depth_mm.shape[0]
    bar = _turbo(np.repeat(np.linspace(1, 0, height)[:, None], _BAR_PX, axis=1))
    bar[:, 16:] = 32
    for row in np.linspace(8, height - 8, 6).astype(int):
        distance = 1 / (1 / far_mm + (1 - row / (height - 1)) * span)
        cv2.putText(bar, f"{distance:.0f}", (20, int(row) + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1)
    return np.hstack([picture, bar])


def confidence_picture(confidence: np.ndarray) -> np.ndarray:
    """Grey picture of confidence, white is 1; (H, W, 3) uint8."""
    grey = np.rint(np.clip(np.nan_to_num(confidence), 0, 1) * 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def color_picture(color: np.ndarray) -> np.ndarray:
    """8-bit sRGB of linear light; (H, W, 3) uint8."""
    return linear_to_srgb_bytes(color)


def _turbo(share: np.ndarray) -> np.ndarray:
    level = np.rint(share * 255).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(level, cv2.COLORMAP_TURBO)[..., ::-1])

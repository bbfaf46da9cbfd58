"""Convert maps to pictures, fast enough for a live page."""

from __future__ import annotations

import cv2
import numpy as np

_BAR_PX = 70  # width of the colour bar with its labels


def depth_picture(depth_mm: np.ndarray, *, near_mm: float, far_mm: float) -> np.ndarray:
    """Colour a depth map, near is red, unknown is black, and add a bar in mm; (H, W + 70, 3) uint8 RGB.

    Colours are linear in 1 / distance, in which the error of a measurement is uniform.
    """
    known = np.isfinite(depth_mm) & (depth_mm > 0)
    span = 1 / near_mm - 1 / far_mm
    level = (1 / np.where(known, depth_mm, far_mm) - 1 / far_mm) / span
    picture = _turbo(np.clip(level, 0, 1))
    picture[~known] = 0
    height = depth_mm.shape[0]
    bar = _turbo(np.repeat(np.linspace(1, 0, height)[:, None], _BAR_PX, axis=1))
    bar[:, 16:] = 32
    for row in np.linspace(8, height - 8, 6).astype(int):
        distance = 1 / (1 / far_mm + (1 - row / (height - 1)) * span)
        cv2.putText(bar, f"{distance:.0f}", (20, int(row) + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1)
    return np.hstack([picture, bar])


def confidence_picture(confidence: np.ndarray) -> np.ndarray:
    """Return a grey picture of confidence, white is 1; (H, W, 3) uint8."""
    grey = np.rint(np.clip(np.nan_to_num(confidence), 0, 1) * 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def _turbo(level: np.ndarray) -> np.ndarray:
    index = np.rint(level * 255).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(index, cv2.COLORMAP_TURBO)[..., ::-1])

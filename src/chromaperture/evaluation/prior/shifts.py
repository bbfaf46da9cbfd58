"""Shared by the prior methods: sub-pixel shifts, box windows, the best of a stack of layers."""

from __future__ import annotations

import cv2
import numpy as np
import scipy.ndimage


def shifted(view: np.ndarray, dx: float, dy: float) -> np.ndarray:
    """Sample a view at (x + dx, y + dy); (H, W) float32, cubic, mirrored at the rim."""
    if dx == 0 and dy == 0:
        return np.asarray(view, np.float32)
    # Splines: OpenCV's cubic resampling moves a ramp by up to 0.05 px.
    return np.asarray(scipy.ndimage.shift(np.asarray(view, np.float32), (-dy, -dx), order=3, mode="mirror"))


def box(picture: np.ndarray, side_px: int) -> np.ndarray:
    """Mean over a square window; (H, W) float64."""
    mean = cv2.boxFilter(np.asarray(picture, np.float64), -1, (side_px, side_px), borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(mean)


def best_layer(score: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
    """Disparity of the largest score, refined by a parabola; NaN where it lies at an end of the range.

    Parameters
    ----------
    score : (D, H, W) float
    layers_px : (D,) float, evenly spaced

    Returns
    -------
    (H, W) float64, px
    """
    best = score.argmax(axis=0)
    inner = np.clip(best, 1, len(layers_px) - 2)
    below, at, above = (np.take_along_axis(score, (inner + k)[None], axis=0)[0] for k in (-1, 0, 1))
    bend = below - 2 * at + above
    offset = np.where(bend < 0, 0.5 * (below - above) / np.where(bend < 0, bend, -1.0), 0.0)
    found = layers_px[inner] + np.clip(offset, -0.5, 0.5) * (layers_px[1] - layers_px[0])
    return np.where(best == inner, found, np.nan)

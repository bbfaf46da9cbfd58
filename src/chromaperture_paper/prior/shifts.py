"""Sub-pixel shifts, box windows and the best of a stack of layers, for the prior methods."""

from __future__ import annotations

import cv2
import numpy as np
import scipy.ndimage

WINDOW_PX = 15  # side of the windows of the prior methods, the same for all; chosen by hand


def spline(view: np.ndarray) -> np.ndarray:
    """Fit a cubic spline to a view; return its coefficients for `sampled`, (H, W) float32."""
    view = np.asarray(view, np.float32)
    return np.asarray(scipy.ndimage.spline_filter(view, order=3, output=np.float32, mode="mirror"))


def sampled(coefficients: np.ndarray, dx: float, dy: float) -> np.ndarray:
    """Sample a view's spline at (x + dx, y + dy); (H, W) float32, mirrored at the rim.

    Splines, because OpenCV's cubic resampling shifts a ramp by up to 0.05 px. One shift for all pixels makes the four
    weights of an axis a filter.
    """
    x, y = _weights(dx), _weights(dy)
    return np.asarray(cv2.sepFilter2D(coefficients, -1, x, y, borderType=cv2.BORDER_REFLECT_101))


def _weights(shift: float) -> np.ndarray:
    """Return the weights of the coefficients about a pixel, for a value ``shift`` px beside it; float32."""
    whole = int(np.floor(shift))
    t = shift - whole
    reach = max(abs(whole - 1), abs(whole + 2))
    kernel = np.zeros(2 * reach + 1, np.float32)
    four = np.array([(1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3]) / 6
    kernel[reach + whole - 1 : reach + whole + 3] = four
    return kernel


def box(picture: np.ndarray) -> np.ndarray:
    """Average over a square window of WINDOW_PX; (H, W) float64."""
    values = np.asarray(picture, np.float64)
    return np.asarray(cv2.blur(values, (WINDOW_PX, WINDOW_PX), borderType=cv2.BORDER_REFLECT_101))


def best_layer(score: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
    """Return the disparity of the largest score, refined by a parabola; NaN at the ends of the range.

    ``score`` (D, H, W) float; ``layers_px`` (D,) float, evenly spaced. Returns (H, W) float64, px.
    """
    best = score.argmax(axis=0)
    inner = np.clip(best, 1, len(layers_px) - 2)
    below, at, above = (np.take_along_axis(score, (inner + k)[None], axis=0)[0] for k in (-1, 0, 1))
    bend = below - 2 * at + above
    offset = np.where(bend < 0, 0.5 * (below - above) / np.where(bend < 0, bend, -1.0), 0.0)
    found = layers_px[inner] + np.clip(offset, -0.5, 0.5) * (layers_px[1] - layers_px[0])
    return np.where(best == inner, found, np.nan)

"""The winner of the score volume, between the layers (paper Figure 9: layered against sub-pixel)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Winner(NamedTuple):
    """The best disparity of every pixel, before it is given an error bar.

    Attributes
    ----------
    disparity_px : (H, W) float32, px; NaN where the best layer is an end of the range.
    peak : (H, W) float32; score at the vertex of the parabola.
    curvature : (H, W) float32, 1/px^2; minus the second derivative of the score there, >= 0.
    spread_px : (H, W) float32 or None, px; width of the posterior of the layers, where an optimiser knows it.
    """

    disparity_px: np.ndarray
    peak: np.ndarray
    curvature: np.ndarray
    spread_px: np.ndarray | None = None


def parabola_winner(score: np.ndarray, layers_px: np.ndarray, *, lower_is_better: bool = False) -> Winner:
    """Take the best layer and refine it by a parabola through it and its neighbours.

    Parameters
    ----------
    score : (H, W, D) float
        D >= 3.
    layers_px : (D,) float, px
        Equally spaced.
    lower_is_better : bool
        The volume holds costs; its negative would be as large as itself, a GB of a large picture.
    """
    step = layers_px[1] - layers_px[0]
    best = score.argmin(axis=2) if lower_is_better else score.argmax(axis=2)
    sign = -1 if lower_is_better else 1
    inner = np.clip(best, 1, score.shape[2] - 2)
    left, center, right = (sign * np.take_along_axis(score, (inner + o)[..., None], 2)[..., 0] for o in (-1, 0, 1))
    bend = np.maximum(2 * center - left - right, 0)
    slope = right - left
    safe = np.where(bend > 1e-12, bend, 1.0)
    offset = np.where(bend > 1e-12, np.clip(slope / (2 * safe), -0.5, 0.5), 0.0)
    peak = center + np.where(bend > 1e-12, slope**2 / (8 * safe), 0.0)
    disparity = np.where(best == inner, layers_px[0] + step * (inner + offset), np.nan)
    return Winner(
        disparity.astype(np.float32), peak.astype(np.float32), (bend / step**2).astype(np.float32)
    )

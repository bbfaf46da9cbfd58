"""The best layer of every pixel, and what is known about it (paper Figure 9: layered against sub-pixel)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Winner(NamedTuple):
    """The best disparity of every pixel by its own scores, (H, W) float32 each."""

    disparity_px: np.ndarray  # px; NaN where the best layer is an end of the range
    peak: np.ndarray
    curvature: np.ndarray  # 1/px^2; minus the second derivative of the score there, >= 0


class Surface(NamedTuple):
    """A surface through a volume, (H, W) float32 each."""

    disparity_px: np.ndarray  # px; NaN unknown
    sigma_px: np.ndarray  # px; standard deviation of the posterior over the layers
    peak: np.ndarray  # correlation of the views at the surface's layer, in [0, 1]


class PathWinner(NamedTuple):
    """The best layer of every pixel by the costs of its paths, (H, W) float32 each."""

    layer: np.ndarray
    # ``before``, ``at``, ``after``: nats; log-likelihoods of the layer's neighbours and of the layer, which is moved
    # inside the: range by one where it is an end.
    before: np.ndarray
    at: np.ndarray
    after: np.ndarray
    # px; root mean square distance of the layers from the best, weighted by how little more they cost.
    sigma_px: np.ndarray
    # ``far_before``, ``far_after``: nats; log-likelihoods two layers from the layer, or at the end of the range.
    far_before: np.ndarray
    far_after: np.ndarray


def parabola_winner(score: np.ndarray, layers_px: np.ndarray, *, lower_is_better: bool = False) -> Winner:
    """Take the best layer and refine it by a parabola through it and its neighbours.

    ``score`` (H, W, D) float: D >= 3; ``layers_px`` (D,) float, px: equally spaced; ``lower_is_better``: the volume
    holds costs. A negated copy would take as much memory again.
    """
    step = layers_px[1] - layers_px[0]
    best = score.argmin(axis=2) if lower_is_better else score.argmax(axis=2)
    sign = -1 if lower_is_better else 1
    inner = np.clip(best, 1, score.shape[2] - 2)
    left, center, right = (sign * np.take_along_axis(score, (inner + o)[..., None], 2)[..., 0] for o in (-1, 0, 1))
    bend = np.maximum(2 * center - left - right, 0)
    slope = right - left
    safe = np.where(bend > 1e-12, bend, 1.0)  # 1e-12: a flat top has no vertex; scores are of order 1
    offset = np.where(bend > 1e-12, np.clip(slope / (2 * safe), -0.5, 0.5), 0.0)
    peak = center + np.where(bend > 1e-12, slope**2 / (8 * safe), 0.0)
    disparity = np.where(best == inner, layers_px[0] + step * (inner + offset), np.nan)
    return Winner(disparity.astype(np.float32), peak.astype(np.float32), (bend / step**2).astype(np.float32))

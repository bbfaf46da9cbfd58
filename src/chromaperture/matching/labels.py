"""Labels, the common name of equal depth at pixels whose disparities differ, and the best one of every pixel.

Field curvature and vignetting bend the disparity of a flat wall. Smoothness of the disparity itself would work against
the lens; with labels of equal depth the wall is constant.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import NamedTuple

import numpy as np

# Px by which the views farthest apart move between two labels at most. Correlations have a cusp where views agree,
# which labels farther apart miss: docs/decisions.md, *Cells*.
MOST_APART_PX = 0.5


class LabelMap(NamedTuple):
    """What a label means at every pixel: ``disparity = offset_px + scale * label``."""

    offset_px: np.ndarray  # (H, W) float32, px
    scale: np.ndarray  # (H, W) float32: only `IDENTITY` is (1, 1)

    @property
    def is_identity(self) -> bool:
        """Whether labels are disparities."""
        return self.scale.size == 1

    def disparity(self, label: np.ndarray) -> np.ndarray:
        """Return the disparity of every pixel for its label; (H, W) px."""
        return np.asarray(self.offset_px + self.scale * label)

    def halved(self) -> LabelMap:
        """Return the map at the pixels of the halved picture, whose disparities are half as large."""
        offset, scale = (np.ascontiguousarray(part[::2, ::2], np.float32) for part in self)
        return LabelMap(offset / 2, scale)

    def first_layer(self, layers_px: np.ndarray) -> np.ndarray:
        """Return where the label of the first of some layers lies at every pixel, in layers from that one."""
        return np.asarray((self.offset_px + (self.scale - 1) * layers_px[0]) / float(layers_px[1] - layers_px[0]))

    def at(self, rows: np.ndarray, columns: np.ndarray) -> LabelMap:
        """Return the map at some rows and columns of pixels."""
        return self if self.is_identity else LabelMap(*(part[np.ix_(rows, columns)] for part in self))

    def of_cells(self, cell_px: int) -> LabelMap:
        """Return the map at every so manyth pixel; disparities stay as they are."""
        return LabelMap(*(np.ascontiguousarray(part[::cell_px, ::cell_px]) for part in self))


# A lens that shows equal depth at equal disparity all over the frame.
IDENTITY = LabelMap(np.zeros((1, 1), np.float32), np.ones((1, 1), np.float32))


def label_map(
    infinity_disparity_px: np.ndarray, scale_px_mm: np.ndarray, *, reference: tuple[float, float]
) -> LabelMap:
    """Return the map whose labels are the disparities of a reference pixel at the same depth.

    From ``d = A - B / z`` here and ``label = A0 - B0 / z`` there.

    ``infinity_disparity_px`` (H, W) float, px: a of the views that are matched; ``scale_px_mm`` (H, W) float, px mm: B;
    ``reference`` (float, float): A0 and B0, the same for all views of a camera.
    """
    scale = scale_px_mm / reference[1]
    offset = infinity_disparity_px - scale * reference[0]
    return LabelMap(offset.astype(np.float32), scale.astype(np.float32))


def labels_between(layers_px: np.ndarray, directions: np.ndarray, *, most_px: float = MOST_APART_PX) -> np.ndarray:
    """Return the labels to choose among: the layers, and so many between two of them that the views move little.

    ``layers_px`` (D,) float, px: equally spaced; ``directions`` (K, 2) float: displacement of each view per px of
    disparity; ``most_px``: by which two views move between two labels at most. Returns (N,) float64, px; every n-th is
    a layer.
    """
    apart = max(float(np.linalg.norm(a - b)) for a, b in combinations(np.asarray(directions), 2))
    step = layers_px[1] - layers_px[0]
    parts = max(1, math.ceil(apart * step / most_px - 1e-6))  # 1e-6: what fits but for rounding fits
    return np.asarray(layers_px[0] + step / parts * np.arange(parts * (len(layers_px) - 1) + 1))


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

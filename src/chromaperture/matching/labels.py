"""Labels: the common name of equal depth at pixels whose disparities differ.

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

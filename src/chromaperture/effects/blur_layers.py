"""Divide a picture into layers of equal blur; each pixel is weighted linearly between two neighbouring layers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

# Distance of two layers in blur radius: the larger of a step, px, and a fraction of the radius, because a large blur
# changes slowly. Chosen by hand; not tuned. Finer layers cost one transform each.
_STEP_PX, _GROWTH = 0.5, 0.10


def layer_radii(radius_px: np.ndarray, *, growth: float = _GROWTH) -> np.ndarray:
    """Choose blur radii that cover the range of a picture, fine near focus and coarser beyond.

    ``radius_px`` (H, W) float32, px, no NaN; ``growth``: distance of two layers, of their radius; at least half a px.
    Returns (L,) float64, px, rising; one of them is 0 unless the whole picture lies on one side of focus.
    """
    low, high = float(radius_px.min()), float(radius_px.max())
    sides = []
    for reach in (max(-low, 0.0), max(high, 0.0)):
        nodes = [0.0]
        while nodes[-1] < reach:
            nodes.append(nodes[-1] + max(_STEP_PX, growth * nodes[-1]))
        sides.append(np.array(nodes))
    radii = np.concatenate([-sides[0][:0:-1], sides[1]])
    used = np.flatnonzero((radii >= low) & (radii <= high))
    if used.size == 0:  # between two nodes
        first = int(np.searchsorted(radii, low)) - 1
        return radii[first : first + 2]
    return radii[max(used[0] - 1, 0) if radii[used[0]] > low else used[0] : used[-1] + 2]


def layer_weights(radius_px: np.ndarray, radii: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the weight of every pixel in each layer, in the order of the radii; (H, W) float32 that sum to 1."""
    for i, center in enumerate(radii):
        weight = np.ones(radius_px.shape, np.float32)
        if i > 0:
            weight = np.minimum(weight, (radius_px - np.float32(radii[i - 1])) / np.float32(center - radii[i - 1]))
        if i + 1 < len(radii):
            weight = np.minimum(weight, (np.float32(radii[i + 1]) - radius_px) / np.float32(radii[i + 1] - center))
        yield np.clip(weight, 0, 1, out=weight)

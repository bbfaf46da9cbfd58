"""A picture cut into layers of equal blur; two neighbouring layers share the light between them linearly."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

_STEP_PX = 0.5  # of blur radius, close to focus
_GROWTH = 0.10  # of the radius itself, beyond: a large blur changes slowly


def layer_radii(radius_px: np.ndarray, *, step_px: float = _STEP_PX, growth: float = _GROWTH) -> np.ndarray:
    """Choose blur radii that span a picture's, fine near focus and coarser beyond.

    Parameters
    ----------
    radius_px : (H, W) float32, px, no NaN
    step_px, growth : float
        Distance of two layers: the larger of the step and this share of the radius.

    Returns
    -------
    (L,) float64, rising, one of them 0 unless the whole picture lies to one side
    """
    low, high = float(radius_px.min()), float(radius_px.max())
    sides = []
    for reach in (max(-low, 0.0), max(high, 0.0)):
        nodes = [0.0]
        while nodes[-1] < reach:
            nodes.append(nodes[-1] + max(step_px, growth * nodes[-1]))
        sides.append(np.array(nodes))
    radii = np.concatenate([-sides[0][:0:-1], sides[1]])
    used = np.flatnonzero((radii >= low) & (radii <= high))
    if used.size == 0:  # between two nodes
        first = int(np.searchsorted(radii, low)) - 1
        return radii[first : first + 2]
    return radii[max(used[0] - 1, 0) if radii[used[0]] > low else used[0] : used[-1] + 2]


def shares(radius_px: np.ndarray, radii: np.ndarray) -> Iterator[np.ndarray]:
    """Share of every pixel in each layer, in the order of the radii; yields (H, W) float32 that sum to 1."""
    for i, center in enumerate(radii):
        share = np.ones(radius_px.shape, np.float32)
        if i > 0:
            share = np.minimum(share, (radius_px - np.float32(radii[i - 1])) / np.float32(center - radii[i - 1]))
        if i + 1 < len(radii):
            share = np.minimum(share, (np.float32(radii[i + 1]) - radius_px) / np.float32(radii[i + 1] - center))
        yield np.clip(share, 0, 1, out=share)

"""Averages along a surface on an even guide, in plain NumPy: the oracle of ``compiled/smoothing.py``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from chromaperture.matching.readable.bilateral import even_link


def smooth_along_surface(
    maps: Sequence[np.ndarray], guide: np.ndarray, layer: np.ndarray, *, sigma_px: float
) -> list[np.ndarray]:
    """Sum maps over their neighbourhood, weighted along paths on which the guide is even and the surface has no step.

    Parameters
    ----------
    maps : sequence of (H, W) float32
    guide : (H, W) float32, in units of ``guide_range``
    layer : (H, W) float32
        Index of every pixel's layer; there is no link between pixels more than one layer apart.
    sigma_px : float
        Reach on an even guide; 0 returns the maps.

    Returns
    -------
    list of (H, W) float
    """
    links = [_links(guide, layer, axis, even_link(sigma_px)) for axis in (1, 0)]
    return [_both_ways(_both_ways(values, links[0], axis=1), links[1], axis=0) for values in maps]


def _links(guide: np.ndarray, layer: np.ndarray, axis: int, on_even: float) -> np.ndarray:
    """Weight of the link from each pixel to the one before it; 0 for the first; (H, W)."""
    links = np.zeros(guide.shape, np.float32)
    to = np.s_[:, 1:] if axis == 1 else np.s_[1:]
    links[to] = on_even * np.exp(-np.abs(np.diff(guide, axis=axis)))
    links[to] *= np.abs(np.diff(layer, axis=axis)) <= 1
    return links


def _both_ways(maps: np.ndarray, links: np.ndarray, *, axis: int) -> np.ndarray:
    """Sum of the recursions from both ends of an axis, the sample itself counted once; (H, W) float64."""
    x, link = np.moveaxis(maps, axis, 0).astype(np.float64), np.moveaxis(links, axis, 0)
    forward, backward = x.copy(), x.copy()
    for i in range(1, len(x)):
        forward[i] += link[i] * forward[i - 1]
    for i in range(len(x) - 2, -1, -1):
        backward[i] += link[i + 1] * backward[i + 1]
    return np.moveaxis(forward + backward - x, 0, axis)

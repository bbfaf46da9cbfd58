"""From the halved picture to full resolution, steered by the guide, in NumPy: the oracle of ``compiled/enlarge.py``."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.labels import Surface

JUMP_PX = 1.0  # disparities farther apart belong to two surfaces: a pixel between them takes one of them, no mean


def enlarge(surface: Surface, guide: np.ndarray) -> Surface:
    """Bring a surface to full resolution; pixels in between take more of the neighbour whose guide is like theirs.

    Parameters
    ----------
    surface : Surface, (h, w)
        Disparities in px of the full picture.
    guide : (H, W) float32, in units of ``guide_range``; h = ceil(H / 2), w = ceil(W / 2)

    Returns
    -------
    Surface, (H, W)
    """
    wide = _between(np.stack(surface), guide[::2], axis=1)
    return Surface(*_between(wide, guide, axis=0).astype(np.float32))


def _between(maps: np.ndarray, guide: np.ndarray, *, axis: int) -> np.ndarray:
    """Fill in every second sample along an axis of (3, h, w) maps; the guide (h, w) is already enlarged there."""
    maps, guide = np.moveaxis(maps, axis + 1, 0), np.moveaxis(guide, axis, 0)
    before = maps[: len(guide) // 2]
    after = np.concatenate([maps[1:], maps[-1:]])[: len(before)]
    here, at_before = guide[1::2], guide[0::2][: len(before)]
    at_after = np.concatenate([guide[2::2], guide[-1:]])[: len(before)]
    to_before, to_after = (here - at_before) ** 2, (here - at_after) ** 2
    weight = (1 + to_before) / (2 + to_before + to_after)  # of the sample after
    with np.errstate(invalid="ignore"):
        apart = np.abs(after[:, 0] - before[:, 0]) > JUMP_PX
    weight = np.where(apart, weight > 0.5, weight)
    weight = np.where(np.isnan(before[:, 0]), 1, np.where(np.isnan(after[:, 0]), 0, weight))[:, None]
    mixed = np.where(weight <= 0, before, np.where(weight >= 1, after, before + weight * (after - before)))
    out = np.empty((len(guide), *maps.shape[1:]), np.float32)
    out[::2], out[1::2] = maps, mixed
    return np.moveaxis(out, 0, axis + 1)

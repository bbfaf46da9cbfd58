# mypy: disallow-untyped-defs=False
"""Averages along a surface, compiled; ``readable/smoothing.py`` explains what is computed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from chromaperture.matching.compiled.bands import fading
from chromaperture.matching.compiled.layout import ONE, ZERO, inner, kernel
from chromaperture.matching.readable.bilateral import even_link
from chromaperture.system.threads import in_parallel


def smooth_along_surface(
    maps: Sequence[np.ndarray], guide: np.ndarray, layer: np.ndarray, *, sigma_px: float
) -> list[np.ndarray]:
    """Sum maps over their neighbourhood, as `readable.smooth_along_surface`; float32."""
    out = [np.array(values, np.float32) for values in maps]
    guide, link = np.ascontiguousarray(guide, np.float32), np.float32(even_link(sigma_px))

    def smooth(_: int, first: int, last: int) -> None:
        for values in out[first:last]:
            _smooth_in_place(values, guide, layer, link)

    in_parallel(smooth, len(out))
    return out


@kernel
def _smooth_in_place(maps, guide, layer, even_link):
    """Smooth a map (H, W) in place along x, then along y."""
    height, width = maps.shape
    links, ahead = np.empty(width + 1, np.float32), np.empty(width, np.float32)
    for y in range(height):
        row = maps[y]
        _links_between(guide[y, 1:], guide[y, : width - 1], layer[y, 1:], layer[y, : width - 1], even_link, links[1:])
        state = ZERO
        for x in range(width):
            state = row[x] + links[x] * state if x > 0 else row[x]
            ahead[x] = state
        state = ZERO
        for x in range(width - 1, -1, -1):
            own = row[x]
            row[x] = ahead[x] + state
            state = links[x] * (own + state)
    down = np.empty((height, width), np.float32)
    for x in range(width):  # assigning the row would compile Numba's check of the shapes and its texts: 2.8 s
        down[0, x] = maps[0, x]
    for y in range(1, height):
        _links_between(guide[y], guide[y - 1], layer[y], layer[y - 1], even_link, links)
        for x in range(width):
            down[y, x] = maps[y, x] + links[x] * down[y - 1, x]
    below = ahead
    below[:] = ZERO
    for y in range(height - 1, -1, -1):
        upper = max(y - 1, 0)
        _links_between(guide[y], guide[upper], layer[y], layer[upper], even_link, links)
        for x in range(width):
            own = maps[y, x]
            maps[y, x] = down[y, x] + below[x]
            below[x] = links[x] * (own + below[x])


@inner
def _links_between(here, before, layer, layer_before, even_link, links):
    for x in range(len(here)):
        links[x] = fading(here[x] - before[x], even_link) if abs(layer[x] - layer_before[x]) <= ONE else ZERO

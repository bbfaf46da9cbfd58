# mypy: disallow-untyped-defs=False
"""Compiled twins of `coarse.two_way` and `coarse.enlarge`: guided smoothing, guided interpolation."""

from __future__ import annotations

import numpy as np

from chromaperture.disparity.bands import fading
from chromaperture.disparity.coarse import JUMP_PX
from chromaperture.disparity.layout import ONE, ZERO, compiled, inner

_JUMP = np.float32(JUMP_PX)
_HALF = np.float32(0.5)


@compiled
def smooth_surface(maps, guide, layer, near):
    """Smooth a map (H, W) in place along x and y, as `coarse.two_way` with `coarse.smoothing_links`."""
    height, width = maps.shape
    links, ahead = np.empty(width + 1, np.float32), np.empty(width, np.float32)
    for y in range(height):
        row = maps[y]
        _links_between(guide[y, 1:], guide[y, : width - 1], layer[y, 1:], layer[y, : width - 1], near, links[1:])
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
    down[0] = maps[0]
    for y in range(1, height):
        _links_between(guide[y], guide[y - 1], layer[y], layer[y - 1], near, links)
        for x in range(width):
            down[y, x] = maps[y, x] + links[x] * down[y - 1, x]
    below = ahead
    below[:] = ZERO
    for y in range(height - 1, -1, -1):
        upper = max(y - 1, 0)
        _links_between(guide[y], guide[upper], layer[y], layer[upper], near, links)
        for x in range(width):
            own = maps[y, x]
            maps[y, x] = down[y, x] + below[x]
            below[x] = links[x] * (own + below[x])


@inner
def _links_between(here, before, layer, layer_before, near, links):
    for x in range(len(here)):
        links[x] = fading(here[x] - before[x], near) if abs(layer[x] - layer_before[x]) <= ONE else ZERO


@compiled
def fill_columns(a0, a1, a2, a3, guide, top, bottom, b0, b1, b2, b3):
    """Every second row of the enlarged maps, from the rows ``top`` to before ``bottom`` of the small ones."""
    width = guide.shape[1]
    odd = width // 2
    share, after = np.empty(odd, np.float32), np.empty(odd, np.float32)
    before_guide, here_guide = np.empty(odd, np.float32), np.empty(odd, np.float32)
    after_guide = np.empty(odd, np.float32)
    for y in range(top, bottom):
        row = guide[2 * y]
        for x in range(odd):
            before_guide[x], here_guide[x] = row[2 * x], row[2 * x + 1]
            after_guide[x] = row[min(2 * x + 2, width - 1)]
        _follow(a0[y], after)
        _share(a0[y], after, before_guide, here_guide, after_guide, share)
        _spread_row(a0[y], after, share, b0[2 * y])
        _follow(a1[y], after)
        _spread_row(a1[y], after, share, b1[2 * y])
        _follow(a2[y], after)
        _spread_row(a2[y], after, share, b2[2 * y])
        _follow(a3[y], after)
        _spread_row(a3[y], after, share, b3[2 * y])


@compiled
def fill_rows(guide, top, bottom, b0, b1, b2, b3):
    """Fill in the odd rows, 2 top + 1 to before 2 bottom + 1, between the even ones."""
    height, width = guide.shape
    share = np.empty(width, np.float32)
    for y in range(top, bottom):
        here = 2 * y + 1
        below = here + 1 if here + 1 < height else here - 1
        at_below = min(here + 1, height - 1)
        _share(b0[here - 1], b0[below], guide[here - 1], guide[here], guide[at_below], share)
        _mix_row(b0[here - 1], b0[below], share, b0[here])
        _mix_row(b1[here - 1], b1[below], share, b1[here])
        _mix_row(b2[here - 1], b2[below], share, b2[here])
        _mix_row(b3[here - 1], b3[below], share, b3[here])


@inner
def _follow(row, after):
    """Right neighbour of every sample; the last is its own."""
    end = len(row) - 1
    for x in range(len(after)):
        after[x] = row[min(x + 1, end)]


@inner
def _share(before, after, before_guide, here_guide, after_guide, share):
    for x in range(len(share)):
        to_before, to_after = here_guide[x] - before_guide[x], here_guide[x] - after_guide[x]
        part = ONE + to_before * to_before
        part /= part + ONE + to_after * to_after
        hard = ONE if part > _HALF else ZERO
        part = hard if abs(after[x] - before[x]) > _JUMP else part
        part = ZERO if after[x] != after[x] else part
        share[x] = ONE if before[x] != before[x] else part


@inner
def _mix_row(before, after, share, out):
    for x in range(len(share)):
        a, b, part = before[x], after[x], share[x]
        mixed = a + part * (b - a)
        mixed = b if part >= ONE else mixed
        out[x] = a if part <= ZERO else mixed


@inner
def _spread_row(row, after, share, out):
    for x in range(len(row)):
        out[2 * x] = row[x]
    for x in range(len(share)):
        a, b, part = row[x], after[x], share[x]
        mixed = a + part * (b - a)
        mixed = b if part >= ONE else mixed
        out[2 * x + 1] = a if part <= ZERO else mixed

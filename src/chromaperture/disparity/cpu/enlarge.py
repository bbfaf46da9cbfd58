# mypy: disallow-untyped-defs=False
"""From the halved picture to full resolution, compiled; ``stages/enlarge.py`` explains what is computed."""

from __future__ import annotations

import numpy as np

from chromaperture.disparity.cpu.layout import ONE, ZERO, inner, kernel
from chromaperture.disparity.stages.enlarge import JUMP_PX
from chromaperture.disparity.winner import Surface
from chromaperture.threads import in_parallel

_JUMP = np.float32(JUMP_PX)
_HALF = np.float32(0.5)


def enlarge(surface: Surface, guide: np.ndarray) -> Surface:
    """Bring a surface to full resolution, as `stages.enlarge`."""
    guide = np.ascontiguousarray(guide, np.float32)
    out = Surface(*(np.empty(guide.shape, np.float32) for _ in range(3)))
    small = Surface(*(np.ascontiguousarray(part, np.float32) for part in surface))
    in_parallel(lambda _, top, bottom: _fill_columns(small, guide, top, bottom, out), len(small.peak))
    in_parallel(lambda _, top, bottom: _fill_rows(guide, top, bottom, out), len(guide) // 2)
    return out


@kernel
def _fill_columns(small, guide, top, bottom, out):
    """Every second row of the enlarged maps, from the rows ``top`` to before ``bottom`` of the small ones."""
    width = guide.shape[1]
    odd = width // 2
    weight, after = np.empty(odd, np.float32), np.empty(odd, np.float32)
    before_guide, here_guide = np.empty(odd, np.float32), np.empty(odd, np.float32)
    after_guide = np.empty(odd, np.float32)
    for y in range(top, bottom):
        row = guide[2 * y]
        for x in range(odd):
            before_guide[x], here_guide[x] = row[2 * x], row[2 * x + 1]
            after_guide[x] = row[min(2 * x + 2, width - 1)]
        _shift_left(small.disparity_px[y], after)
        _weigh(small.disparity_px[y], after, before_guide, here_guide, after_guide, weight)
        _fill_row(small.disparity_px[y], after, weight, out.disparity_px[2 * y])
        _shift_left(small.sigma_px[y], after)
        _fill_row(small.sigma_px[y], after, weight, out.sigma_px[2 * y])
        _shift_left(small.peak[y], after)
        _fill_row(small.peak[y], after, weight, out.peak[2 * y])


@kernel
def _fill_rows(guide, top, bottom, out):
    """Fill in the odd rows, 2 top + 1 to before 2 bottom + 1, between the even ones."""
    height, width = guide.shape
    weight = np.empty(width, np.float32)
    for y in range(top, bottom):
        here = 2 * y + 1
        below = here + 1 if here + 1 < height else here - 1
        at_below = min(here + 1, height - 1)
        disparity, sigma, peak = out.disparity_px, out.sigma_px, out.peak
        _weigh(disparity[here - 1], disparity[below], guide[here - 1], guide[here], guide[at_below], weight)
        _mix_row(disparity[here - 1], disparity[below], weight, disparity[here])
        _mix_row(sigma[here - 1], sigma[below], weight, sigma[here])
        _mix_row(peak[here - 1], peak[below], weight, peak[here])


@inner
def _shift_left(row, after):
    """Right neighbour of every sample; the last is its own."""
    end = len(row) - 1
    for x in range(len(after)):
        after[x] = row[min(x + 1, end)]


@inner
def _weigh(before, after, before_guide, here_guide, after_guide, weight):
    for x in range(len(weight)):
        to_before, to_after = here_guide[x] - before_guide[x], here_guide[x] - after_guide[x]
        part = ONE + to_before * to_before
        part /= part + ONE + to_after * to_after
        hard = ONE if part > _HALF else ZERO
        part = hard if abs(after[x] - before[x]) > _JUMP else part
        part = ZERO if after[x] != after[x] else part
        weight[x] = ONE if before[x] != before[x] else part


@inner
def _mix_row(before, after, weight, out):
    for x in range(len(weight)):
        a, b, part = before[x], after[x], weight[x]
        mixed = a + part * (b - a)
        mixed = b if part >= ONE else mixed
        out[x] = a if part <= ZERO else mixed


@inner
def _fill_row(row, after, weight, out):
    for x in range(len(row)):
        out[2 * x] = row[x]
    for x in range(len(weight)):
        a, b, part = row[x], after[x], weight[x]
        mixed = a + part * (b - a)
        mixed = b if part >= ONE else mixed
        out[2 * x + 1] = a if part <= ZERO else mixed

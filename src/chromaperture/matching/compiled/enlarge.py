# mypy: disallow-untyped-defs=False
"""From the halved picture to full resolution, compiled; ``readable/enlarge.py`` explains what is computed."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.compiled.layout import ONE, ZERO, inner, kernel
from chromaperture.matching.labels import Surface
from chromaperture.matching.readable.enlarge import JUMP_PX
from chromaperture.system.threads import in_parallel

_JUMP = np.float32(JUMP_PX)
_HALF = np.float32(0.5)


def enlarge(surface: Surface, guide: np.ndarray) -> Surface:
    """Bring a surface to full resolution, as `readable.enlarge`."""
    guide = np.ascontiguousarray(guide, np.float32)
    out = Surface(*(np.empty(guide.shape, np.float32) for _ in range(3)))
    small = Surface(*(np.ascontiguousarray(part, np.float32) for part in surface))
    in_parallel(lambda _, top, bottom: _fill(small, guide, top, bottom, out), len(small.peak))
    return out


@kernel
def _fill(small, guide, top, bottom, out):
    """Fill the rows 2 top to before 2 bottom of the enlarged maps; the next thread's first row is computed as well."""
    height, width = guide.shape
    lines, spare = np.empty((5, width // 2), np.float32), np.empty((3, width), np.float32)
    weight = np.empty(width, np.float32)
    now = (spare[0], spare[1], spare[2])
    for y in range(top, min(bottom + 1, len(small.peak))):
        before, now = now, (spare[0], spare[1], spare[2])
        if y < bottom:
            now = (out.disparity_px[2 * y], out.sigma_px[2 * y], out.peak[2 * y])
        _fill_columns(small, guide[2 * y], y, lines, now)
        if y > top:
            _fill_between(before, now, guide[2 * y - 2], guide[2 * y - 1], guide[2 * y], weight, 2 * y - 1, out)
    if bottom == len(small.peak) and height % 2 == 0:
        end = height - 1
        _fill_between(now, now, guide[end - 1], guide[end], guide[end], weight, end, out)


@inner
def _fill_between(before, after, before_guide, here_guide, after_guide, weight, y, out):
    """Fill a row of the three maps between two others."""
    _weigh(before[0], after[0], before_guide, here_guide, after_guide, weight)
    _mix_row(before[0], after[0], weight, out.disparity_px[y])
    _mix_row(before[1], after[1], weight, out.sigma_px[y])
    _mix_row(before[2], after[2], weight, out.peak[y])


@inner
def _fill_columns(small, guide, y, lines, rows):
    """Enlarge a row of the small maps along x."""
    width, odd = len(guide), lines.shape[1]
    weight, after, before_guide, here_guide, after_guide = lines[0], lines[1], lines[2], lines[3], lines[4]
    for x in range(odd):
        before_guide[x], here_guide[x] = guide[2 * x], guide[2 * x + 1]
        after_guide[x] = guide[min(2 * x + 2, width - 1)]
    _shift_left(small.disparity_px[y], after)
    _weigh(small.disparity_px[y], after, before_guide, here_guide, after_guide, weight)
    _fill_row(small.disparity_px[y], after, weight, rows[0])
    _shift_left(small.sigma_px[y], after)
    _fill_row(small.sigma_px[y], after, weight, rows[1])
    _shift_left(small.peak[y], after)
    _fill_row(small.peak[y], after, weight, rows[2])


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

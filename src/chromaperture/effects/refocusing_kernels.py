"""Passes of `refocus` over rows ``first`` to before ``last``; the method is explained there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.threads import in_parallel


def over_rows(kernel: Callable[..., None], rows: int, *arguments: Any) -> None:
    """Call a kernel on all cores, each with a part of the rows."""
    in_parallel(lambda _, first, last: kernel(*arguments, first, last), rows)


@inlined(inline="always")
def _weight(radius, below, center, above):  # type: ignore[no-untyped-def]
    """Return the weight of a layer in a pixel, linear to the neighbouring layers' radii."""
    if radius <= below or radius >= above:
        return np.float32(0)
    if radius < center:
        return (radius - below) / (center - below)
    return (above - radius) / (above - center)


@compiled()
def layer_bounds(new, behind_new, hidden, below, above, out, first, last):  # type: ignore[no-untyped-def]
    """Find the first and last column of a layer in every row; (H, 2) int64, first > last in rows without it."""
    width = new.shape[1]
    for y in range(first, last):
        left, right = width, -1
        for x in range(width):
            inside = below < new[y, x] < above or (hidden[y, x] and below < behind_new[y, x] < above)
            if inside:
                left = min(left, x)
                right = x
        out[y, 0], out[y, 1] = left, right


@compiled()
def layer_planes(color, new, behind, behind_new, hidden, nodes, corner, out, first, last):  # type: ignore[no-untyped-def]
    """Compute light and coverage of a layer in a box with that corner; (h, w, 4) float32, 0 where it is absent."""
    top, left = corner
    below, center, above = nodes
    for row in range(first, last):
        y = row + top
        for column in range(out.shape[1]):
            x = column + left
            a = _weight(new[y, x], below, center, above)
            b = _weight(behind_new[y, x], below, center, above) if hidden[y, x] else np.float32(0)
            if a == 0 and b == 0:
                continue
            for c in range(3):
                out[row, column, c] = a * color[y, x, c] + b * behind[y, x, c]
            out[row, column, 3] = a + b


@compiled()
def add_layer(total, before, blurred, corner, first, last):  # type: ignore[no-untyped-def]
    """Add a blurred layer, in place, where no clearly nearer layer hides it; total holds light and coverage."""
    top, left = corner
    for y in range(first, last):
        for x in range(blurred.shape[1]):
            visible = min(max(np.float32(1) - before[y + top, x + left], np.float32(0)), np.float32(1))
            for c in range(4):
                total[y + top, x + left, c] += visible * blurred[y, x, c]


@compiled()
def normalise(total, out, first, last):  # type: ignore[no-untyped-def]
    """Divide light by coverage; (H, W, 3) float32, not negative."""
    for y in range(first, last):
        for x in range(total.shape[1]):
            gain = np.float32(1) / max(total[y, x, 3], np.float32(1e-3))
            for c in range(3):
                out[y, x, c] = max(total[y, x, c] * gain, np.float32(0))

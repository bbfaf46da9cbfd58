"""Passes of `refocus` over all pixels; the method is explained there."""

from __future__ import annotations

import numpy as np

from chromaperture.compilation import compiled, inlined
from chromaperture.threads import in_parallel


def layer_bounds(
    new: np.ndarray, behind_new: np.ndarray, hidden: np.ndarray, below: np.float32, above: np.float32
) -> np.ndarray:
    """Return the first and last column of a layer in every row; (H, 2) int64, first > last in rows without it."""
    out = np.empty((new.shape[0], 2), np.int64)
    in_parallel(lambda _, first, last: _bounds(new, behind_new, hidden, below, above, out, first, last), len(out))
    return out


def layer_planes(
    color: np.ndarray,
    new: np.ndarray,
    behind: np.ndarray,
    behind_new: np.ndarray,
    hidden: np.ndarray,
    nodes: tuple[np.float32, np.float32, np.float32],
    box: tuple[int, int, int, int],
) -> np.ndarray:
    """Return light and coverage of a layer inside a box (top, bottom, left, right); (h, w, 4) float32."""
    out = np.zeros((box[1] - box[0], box[3] - box[2], 4), np.float32)
    in_parallel(
        lambda _, first, last: _planes(color, new, behind, behind_new, hidden, nodes, box, out, first, last), len(out)
    )
    return out


def add_layer(total: np.ndarray, before: np.ndarray, blurred: np.ndarray, top: int, left: int) -> None:
    """Add a blurred layer, in place, where no clearly nearer layer hides it; total holds light and coverage."""
    in_parallel(lambda _, first, last: _add(total, before, blurred, top, left, first, last), len(blurred))


def normalised(total: np.ndarray) -> np.ndarray:
    """Return light over coverage; (H, W, 3) float32, not negative."""
    out = np.empty((*total.shape[:2], 3), np.float32)
    in_parallel(lambda _, first, last: _normalise(total, out, first, last), len(out))
    return out


@inlined(inline="always")
def _weight(radius, below, center, above):  # type: ignore[no-untyped-def]
    """Weight of a layer in a pixel, linear to the neighbouring layers' radii."""
    if radius <= below or radius >= above:
        return np.float32(0)
    if radius < center:
        return (radius - below) / (center - below)
    return (above - radius) / (above - center)


@compiled()
def _bounds(new, behind_new, hidden, below, above, out, first_row, last_row):  # type: ignore[no-untyped-def]
    width = new.shape[1]
    for y in range(first_row, last_row):
        first, last = width, -1
        for x in range(width):
            inside = below < new[y, x] < above or (hidden[y, x] and below < behind_new[y, x] < above)
            if inside:
                first = min(first, x)
                last = x
        out[y, 0], out[y, 1] = first, last


@compiled()
def _planes(color, new, behind, behind_new, hidden, nodes, box, out, first_row, last_row):  # type: ignore[no-untyped-def]
    top, _, left, right = box
    below, center, above = nodes
    for y in range(top + first_row, top + last_row):
        for x in range(left, right):
            a = _weight(new[y, x], below, center, above)
            b = _weight(behind_new[y, x], below, center, above) if hidden[y, x] else np.float32(0)
            if a == 0 and b == 0:
                continue
            for c in range(3):
                out[y - top, x - left, c] = a * color[y, x, c] + b * behind[y, x, c]
            out[y - top, x - left, 3] = a + b


@compiled()
def _add(total, before, blurred, top, left, first_row, last_row):  # type: ignore[no-untyped-def]
    for y in range(first_row, last_row):
        for x in range(blurred.shape[1]):
            seen = min(max(np.float32(1) - before[y + top, x + left], np.float32(0)), np.float32(1))
            for c in range(4):
                total[y + top, x + left, c] += seen * blurred[y, x, c]


@compiled()
def _normalise(total, out, first_row, last_row):  # type: ignore[no-untyped-def]
    for y in range(first_row, last_row):
        for x in range(total.shape[1]):
            gain = np.float32(1) / max(total[y, x, 3], np.float32(1e-3))
            for c in range(3):
                out[y, x, c] = max(total[y, x, c] * gain, np.float32(0))

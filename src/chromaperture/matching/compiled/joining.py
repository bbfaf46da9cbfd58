# mypy: disallow-untyped-defs=False
"""Regions that join, compiled; ``readable/joining.py`` explains what is computed."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.compiled.paths import FAST
from chromaperture.system.compilation import compiled, inlined


def join_regions(
    total: np.ndarray, pairs: np.ndarray, border: np.ndarray, *, plane_penalty: float
) -> tuple[np.ndarray, np.ndarray]:
    """Join neighbours while the energy falls, as `readable.join_regions`."""
    total, into = np.array(total, np.float64), np.arange(len(total))
    _join_regions(total, pairs.astype(np.int64), border.astype(np.float64), float(plane_penalty), into)
    return into, total


@compiled(fastmath=FAST)
def _join_regions(total, pairs, border, plane_penalty, into):
    """Join in place: all but ``plane_penalty`` is changed."""
    regions, count = len(total), len(pairs)
    least, most, loss = np.empty(regions), np.empty(regions), np.empty(count)
    best, step, grows = np.empty(regions, np.int64), np.arange(regions), np.empty(regions, np.bool_)
    for i in range(regions):
        least[i] = _least(total, i)
    for p in range(count):
        loss[p] = _loss(total, least, pairs[p, 0], pairs[p, 1])
    joined = True
    while joined:
        joined = False
        for i in range(regions):
            most[i], best[i], grows[i] = 0.0, -1, False  # what gains nothing is nobody's best
        for p in range(count):
            gain = border[p] + plane_penalty - loss[p]
            for side in range(2):
                if gain > most[pairs[p, side]]:
                    most[pairs[p, side]], best[pairs[p, side]] = gain, p
        for p in range(count):
            one, other = pairs[p, 0], pairs[p, 1]
            if best[one] == p and best[other] == p:
                for k in range(total.shape[1]):
                    total[one, k] += total[other, k]
                least[one] = _least(total, one)
                step[other], grows[one], joined = one, True, True
        for i in range(regions):
            into[i] = step[into[i]]
        count = _renumbered(pairs, border, loss, count, step)
        for p in range(count):
            one, other = pairs[p, 0], pairs[p, 1]
            if grows[one] or grows[other]:
                loss[p] = _loss(total, least, one, other)


@inlined(fastmath=FAST)
def _least(total, i):
    """Nats of a region's best plane."""
    found = total[i, 0]
    for k in range(1, total.shape[1]):
        found = min(found, total[i, k])
    return found


@inlined(fastmath=FAST)
def _loss(total, least, one, other):
    """Nats that two regions lose by having one plane."""
    both = total[one, 0] + total[other, 0]
    for k in range(1, total.shape[1]):
        both = min(both, total[one, k] + total[other, k])
    return both - (least[one] + least[other])


@inlined()
def _renumbered(pairs, border, loss, count, step):
    """Give pairs the numbers of joined regions and sum what is said of the same pair; returns how many are left."""
    found, borders, losses = np.empty((count, 2), np.int64), np.empty(count), np.empty(count)
    kept = 0
    for p in range(count):
        one, other = step[pairs[p, 0]], step[pairs[p, 1]]
        if one != other:
            found[kept, 0], found[kept, 1] = min(one, other), max(one, other)
            borders[kept], losses[kept] = border[p], loss[p]
            kept += 1
    left = 0
    for i in _ordered(found, kept, len(step)):
        if left and pairs[left - 1, 0] == found[i, 0] and pairs[left - 1, 1] == found[i, 1]:
            border[left - 1] += borders[i]
        else:
            pairs[left, 0], pairs[left, 1] = found[i, 0], found[i, 1]
            border[left], loss[left] = borders[i], losses[i]
            left += 1
    return left


@inlined()
def _ordered(pairs, count, regions):
    """Return the order of pairs by their numbers, equal ones as they were: a counting sort by one, then the other."""
    order, before = np.arange(count), np.empty(count, np.int64)
    starts = np.empty(regions + 1, np.int64)
    for side in (1, 0):
        for i in range(regions + 1):
            starts[i] = 0
        for i in range(count):
            before[i] = order[i]
            starts[pairs[i, side] + 1] += 1
        for i in range(regions):
            starts[i + 1] += starts[i]
        for i in before:
            order[starts[pairs[i, side]]] = i
            starts[pairs[i, side]] += 1
    return order

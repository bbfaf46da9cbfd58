# mypy: disallow-untyped-defs=False
"""Most likely planes near given ones, compiled; ``stages/plane_refining.py`` explains what is computed.

Planes count labels from the first, in layers, and points from their middle.
"""

from __future__ import annotations

import numpy as np

from chromaperture.compilation import compiled, inlined
from chromaperture.disparity.cpu.paths import FAST
from chromaperture.disparity.stages.plane_refining import (
    CONDITION,
    GAINED,
    LEAST_BEND,
    MOST_POINTS,
    REACH,
    SHORTENED,
    PointSets,
)
from chromaperture.disparity.stages.planes import PlaneCosts
from chromaperture.threads import parallel_map, thread_count

_PARTS = 8  # of the work of each thread: sets are of unlike size
# Points in all steps of all starts, .2 ms of work, for each part that may go to another thread; chosen by hand. Smaller
# parts leave threads waiting for the interpreter's lock: docs/gpu.md, "On an NVIDIA H200".
_FEW_POINTS = 20_000


def best_planes(
    likelihood: np.ndarray,
    points: PointSets,
    planes: np.ndarray,
    labels_px: np.ndarray,
    costs: PlaneCosts,
    *,
    steps: int,
    even: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the most likely plane of every set of points, as `stages.best_planes`."""
    step = float(labels_px[1] - labels_px[0])
    out, values = np.empty((len(planes), 3)), np.empty(len(planes))
    in_layers = np.array(planes, float) / step
    in_layers[..., 2] -= labels_px[0] / step
    slope, outside = float(costs.slope), float(costs.outside)

    def some(part: np.ndarray) -> None:
        _best_planes(
            likelihood, points.x, points.y, points.starts, in_layers, slope, outside, steps, even,
            part[0], part[-1] + 1, out, values,
        )  # fmt: skip

    visits = int(points.starts[-1]) * in_layers.shape[1] * (1 + steps)
    count = min(_PARTS * thread_count(), len(planes), 1 + visits // _FEW_POINTS)
    parallel_map(some, np.array_split(np.arange(len(planes)), count))
    out[:, 2] += labels_px[0] / step
    return out * step, values


@compiled(fastmath=FAST)
def _best_planes(likelihood, xs, ys, starts, planes, slope, outside, steps, even, first, last, out, values):
    plane = np.empty(3)
    for i in range(first, last):
        x, y = xs[starts[i] : starts[i + 1]], ys[starts[i] : starts[i + 1]]
        for m in range(planes.shape[1]):
            _copy(planes[i, m], plane)
            if steps > 0:
                _refine(likelihood, x, y, plane, slope, steps, even)
            value = _log_likelihood(likelihood, x, y, plane, outside)
            value -= slope / 2 * len(x) * (plane[0] ** 2 + plane[1] ** 2)
            if m == 0 or value > values[i]:
                values[i] = value
                _copy(plane, out[i])


@inlined(fastmath=FAST)
def _refine(likelihood, x, y, plane, slope, steps, even):
    """Move a plane in place."""
    every = max(1, -(-len(x) // MOST_POINTS))
    middle_x, middle_y, count = _middle(x, y, every)
    plane[2] += plane[0] * middle_x + plane[1] * middle_y
    penalty = slope * count
    move, trial, uphill, sums, further = np.zeros(3), np.empty(3), np.empty(3), np.empty(10), np.empty(10)
    bend = np.empty((3, 3))
    _sum(likelihood, x, y, every, middle_x, middle_y, plane, penalty, sums)
    for _ in range(steps):
        _, uphill[0], uphill[1], uphill[2], xx, xy, x1, yy, y1, one = sums
        if even:
            move[2] = uphill[2] / max(-one, LEAST_BEND)
        else:
            uphill[0] -= penalty * plane[0]
            uphill[1] -= penalty * plane[1]
            bend[0, 0], bend[1, 1], bend[2, 2] = penalty - xx, penalty - yy, -one
            bend[0, 1] = bend[1, 0] = -xy
            bend[0, 2] = bend[2, 0] = -x1
            bend[1, 2] = bend[2, 1] = -y1
            size, axes = np.linalg.eigh(bend)
            least = CONDITION * max(size[2], LEAST_BEND)
            for i in range(3):
                move[i] = 0.0
                for k in range(3):
                    part = axes[0, k] * uphill[0] + axes[1, k] * uphill[1] + axes[2, k] * uphill[2]
                    move[i] += part / max(size[k], least) * axes[i, k]
        before = sums[0]
        for shorter in SHORTENED:
            for i in range(3):
                trial[i] = plane[i] + shorter * move[i]
            _sum(likelihood, x, y, every, middle_x, middle_y, trial, penalty, further)
            if further[0] > sums[0]:
                _copy(trial, plane)
                _copy(further, sums)
                break
        if sums[0] - before <= GAINED * abs(sums[0]):
            break
    plane[2] -= plane[0] * middle_x + plane[1] * middle_y


@inlined()
def _copy(numbers, out):
    for i in range(len(out)):
        out[i] = numbers[i]


@inlined()
def _middle(xs, ys, every):
    """Mean of every so many points, and their count."""
    x, y, count = 0.0, 0.0, 0
    for i in range(0, len(xs), every):
        x += xs[i]
        y += ys[i]
        count += 1
    return x / count, y / count, count


@inlined(fastmath=FAST)
def _sum(likelihood, xs, ys, every, middle_x, middle_y, plane, penalty, sums):
    """Value less the slope's cost, then gradient (3) and upper triangle of the Hessian (6) of the value alone."""
    last = likelihood.shape[2] - 1 - REACH
    a, b, c = plane
    value = gx = gy = g1 = xx = xy = x1 = yy = y1 = one = 0.0
    for i in range(0, len(xs), every):
        x, y = xs[i] - middle_x, ys[i] - middle_y
        place = a * x + b * y + c
        if place < REACH or place >= last:
            continue
        gains, below = likelihood[ys[i], xs[i]], int(place)
        t = place - below
        before = (1 - t) * gains[below - REACH] + t * gains[below - REACH + 1]
        here = (1 - t) * gains[below] + t * gains[below + 1]
        after = (1 - t) * gains[below + REACH] + t * gains[below + REACH + 1]
        first, second = (after - before) / (2 * REACH), (after + before - 2 * here) / (REACH * REACH)
        value += here
        gx += first * x
        gy += first * y
        g1 += first
        xx += second * x * x
        xy += second * x * y
        x1 += second * x
        yy += second * y * y
        y1 += second * y
        one += second
    sums[0] = value - penalty / 2 * (a * a + b * b)
    sums[1], sums[2], sums[3] = gx, gy, g1
    sums[4], sums[5], sums[6], sums[7], sums[8], sums[9] = xx, xy, x1, yy, y1, one


@inlined(fastmath=FAST)
def _log_likelihood(likelihood, xs, ys, plane, outside):
    """Sum over points, less what labels outside the range cost."""
    last, value = likelihood.shape[2] - 1, 0.0
    a, b, c = plane
    for i in range(len(xs)):
        place = a * xs[i] + b * ys[i] + c
        if place < 0 or place > last:
            value -= outside
            continue
        gains, below = likelihood[ys[i], xs[i]], min(int(place), last - 1)
        t = place - below
        value += (1 - t) * gains[below] + t * gains[below + 1]
    return value

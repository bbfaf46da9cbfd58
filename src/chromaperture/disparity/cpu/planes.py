# mypy: disallow-untyped-defs=False
"""Costs of planes and belief propagation, compiled; ``stages/planes.py`` explains what is computed."""

from __future__ import annotations

import numpy as np

from chromaperture.compilation import compiled, inlined
from chromaperture.disparity.cpu import simd as v
from chromaperture.disparity.cpu.paths import FAST
from chromaperture.disparity.cpu.workspace import workspace
from chromaperture.disparity.stages.planes import LEAST_AREA, LEAST_POINTS, NEAR, PlaneCosts
from chromaperture.threads import in_parallel

_CACHED = 1 << 18  # numbers in half of a level-2 cache of 2 MB
_NEVER = np.float32(1e30)  # nats; cost of the lanes beyond the last choice


def plane_costs(likelihood: np.ndarray, planes: np.ndarray, labels_px: np.ndarray, costs: PlaneCosts) -> np.ndarray:
    """Cost of every plane at every pixel, as `stages.plane_costs`; (H, W, K) float32."""
    likelihood = np.ascontiguousarray(likelihood, np.float32)
    step = float(labels_px[1] - labels_px[0])
    places = np.asarray(planes, float) / step  # labels count from the first, in layers
    places[:, 2] -= labels_px[0] / step
    slopes = (costs.slope / 2 * (places[:, 0] ** 2 + places[:, 1] ** 2)).astype(np.float32)
    out = np.empty((*likelihood.shape[:2], len(planes)), np.float32)
    in_parallel(
        lambda _, top, bottom: _plane_costs(likelihood, places, slopes, np.float32(costs.outside), top, bottom, out),
        len(out),
    )
    return out


def agreed_plane(
    corners: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    label: np.ndarray,
    weight: np.ndarray,
    *,
    tolerance_px: float,
    rounds: int,
) -> np.ndarray:
    """Find the plane that most points agree with, and fit it, as `stages.agreed_plane`."""
    plane = np.empty(3)
    found = _agreed_plane(corners, x, y, label, weight, tolerance_px, rounds, plane)
    return plane if found else np.full(3, np.nan)


def potts_beliefs(cost: np.ndarray, links: np.ndarray, *, sweeps: int) -> np.ndarray:
    """Min-sum belief propagation on the pixel grid, as `stages.potts_beliefs`; (H, W, K) float32."""
    height, width, count = cost.shape
    shape = height, width, -(-count // v.LANES) * v.LANES
    links = np.ascontiguousarray(links, np.float32)
    with workspace() as memory:
        beliefs = memory.array("beliefs", shape, np.float32)  # the cost and all four messages
        messages = memory.array("messages", (4, *shape), np.float32)

        def begin(_: int, top: int, bottom: int) -> None:
            beliefs[top:bottom, :, :count] = cost[top:bottom]
            beliefs[top:bottom, :, count:] = _NEVER
            messages[:, top:bottom] = 0

        in_parallel(begin, height)
        for _ in range(sweeps):
            in_parallel(lambda _, first, last: _along_rows(beliefs, messages, links[0], first, last), height)
            in_parallel(lambda _, first, last: _along_columns(beliefs, messages, links[1], first, last), width)
        return beliefs[..., :count].copy()


@compiled(fastmath=FAST)
def _plane_costs(likelihood, places, slopes, outside, top, bottom, out):
    width, count = likelihood.shape[1], likelihood.shape[2]
    for y in range(top, bottom):
        for x in range(width):
            for k in range(len(places)):
                place = places[k, 0] * x + places[k, 1] * y + places[k, 2]
                if place < 0 or place > count - 1:
                    out[y, x, k] = outside + slopes[k]
                else:
                    below = min(int(place), count - 2)
                    t = np.float32(place - below)
                    low, high = likelihood[y, x, below], likelihood[y, x, below + 1]
                    out[y, x, k] = slopes[k] - low - t * (high - low)


@compiled()
def _agreed_plane(corners, x, y, label, weight, tolerance, rounds, plane):
    """Find the plane of most votes and fit it, into ``plane``; returns whether enough points agree."""
    # About the middle of the points, in single precision: half the time, and enough to compare planes.
    middle_x, middle_y = x.mean(), y.mean()
    place = np.empty((4, len(x)), np.float32)
    for i in range(len(x)):
        place[0, i], place[1, i], place[2, i], place[3, i] = x[i] - middle_x, y[i] - middle_y, label[i], weight[i]
    most = np.float32(-1)
    for k in range(len(corners)):
        i, j, n = corners[k]
        jx, jy, nx, ny = float(x[j] - x[i]), float(y[j] - y[i]), float(x[n] - x[i]), float(y[n] - y[i])
        area = jx * ny - nx * jy
        if abs(area) <= LEAST_AREA:
            continue
        rise_j, rise_n = float(label[j]) - float(label[i]), float(label[n]) - float(label[i])
        a, b = (rise_j * ny - rise_n * jy) / area, (jx * rise_n - nx * rise_j) / area
        c = label[i] - a * (x[i] - middle_x) - b * (y[i] - middle_y)
        votes = _votes(np.float32(a), np.float32(b), np.float32(c), place, np.float32(1 / tolerance))
        if votes > most:
            most, plane[0], plane[1], plane[2] = votes, a, b, c
    if most < 0:
        return False
    for _ in range(rounds):
        if not _fit_near(place, NEAR * tolerance, plane):
            return False
    plane[2] -= plane[0] * middle_x + plane[1] * middle_y
    return True


@inlined(fastmath=FAST)
def _votes(a, b, c, place, sharpness):
    x, y, label, weight = place[0], place[1], place[2], place[3]
    total = np.float32(0)
    for i in range(len(x)):
        away = (a * x[i] + b * y[i] + c - label[i]) * sharpness
        total += max(np.float32(0), np.float32(1) - away * away) * weight[i]
    return total


@inlined()
def _fit_near(place, reach, plane):
    """Fit a plane to the points within reach of it, in place; returns whether there are enough."""
    count = 0
    xx = xy = x1 = yy = y1 = w1 = xl = yl = l1 = 0.0
    for i in range(place.shape[1]):
        x, y, label, w = float(place[0, i]), float(place[1, i]), float(place[2, i]), float(place[3, i])
        if abs(plane[0] * x + plane[1] * y + plane[2] - label) < reach:
            count += 1
            xx += w * x * x
            xy += w * x * y
            x1 += w * x
            yy += w * y * y
            y1 += w * y
            w1 += w
            xl += w * x * label
            yl += w * y * label
            l1 += w * label
    p, q, r = yy * w1 - y1 * y1, y1 * x1 - xy * w1, xy * y1 - yy * x1
    determinant = xx * p + xy * q + x1 * r
    if count < LEAST_POINTS or determinant == 0:
        return False
    s, t, u = xx * w1 - x1 * x1, xy * x1 - xx * y1, xx * yy - xy * xy
    plane[0] = (p * xl + q * yl + r * l1) / determinant
    plane[1] = (q * xl + s * yl + t * l1) / determinant
    plane[2] = (r * xl + t * yl + u * l1) / determinant
    return True


@inlined(fastmath=FAST)
def _send(beliefs, to, back, here, there, count, penalty):
    """Renew one message; beliefs hold the cost and all messages, so the one from the receiver is taken off.

    Arrays are flat, ``count`` whole vectors a pixel.
    """
    least, most = v.broadcast(np.float32(np.inf)), v.broadcast(penalty)
    for k in range(0, count, v.LANES):
        least = v.smaller(least, v.sub(v.load(beliefs, here + k), v.load(back, here + k)))
    least = v.least_lane(least)
    for k in range(0, count, v.LANES):
        message = v.sub(v.sub(v.load(beliefs, here + k), v.load(back, here + k)), least)
        message = v.smaller(message, most)
        change = v.sub(message, v.load(to, there + k))
        v.store(beliefs, there + k, v.add(v.load(beliefs, there + k), change))
        v.store(to, there + k, message)


@compiled(fastmath=FAST)
def _along_rows(beliefs, messages, links, first, last):
    width, count = beliefs.shape[1:]
    values, right, left = beliefs.reshape(-1), messages[0].reshape(-1), messages[1].reshape(-1)
    for y in range(first, last):
        at = y * width * count
        for x in range(width - 1):
            _send(values, right, left, at + x * count, at + (x + 1) * count, count, links[y, x])
        for x in range(width - 1, 0, -1):
            _send(values, left, right, at + x * count, at + (x - 1) * count, count, links[y, x - 1])


@compiled(fastmath=FAST)
def _along_columns(beliefs, messages, links, first, last):
    height, width, count = beliefs.shape
    values, down, up = beliefs.reshape(-1), messages[2].reshape(-1), messages[3].reshape(-1)
    row = width * count
    together = max(1, _CACHED // (3 * height * count))  # columns whose beliefs and messages stay in the cache
    for left in range(first, last, together):
        right = min(left + together, last)
        for y in range(height - 1):
            for x in range(left, right):
                at = y * row + x * count
                _send(values, down, up, at, at + row, count, links[y, x])
        for y in range(height - 1, 0, -1):
            for x in range(left, right):
                at = y * row + x * count
                _send(values, up, down, at, at - row, count, links[y - 1, x])

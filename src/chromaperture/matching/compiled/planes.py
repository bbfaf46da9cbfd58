# mypy: disallow-untyped-defs=False
"""Costs of planes, compiled; ``readable/planes.py`` explains what is computed."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.compiled.paths import FAST
from chromaperture.matching.readable.planes import LEAST_AREA, LEAST_POINTS, NEAR, PlaneCosts
from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.threads import in_parallel


def plane_costs(likelihood: np.ndarray, planes: np.ndarray, labels_px: np.ndarray, costs: PlaneCosts) -> np.ndarray:
    """Cost of every plane at every pixel, as `readable.plane_costs`; (H, W, K) float32."""
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
    """Find the plane that most points agree with, and fit it, as `readable.agreed_plane`."""
    plane = np.empty(3)
    found = _agreed_plane(corners, x, y, label, weight, tolerance_px, rounds, plane)
    return plane if found else np.full(3, np.nan)


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

"""``semiglobal.py`` in Numba: every straight line of pixels is walked there and back by one thread.

A pixel lies on exactly one line of each of the four families, so the threads never write to the same
pixel and the memory is the two volumes and a few buffers as long as the layers. The truncated linear
penalty costs two passes over the layers, however far it reaches.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from chromaperture.config import OptimiserConfig
from chromaperture.disparity.semiglobal import EDGE_LAYERS, LEAST_SHARE, LINES, LayerField, couple
from chromaperture.disparity.variational_kernels import iterate

FAST: set[str] = {"contract", "arcp", "nsz", "reassoc", "afn", "nnan"}


def aggregate(
    likelihood: np.ndarray, guide: np.ndarray, step_px: float, *, config: OptimiserConfig
) -> np.ndarray:
    """Sum of the path costs, as `semiglobal.aggregate`; (H, W, D) float32."""
    likelihood = np.ascontiguousarray(likelihood, np.float32)
    height, width, _ = likelihood.shape
    total = np.float32(config.paths - 1) * likelihood  # counted once, not once a path
    for dx, dy in LINES[: config.paths // 2]:
        _walk_lines(
            likelihood,
            np.ascontiguousarray(guide, np.float32),
            line_starts(height, width, dx, dy),
            dx,
            dy,
            np.float32(config.slope_penalty * step_px),
            np.float32(config.jump_penalty),
            np.float32(config.edge_floor),
            np.float32(config.edge_range),
            total,
        )
    return total


def coupled_variation(
    disparity_px: np.ndarray,
    likelihood: np.ndarray,
    guide: np.ndarray,
    layers_px: np.ndarray,
    *,
    config: OptimiserConfig,
) -> np.ndarray:
    """Refine a disparity map, as `semiglobal.coupled_variation`; (H, W) float32, px."""
    likelihood = np.ascontiguousarray(likelihood, np.float32)
    return couple(disparity_px, likelihood, guide, layers_px, config, iterate, nearest_likely)


def spread(
    disparity_px: np.ndarray, cost: np.ndarray, layers_px: np.ndarray, *, temperature: float
) -> np.ndarray:
    """Root mean square distance of the layers from the answer, as `semiglobal.spread`; (H, W) float32, px."""
    out = np.empty(disparity_px.shape, np.float32)
    _spread(
        np.asarray(disparity_px, np.float32), cost, layers_px.astype(np.float32), np.float32(temperature), out
    )
    return out


def at_labels(
    likelihood: np.ndarray, layers_px: np.ndarray, labels_px: np.ndarray, field: LayerField, *, factors: float = 1.0
) -> np.ndarray:
    """Read a volume at the labels of a field, as `semiglobal.at_labels`; (H, W, N) float32."""
    out = np.empty((*likelihood.shape[:2], len(labels_px)), np.float32)
    step = float(layers_px[1] - layers_px[0])
    _at_labels(
        np.ascontiguousarray(likelihood, np.float32),
        (np.asarray(labels_px, float) - layers_px[0]) / step,
        ((field.offset_px + (field.scale - 1) * layers_px[0]) / step).astype(np.float32),
        np.ascontiguousarray(field.scale, np.float32),
        np.float32(factors),
        np.float32(LEAST_SHARE),
        EDGE_LAYERS,
        out,
    )
    return out


def line_starts(height: int, width: int, dx: int, dy: int) -> np.ndarray:
    """First pixel (x, y) and length of every line of a family; (lines, 3) int64.

    Lines start in the first row unless they are rows, and at the left or right border unless they are
    columns.
    """
    starts = [(x, 0) for x in range(width)] if dy > 0 else []
    if dx != 0:
        starts += [(0 if dx > 0 else width - 1, y) for y in range(1 if dy > 0 else 0, height)]
    x, y = np.array(starts).T
    endless = np.full(len(x), height + width)
    along_x = endless if dx == 0 else width - x if dx > 0 else x + 1
    along_y = endless if dy == 0 else height - y
    return np.stack([x, y, np.minimum(along_x, along_y)], axis=1)


def nearest_likely(u: np.ndarray, likelihood: np.ndarray, fidelity: float) -> np.ndarray:
    """Give the best layer near ``u``, as `semiglobal.nearest_likely`; (H, W) float32."""
    out = np.empty_like(u)
    _nearest_likely(u, likelihood, np.float32(fidelity), out)
    return out


@njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _walk_lines(likelihood, guide, starts, dx, dy, slope, jump, floor, edge_range, total):  # type: ignore[no-untyped-def]
    for line in prange(len(starts)):
        x, y, count = starts[line]
        path = np.empty(likelihood.shape[2], np.float32)
        _walk(likelihood, guide, x, y, dx, dy, count, slope, jump, floor, edge_range, path, total)
        x, y = x + (count - 1) * dx, y + (count - 1) * dy
        _walk(likelihood, guide, x, y, -dx, -dy, count, slope, jump, floor, edge_range, path, total)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _walk(likelihood, guide, x, y, dx, dy, count, slope, jump, floor, edge_range, path, total):  # type: ignore[no-untyped-def]
    """Add the costs of one path; ``path`` holds L(p, d) of the last pixel, less its minimum."""
    layers = len(path)
    path[:] = 0
    one = np.float32(1)
    before = guide[y, x]
    for _ in range(count):
        here = guide[y, x]
        weight = floor + (one - floor) * np.exp(-abs(here - before) / edge_range)
        before = here
        near, far = slope * weight, jump * weight
        # min over e of path[e] + near |d - e|: a pass up and a pass down; the least of ``path`` is 0.
        for k in range(1, layers):
            path[k] = min(path[k], path[k - 1] + near)
        least = np.float32(np.inf)
        gain = likelihood[y, x]
        out = total[y, x]
        arrived = far
        for k in range(layers - 1, -1, -1):
            arrived = min(path[k], arrived + near)
            path[k] = min(arrived, far) - gain[k]
            least = min(least, path[k])
        for k in range(layers):
            out[k] += path[k]
            path[k] -= least
        x += dx
        y += dy


@njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _nearest_likely(u, likelihood, fidelity, out):  # type: ignore[no-untyped-def]
    height, width, layers = likelihood.shape
    half = np.float32(0.5)
    for y in prange(height):
        cost = np.empty(layers, np.float32)
        for x in range(width):
            gain = likelihood[y, x]
            for k in range(layers):
                away = np.float32(k) - u[y, x]
                cost[k] = half * away * away - fidelity * gain[k]
            best = 0
            for k in range(1, layers):
                if cost[k] < cost[best]:
                    best = k
            v = np.float32(best)
            if 0 < best < layers - 1:
                bend = cost[best - 1] - 2 * cost[best] + cost[best + 1]
                offset = (cost[best - 1] - cost[best + 1]) / (2 * max(bend, np.float32(1e-12)))
                v += min(max(offset, -half), half)
            out[y, x] = v


@njit(parallel=True, cache=True, fastmath=FAST, error_model="numpy")
def _spread(disparity, cost, layers, temperature, out):  # type: ignore[no-untyped-def]
    height, width, count = cost.shape
    for y in prange(height):
        for x in range(width):
            least = cost[y, x, 0]
            for k in range(1, count):
                least = min(least, cost[y, x, k])
            mass, moment = np.float32(0), np.float32(0)
            for k in range(count):
                above = (cost[y, x, k] - least) / temperature
                if above < np.float32(20):  # e^-20 is below float32's resolution of the sum
                    probable = np.exp(-above)
                    away = layers[k] - disparity[y, x]
                    mass += probable
                    moment += probable * away * away
            out[y, x] = np.sqrt(moment / mass)


@njit(parallel=True, cache=True, error_model="numpy")
def _at_labels(likelihood, labels, offset, scale, factors, least, edge, out):  # type: ignore[no-untyped-def]
    """Labels and offset count in layers from the first one."""
    height, width, layers = likelihood.shape
    zero, one, two, six = np.float32(0), np.float32(1), np.float32(2), np.float32(6)
    for y in prange(height):
        share = np.empty(layers + 2, np.float32)  # and a straight continuation at both ends
        for x in range(width):
            for k in range(layers):
                share[k + 1] = np.exp(-two / factors * likelihood[y, x, k])
            share[0], share[layers + 1] = two * share[1] - share[2], two * share[layers] - share[layers - 1]
            for n in range(len(labels)):
                place = offset[y, x] + scale[y, x] * labels[n]
                if not -edge < place < layers - 1 + edge:
                    out[y, x, n] = zero
                    continue
                below = min(max(int(np.floor(place)), 0), layers - 2)
                t = np.float32(place - below)
                a, b, c = t + one, t - one, t - two
                value = t * (a * b * share[below + 3] - b * c * share[below]) / six
                value += c * a * (b * share[below + 1] - t * share[below + 2]) / two
                value = max(value, least * min(share[below + 1], share[below + 2]))
                out[y, x, n] = max(-factors / two * np.log(value), zero)

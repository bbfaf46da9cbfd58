"""Semi-global matching of a volume, compiled; ``stages/paths.py`` explains what is computed.

Every straight line of pixels is walked there and back by one thread. A pixel lies on exactly one line of each of the
four families, so the threads never write to the same pixel and the memory is the two volumes and a few buffers as long
as the layers. The truncated linear penalty costs two passes over the layers, however far it reaches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.compilation import compiled, inlined
from chromaperture.disparity.labels import LabelMap
from chromaperture.disparity.stages.paths import EDGE_LAYERS, LEAST_UNEXPLAINED, LINES, penalties_of
from chromaperture.stage_config import SurfaceConfig
from chromaperture.threads import in_parallel

# "nnan" lets min and max become one instruction each; volumes and costs hold no NaN.
FAST: set[str] = {"contract", "arcp", "nsz", "reassoc", "afn", "nnan"}


class Penalties(NamedTuple):
    """As `stages.paths.PathPenalties`, in float32."""

    slope_per_layer: np.float32
    jump: np.float32
    edge_range: np.float32
    edge_floor: np.float32


def aggregate_paths(
    likelihood: np.ndarray, guide: np.ndarray, layers_px: np.ndarray, *, config: SurfaceConfig
) -> np.ndarray:
    """Sum the path costs, as `stages.aggregate_paths`; (H, W, D) float32."""
    likelihood, guide = (np.ascontiguousarray(maps, np.float32) for maps in (likelihood, guide))
    penalties = Penalties(*map(np.float32, penalties_of(config, layers_px)))
    total = np.float32(config.paths - 1) * likelihood  # counted once, not once a path
    for line in LINES[: config.paths // 2]:
        starts = line_starts(guide.shape[0], guide.shape[1], *line)
        in_parallel(
            lambda _, first, last, line=line, starts=starts: _walk_lines(  # type: ignore[misc]
                likelihood, guide, starts[first:last], line, penalties, total
            ),
            len(starts),
        )
    return total


def posterior_sigma(
    disparity_px: np.ndarray, cost: np.ndarray, layers_px: np.ndarray, *, temperature: float
) -> np.ndarray:
    """Return the root mean square distance of the layers, as `stages.posterior_sigma`; (H, W) float32, px."""
    out, layers = np.empty(disparity_px.shape, np.float32), layers_px.astype(np.float32)
    disparity = np.asarray(disparity_px, np.float32)

    def rows(_: int, top: int, bottom: int) -> None:
        _posterior_sigma(disparity[top:bottom], cost[top:bottom], layers, np.float32(temperature), out[top:bottom])

    in_parallel(rows, len(out))
    return out


def read_at_labels(
    likelihood: np.ndarray, layers_px: np.ndarray, labels_px: np.ndarray, label_map: LabelMap, *, factors: float = 1.0
) -> np.ndarray:
    """Interpolate a volume at the labels of a map, as `stages.read_at_labels`; (H, W, N) float32."""
    out = np.empty((*likelihood.shape[:2], len(labels_px)), np.float32)
    step = float(layers_px[1] - layers_px[0])
    likelihood = np.ascontiguousarray(likelihood, np.float32)
    labels = (np.asarray(labels_px, float) - layers_px[0]) / step
    begin = ((label_map.offset_px + (label_map.scale - 1) * layers_px[0]) / step).astype(np.float32)
    offset, scale = (
        np.ascontiguousarray(np.broadcast_to(part, out.shape[:2]), np.float32) for part in (begin, label_map.scale)
    )

    def rows(_: int, top: int, bottom: int) -> None:
        part = slice(top, bottom)
        _read_at_labels(likelihood[part], labels, offset[part], scale[part], np.float32(factors), out[part])

    in_parallel(rows, len(out))
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


@compiled(fastmath=FAST, error_model="numpy")
def _walk_lines(likelihood, guide, starts, step, penalties, total):  # type: ignore[no-untyped-def]
    dx, dy = step
    path = np.empty(likelihood.shape[2], np.float32)
    for line in range(len(starts)):
        x, y, count = starts[line]
        _walk(likelihood, guide, x, y, dx, dy, count, penalties, path, total)
        x, y = x + (count - 1) * dx, y + (count - 1) * dy
        _walk(likelihood, guide, x, y, -dx, -dy, count, penalties, path, total)


@inlined(fastmath=FAST, error_model="numpy")
def _walk(likelihood, guide, x, y, dx, dy, count, penalties, path, total):  # type: ignore[no-untyped-def]
    """Add the costs of one path; ``path`` holds L(p, d) of the last pixel, less its minimum."""
    slope, jump, edge_range, floor = penalties
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


@compiled(fastmath=FAST, error_model="numpy")
def _posterior_sigma(disparity, cost, layers, temperature, out):  # type: ignore[no-untyped-def]
    height, width, count = cost.shape
    for y in range(height):
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


@compiled(error_model="numpy")
def _read_at_labels(likelihood, labels, offset, scale, factors, out):  # type: ignore[no-untyped-def]
    """Labels and offset count in layers from the first one."""
    height, width, layers = likelihood.shape
    least, edge = np.float32(LEAST_UNEXPLAINED), EDGE_LAYERS
    zero, one, two, six = np.float32(0), np.float32(1), np.float32(2), np.float32(6)
    for y in range(height):
        unexplained = np.empty(layers + 2, np.float32)  # with a straight continuation at both ends
        for x in range(width):
            for k in range(layers):
                unexplained[k + 1] = np.exp(-two / factors * likelihood[y, x, k])
            unexplained[0] = two * unexplained[1] - unexplained[2]
            unexplained[layers + 1] = two * unexplained[layers] - unexplained[layers - 1]
            for n in range(len(labels)):
                place = offset[y, x] + scale[y, x] * labels[n]
                if not -edge < place < layers - 1 + edge:
                    out[y, x, n] = zero
                    continue
                below = min(max(int(np.floor(place)), 0), layers - 2)
                t = np.float32(place - below)
                a, b, c = t + one, t - one, t - two
                value = t * (a * b * unexplained[below + 3] - b * c * unexplained[below]) / six
                value += c * a * (b * unexplained[below + 1] - t * unexplained[below + 2]) / two
                value = max(value, least * min(unexplained[below + 1], unexplained[below + 2]))
                out[y, x, n] = max(-factors / two * np.log(value), zero)

"""Semi-global matching of a volume, compiled; ``readable/paths.py`` explains what is computed.

Every straight line of pixels is walked there and back by one thread. A pixel lies on exactly one line of each of the
four families, so the threads never write to the same pixel and the memory is the two volumes and a few buffers as long
as the layers. The truncated linear penalty costs a pass over the layers for each power of two that it reaches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.labels import LabelMap
from chromaperture.matching.readable.paths import EDGE_LAYERS, LEAST_UNEXPLAINED, LINES, Posterior, penalties_of
from chromaperture.settings.stages import SurfaceConfig
from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.threads import in_parallel

# "nnan" lets min and max become one instruction each; volumes and costs hold no NaN.
FAST: set[str] = {"contract", "arcp", "nsz", "reassoc", "afn", "nnan"}


# Pixels of a path whose layers are fetched into the cache before they are needed: they lie a row of the volume apart,
# where the processor foresees nothing. 2 and 4 save .36 and .41 of the time (720 x 480 px, 143 labels).
AHEAD = 4
_LINE = 16  # numbers of a line of the cache


class Penalties(NamedTuple):
    """As `readable.paths.PathPenalties`, in float32."""

    slope_per_layer: np.float32
    jump: np.float32
    edge_range: np.float32
    edge_floor: np.float32


def aggregate_paths(
    likelihood: np.ndarray, guide: np.ndarray, layers_px: np.ndarray, *, config: SurfaceConfig
) -> np.ndarray:
    """Sum the path costs, as `readable.aggregate_paths`; (H, W, D) float32."""
    likelihood, guide = (np.ascontiguousarray(maps, np.float32) for maps in (likelihood, guide))
    penalties = Penalties(*map(np.float32, penalties_of(config, layers_px)))
    total = np.empty_like(likelihood)
    own = np.float32(config.paths - 1)  # is taken off: a pixel's log-likelihood counts once, not once a path
    for line in LINES[: config.paths // 2]:
        starts = line_starts(guide.shape[0], guide.shape[1], *line)
        in_parallel(
            lambda _, first, last, line=line, starts=starts: _walk_lines(  # type: ignore[misc]
                likelihood, guide, starts[first:last], line, penalties, own, line == LINES[0], total
            ),
            len(starts),
        )
    return total


def posterior(cost: np.ndarray, layers_px: np.ndarray, *, temperature: float) -> Posterior:
    """Return mean and variance of the layers, as `readable.posterior`."""
    cost = np.ascontiguousarray(cost, np.float32)
    mean, variance = np.empty((2, *cost.shape[:2]), np.float32)

    def rows(_: int, top: int, bottom: int) -> None:
        _posterior(cost[top:bottom], np.float32(temperature), mean[top:bottom], variance[top:bottom])

    in_parallel(rows, len(cost))
    step = np.float32(layers_px[1] - layers_px[0] if len(layers_px) > 1 else 1)
    mean *= step
    mean += np.float32(layers_px[0])
    variance *= step * step
    return Posterior(mean, variance)


def read_at_labels(
    likelihood: np.ndarray,
    layers_px: np.ndarray,
    labels_px: np.ndarray,
    label_map: LabelMap,
    *,
    factors: float = 1.0,
    places: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Interpolate a volume at the labels of a map, as `readable.read_at_labels`; (H, W, N) float32."""
    samples = likelihood.shape[:2]
    down, across = (
        np.minimum(place, n - 1).astype(np.float32)
        for place, n in zip(places or map(np.arange, samples), samples, strict=True)
    )
    out = np.empty((len(down), len(across), len(labels_px)), np.float32)
    step = float(layers_px[1] - layers_px[0])
    unexplained = np.exp(np.float32(-2 / factors) * np.asarray(likelihood, np.float32))
    labels = ((np.asarray(labels_px, float) - layers_px[0]) / step).astype(np.float32)
    begin = label_map.first_layer(layers_px).astype(np.float32)
    offset, scale = (np.array(np.broadcast_to(part, samples), np.float32) for part in (begin, label_map.scale))

    def fill(_: int, top: int, bottom: int) -> None:
        _read_at_labels(unexplained, labels, offset, scale, np.float32(factors), down, across, top, bottom, out)

    in_parallel(fill, len(out))
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
def _walk_lines(likelihood, guide, starts, step, penalties, own, is_first, total):  # type: ignore[no-untyped-def]
    """Add the costs of a family of lines, or set them where it is the first, in both directions."""
    dx, dy = step
    shifts = _shifts(likelihood.shape[2], penalties)
    size = (1 << shifts) + likelihood.shape[2] + v.LANES + (1 << shifts)
    rows = np.empty(2 * size, np.float32)
    for line in range(len(starts)):
        x, y, count = starts[line]
        _walk(likelihood, guide, x, y, dx, dy, count, penalties, shifts, rows, own, is_first, total)
        x, y = x + (count - 1) * dx, y + (count - 1) * dy
        _walk(likelihood, guide, x, y, -dx, -dy, count, penalties, shifts, rows, own, False, total)


@inlined(fastmath=FAST, error_model="numpy")
def _shifts(layers, penalties):  # type: ignore[no-untyped-def]
    """Count of the shifts 1, 2, 4, ... whose sums are all changes of layer that cost less than a jump."""
    shifts, reached = 0, 0
    while reached < layers - 1 and penalties.slope_per_layer * np.float32(reached + 1) < penalties.jump:
        reached += 1 << shifts
        shifts += 1
    return shifts


@inlined(fastmath=FAST, error_model="numpy")
def _walk(likelihood, guide, x, y, dx, dy, count, penalties, shifts, rows, own, is_first, total):  # type: ignore[no-untyped-def]
    """Add the costs of one path.

    ``rows`` has room for L(p, d) of the last pixel, less its minimum, twice, with a border that no path reaches. The
    least of L(q, e) + near |d - e| over all e is found by shifts of 1, 2, 4, ... layers up and down: every change of
    layer is a sum of these. A recursion over the layers computes less, but each of its steps waits for the last one.
    """
    slope, jump, edge_range, floor = penalties
    width, layers = likelihood.shape[1:]
    gains, sums = likelihood.reshape(-1), total.reshape(-1)
    whole, padded = layers // v.LANES * v.LANES, (layers + v.LANES - 1) // v.LANES * v.LANES
    here, there = 1 << shifts, len(rows) // 2 + (1 << shifts)
    one, closed = np.float32(1), np.float32(np.inf)
    for k in range(len(rows)):
        rows[k] = closed
    for k in range(here, here + layers):
        rows[k] = 0
    before = guide[y, x]
    for _ in range(count):
        value = guide[y, x]
        weight = floor + (one - floor) * np.exp(-abs(value - before) / edge_range)
        before = value
        for i in range(shifts):
            shift = 1 << i
            cost = v.broadcast(slope * weight * np.float32(shift))
            for k in range(0, padded, v.LANES):
                beside = v.smaller(v.load(rows, here + k - shift), v.load(rows, here + k + shift))
                v.store(rows, there + k, v.smaller(v.load(rows, here + k), v.add(beside, cost)))
            here, there = there, here

        at = (y * width + x) * layers
        ahead = at + AHEAD * (dy * width + dx) * layers
        for k in range(0, padded, _LINE):
            v.prefetch(gains, ahead + k)
            v.prefetch(sums, ahead + k)
        jumped = jump * weight
        far = v.broadcast(jumped)
        lowest = v.broadcast(closed)
        for k in range(0, whole, v.LANES):
            gain = v.load(gains, at + k)
            cost = v.sub(v.smaller(v.load(rows, here + k), far), gain)
            v.store(rows, here + k, cost)
            lowest = v.smaller(lowest, cost)
            before_it = v.mul(v.broadcast(own), gain) if is_first else v.load(sums, at + k)
            v.store(sums, at + k, v.add(before_it, cost))
        least = v.lane(v.least_lane(lowest), 0)
        for k in range(whole, layers):
            last = min(v.get(rows, here + k), jumped) - v.get(gains, at + k)
            v.put(rows, here + k, last)
            least = min(least, last)
            v.put(sums, at + k, last + (own * v.get(gains, at + k) if is_first else v.get(sums, at + k)))
        for k in range(layers, padded):
            v.put(rows, here + k, closed)
        lowest = v.broadcast(least)
        for k in range(0, padded, v.LANES):
            v.store(rows, here + k, v.sub(v.load(rows, here + k), lowest))
        x += dx
        y += dy


@compiled(fastmath=FAST, error_model="numpy")
def _posterior(cost, temperature, mean, variance):  # type: ignore[no-untyped-def]
    """Mean and variance in layers."""
    height, width, count = cost.shape
    padded = (count + v.LANES - 1) // v.LANES * v.LANES
    values = np.full(padded, np.float32(np.inf), np.float32)  # costs, then how probable they are
    layers = np.arange(padded).astype(np.float32)
    colder = v.broadcast(np.float32(-1) / temperature)
    for y in range(height):
        for x in range(width):
            lowest = v.broadcast(np.float32(np.inf))
            for k in range(count):
                values[k] = cost[y, x, k]
            for k in range(count, padded):
                values[k] = np.float32(np.inf)
            for k in range(0, padded, v.LANES):
                lowest = v.smaller(lowest, v.load(values, k))
            lowest = v.least_lane(lowest)
            mass, sums = v.broadcast(np.float32(0)), v.broadcast(np.float32(0))
            for k in range(0, padded, v.LANES):
                probable = v.exponential(v.mul(v.sub(v.load(values, k), lowest), colder))
                v.store(values, k, probable)
                mass = v.add(mass, probable)
                sums = v.fma(probable, v.load(layers, k), sums)
            mass = v.sum_lanes(mass)
            middle = v.div(v.sum_lanes(sums), mass)
            spread = v.broadcast(np.float32(0))
            for k in range(0, padded, v.LANES):
                away = v.sub(v.load(layers, k), middle)
                spread = v.fma(v.mul(v.load(values, k), away), away, spread)
            mean[y, x] = v.lane(middle, 0)
            variance[y, x] = v.lane(v.div(v.sum_lanes(spread), mass), 0)


@compiled(fastmath=FAST, error_model="numpy")
def _read_at_labels(unexplained, labels, offset, scale, factors, down, across, top, bottom, out):  # type: ignore[no-untyped-def]
    """Rows from ``top`` to before ``bottom``; labels and offset count in layers from the first one."""
    height, width = unexplained.shape[:2]
    count = len(labels)
    padded = (count + v.LANES - 1) // v.LANES * v.LANES
    whole = count // v.LANES * v.LANES
    at_labels = np.ones((2, width, padded), np.float32)  # two rows of samples
    mixed = np.empty((width, padded), np.float32)
    part = np.empty(padded, np.float32)
    nats, nothing = v.broadcast(-factors / np.float32(2)), v.broadcast(np.float32(0))
    lines, values, sums = at_labels.reshape(-1), mixed.reshape(-1), out.reshape(-1)
    held = -1  # row of samples up to which `at_labels` has been computed
    for y in range(top, bottom):
        above = np.int64(down[y])
        below = min(above + 1, height - 1)
        for row in range(max(held + 1, above), below + 1):
            _labels_of_row(unexplained[row], labels, offset[row], scale[row], at_labels[row % 2])
            held = row
        weight = v.broadcast(down[y] - np.float32(above))
        upper, lower = (above % 2) * width * padded, (below % 2) * width * padded
        for k in range(0, width * padded, v.LANES):
            first = v.load(lines, upper + k)
            v.store(values, k, v.fma(weight, v.sub(v.load(lines, lower + k), first), first))
        for x in range(out.shape[1]):
            left = np.int64(across[x])
            here, beside = left * padded, min(left + 1, width - 1) * padded
            weight = v.broadcast(across[x] - np.float32(left))
            at = (y * out.shape[1] + x) * count
            for k in range(0, padded, v.LANES):
                first = v.load(values, here + k)
                between = v.fma(weight, v.sub(v.load(values, beside + k), first), first)
                found = v.larger(v.mul(nats, v.logarithm(between)), nothing)
                if k < whole:
                    v.store(sums, at + k, found)
                else:
                    v.store(part, 0, found)
                    for i in range(count - whole):
                        sums[at + whole + i] = part[i]


@inlined(fastmath={"contract"}, error_model="numpy")
def _labels_of_row(row, labels, offset, scale, out):  # type: ignore[no-untyped-def]
    """Interpolate a row of samples (w, D) at its labels; (w, N or more)."""
    layers, count = row.shape[1], len(labels)
    least, edge = np.float32(LEAST_UNEXPLAINED), np.float32(EDGE_LAYERS)
    one, two, three = np.float32(1), np.float32(2), np.float32(3)
    twelve, twentyfour, hundredtwenty = np.float32(12), np.float32(24), np.float32(120)  # of Lagrange's weights
    samples = np.empty(layers + 4, np.float32)  # with a straight continuation at both ends
    q0, q1, q2, q3, q4, q5 = np.empty((6, count), np.float32)
    lows, ts, insides = np.empty(count, np.int32), np.empty(count, np.float32), np.empty(count, np.bool_)
    for x in range(len(row)):
        for k in range(layers):
            samples[2 + k] = row[x, k]
        samples[1] = two * samples[2] - samples[3]
        samples[0] = two * samples[1] - samples[2]
        samples[layers + 2] = two * samples[layers + 1] - samples[layers]
        samples[layers + 3] = two * samples[layers + 2] - samples[layers + 1]
        for n in range(count):
            place = offset[x] + scale[x] * labels[n]
            low = min(max(np.int32(np.floor(place)), np.int32(0)), np.int32(layers - 2))
            lows[n] = low
            ts[n] = place - np.float32(low)
            insides[n] = -edge < place < np.float32(layers - 1) + edge
        for n in range(count):  # apart from the sums, which become vectors
            low = np.uint64(lows[n])
            q0[n], q1[n], q2[n] = samples[low], samples[low + np.uint64(1)], samples[low + np.uint64(2)]
            q3[n], q4[n], q5[n] = (
                samples[low + np.uint64(3)], samples[low + np.uint64(4)], samples[low + np.uint64(5)]
            )  # fmt: skip
        for n in range(count):
            t = ts[n]
            a, b, c, d, e = t + two, t + one, t - one, t - two, t - three
            inner, outer = b * t * c, a * b * t * c * d
            value = a * e * (t * b * d * q3[n] - b * c * d * q2[n]) / twelve
            value += t * c * a * e * (d * q1[n] - b * q4[n]) / twentyfour
            value += (outer * q5[n] - inner * d * e * q0[n]) / hundredtwenty
            value = max(value, least * min(q2[n], q3[n]))
            out[x, n] = value if insides[n] else one

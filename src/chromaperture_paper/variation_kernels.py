"""Primal-dual iterations of total variation, compiled; ``variation.py`` explains what is computed.

An iteration reads and writes far more than it computes, so what counts is how often the arrays travel from
memory. Row i of iteration t needs only rows i - 1 .. i + 1 of iteration t - 1. The sweep therefore runs as
a wavefront: at step s it does row s of the first iteration, row s - 1 of the second, and so on, all in place,
in the cache. Bands of rows go to different threads; each keeps as many rows of its neighbours on either side as a sweep
has iterations, and the bands exchange these rows after every sweep. The result depends on neither.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from chromaperture.matching.compiled.paths import FAST
from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.threads import in_parallel, parallel_map, thread_count
from chromaperture_paper.variation import Problem, State, Steps

SWEEP = 10  # iterations in one sweep: seven arrays of so many rows of 2000 px fill a level-2 cache of 512 kB
EXTRAPOLATED, U, DUAL_X, DUAL_Y = range(4)


def iterate(problem: Problem, state: State, steps: Steps, *, sweep: int = SWEEP, bands: int | None = None) -> None:
    """Run the primal-dual iterations on ``state`` in place, as `variation.iterate`."""
    height, total = len(problem.target), len(steps.primal)
    count = max(1, min(bands or thread_count(), height // 4))
    sweep = max(1, min(sweep, height // count, total))
    rows = -(-height // count)
    kept = parallel_map(lambda top: _Band(state, top, min(height, top + rows), sweep), range(0, height, rows))
    lo, hi, huber = (np.float32(value) for value in (*problem.bounds, problem.huber))
    sizes, edges = np.stack(steps).astype(np.float32), _edges(problem)
    for done in range(0, total, sweep):
        now = np.ascontiguousarray(sizes[:, done : done + sweep])
        for above, below in pairwise(kept):
            if done:
                above.exchange(below)

        def advance(_: int, first: int, last: int, now: np.ndarray = now) -> None:
            for band in kept[first:last]:
                _sweep(
                    band.rows, problem.target, problem.weight, edges, problem.quadratic, lo, hi, huber,
                    now, band.first, band.last, band.low,
                )  # fmt: skip

        in_parallel(advance, len(kept))
    parallel_map(lambda band: band.store(state), kept)


class _Band:
    """Rows ``first`` to before ``last`` of the state, and ``margin`` rows of the neighbours on either side."""

    def __init__(self, state: State, first: int, last: int, margin: int) -> None:
        height, width = state.u.shape
        self.first, self.last, self.low, self.margin = first, last, first - margin, margin
        self.rows = np.empty((4, last - first + 2 * margin, width), np.float32)  # row r is row low + r of the map
        self.top, self.bottom = max(0, self.low), min(height, last + margin)
        for own, values in zip(self.rows, self._maps(state), strict=True):
            own[self.top - self.low : self.bottom - self.low] = values[self.top : self.bottom]

    @staticmethod
    def _maps(state: State) -> tuple[np.ndarray, ...]:
        return state.extrapolated, state.u, state.dual[0], state.dual[1]

    def exchange(self, below: _Band) -> None:
        """Copy the rows next to the common border, each way."""
        top, middle, bottom = below.top, self.last, self.bottom
        below.rows[:, top - below.low : middle - below.low] = self.rows[:, top - self.low : middle - self.low]
        self.rows[:, middle - self.low : bottom - self.low] = below.rows[:, middle - below.low : bottom - below.low]

    def store(self, state: State) -> None:
        """Write the band's own rows back."""
        for own, values in zip(self.rows, self._maps(state), strict=True):
            values[self.first : self.last] = own[self.first - self.low : self.last - self.low]


def gap_per_px(problem: Problem, state: State) -> float:
    """Return the primal-dual gap per pixel, as `stages.gap_per_px`."""
    rows = np.zeros(len(state.u))
    lo, hi, edges = *problem.bounds, _edges(problem)

    def some(_: int, first: int, last: int) -> None:
        _gap_rows(
            state.u, state.dual, problem.target, problem.weight, edges, problem.quadratic, lo, hi, problem.huber,
            first, last, rows,
        )  # fmt: skip

    in_parallel(some, len(rows))
    return float(rows.sum() / state.u.size)


def _edges(problem: Problem) -> np.ndarray:
    """Edge weights, or an empty array for none: one compiled text serves both."""
    return np.empty((2, 0, 0), np.float32) if problem.edges is None else problem.edges


@compiled(fastmath=FAST, error_model="numpy")
def _sweep(state, target, weight, edges, quadratic, lo, hi, huber, steps, first, last, low):  # type: ignore[no-untyped-def]
    """Advance rows first .. last of a band by the iterations in ``steps``; each uses up a row a side."""
    height, width = target.shape
    count = steps.shape[1]
    nothing = np.zeros(width, np.float32)
    weighted = edges.size > 0
    for s in range(max(0, first - count), min(height, last + count) + count):
        for t in range(count):
            i = s - t
            rest = count - t
            if i < max(0, first - rest) or i >= min(height, last + rest - 1):
                continue
            tau, sigma, theta = steps[0, t], steps[1, t], steps[2, t]
            r = i - low
            bar = state[EXTRAPOLATED, r]
            below = state[EXTRAPOLATED, r + 1] if i < height - 1 else bar
            px, py = state[DUAL_X, r], state[DUAL_Y, r]
            if weighted:
                _dual_row_weighted(bar, below, px, py, edges[0, i], edges[1, i], sigma, huber)
            else:
                _dual_row(bar, below, px, py, sigma, huber)
            if i < max(0, first - rest + 1):
                continue
            above = state[DUAL_Y, r - 1] if i > 0 else nothing
            u = state[U, r]
            if weighted:
                edge_above = edges[1, i - 1] if i > 0 else nothing
                _divergence_row_weighted(u, bar, px, py, above, edges[0, i], edges[1, i], edge_above, tau)
            else:
                _divergence_row(u, bar, px, py, above, tau)
            if quadratic:
                _quadratic_row(u, bar, target[i], weight[i], tau, theta, lo, hi)
            else:
                _absolute_row(u, bar, target[i], weight[i], tau, theta, lo, hi)


@inlined(fastmath=FAST, error_model="numpy")
def _dual_row(bar, below, px, py, sigma, huber):  # type: ignore[no-untyped-def]
    shrink = np.float32(1) / (np.float32(1) + sigma * huber)
    n = len(bar)
    for j in range(n - 1):
        x = (px[j] + sigma * (bar[j + 1] - bar[j])) * shrink
        y = (py[j] + sigma * (below[j] - bar[j])) * shrink
        inverse = np.float32(1) / np.sqrt(max(np.float32(1), x * x + y * y))
        px[j] = x * inverse
        py[j] = y * inverse
    y = (py[n - 1] + sigma * (below[n - 1] - bar[n - 1])) * shrink
    py[n - 1] = y / max(np.float32(1), abs(y))


@inlined(fastmath=FAST, error_model="numpy")
def _dual_row_weighted(bar, below, px, py, ex, ey, sigma, huber):  # type: ignore[no-untyped-def]
    shrink = np.float32(1) / (np.float32(1) + sigma * huber)
    n = len(bar)
    for j in range(n - 1):
        x = (px[j] + sigma * ex[j] * (bar[j + 1] - bar[j])) * shrink
        y = (py[j] + sigma * ey[j] * (below[j] - bar[j])) * shrink
        inverse = np.float32(1) / np.sqrt(max(np.float32(1), x * x + y * y))
        px[j] = x * inverse
        py[j] = y * inverse
    y = (py[n - 1] + sigma * ey[n - 1] * (below[n - 1] - bar[n - 1])) * shrink
    py[n - 1] = y / max(np.float32(1), abs(y))


# ``bar`` holds v = u + tau div p between these two passes: the extrapolated row is no longer needed then.
@inlined(fastmath=FAST, error_model="numpy")
def _divergence_row(u, bar, px, py, above, tau):  # type: ignore[no-untyped-def]
    bar[0] = u[0] + tau * (px[0] + py[0] - above[0])
    for j in range(1, len(u)):
        bar[j] = u[j] + tau * (px[j] - px[j - 1] + py[j] - above[j])


@inlined(fastmath=FAST, error_model="numpy")
def _divergence_row_weighted(u, bar, px, py, above, ex, ey, ey_above, tau):  # type: ignore[no-untyped-def]
    bar[0] = u[0] + tau * (ex[0] * px[0] + ey[0] * py[0] - ey_above[0] * above[0])
    for j in range(1, len(u)):
        across = ex[j] * px[j] - ex[j - 1] * px[j - 1]
        bar[j] = u[j] + tau * (across + ey[j] * py[j] - ey_above[j] * above[j])


@inlined(fastmath=FAST, error_model="numpy")
def _absolute_row(u, bar, f, w, tau, theta, lo, hi):  # type: ignore[no-untyped-def]
    for j in range(len(u)):
        pull = tau * w[j]
        new = min(max(bar[j] - min(max(bar[j] - f[j], -pull), pull), lo), hi)
        bar[j] = new + theta * (new - u[j])
        u[j] = new


@inlined(fastmath=FAST, error_model="numpy")
def _quadratic_row(u, bar, f, w, tau, theta, lo, hi):  # type: ignore[no-untyped-def]
    for j in range(len(u)):
        pull = tau * w[j]
        new = min(max((bar[j] + pull * f[j]) / (np.float32(1) + pull), lo), hi)
        bar[j] = new + theta * (new - u[j])
        u[j] = new


@compiled(error_model="numpy")
def _gap_rows(u, dual, target, weight, edges, quadratic, lo, hi, huber, first, last, rows):  # type: ignore[no-untyped-def]
    """Energy minus its dual bound, one sum a row; float64."""
    height, width = u.shape
    weighted = edges.size > 0
    for i in range(first, last):
        total = 0.0
        for j in range(width):
            right = j < width - 1
            down = i < height - 1
            gx = np.float64(u[i, j + 1]) - np.float64(u[i, j]) if right else 0.0
            gy = np.float64(u[i + 1, j]) - np.float64(u[i, j]) if down else 0.0
            px, py = np.float64(dual[0, i, j]), np.float64(dual[1, i, j])
            total += huber / 2 * (px * px + py * py)
            left_x = np.float64(dual[0, i, j - 1]) if j > 0 else 0.0
            above_y = np.float64(dual[1, i - 1, j]) if i > 0 else 0.0
            if weighted:
                gx *= edges[0, i, j]
                gy *= edges[1, i, j]
                px *= edges[0, i, j]
                py *= edges[1, i, j]
                left_x *= edges[0, i, j - 1] if j > 0 else 0.0
                above_y *= edges[1, i - 1, j] if i > 0 else 0.0
            norm = np.sqrt(gx * gx + gy * gy)
            total += norm * norm / (2 * huber) if norm < huber else norm - huber / 2
            q = (px if right else 0.0) - left_x + (py if down else 0.0) - above_y
            f, w = np.float64(target[i, j]), np.float64(weight[i, j])
            away = np.float64(u[i, j]) - f
            if quadratic:
                best = hi if q > 0 else lo
                if w > 0:
                    best = min(max(f + q / w, lo), hi)
                total += w / 2 * away * away + q * best - w / 2 * (best - f) ** 2
            else:
                total += w * abs(away)
                total += max(q * lo - w * (f - lo), q * f, q * hi - w * (hi - f))
        rows[i] = total

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
from chromaperture_paper.variation import PRIMAL_STEP, Problem, State, step_sizes

SWEEP = 10  # iterations in one sweep: seven arrays of so many rows of 2000 px fill a level-2 cache of 512 kB
EXTRAPOLATED, U, DUAL_X, DUAL_Y = range(4)


def iterate(
    problem: Problem,
    state: State,
    iterations: int,
    *,
    primal_step: float = PRIMAL_STEP,
    sweep: int = SWEEP,
    bands: int | None = None,
) -> None:
    """Run the primal-dual iterations on ``state`` in place, as `variation.iterate`."""
    height = len(problem.target)
    count = max(1, min(bands or thread_count(), height // 4))
    sweep = max(1, min(sweep, height // count, iterations))
    rows = -(-height // count)
    kept = parallel_map(lambda top: _Band(state, top, min(height, top + rows), sweep), range(0, height, rows))
    # The last, the extrapolation, is an argument so that the compiler does not reorder the sum that it is in.
    numbers = tuple(np.float32(value) for value in (*problem.bounds, problem.huber, *step_sizes(primal_step), 1.0))
    for done in range(0, iterations, sweep):
        now = min(sweep, iterations - done)
        for above, below in pairwise(kept):
            if done:
                above.exchange(below)

        def advance(_: int, first: int, last: int, now: int = now) -> None:
            for band in kept[first:last]:
                _sweep(band.rows, problem.target, problem.weight, *numbers, now, band.first, band.last, band.low)

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


@compiled(fastmath=FAST, error_model="numpy")
def _sweep(state, target, weight, lo, hi, huber, tau, sigma, theta, count, first, last, low):  # type: ignore[no-untyped-def]
    """Advance rows first .. last of a band by ``count`` iterations; each uses up a row a side."""
    height, width = target.shape
    nothing = np.zeros(width, np.float32)
    for s in range(max(0, first - count), min(height, last + count) + count):
        for t in range(count):
            i = s - t
            rest = count - t
            if i < max(0, first - rest) or i >= min(height, last + rest - 1):
                continue
            r = i - low
            bar = state[EXTRAPOLATED, r]
            below = state[EXTRAPOLATED, r + 1] if i < height - 1 else bar
            px, py = state[DUAL_X, r], state[DUAL_Y, r]
            _dual_row(bar, below, px, py, sigma, huber)
            if i < max(0, first - rest + 1):
                continue
            above = state[DUAL_Y, r - 1] if i > 0 else nothing
            u = state[U, r]
            _divergence_row(u, bar, px, py, above, tau)
            _primal_row(u, bar, target[i], weight[i], tau, theta, lo, hi)


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


# ``bar`` holds v = u + tau div p between these two passes: the extrapolated row is no longer needed then.
@inlined(fastmath=FAST, error_model="numpy")
def _divergence_row(u, bar, px, py, above, tau):  # type: ignore[no-untyped-def]
    bar[0] = u[0] + tau * (px[0] + py[0] - above[0])
    for j in range(1, len(u)):
        bar[j] = u[j] + tau * (px[j] - px[j - 1] + py[j] - above[j])


@inlined(fastmath=FAST, error_model="numpy")
def _primal_row(u, bar, f, w, tau, theta, lo, hi):  # type: ignore[no-untyped-def]
    for j in range(len(u)):
        pull = tau * w[j]
        new = min(max(bar[j] - min(max(bar[j] - f[j], -pull), pull), lo), hi)
        bar[j] = new + theta * (new - u[j])
        u[j] = new

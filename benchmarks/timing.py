"""Fair timing: the contestants alternate, and the fastest run of each counts."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import cv2
import numba

from chromaperture.system.threads import limited_threads


def fastest_ms(contestants: Mapping[str, Callable[[], object]], *, threads: int, rounds: int = 8) -> dict[str, float]:
    """Fastest run of every contestant, ms, with the same number of threads; one unmeasured round first."""
    numba.set_num_threads(threads)  # of Numba's own parallel loops
    cv2.setNumThreads(threads)
    best = dict.fromkeys(contestants, float("inf"))
    with limited_threads(threads):
        for i in range(rounds + 1):
            for name, work in contestants.items():
                begin = time.perf_counter()
                work()
                if i > 0:
                    best[name] = min(best[name], 1e3 * (time.perf_counter() - begin))
    return best

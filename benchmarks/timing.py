"""Fair times: contestants alternate and the fastest run of each counts; memory is that of a process of its own."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numba

from chromaperture.system.threads import limited_threads

PROGRAM = f"""
import json, sys
from chromaperture.cli.main import main
try:
    main()
except SystemExit as end:
    if end.code:
        raise
sys.path.insert(0, {str(Path(__file__).parent)!r})
from timing import used
print("USED", json.dumps(used()))
"""


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


def used() -> dict[str, float]:
    """Largest resident memory of this process, GB, and its processor time, s."""
    use = resource.getrusage(resource.RUSAGE_SELF)
    # Not `ru_maxrss`, which a process inherits from the one that started it.
    status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    peak = next(line for line in status if line.startswith("VmHWM")).split()[1]
    return {"peak_gb": int(peak) / 1e6, "cpu_s": use.ru_utime + use.ru_stime}


def used_by_program(*arguments: object) -> dict[str, float]:
    """Run ``chromaperture ARGUMENTS`` in a process of its own; its largest resident memory and processor time."""
    command = [sys.executable, "-c", PROGRAM, *map(str, arguments)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if run.returncode:
        raise SystemExit(run.stderr)
    return json.loads(run.stdout.split("USED", 1)[1])

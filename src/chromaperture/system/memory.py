"""How much memory this process may still use, asked before work begins: a killed process explains nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chromaperture.system.errors import InputError, OutOfMemoryError

LIMIT = "CHROMAPERTURE_MEMORY_GB"  # environment variable: the most memory that a measurement may take

# Limits of a container, and what it uses: of cgroups 2, then of cgroups 1.
_CGROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
_MEMINFO, _STATM = "/proc/meminfo", "/proc/self/statm"


def available_bytes() -> float:
    """Return the memory that this process may still use: of machine, container, limit and `LIMIT`; else inf."""
    containers = (_of_container(*files) for files in _CGROUPS)
    return max(0.0, min(_of_machine(), *containers, address_space_bytes(), limit_bytes()))


def limit_bytes() -> float:
    """Return what the environment variable `LIMIT` sets; inf without it. Raises InputError."""
    text = os.environ.get(LIMIT, "").strip()
    if not text:
        return float("inf")
    try:
        found = float(text)
    except ValueError:
        found = 0.0
    if not 0 < found < 1e6:  # neither NaN nor bytes
        raise InputError(f"{LIMIT}={text[:40]} is no amount of memory: set it to gigabytes, such as 2.5, or unset it")
    return 1e9 * found


def check_memory(what: str, needed_bytes: float, *, advice: str) -> None:
    """Raise OutOfMemoryError, ``what`` ... ``advice``, where work would need more memory than there is."""
    available = available_bytes()
    if needed_bytes > available:
        needed, free = (f"{value / 1e9:.1f} GB" for value in (needed_bytes, available))
        raise OutOfMemoryError(f"{what}: not enough memory: {needed} are needed and {free} free; {advice}")


def _of_machine() -> float:
    text = _read(_MEMINFO)
    for line in text.splitlines():
        if line.startswith("MemAvailable:"):
            return 1024 * _number(line.split()[1])
    try:
        return float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):  # Windows, macOS
        return float("inf")


def _of_container(limit_file: str, used_file: str) -> float:
    limit, used = (_number(_read(name)) for name in (limit_file, used_file))
    # What is in use counts the files that the system has cached, which it gives back: half of it at most is taken.
    return limit - used / 2 if limit < float("inf") and used < float("inf") else float("inf")


def address_space_bytes() -> float:
    """Return what this process may still map, files included (``ulimit -v``); inf without a limit."""
    try:
        import resource
    except ImportError:  # Windows
        return float("inf")
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return float("inf")
    pages = _number((_read(_STATM).split() or ["inf"])[0])
    return limit - pages * os.sysconf("SC_PAGE_SIZE") if pages < float("inf") else float("inf")


def _read(name: str) -> str:
    try:
        return Path(name).read_text(encoding="ascii")
    except (OSError, ValueError):
        return ""


def _number(text: str) -> float:
    """Return a count; inf for ``max``, nothing and anything else."""
    text = text.strip()
    return float(text) if text.isascii() and text.isdigit() else float("inf")


@dataclass(frozen=True)
class RowsOnDemand:
    """A map (H, W) or (H, W, C) that only gives slices of rows, each made anew."""

    shape: tuple[int, ...]
    dtype: np.dtype
    make: Callable[[slice], np.ndarray]  # from a slice of rows to their array

    def __getitem__(self, rows: slice) -> np.ndarray:
        return self.make(rows)

    def __len__(self) -> int:
        return self.shape[0]


Rows = np.ndarray | RowsOnDemand

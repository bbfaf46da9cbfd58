"""Keep part of the disk free while a page writes recordings and snapshots."""

from __future__ import annotations

import shutil
from pathlib import Path

from chromaperture.system.errors import InputError

# Chosen by hand: what the system, its logs and the next calibration need. A page could else fill the disk in minutes.
RESERVE_BYTES = 2 * 2**30


def require_space(folder: str | Path, needed_bytes: int, reserve_bytes: int) -> None:
    """Raise InputError where less than the reserve would stay free after writing so many bytes."""
    existing = Path(folder).absolute()
    while not existing.exists():
        existing = existing.parent
    free = shutil.disk_usage(existing).free
    if free - needed_bytes < reserve_bytes:
        raise InputError(
            f"only {free / 2**30:.1f} GiB of the disk are free at {folder}, and {reserve_bytes / 2**30:.1f} GiB are "
            "kept free; free some space or choose a smaller --keep-free-gb"
        )

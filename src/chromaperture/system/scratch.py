"""Arrays in files on disk, for what does not fit into memory: the results are the same, to the last bit.

Tiles would do with less memory, too, but the surface of quality ``accurate`` follows paths and planes through the whole
picture: at the tiles' borders it would break. The system keeps what is in use in memory and the rest on the disk.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

import numpy as np

from chromaperture.system.errors import OutOfMemoryError

_LARGE_FILES = Path("/var/tmp")  # /tmp is memory on many systems (file-hierarchy(7) of systemd)

_volumes_on_disk: ContextVar[bool] = ContextVar("volumes_on_disk", default=False)


@contextmanager
def volumes_on_disk(on_disk: bool) -> Iterator[None]:
    """Keep volumes of evidence and of costs on disk inside a ``with`` block of this thread."""
    before = _volumes_on_disk.set(on_disk)
    try:
        yield
    finally:
        _volumes_on_disk.reset(before)


def are_volumes_on_disk() -> bool:
    """Return whether `volumes_on_disk` says so here."""
    return _volumes_on_disk.get()


def scratch_folder() -> Path:
    """Return where files of `scratch_array` are: in ``TMPDIR``, else where large temporary files belong."""
    if not os.environ.get("TMPDIR") and _LARGE_FILES.is_dir() and os.access(_LARGE_FILES, os.W_OK | os.X_OK):
        return _LARGE_FILES
    return Path(tempfile.gettempdir())


def free_scratch_bytes() -> float:
    """Return how much room the disk of `scratch_folder` has."""
    try:
        return float(shutil.disk_usage(scratch_folder()).free)
    except OSError:
        return 0.0


def scratch_array(shape: tuple[int, ...]) -> np.ndarray:
    """Return a float32 array of zeros in a file that is gone with the array, also when the process is killed.

    Raises OutOfMemoryError: the disk is full, or cannot be written.
    """
    size = 4 * math.prod(shape)
    try:
        with tempfile.TemporaryFile(dir=scratch_folder(), prefix="chromaperture-") as file:
            if hasattr(os, "posix_fallocate"):  # a page for which there is no room would kill the process later
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            return np.asarray(np.memmap(file, np.float32, mode="r+", shape=shape))
    except OSError as error:
        raise OutOfMemoryError(
            f"no room for {size / 1e9:.1f} GB in {scratch_folder()} ({error.strerror or error}); "
            "set TMPDIR to a folder of a larger disk"
        ) from None

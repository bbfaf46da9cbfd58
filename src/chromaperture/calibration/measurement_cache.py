"""Cache of measurements on disk, from which an interrupted calibration resumes."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import zipfile
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path

import numpy as np

_RELEASE = version("chromaperture")


class Store:
    """Arrays, keyed by what they were computed from; without a folder nothing is kept.

    Parameters
    ----------
    folder : Path or None
        Created on first use. If it cannot be written to, everything is computed again.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder

    def arrays(
        self, photograph: Path, settings: object, compute: Callable[[], Mapping[str, np.ndarray]]
    ) -> Mapping[str, np.ndarray]:
        """Return ``compute()``, from disk if this release has computed it for that photograph and those settings."""
        if self.folder is None:
            return compute()
        name = hashlib.sha256(photograph.read_bytes() + repr((_RELEASE, settings)).encode()).hexdigest()[:32]
        path = self.folder / f"{name}.npz"
        with contextlib.suppress(OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
            kept = np.load(io.BytesIO(path.read_bytes()))
            return {key: kept[key] for key in kept.files}
        arrays = compute()
        with contextlib.suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(f".{os.getpid()}.part")
            with part.open("wb") as file:
                np.savez(file, allow_pickle=False, **arrays)
            os.replace(part, path)
        return arrays

"""Whether a file may be a camera file, said before the libraries that read one are loaded."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from chromaperture.system.errors import InputError
from chromaperture.system.validation import quoted


def camera_file_at(path: Path) -> Path:
    """Return the path; raises InputError where nothing is there, or a file that begins as no camera file does."""
    if not os.path.lexists(path):
        name = quoted(path)
        raise InputError(f"no camera file at {name}; make one with: chromaperture calibrate SESSION --out {name}")
    if path.is_file():  # opening a pipe would wait for a writer
        with contextlib.suppress(OSError), path.open("rb") as file:  # whoever reads it says why it cannot be read
            if file.read(5) not in (b"", b"#ASDF"):
                raise InputError(f"{path.name} is no camera file; give the .asdf that 'chromaperture calibrate' wrote")
    return path

"""A folder, a glob or a single picture as a source."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from chromaperture.capture.files import read_counts
from chromaperture.capture.picture_format import described
from chromaperture.capture.recording import HEADER
from chromaperture.capture.shots import counted, photographs
from chromaperture.capture.source import Frame, PictureSource, checked_fps
from chromaperture.color.encoding import Pattern, Siting, StatedFacts
from chromaperture.system.errors import InputError, MissingDependencyError
from chromaperture.system.storage import natural


@dataclass(kw_only=True, eq=False)
class FolderSource(PictureSource):
    """Pictures of a folder, a glob or a file, in the natural order of their names; ``fps`` is for their times."""

    fps: float = 30.0
    mosaic: Pattern | None = None
    siting: Siting | None = None
    primaries: Literal["srgb"] | None = None

    def __post_init__(self) -> None:
        checked_fps(self.fps)
        self.stated, self.paths = StatedFacts(self.siting, self.primaries, self.mosaic), list[Path]()

    def open(self) -> None:
        """Find the pictures."""
        folder = Path(self.name)
        if os.path.isdir(folder):  # unlike `Path`, no error for names that are too long
            self.paths, left_out = photographs(folder)
            if left_out:
                self.report("skipped", f"{self.name}: left out {counted(left_out)}")
        else:
            self.paths = [folder] if os.path.isfile(folder) else _matching(self.name)
        self.paths.sort(key=natural)
        self.total = len(self.paths)
        if not self.paths:
            if os.path.isfile(folder / HEADER):
                raise InputError(f"{self.name} is a recording; give replay:{self.name}")
            raise InputError(f"no picture at {self.name}; give a folder, a glob in quotes, or a file")

    def frames(self) -> Iterator[Frame]:
        """Yield one frame per picture; report and skip unreadable ones."""
        read = 0
        for index, path in enumerate(self.paths):
            try:
                counts, encoding, form = read_counts(path, stated=self.stated, **self.levels)
            except MissingDependencyError:
                raise  # all files need it
            except InputError as error:
                self.report("skipped", str(error))
                continue
            read += 1
            yield Frame(counts, encoding, index / self.fps, index, {"file": path.name} | described(form))
        if not read:
            raise InputError(f"none of the {len(self.paths)} files at {self.name} can be used as a colour picture")


def _matching(pattern: str) -> list[Path]:
    try:
        return [Path(found) for found in glob.glob(pattern, recursive=True)]
    except ValueError:  # a zero byte
        return []

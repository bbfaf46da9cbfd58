"""A folder, a glob or a single picture as a source."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from chromaperture.capture.files import read_counts
from chromaperture.capture.picture_format import described
from chromaperture.capture.recording import HEADER
from chromaperture.capture.shots import counted, photographs
from chromaperture.capture.source import Event, FileSource, Frame, Listener, checked_fps
from chromaperture.color.encoding import Encoding, Pattern, Siting, StatedFacts
from chromaperture.system.errors import InputError, MissingDependencyError


class FolderSource(FileSource):
    """Pictures in the natural order of their names.

    Parameters
    ----------
    pattern : str
        A folder, a glob or a file.
    fps : float
        For the times of the frames.
    black_level, white_level, camera_encoding : float or Encoding, optional
        See `choose_encoding`.
    mosaic, siting, primaries : str, optional
        See `StatedFacts`; default the camera's.
    listener : callable, optional
    """

    def __init__(
        self,
        pattern: str,
        *,
        fps: float = 30.0,
        black_level: float | None = None,
        white_level: float | None = None,
        camera_encoding: Encoding | None = None,
        mosaic: Pattern | None = None,
        siting: Siting | None = None,
        primaries: Literal["srgb"] | None = None,
        listener: Listener | None = None,
    ) -> None:
        super().__init__(pattern, listener=listener)
        self.fps, self.levels = checked_fps(fps), dict[str, Any](black_level=black_level, white_level=white_level)
        self.levels |= {"camera_encoding": camera_encoding, "stated": StatedFacts(siting, primaries, mosaic)}
        self.paths: list[Path] = []

    def open(self) -> None:
        """Find the pictures."""
        folder = Path(self.name)
        if os.path.isdir(folder):  # unlike `Path`, no error for names that are too long
            self.paths, left_out = photographs(folder)
            if left_out:
                self.listener(Event("skipped", f"{self.name}: left out {counted(left_out)}"))
        else:
            self.paths = [folder] if os.path.isfile(folder) else _matching(self.name)
        self.paths.sort(key=natural)
        if not self.paths:
            if os.path.isfile(folder / HEADER):
                raise InputError(f"{self.name} is a recording; give replay:{self.name}")
            raise InputError(f"no picture at {self.name}; give a folder, a glob in quotes, or a file")

    def frames(self) -> Iterator[Frame]:
        """Yield one frame per picture; report and skip unreadable ones."""
        read = 0
        for index, path in enumerate(self.paths):
            try:
                counts, encoding, form = read_counts(path, **self.levels)
            except MissingDependencyError:
                raise  # all files need it
            except InputError as error:
                self.listener(Event("skipped", str(error)))
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


def natural(path: Path) -> list[tuple[int, int | str]]:
    """Sort key by which frame2 comes before frame10."""
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", str(path))]

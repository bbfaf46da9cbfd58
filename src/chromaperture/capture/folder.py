"""A folder, a glob or a single picture as a source."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from chromaperture.capture.files import photographs, read_counts
from chromaperture.capture.source import Encoding, Event, FileSource, Frame, Listener
from chromaperture.errors import InputError, MissingDependencyError


class FolderSource(FileSource):
    """Pictures in the natural order of their names.

    Parameters
    ----------
    pattern : str
        A folder, a glob or a file.
    fps : float
        For the times of the frames.
    black_level, white_level : float, optional
        See `chromaperture.read_image`.
    camera_levels : (float, float), optional
        Black and white level of the camera file, for files that can hold such counts, when no levels are given.
    listener : callable, optional
    """

    def __init__(
        self,
        pattern: str,
        *,
        fps: float = 30.0,
        black_level: float | None = None,
        white_level: float | None = None,
        camera_levels: tuple[float, float] | None = None,
        listener: Listener | None = None,
    ) -> None:
        super().__init__(pattern, listener=listener)
        self.fps, self.levels = fps, {"black_level": black_level, "white_level": white_level}
        self.paths: list[Path] = []
        self._by_camera = camera_levels is not None and black_level is None and white_level is None
        if camera_levels is not None and self._by_camera:
            self.levels = {"black_level": camera_levels[0], "white_level": camera_levels[1]}

    def open(self) -> None:
        """Find the pictures."""
        folder = Path(self.name)
        if folder.is_dir():
            self.paths = photographs(folder)
        else:
            self.paths = [folder] if folder.is_file() else [Path(p) for p in glob.glob(self.name, recursive=True)]
        self.paths.sort(key=natural)
        if not self.paths:
            raise InputError(f"no picture at {self.name}; give a folder, a glob in quotes, or a file")

    def frames(self) -> Iterator[Frame]:
        """Yield one frame per picture; report and skip unreadable ones."""
        read = 0
        for index, path in enumerate(self.paths):
            try:
                counts, encoding = read_counts(path, **self.levels)
            except MissingDependencyError:
                raise  # all files need it
            except InputError as error:
                self.listener(Event("skipped", str(error)))
                continue
            read += 1
            if self._by_camera and counts.dtype == np.uint8 and encoding.white_level > 255:
                encoding = Encoding(0.0, 255.0, "srgb")  # 8 bits cannot hold the camera's counts
            yield Frame(counts, encoding, index / self.fps, index, {"file": path.name})
        if not read:
            raise InputError(f"none of the {len(self.paths)} files at {self.name} can be read as a colour picture")


def natural(path: Path) -> list[tuple[int, int | str]]:
    """Sort key by which frame2 comes before frame10."""
    return [(0, int(part)) if part.isdigit() else (1, part) for part in re.split(r"(\d+)", str(path))]

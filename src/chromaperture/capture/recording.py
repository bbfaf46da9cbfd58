"""Recordings: every acknowledged frame is on the disk, however the program ends.

A folder with ``recording.json`` (format and source), ``frames/NNNNNNNN.tiff`` (counts as delivered, uncompressed) and
``index.jsonl``, one line per frame, appended and synced to the disk after the picture. An incomplete last line, as a
crash leaves it, is ignored. Levels that nobody gave are null; format 1 wrote 0 and 65535 for those of 16-bit files.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import zlib
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import tifffile

from chromaperture.capture.source import (
    CENTRED,
    Encoding,
    Event,
    FileSource,
    Frame,
    Listener,
    choose_encoding,
    format_encoding,
)
from chromaperture.errors import InputError

_FORMAT, _FIRST_FORMAT = "chromaperture recording 2", "chromaperture recording 1"
_INDEX, _HEADER = "index.jsonl", "recording.json"


class Recorder:
    """Write frames; a context manager.

    Parameters
    ----------
    folder : str or Path
        Created when absent; must not hold a recording.
    source : str
        Name of the source, for the record.

    Raises
    ------
    InputError
        From entering: the folder holds a recording or cannot be written. From `write`: the disk is full.
    """

    def __init__(self, folder: str | Path, *, source: str = "") -> None:
        self.folder, self.count = Path(folder), 0
        self._source, self._index = source, -1

    def __enter__(self) -> Self:
        if (self.folder / _HEADER).exists() or (self.folder / _INDEX).exists():
            raise InputError(f"{self.folder} holds a recording already; choose another folder")
        try:
            (self.folder / "frames").mkdir(parents=True, exist_ok=True)
            header = json.dumps({"format": _FORMAT, "source": self._source}) + "\n"
            _write_durably(self.folder / _HEADER, header.encode())
            self._index = os.open(self.folder / _INDEX, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            _sync_folder(self.folder)
        except BaseException as error:
            self.__exit__(type(error), error, None)
            if isinstance(error, OSError):
                raise self._failure(error) from None
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._index >= 0:
            os.close(self._index)
        self._index = -1
        if kind is not None and not self.count:  # nothing was recorded: the same folder can be given again
            with contextlib.suppress(OSError):
                for path in (self.folder / _INDEX, self.folder / _HEADER, *(self.folder / "frames").iterdir()):
                    path.unlink(missing_ok=True)
                (self.folder / "frames").rmdir()

    def write(self, frame: Frame) -> None:
        """Write one frame; it is on the disk when this returns."""
        name = f"{self.count:08d}.tiff"
        path = self.folder / "frames" / name
        entry = {
            "file": name,
            "index": frame.index,
            "time_s": frame.time_s,
            "crc32": zlib.crc32(frame.counts.tobytes()),
            "encoding": _recorded(frame.encoding),
            "metadata": dict(frame.metadata),
        }
        line = (json.dumps(entry, default=str) + "\n").encode()
        end = os.fstat(self._index).st_size
        try:
            _write_durably(path, _tiff(frame.counts))
            _sync_folder(path.parent)
            _write_all(self._index, line)
            os.fsync(self._index)
        except OSError as error:
            os.ftruncate(self._index, end)
            path.unlink(missing_ok=True)
            raise self._failure(error) from None
        self.count += 1

    def _failure(self, error: OSError) -> InputError:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            return InputError(
                f"the disk is full: recording stopped, {self.count} frames are safe in {self.folder}; free some space"
            )
        return InputError(f"cannot write to {self.folder} ({error.strerror}); {self.count} frames are safe there")


class ReplaySource(FileSource):
    """Frames of a recording, with times and counts as recorded.

    Parameters
    ----------
    folder : str
    black_level, white_level : float, optional
        Instead of the recorded ones.
    camera_levels : (float, float), optional
        Of the camera file, for levels that nobody gave; see `choose_encoding`.
    listener : callable, optional
    """

    def __init__(
        self,
        folder: str,
        *,
        black_level: float | None = None,
        white_level: float | None = None,
        camera_levels: tuple[float, float] | None = None,
        listener: Listener | None = None,
    ) -> None:
        super().__init__(f"replay:{folder}", listener=listener)
        self.folder = Path(folder)
        self.levels, self.camera_levels = {"black_level": black_level, "white_level": white_level}, camera_levels
        self.entries: list[dict[str, Any]] = []
        self._is_first_format = False

    def open(self) -> None:
        """Read the index."""
        try:
            header = json.loads((self.folder / _HEADER).read_text(encoding="utf-8"))
            known = header.get("format") in (_FORMAT, _FIRST_FORMAT)
            self._is_first_format = header.get("format") == _FIRST_FORMAT
            data = (self.folder / _INDEX).read_bytes()
        except (OSError, ValueError, AttributeError):
            raise InputError(f"no recording at {self.folder}; give a folder that 'chromaperture record' made") from None
        if not known:
            raise InputError(f"{self.folder} was recorded by a newer version; update chromaperture")
        self.entries = []
        for line in data.split(b"\n")[:-1]:  # text after the last newline was never acknowledged
            try:
                self.entries.append(json.loads(line))
            except ValueError:
                self.listener(Event("skipped", f"line {len(self.entries) + 1} of {self.folder / _INDEX} is damaged"))
        if not self.entries:
            raise InputError(f"the recording at {self.folder} holds no frame")

    def frames(self) -> Iterator[Frame]:
        """Yield the frames; report and skip damaged ones."""
        for entry in self.entries:
            path = self.folder / "frames" / entry["file"]
            try:
                counts = np.asarray(tifffile.imread(path))
            except (OSError, ValueError, tifffile.TiffFileError):
                counts = np.zeros(0)
            if zlib.crc32(counts.tobytes()) != entry["crc32"]:
                self.listener(Event("skipped", f"{path} is damaged; its frame is left out"))
                continue
            yield Frame(
                counts, self._encoding(entry["encoding"], counts), entry["time_s"], entry["index"], entry["metadata"]
            )

    def _encoding(self, recorded: dict[str, Any], counts: np.ndarray) -> Encoding:
        """Return the recorded encoding, with the levels of the reader or of the camera file in their place."""
        fields = dict(recorded)
        fields["channel_offsets_px"] = tuple(tuple(xy) for xy in fields["channel_offsets_px"])
        if fields["white_level"] is None:
            own = format_encoding(counts.dtype)
        else:
            own = Encoding(**fields)
            if self._is_first_format and counts.dtype == np.uint16 and own == Encoding():
                own = format_encoding(counts.dtype)
        camera_levels = None if own.given else self.camera_levels
        return choose_encoding(own, counts, **self.levels, camera_levels=camera_levels)


def _recorded(encoding: Encoding) -> dict[str, Any]:
    """Return the fields to record; null for levels that neither a person nor a RAW file gave."""
    fields = asdict(encoding)
    if not encoding.given and encoding.channel_offsets_px == CENTRED:
        fields["black_level"] = fields["white_level"] = None
    return fields


def _tiff(counts: np.ndarray) -> bytes:
    memory = io.BytesIO()
    tifffile.imwrite(memory, counts, photometric="rgb", metadata=None)
    return memory.getvalue()


def _write_durably(path: Path, data: bytes) -> None:
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    try:
        _write_all(file, data)
        os.fsync(file)
    finally:
        os.close(file)


def _write_all(file: int, data: bytes) -> None:
    view = memoryview(data)
    while view:  # a nearly full disk writes a part
        view = view[os.write(file, view) :]


def _sync_folder(folder: Path) -> None:
    file = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)

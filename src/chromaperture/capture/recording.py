"""Recordings: every acknowledged frame is on the disk, however the program ends.

``recording.json`` (format and source), ``frames/NNNNNNNN.tiff`` (counts as delivered) and ``index.jsonl``, a line per
frame, synced to the disk after the picture. An incomplete last line, as a crash leaves it, is ignored. Picture and line
have a checksum each, lines since format 3: a damaged one costs its frame. Levels that nobody gave are null; format 1
wrote 0 and 65535.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import re
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import tifffile
from pydantic import Field

from chromaperture.capture.source import Frame, PictureSource
from chromaperture.capture.tiff import decode_tiff
from chromaperture.color.color_space import TRANSFERS
from chromaperture.color.encoding import Encoding, choose_encoding, format_encoding
from chromaperture.system.errors import InputError
from chromaperture.system.validation import Finite, Table, checked, quoted, read_bytes

_FORMATS = [f"chromaperture recording {number}" for number in (1, 2, 3)]
_FORMAT, _FIRST_FORMAT = _FORMATS[-1], _FORMATS[0]
_MOST_HEADER_BYTES, _MOST_INDEX_BYTES = 10_000, 2_000_000_000  # of the index: two days at 30 frames a second
_MOST_PICTURE_BYTES = 2_000_000_000  # of a frame: 160 megapixels of float32
_INDEX, HEADER = "index.jsonl", "recording.json"

_LINE = re.compile(rb'(\{.*), "line_crc32": "([0-9a-f]{8})"\}')  # the checksum is that of the bytes before it
_LONGEST = 1_000_000  # bytes of a line; metadata of cameras have some 100
_Pair = tuple[Finite, Finite]


class EncodingEntry(Table):
    """See `Encoding`; levels that nobody gave are null."""

    black_level: Finite | None
    white_level: Finite | None
    curve: Literal[TRANSFERS]  # type: ignore[valid-type]
    channel_offsets_px: tuple[_Pair, _Pair, _Pair]
    given: bool = True  # the first format has none
    curve_parameters: Annotated[tuple[Finite, ...], Field(max_length=65536)] = ()
    to_srgb: Annotated[tuple[Finite, ...], Field(min_length=9, max_length=9)] | None = None


class Entry(Table):
    """One frame: the name of its picture and what the picture does not hold."""

    file: Annotated[str, Field(pattern=r"\A[0-9]{8,12}\.tiff\z")]  # as `Recorder` names them; no path leads out
    index: Annotated[int, Field(ge=0, lt=2**63)]
    time_s: Finite
    crc32: Annotated[int, Field(ge=0, lt=2**32)]
    encoding: EncodingEntry
    metadata: dict[str, Any]


class Recorder:
    """Write frames into a folder that holds no recording; a context manager; raises InputError, disk full too."""

    def __init__(self, folder: str | Path, *, source: str = "") -> None:
        self.folder, self.count = Path(folder), 0
        self._source, self._is_new, self._end = source, False, 0  # of the index, bytes

    def __enter__(self) -> Self:
        if (self.folder / HEADER).exists() or (self.folder / _INDEX).exists():
            raise InputError(f"{self.folder} holds a recording already; choose another folder")
        self._is_new = not self.folder.exists()
        try:
            (self.folder / "frames").mkdir(parents=True, exist_ok=True)
            header = json.dumps({"format": _FORMAT, "source": self._source}) + "\n"
            _write_durably(self.folder / HEADER, header.encode())
            _write_durably(self.folder / _INDEX, b"")
            _sync_folder(self.folder)
        except BaseException as error:
            self.__exit__(type(error))
            if isinstance(error, OSError):
                raise self._failure(error) from None
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and not self.count:  # nothing was recorded: the same folder can be given again
            with contextlib.suppress(OSError):
                for path in (self.folder / _INDEX, self.folder / HEADER, *(self.folder / "frames").iterdir()):
                    path.unlink(missing_ok=True)
                (self.folder / "frames").rmdir()
                if self._is_new:
                    self.folder.rmdir()

    def write(self, frame: Frame) -> None:
        """Write one frame; it is on the disk when this returns."""
        name = f"{self.count:08d}.tiff"
        path = self.folder / "frames" / name
        entry = {
            "file": name,
            "index": frame.index,
            "time_s": frame.time_s,
            "crc32": zlib.crc32(frame.counts.tobytes()),
            "encoding": _recorded(frame.encoding, frame.counts.dtype),
            "metadata": dict(frame.metadata),
        }
        line = _line_of(entry)
        try:
            _write_durably(path, _tiff(frame.counts))
            _sync_folder(path.parent)
            _write_durably(self.folder / _INDEX, line, os.O_APPEND)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.truncate(self.folder / _INDEX, self._end)
            path.unlink(missing_ok=True)
            raise self._failure(error) from None
        self.count, self._end = self.count + 1, self._end + len(line)

    def _failure(self, error: OSError) -> InputError:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            return InputError(
                f"the disk is full: recording stopped, {self.count} frames are safe in {self.folder}; free some space"
            )
        return InputError(f"cannot write to {self.folder} ({error.strerror}); {self.count} frames are safe there")


@dataclass(kw_only=True, eq=False)
class ReplaySource(PictureSource):
    """Frames of a recording, with times, counts and levels as recorded, unless others are given."""

    kind = "replay"

    def __post_init__(self) -> None:
        self.folder, self.entries, self._is_first_format = Path(self.place), list[Entry](), False

    def open(self) -> None:
        """Read the index; report and leave out damaged lines."""
        none = f"no recording at {quoted(self.folder)}; give a folder that 'chromaperture record' made"
        try:
            header = json.loads(read_bytes(self.folder / HEADER, most_bytes=_MOST_HEADER_BYTES))
            kind = header.get("format")
            data = read_bytes(self.folder / _INDEX, most_bytes=_MOST_INDEX_BYTES)
        except (InputError, ValueError, AttributeError, RecursionError):
            raise InputError(none) from None
        if kind not in _FORMATS:
            raise InputError(f"{quoted(self.folder)} was recorded by a newer version; update chromaperture")
        self._is_first_format = kind == _FIRST_FORMAT
        self.entries = []
        for number, line in enumerate(data.split(b"\n")[:-1], start=1):  # the rest was never acknowledged
            try:
                self.entries.append(_entry_of(line, has_checksum=kind == _FORMAT))
            except InputError as error:
                where = f"line {number} of {quoted(self.folder / _INDEX)}"
                self.report("skipped", f"{where} is damaged, its frame is left out: {error}")
        self.total = len(self.entries)
        if not self.entries:
            raise InputError(f"the recording at {quoted(self.folder)} holds no frame that can be read")

    def frames(self) -> Iterator[Frame]:
        """Yield the frames; report and skip damaged ones."""
        for entry in self.entries:
            path = self.folder / "frames" / entry.file
            try:
                counts = self._counts(path, entry)
                encoding = self._encoding(entry.encoding, counts)
            except InputError as error:
                self.report("skipped", f"{quoted(path)} is left out: {error}")
                continue
            yield Frame(counts, encoding, entry.time_s, entry.index, entry.metadata)

    def _counts(self, path: Path, entry: Entry) -> np.ndarray:
        """Read the picture of a frame; raises InputError where it is damaged, or not the one that was recorded."""
        if path.is_symlink():
            raise InputError("it is a link; copy the picture itself into the recording")
        counts = decode_tiff(read_bytes(path, most_bytes=_MOST_PICTURE_BYTES), path.name)
        if zlib.crc32(np.ascontiguousarray(counts).tobytes()) != entry.crc32:
            raise InputError("the picture is damaged")
        if counts.ndim != 3 or counts.shape[2] != 3:
            raise InputError(f"it holds an array of shape {counts.shape}")
        return counts

    def _encoding(self, recorded: EncodingEntry, counts: np.ndarray) -> Encoding:
        """Return the recorded encoding, with the levels of the reader or of the camera file in their place."""
        if recorded.white_level is None or recorded.black_level is None:
            own = format_encoding(counts.dtype)
        else:
            own = Encoding(**dict(recorded))
            if self._is_first_format and counts.dtype == np.uint16 and own == Encoding():
                own = format_encoding(counts.dtype)
        camera = None if own.given else self.camera_encoding
        return choose_encoding(own, counts, **self.levels | {"camera_encoding": camera})


def _line_of(entry: dict[str, Any]) -> bytes:
    """Return the line of a frame, its checksum and the newline included."""
    body = json.dumps(entry, default=str).removesuffix("}").encode()
    return body + b', "line_crc32": "%08x"}\n' % zlib.crc32(body)


def _entry_of(line: bytes, *, has_checksum: bool) -> Entry:
    """Read a line without its newline, those of the first two formats without a checksum; raises InputError."""
    if has_checksum:
        found = _LINE.fullmatch(line)
        if found is None or zlib.crc32(found[1]) != int(found[2], 16):
            raise InputError("its checksum is not that of its text")
        line = found[1] + b"}"
    try:
        tree = json.loads(line) if len(line) <= _LONGEST else None
    except (ValueError, RecursionError):
        raise InputError("it is not JSON") from None
    metadata = tree.get("metadata") if isinstance(tree, dict) else None
    entry = checked(Entry, tree, where="a line of the index")
    return entry.model_copy(update={"metadata": metadata})  # lists stay lists


def _recorded(encoding: Encoding, dtype: np.dtype[Any]) -> dict[str, Any]:
    """Return the fields to record; null for levels that are those of the number format alone."""
    fields = asdict(encoding)
    del fields["response"], fields["stated"]  # of the camera file, which is read again
    if not encoding.given and encoding == format_encoding(dtype):
        fields["black_level"] = fields["white_level"] = None
    return fields


def _tiff(counts: np.ndarray) -> bytes:
    memory = io.BytesIO()
    tifffile.imwrite(memory, counts, photometric="rgb", metadata=None)
    return memory.getvalue()


def _write_durably(path: Path, data: bytes, how: int = os.O_TRUNC) -> None:
    file = os.open(path, os.O_WRONLY | os.O_CREAT | how, 0o644)
    try:
        view = memoryview(data)
        while view:  # a nearly full disk writes a part
            view = view[os.write(file, view) :]
        os.fsync(file)
    finally:
        os.close(file)


def _sync_folder(folder: Path) -> None:
    file = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)

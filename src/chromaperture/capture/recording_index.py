"""Lines of a recording's index: one for each frame, with a checksum of its own."""

from __future__ import annotations

import json
import re
import zlib
from typing import Annotated, Any, Literal

from pydantic import Field

from chromaperture.color.color_space import TRANSFERS
from chromaperture.system.errors import InputError
from chromaperture.system.validation import Finite, Table, checked

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


def line_of(entry: dict[str, Any]) -> bytes:
    """Return the line of a frame, its checksum and the newline included."""
    body = json.dumps(entry, default=str).removesuffix("}").encode()
    return body + b', "line_crc32": "%08x"}\n' % zlib.crc32(body)


def entry_of(line: bytes, *, has_checksum: bool) -> Entry:
    """Read a line without its newline.

    Parameters
    ----------
    line : bytes
    has_checksum : bool
        False for the lines of the first two formats.

    Raises
    ------
    InputError
        The line is damaged.
    """
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

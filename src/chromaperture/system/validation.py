"""Reading of files that another person or program wrote: bounded, typed, and refused in one line.

Pydantic checks types, ranges and keys; a message names the file, the key, what was expected, and the nearest key.
"""

from __future__ import annotations

import codecs
import difflib
import math
import os
import stat
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from chromaperture.system.errors import InputError

# A lens of 20 surfaces has 3 KB, a session 1 KB; tables of more belong into other files.
MOST_TOML_BYTES = 65_536
# On one line: Python's reader takes 0.1 s for a dotted key of 2000 parts, and the square of that for longer ones.
MOST_DOTS = 2_000
LARGEST_SIDE = 100_000  # px, of a picture; the widest sensors have 20,000
# Of a picture: medium-format cameras have 150 megapixels. As linear light in float32 it takes 3 GB.
MOST_PIXELS = 250_000_000
MOST_FILE_BYTES = 12 * MOST_PIXELS + 100_000_000  # of a picture's file: three float32 a pixel, and metadata
_LONGEST_QUOTE = 60  # characters of a value that a message repeats

Number = Annotated[float, Field(ge=-math.inf)]  # infinite or not, but not NaN
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Name = Annotated[str, Field(max_length=200)]  # of a file system: 255 bytes
_STRICT = ConfigDict(strict=True)  # "1" and true are no numbers
# How messages call what pydantic expected.
_EXPECTED = {"float_type": "a number", "float_parsing": "a number", "int_type": "a whole number",
             "int_parsing": "a whole number", "bool_type": "true or false", "string_type": "text",
             "tuple_type": "a list", "model_type": "a table", "dict_type": "a table", "dataclass_type": "a table",
             "mapping_type": "a table"}  # fmt: skip
M = TypeVar("M")


class Table(BaseModel):
    """A table of a file; subclasses name its keys. Unknown keys are errors."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


def read_bytes(path: str | Path, *, most_bytes: int) -> bytes:
    """Read a regular file whole; raises InputError where it is none, or larger than ``most_bytes``."""
    try:
        # Opening a pipe would wait for a writer.
        with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise InputError(f"cannot read {quoted(path)}: it is not a regular file; give a file")
            data = file.read(min(status.st_size, most_bytes) + 1)  # Python reserves what it is asked for
    except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot read {quoted(path)}: {reason}; give a file that can be read") from None
    if len(data) > most_bytes:
        raise InputError(f"{quoted(path)} is larger than {most_bytes} bytes: this is not such a file")
    return data


def read_text(path: str | Path, *, most_bytes: int) -> str:
    """Read a text file in UTF-8; raises InputError like `read_bytes`, and for another encoding."""
    return as_text(read_bytes(path, most_bytes=most_bytes), path)


def as_text(data: bytes, path: str | Path, *, or_utf16: bool = False) -> str:
    """Decode UTF-8, or UTF-16 that says so, as PowerShell writes it; raises InputError for another encoding."""
    is_utf16 = or_utf16 and data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return data.decode("utf-16" if is_utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise InputError(f"{quoted(path)} is not UTF-8 text (line {line}): save it again with this encoding") from None


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file; raises InputError where it cannot be read, or is not TOML."""
    text = read_text(path, most_bytes=MOST_TOML_BYTES)
    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") > MOST_DOTS:
            raise InputError(
                f"{quoted(path)}: line {number} has more than {MOST_DOTS} dots: break it into several lines"
            )
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: also of numbers with thousands of digits
        reason = "too deeply nested" if isinstance(error, RecursionError) else error
        raise InputError(f"{quoted(path)} is not valid TOML: {reason}".replace("\n", " ")) from None


def checked(kind: type[M], tree: Any, *, where: str) -> M:
    """Check a tree of plain values against a `Table` or a dataclass; raises InputError that names the key."""
    try:
        return cast(M, _adapter(cast(Any, kind)).validate_python(_tuples(tree)))
    except ValidationError as error:
        raise InputError(f"{where}: {_explained(error, kind)}") from None
    except RecursionError:
        raise InputError(f"{where}: too deeply nested") from None


def checked_value(kind: Any, value: Any, *, where: str) -> Any:
    """Check one value against a type, and return it; raises InputError like `checked`."""
    try:
        return _adapter(kind).validate_python(_tuples(value))
    except ValidationError as error:
        raise InputError(f"{where}{_explained(error)}") from None
    except RecursionError:
        raise InputError(f"{where} is too deeply nested") from None


def nearest(key: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown key: the known one that resembles it, else all."""
    known = list(known)
    near = difflib.get_close_matches(key[:_LONGEST_QUOTE], known, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(known)}"


def quoted(value: object) -> str:
    """Return a value or a path as a message shows it: on one line, and not long."""
    if isinstance(value, Path):
        text = str(value)
    else:
        text = value if isinstance(value, str) and value.isprintable() else _representation(value)
    text = text if text.isprintable() else ascii(text)
    return text if len(text) <= 4 * _LONGEST_QUOTE else f"{text[:_LONGEST_QUOTE]}...{text[-_LONGEST_QUOTE:]}"


def _representation(value: object) -> str:
    """Return ``repr`` cut short; of a number with thousands of digits, that it is one."""
    try:
        text = repr(value)
    except ValueError:
        text = "a number of thousands of digits"
    return text if len(text) <= _LONGEST_QUOTE else f"{text[:_LONGEST_QUOTE]}..."


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    has_own = is_dataclass(kind) or (isinstance(kind, type) and issubclass(kind, BaseModel))
    return TypeAdapter(kind, config=None if has_own else _STRICT)


def _tuples(value: Any) -> Any:
    """Make tuples of lists: arrays have a fixed type, and pydantic takes no list for a tuple."""
    if isinstance(value, list | tuple):
        return tuple(map(_tuples, value))
    return {key: _tuples(item) for key, item in value.items()} if isinstance(value, dict) else value


def _explained(error: ValidationError, kind: Any = None) -> str:
    """Describe the first thing that is wrong: the key, what was expected, what was found."""
    # A misspelt key is missing too: name what is there.
    first = min(error.errors(include_url=False, include_context=False), key=lambda found: found["type"] == "missing")
    *place, last = first["loc"] or ("",)
    if first["type"] == "extra_forbidden":
        known = [] if kind is None else list(_table_at(kind, place).model_fields)
        return f"unknown key {_representation(last)}{_inside(place)}{nearest(str(last), known)}"
    name = _named([*place, last]) if first["loc"] else ""
    if first["type"] == "missing":
        return f"{name} is missing"
    expected = first["msg"].replace("Input should be", "must be").replace("Value error, ", "")
    expected = expected.replace("Tuple should", "the list should").replace(" after validation", "")
    if first["type"] in _EXPECTED:
        expected = f"must be {_EXPECTED[first['type']]}"
    elif "must be" not in expected:
        return f"{name}: {expected}".removeprefix(": ")
    return f"{name} {expected}, is {_representation(first['input'])}".lstrip()


def _named(place: list[int | str]) -> str:
    """Name a value: ``surface 2: radius_mm``, with numbers from 1."""
    name = ""
    for part in place:
        part = part if isinstance(part, int) or part.isidentifier() else _representation(part)
        name += (
            f" {part + 1}" if isinstance(part, int) else f"{': ' if name[-1:].isdigit() else '.' * bool(name)}{part}"
        )
    return name.strip()


def _inside(place: list[int | str]) -> str:
    return f" in {_named(place)}" if place else ""


def _table_at(kind: type[BaseModel], place: list[int | str]) -> type[BaseModel]:
    """Find the table that a place lies in: the way goes through fields, numbers of a list and names of a mapping."""
    for part in place:
        field = kind.model_fields.get(part) if isinstance(part, str) else None
        if field is not None:
            kind = next(_tables(field.annotation), kind)
    return kind


def _tables(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _tables(part)

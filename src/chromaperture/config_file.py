"""Settings from a TOML file: any value of `Config`, in nested tables named as its fields are.

::

    [matcher]
    floor_px = 0.1

    [matcher.paths]
    jump_penalty = 15.0

    [depth]
    max_depth_mm = 8000
"""

from __future__ import annotations

import dataclasses
import difflib
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from chromaperture.config import Config
from chromaperture.errors import InputError

T = TypeVar("T")
_SECTIONS = ("matcher", "depth")  # the quality is chosen by --quality


def with_file(config: Config, path: str | Path) -> Config:
    """Replace settings by those of a TOML file.

    Raises
    ------
    InputError
        The file cannot be read, or has a key or a value that does not fit; the message names the nearest valid key.
    """
    path = Path(path)
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:  # ValueError: also of bytes that are no text
        raise InputError(f"cannot read settings {path}: {error}") from None
    for section in tree:
        if section not in _SECTIONS:
            raise InputError(f"{path.name}: unknown section [{section}]{_nearest(section, _SECTIONS)}")
    return _replaced(config, tree, path.name, "")


def _replaced(settings: T, tree: Any, file: str, section: str) -> T:
    """Return a dataclass with the values of a table, its nested dataclasses included."""
    if not isinstance(tree, dict):
        raise InputError(f"{file}: [{section}] must be a table, is {tree!r}")
    known = [field.name for field in dataclasses.fields(settings)]  # type: ignore[arg-type]
    changes = {}
    for key, value in tree.items():
        name = f"{section}.{key}" if section else key
        if key not in known:
            raise InputError(f"{file}: unknown setting {key!r} in [{section}]{_nearest(key, known)}")
        current = getattr(settings, key)
        if dataclasses.is_dataclass(current):
            changes[key] = _replaced(current, value, file, name)
        else:
            changes[key] = _checked(value, current, file, name)
    try:
        return dataclasses.replace(settings, **changes)  # type: ignore[type-var]
    except InputError as error:
        raise InputError(f"{file}: [{section}] {error}") from None


def _checked(value: Any, current: Any, file: str, name: str) -> Any:
    """Return a value of the type of the one it replaces; InputError where it is of another."""
    if isinstance(current, tuple) and isinstance(value, list):
        return tuple(_checked(item, current[0], file, name) for item in value)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    whole = isinstance(value, int) and not isinstance(value, bool)
    fits = {bool: isinstance(value, bool), str: isinstance(value, str), int: whole, float: number}
    if not fits.get(type(current), False):
        raise InputError(f"{file}: {name} must be like {current!r}, is {value!r}")
    try:
        return float(value) if isinstance(current, float) else value
    except OverflowError:
        raise InputError(f"{file}: {name} must be like {current!r}, is too large") from None


def _nearest(key: str, known: list[str] | tuple[str, ...]) -> str:
    near = difflib.get_close_matches(key, known, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(known)}"

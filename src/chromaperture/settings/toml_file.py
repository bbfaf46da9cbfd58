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
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from chromaperture.settings.methods import Config
from chromaperture.system.errors import InputError
from chromaperture.system.validation import checked_value, nearest, quoted, read_toml

T = TypeVar("T")
_SECTIONS = ("matcher", "depth")  # quality and scale are chosen by --quality and --scale
# Of a number in px: the time of a Gaussian grows with its width, and 1000 px takes seconds; of a count of iterations,
# whose default is 40; of any other: a depth of 1000 km, whose square is still finite.
MOST_PX, MOST_ITERATIONS, LARGEST = 1e3, 10_000, 1e9


def with_file(config: Config, path: str | Path) -> Config:
    """Replace settings by those of a TOML file.

    Raises
    ------
    InputError
        The file cannot be read, or has a key or a value that does not fit; the message names the nearest valid key.
    """
    path = Path(path)
    tree = read_toml(path)
    for section in tree:
        if section not in _SECTIONS:
            raise InputError(f"{path.name}: unknown section [{quoted(section)}]{nearest(section, _SECTIONS)}")
    return _replaced(config, tree, quoted(path.name), "")


def _replaced(settings: T, tree: Any, file: str, section: str) -> T:
    """Return a dataclass with the values of a table, its nested dataclasses included."""
    if not isinstance(tree, dict):
        raise InputError(f"{file}: [{section}] must be a table, is {quoted(tree)}")
    hints = get_type_hints(type(settings))
    changes = {}
    for key, value in tree.items():
        name = f"{section}.{key}" if section else key
        if key not in hints:
            raise InputError(f"{file}: unknown setting {quoted(key)!r} in [{section}]{nearest(key, hints)}")
        current = getattr(settings, key)
        if dataclasses.is_dataclass(current):
            changes[key] = _replaced(current, value, file, name)
        else:
            changes[key] = checked_value(hints[key], value, where=f"{file}: {name} ")
            _check_size(changes[key], f"{file}: {name}")
    try:
        return dataclasses.replace(settings, **changes)  # type: ignore[type-var]
    except InputError as error:
        raise InputError(f"{file}: [{section}] {error}") from None


def _check_size(value: Any, name: str) -> None:
    """Raise InputError where a number is NaN, or larger than any setting of its unit."""
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, tuple):
            _check_size(number, name)
        elif isinstance(number, int | float):
            most = MOST_PX if name.endswith("_px") else MOST_ITERATIONS if isinstance(number, int) else LARGEST
            if not -most <= number <= most:
                raise InputError(f"{name} must lie between {-most:g} and {most:g}, is {quoted(number)}")

"""The text of a stage's shader: its constants, the functions that it uses, and its own file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from chromaperture.system.errors import InputError

_UNROLLED = re.compile(
    r"^( *)for \(var (\w+) = 0u; \2 < (\w+); \2\+\+\) \{  // unrolled\n((?:.*\n)*?)\1\}\n", re.MULTILINE
)


def shader(stage: str, uses: Sequence[str], constants: Mapping[str, Any]) -> str:
    """Return the source of a stage behind its constants and the functions that it uses."""
    lines = [f"const {name} = {_literal(value)};" for name, value in constants.items()]
    return unrolled("\n".join([*lines, *map(text_of, uses), text_of(stage)]), constants)


def unrolled(text: str, constants: Mapping[str, Any]) -> str:
    """Write out the loops whose first line ends in ``// unrolled``, round after round.

    Compilers decide by a loop's length, and what they do not unroll they index in memory. The loop is
    ``for (var p = 0u; p < COUNT; p++) {``, COUNT a number or one of the constants, its end a ``}`` as far indented.
    """
    while found := _UNROLLED.search(text):
        indent, name, count, body = found.groups()
        rounds = int(count.rstrip("u")) if count[0].isdigit() else int(constants[count])
        written = "".join(f"{indent}{{\n{indent}    const {name} = {i}u;\n{body}{indent}}}\n" for i in range(rounds))
        text = text[: found.start()] + written + text[found.end() :]
    return text


def _literal(value: Any) -> str:
    """Write a constant in WGSL."""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, int | np.integer):
        return f"{value}u" if value >= 0 else f"{value}i"
    if isinstance(value, float | np.floating):
        if not math.isfinite(value):
            raise InputError(f"a constant of a shader must be finite, got {value}")
        return f"{np.float32(value)!s}f"
    numbers = [f"{np.float32(v)!s}f" for v in value]
    return f"array<f32, {len(numbers)}>({', '.join(numbers)})"


@cache
def text_of(stage: str) -> str:
    """Return the text of ``STAGE.wgsl``."""
    return resources.files(__package__).joinpath(f"{stage}.wgsl").read_text(encoding="utf-8")

"""The text of a stage's shader, made of sections of the ``.wgsl`` files beside this one.

A section begins with ``// ---- NAME: USED, USED ...`` and ends where the next begins. Behind constants and the sections
that it uses, that of a stage is WGSL but for what every stage would repeat::

    in image: array<f32>;      // @group(0) @binding(0) var<storage, read> image: array<f32>;
    out maps: array<f32>;      // @group(0) @binding(1) var<storage, read_write> maps: array<f32>;

    fn main(i) {               // workgroups of 64, counted along x and y; i is the number of an invocation
    @workgroup_size(256)       // others than 64
    fn main(group, local) {    // of the built-ins workgroup_id, num_workgroups (groups), local_invocation_index

Arrays of a section that others use follow the stage's own where it names their bindings itself.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from itertools import count
from typing import Any

import numpy as np

from chromaperture.system.errors import InputError

_SECTION = re.compile(r"^// ---- (\w+)(?:: (.*))?\n", re.MULTILINE)
_ARRAY = re.compile(r"^(in|out) (?=\w+: )", re.MULTILINE)
_MAIN = re.compile(r"^(@workgroup_size\(\w+\)\n)?fn main\(([a-z, ]*)\) \{\n", re.MULTILINE)
_UNROLLED = re.compile(
    r"^( *)for \(var (\w+) = 0u; \2 < (\w+); \2\+\+\) \{  // unrolled\n((?:.*\n)*?)\1\}\n", re.MULTILINE
)
_BUILT_IN = {
    "group": "@builtin(workgroup_id) group: vec3u",
    "groups": "@builtin(num_workgroups) groups: vec3u",
    "local": "@builtin(local_invocation_index) local: u32",
}


def shader(stage: str, uses: Sequence[str], constants: Mapping[str, Any]) -> str:
    """Return the source of a stage behind its constants, the sections that it uses, and those in ``uses``."""
    lines = [f"const {name} = {_literal(value)};" for name, value in constants.items()]
    always, text = sections()[stage]
    used = [sections()[name][1] for name in (*always, *uses)]
    return unrolled(written_out("\n".join([*lines, *used, text])), constants)


def written_out(text: str) -> str:
    """Write out arrays and the head of ``main``, see above."""
    number = count()
    access = {"in": "read", "out": "read_write"}
    text = _ARRAY.sub(lambda m: f"@group(0) @binding({next(number)}) var<storage, {access[m[1]]}> ", text)
    return _MAIN.sub(lambda m: _head(m[1] or "@workgroup_size(64)\n", m[2]), text)


def _head(size: str, names: str) -> str:
    """Return the head of ``main`` with its built-ins."""
    body = ""
    if names == "i":
        names, body = "group, groups, local", "    let i = invocation(group, groups, local);\n"
    built_in = [_BUILT_IN[name] for name in names.split(", ") if name]
    parameters = ", ".join(built_in) if len(built_in) < 3 else "\n    {}, {},\n    {}\n".format(*built_in)
    return f"@compute {size}fn main({parameters}) {{\n{body}"


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
def sections() -> dict[str, tuple[tuple[str, ...], str]]:
    """Return what every section uses, and its text, by name."""
    found: dict[str, tuple[tuple[str, ...], str]] = {}
    for file in resources.files(__package__).iterdir():
        if file.name.endswith(".wgsl"):
            _, *parts = _SECTION.split(file.read_text(encoding="utf-8"))
            for name, used, text in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
                if name in found:
                    raise ValueError(f"{file.name}: there are two sections {name}")
                found[name] = tuple(used.split(", ")) if used else (), text.strip("\n") + "\n"
    return found

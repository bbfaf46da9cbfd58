"""Mutants of files: bytes changed, cut and repeated; in texts also values of other types and misspelt keys."""

from __future__ import annotations

import re

import numpy as np

_VALUES = (b'"x"', b'""', b"[]", b"[1]", b"[1, 2, 3]", b'["a"]', b"{}", b"{a = 1}", b"true", b"nan", b"inf", b"-inf",
           b"0", b"-1", b"1e308", b"-1e308", b"1e-320", b"3", b"1" + 400 * b"0", b"1979-05-27", b"99999999", b"[[[1]]]",
           b"0x7fffffffffffffff", b'"' + 300 * b"n" + b'"', b"null")  # fmt: skip
_PIECES = (b"\xe9", b"\xff", b"\x00", b"\n", b"[", b"]", b'"', b"=", b".", b"<", b">", b"&#0;", b"..", b"/", b"Z 5 ",
           b"M", b"e999", b"\xc3\xa4", b"\r", b"#", b"[a]\n", b"[[a]]\n", b"../", b"-", b",")  # fmt: skip
_VALUE = re.compile(rb"(?<=[=:,\[\s\"])-?[\w.+-]+(?=[,\]\s\"}])|\"[^\"\n]*\"|\[[^\[\]\n]*\]|\{[^{}\n]*\}")
_KEY = re.compile(rb"[A-Za-z_][\w-]*(?=\s*[=:\]])")


def mutant(seed: bytes, rng: np.random.Generator, *, is_text: bool) -> bytes:
    """Change a file in one to three places."""
    data = seed
    for _ in range(rng.integers(1, 4)):
        kinds = (_flip, _delete, _repeat, _insert, _cut)
        kinds += (_other_value, _misspelt, _line_away) * 2 if is_text else ()
        data = kinds[rng.integers(len(kinds))](data, rng)
    return data


def _place(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data) + 1))


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        if changed:
            changed[rng.integers(len(changed))] = rng.choice([0, 1, 127, 128, 255, rng.integers(256)])
    return bytes(changed)


def _delete(data: bytes, rng: np.random.Generator) -> bytes:
    start = _place(data, rng)
    return data[:start] + data[start + int(rng.integers(1, 40)) :]


def _repeat(data: bytes, rng: np.random.Generator) -> bytes:
    start = _place(data, rng)
    piece = data[start : start + int(rng.integers(1, 80))]
    return data[:start] + piece * int(rng.choice([2, 3, 50])) + data[start:]


def _insert(data: bytes, rng: np.random.Generator) -> bytes:
    start = _place(data, rng)
    return data[:start] + _PIECES[rng.integers(len(_PIECES))] + data[start:]


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _place(data, rng)] if rng.random() < 0.2 else _flip(data, rng)


def _replaced(found: list[re.Match[bytes]], data: bytes, new: bytes, rng: np.random.Generator) -> bytes:
    if not found:
        return data
    match = found[rng.integers(len(found))]
    return data[: match.start()] + new + data[match.end() :]


def _other_value(data: bytes, rng: np.random.Generator) -> bytes:
    return _replaced(list(_VALUE.finditer(data)), data, _VALUES[rng.integers(len(_VALUES))], rng)


def _misspelt(data: bytes, rng: np.random.Generator) -> bytes:
    found = list(_KEY.finditer(data))
    if not found:
        return data
    match = found[rng.integers(len(found))]
    key = bytearray(match.group())
    place = int(rng.integers(len(key)))
    key[place : place + int(rng.integers(0, 2))] = rng.choice([b"", b"x", b"_", b"\xe4"])
    return data[: match.start()] + bytes(key) + data[match.end() :]


def _line_away(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.splitlines(keepends=True)
    if lines:
        del lines[rng.integers(len(lines))]
    return b"".join(lines)

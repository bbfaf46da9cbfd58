"""Colour profiles of the fewest tags, for tests."""

from __future__ import annotations

import struct

import numpy as np

# X, Y, Z of R, G and B as the makers' profiles hold them: Apple, Adobe, Kodak, Hewlett-Packard.
DISPLAY_P3 = ((0.51512, 0.24120, -0.00105), (0.29198, 0.69225, 0.04189), (0.15710, 0.06657, 0.78407))
ADOBE_RGB = ((0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457))
PROPHOTO = ((0.7977, 0.2880, 0.0), (0.1352, 0.7119, 0.0), (0.0313, 0.0001, 0.8249))
SRGB = ((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.71410))
WIDE = ((0.71626, 0.25829, 0.0), (0.10097, 0.72497, 0.05182), (0.14697, 0.01675, 0.77310))  # no known set


def fixed(*values: float) -> bytes:
    return struct.pack(f">{len(values)}i", *(round(65536 * value) for value in values))


def table(*entries: int) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(f">I{len(entries)}H", len(entries), *entries)


def sampled(curve, n: int) -> bytes:
    return table(*np.rint(65535 * curve(np.linspace(0, 1, n))).astype(int).tolist())


def parametric(kind: int, *values: float) -> bytes:
    return b"para\0\0\0\0" + struct.pack(">H2x", kind) + fixed(*values)


def english(text: str) -> bytes:
    croatian, name = "ne ovo".encode("utf-16-be"), text.encode("utf-16-be")
    records = struct.pack(">2s2sII2s2sII", b"hr", b"HR", len(croatian), 40, b"en", b"US", len(name), 40 + len(croatian))
    return b"mluc\0\0\0\0" + struct.pack(">II", 2, 12) + records + croatian + name


def icc(columns, *curves: bytes, kind=b"RGB ", connection=b"XYZ ", extra=(), name="Mine", leave_out=()) -> bytes:
    """A profile of the fewest tags, version 4; one curve is that of R, G and B."""
    tags = {b"desc": english(name), b"wtpt": b"XYZ \0\0\0\0" + fixed(0.9642, 1, 0.8249)}
    for letter, column, curve in zip((b"r", b"g", b"b"), columns, curves * (3 // len(curves)), strict=True):
        tags[letter + b"XYZ"] = b"XYZ \0\0\0\0" + fixed(*column)
        tags[letter + b"TRC"] = curve
    tags.update(extra)
    tags = {key: value for key, value in tags.items() if key not in leave_out}
    directory, data = struct.pack(">I", len(tags)), b""
    for key, value in tags.items():
        directory += struct.pack(">4sII", key, 132 + 12 * len(tags) + len(data), len(value))
        data += value.ljust(-(-len(value) // 4) * 4, b"\0")
    size = 128 + len(directory) + len(data)
    header = struct.pack(">I4sI4s4s4s12s4s", size, b"none", 0x04300000, b"mntr", kind, connection, b"", b"acsp")
    return header.ljust(68, b"\0") + fixed(0.9642, 1, 0.8249).ljust(60, b"\0") + directory + data

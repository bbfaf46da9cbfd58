"""PNG files of three channels of 16 bits, the format of large photographs, decoded on two cores.

Half of the time goes into inflating, which nothing can divide; meanwhile another thread takes the filters off the rows
before and puts the bytes in order. OpenCV does one after the other, in twice the time.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from chromaperture.compilation import compiled
from chromaperture.deflate import decompressor
from chromaperture.threads import beside

_PIECE = 1 << 16  # bytes inflated at once: a damaged file makes 66 MB of them at most
_BAND_ROWS = 64  # handed to the other thread at once; 2.3 MB for 6000 columns; chosen by hand
_AHEAD = 8  # bands that may wait for the other thread; chosen by hand
_RGB, _PIXEL = 2, 6  # PNG's code of three channels, and their bytes at 16 bits


def decode_rgb16(data: bytes, levels: tuple[float, float] | None = None) -> np.ndarray | None:
    """Decode a PNG file of 16-bit RGB, not interlaced, whose checksums were checked.

    Parameters
    ----------
    data : bytes
    levels : (float, float), optional
        Counts of black and white. With them counts become light row by row, and are not kept: of 24 megapixels 144 MB.

    Returns
    -------
    (H, W, 3) uint16, with levels float32, linear light; or None
        None where the file is of another kind.

    Raises
    ------
    ValueError, deflate.Error
        The file is damaged.
    """
    width, height, depth, kind, _, _, interlaced = struct.unpack_from(">IIBBBBB", data, 16)
    if (depth, kind, interlaced) != (16, _RGB, 0):
        return None
    out = np.empty((height, width, 3), np.uint16 if levels is None else np.float32)
    black, white = levels or (0.0, 1.0)
    scale = np.float32(black), np.float32(white - black)  # as `source.develop_counts`
    line = 1 + _PIXEL * width
    before = np.zeros(_PIXEL * width, np.uint8)
    with beside() as begin:
        taken = []
        for top, rows in _bands(data, line, height):
            band = out[top : top + len(rows)]
            taken.append(begin(lambda rows=rows, band=band: _take_filters_off(rows, before, *scale, band)))  # type: ignore[misc]
            if len(taken) > _AHEAD:
                taken[-_AHEAD].result()
    if not all(found.result() for found in taken):
        raise ValueError("an unknown filter")
    return out


def _bands(data: bytes, line: int, height: int) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the first row and the inflated bytes, (rows, line), of one band after the other."""
    stream = decompressor()
    parts: list[bytes | bytearray] = []
    size, top = 0, 0
    for piece in _compressed(data):
        parts.append(stream.decompress(piece))
        size += len(parts[-1])
        rows = min(height - top, size // line)
        if rows == height - top or rows >= _BAND_ROWS:
            joined = bytearray().join(parts)  # whose array can be written to: the kernel is compiled for such
            yield top, np.frombuffer(joined, np.uint8, rows * line).reshape(rows, line)
            top, parts = top + rows, [joined[rows * line :]]
            size = len(parts[0])
            if top == height:
                return
    raise ValueError("too few rows")


def _compressed(data: bytes) -> Iterator[memoryview]:
    """Yield the content of all IDAT chunks in pieces."""
    view, at = memoryview(data), 8
    while at + 12 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        if name == b"IDAT":
            for start in range(at + 8, at + 8 + length, _PIECE):
                yield view[start : min(start + _PIECE, at + 8 + length)]
        at += 12 + length


@compiled()
def _take_filters_off(rows, before, black, span, out):  # type: ignore[no-untyped-def]
    """Undo the filters of a band (PNG, section 9.2); ``before`` is the row above it, and then the last of it.

    ``out`` holds the counts less black, over ``span``.
    """
    size = len(before)
    for y in range(len(rows)):
        kind, coded = rows[y, 0], rows[y, 1:]
        if kind == 0:
            before[:] = coded
        elif kind == 1:  # the byte of the pixel to the left is added
            for i in range(_PIXEL):
                before[i] = coded[i]
            for i in range(_PIXEL, size):
                before[i] = before[i - _PIXEL] + coded[i]
        elif kind == 2:  # that above
            for i in range(size):
                before[i] += coded[i]
        elif kind == 3:  # the mean of both
            for i in range(size):
                left = np.int32(before[i - _PIXEL]) if i >= _PIXEL else np.int32(0)
                before[i] = ((np.int32(before[i]) + left) >> 1) + coded[i]
        elif kind == 4:  # what is nearest to left + above - the one left of that above
            corners = np.zeros(_PIXEL, np.int32)
            for i in range(size):
                left = np.int32(before[i - _PIXEL]) if i >= _PIXEL else np.int32(0)
                above, corner = np.int32(before[i]), corners[i % _PIXEL]
                to_left, to_above, to_corner = abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)
                nearest = corner if to_corner < to_above else above
                nearest = left if to_left <= to_above and to_left <= to_corner else nearest
                corners[i % _PIXEL] = above
                before[i] = nearest + coded[i]
        else:
            return False
        for x in range(size // _PIXEL):
            for k in range(3):
                count = np.uint16(before[_PIXEL * x + 2 * k]) << 8 | before[_PIXEL * x + 2 * k + 1]
                out[y, x, k] = (np.float32(count) - black) / span
    return True

"""PNG files, encoded in strips of rows on all threads.

A strip ends at a byte of the deflate stream, so strips are compressed each for itself, and lie behind each other.
"""

from __future__ import annotations

import struct
import zlib
from typing import NamedTuple

import numpy as np

from chromaperture.system.deflate import adler32, compressor, crc32
from chromaperture.system.rows_on_demand import Rows
from chromaperture.system.threads import parallel_map

_FILTER_MEAN = 3  # the smallest of OpenCV's encoder's
_STRIP_BYTES = 1 << 19  # before compression: with its filtered bytes it stays in the cache; chosen by hand
_GREY, _RGB = 0, 2  # PNG's codes
_ADLER = 65521  # modulus of zlib's checksum


class _Strip(NamedTuple):
    chunk: bytes
    checksum: int  # of the filtered bytes
    size: int  # of them


def encode_png(picture: Rows) -> bytes:
    """Return the content of a PNG file of a grey (H, W) or RGB (H, W, 3) picture of uint8 or uint16."""
    height, width = picture.shape[:2]
    channels = 1 if len(picture.shape) == 2 else picture.shape[2]
    pixel = channels * picture.dtype.itemsize
    rows = max(1, _STRIP_BYTES // (width * pixel))

    def strip(top: int) -> _Strip:
        filtered = _filtered(picture, top, min(top + rows, height), pixel)
        deflate = compressor()
        packed = deflate.compress(filtered.data)
        packed += deflate.flush(zlib.Z_FINISH if top + rows >= height else zlib.Z_SYNC_FLUSH)
        begin = b"\x78\x01" if top == 0 else b""  # a stream of zlib, of the fastest level
        return _Strip(_chunk(b"IDAT", begin + packed), adler32(filtered.data), filtered.size)

    strips = parallel_map(strip, range(0, height, rows))
    checksum = 1  # of no byte
    for part in strips:
        checksum = _joined_checksum(checksum, part)
    kind = _GREY if len(picture.shape) == 2 else _RGB
    header = struct.pack(">IIBBBBB", width, height, 8 * picture.dtype.itemsize, kind, 0, 0, 0)
    return b"".join(
        [
            b"\x89PNG\r\n\x1a\n",
            _chunk(b"IHDR", header),
            *(part.chunk for part in strips),
            _chunk(b"IDAT", struct.pack(">I", checksum)),
            _chunk(b"IEND", b""),
        ]
    )


def _filtered(picture: Rows, top: int, bottom: int, pixel: int) -> np.ndarray:
    """Rows less the mean of the bytes of the pixels to the left and above, each behind the filter's number."""
    first = max(top - 1, 0)
    part = np.ascontiguousarray(picture[first:bottom])
    if part.itemsize == 2:
        part = part.astype(">u2")
    lines = part.reshape(bottom - first, -1).view(np.uint8)
    above = np.concatenate([np.zeros_like(lines[:1]), lines[:-1]]) if top == 0 else lines[:-1]
    here = lines[bottom - first - (bottom - top) :]
    out = np.empty((bottom - top, 1 + here.shape[1]), np.uint8)
    out[:, 0] = _FILTER_MEAN
    mean = above >> 1  # beyond the left side all is 0
    left, both = here[:, :-pixel], above[:, pixel:]
    mean[:, pixel:] = (left & both) + ((left ^ both) >> 1)  # rounded down, without a carry
    np.subtract(here, mean, out=out[:, 1:])
    return out


def _chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", crc32(content, crc32(name)))


def _joined_checksum(before: int, part: _Strip) -> int:
    """Checksum (Adler-32) of bytes and those of a strip behind them, from those of both."""
    low, high = before & 0xFFFF, before >> 16
    own_low, own_high = part.checksum & 0xFFFF, part.checksum >> 16
    joined = (low + own_low - 1) % _ADLER, (high + own_high + part.size * (low - 1)) % _ADLER
    return joined[1] << 16 | joined[0]

"""TIFF files: one picture, its size checked before it is unpacked."""

from __future__ import annotations

import io
import logging
import math
import zlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import tifffile

from chromaperture.errors import InputError
from chromaperture.validation import MOST_PIXELS

# An error is one line of ours: without a handler, Python prints what libraries log.
logging.getLogger("tifffile").addHandler(logging.NullHandler())
_ICC_PROFILE, _ORIENTATION = 34675, 274  # tags
_MOST_SAMPLES = 4  # of a pixel: R, G, B and alpha
_DEFLATE = {tifffile.COMPRESSION.ADOBE_DEFLATE, tifffile.COMPRESSION.DEFLATE}
_COMPRESSIONS = _DEFLATE | {tifffile.COMPRESSION.NONE, tifffile.COMPRESSION.LZW, tifffile.COMPRESSION.PACKBITS}
_PIECE_BYTES = 1_000_000  # unpacked at a time where only the size is wanted


def no_check(width: int, height: int) -> None:
    """Accept every size."""


def decode_tiff(data: bytes, name: str, *, check: Callable[[int, int], None] = no_check) -> np.ndarray:
    """Decode the first picture of a file.

    Only the first page is looked at: finding the pages and series of a hostile file can take minutes.

    Parameters
    ----------
    data : bytes
    name : str
        Of the file, for messages.
    check : callable
        Called with width and height before anything is unpacked; raises InputError.

    Returns
    -------
    (H, W) or (H, W, S) array, as stored

    Raises
    ------
    InputError
        The file is damaged, holds no pixel, or unpacks to more than it declares.
    """
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages.first
            _check_page(page, name)
            check(page.imagewidth, page.imagelength)
            _check_segments(page, data)
            return np.asarray(page.asarray(maxworkers=1))
    except InputError:
        raise
    except Exception:  # tifffile raises anything on a damaged file
        raise InputError(
            f"{name} is damaged or not a TIFF file with a picture; copy or export the file again"
        ) from None


class TiffHeader(NamedTuple):
    """What the first picture of a TIFF file is; ``profile``: its ICC profile, ``orientation``: EXIF's code."""

    size_px: tuple[int, int]
    bits: int
    profile: bytes | None
    orientation: int


def tiff_header(data: bytes, name: str) -> TiffHeader:
    """Return the header of the first picture; raises InputError like `decode_tiff`."""
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages.first
            _check_page(page, name)
            size = int(page.imagewidth), int(page.imagelength)
            profile, orientation = (page.tags.get(code) for code in (_ICC_PROFILE, _ORIENTATION))
            bits = int(np.dtype(page.dtype).itemsize * 8)
            return TiffHeader(
                size, bits, None if profile is None else bytes(profile.value),
                1 if orientation is None else int(orientation.value),
            )  # fmt: skip
    except InputError:
        raise
    except Exception:
        raise InputError(
            f"{name} is damaged or not a TIFF file with a picture; copy or export the file again"
        ) from None


def _check_page(page: tifffile.TiffPage, name: str) -> None:
    """Raise InputError where a page is no picture of a camera."""
    shape = page.shape
    if page.dtype is None or not shape or min(shape) < 1:
        raise InputError(f"{name} holds no pixel; export the picture again")
    tile = page.tilewidth * page.tilelength if page.is_tiled else 0
    too_many = page.imagewidth * page.imagelength > MOST_PIXELS or tile > MOST_PIXELS
    if too_many or page.samplesperpixel > _MOST_SAMPLES or page.imagedepth != 1 or math.prod(shape) > 4 * MOST_PIXELS:
        raise InputError(f"{name} holds an array of shape {shape}; one RGB picture is needed")
    if page.compression not in _COMPRESSIONS:
        raise InputError(f"{name} is compressed in a way that is not read; export it as TIFF without compression")


def _check_segments(page: tifffile.TiffPage, data: bytes) -> None:
    """Raise ValueError where strips or tiles are missing, cut off, or unpack to more than they hold.

    Deflate shrinks zeros to a thousandth: 2 MB unpack to 2 GB.
    """
    offsets, counts = page.dataoffsets, page.databytecounts
    if not len(offsets) == len(counts) == math.prod(page.chunked):
        raise ValueError("strips are missing")
    if max(map(sum, zip(offsets, counts, strict=True))) > len(data):
        raise ValueError("the file is cut off")
    if page.compression == tifffile.COMPRESSION.NONE and math.prod(page.shape) * page.bitspersample > 8 * sum(counts):
        raise ValueError("strips are too short")
    if page.compression not in _DEFLATE:
        return
    most = math.prod(page.chunks) * np.dtype(page.dtype).itemsize
    for offset, count in zip(offsets, counts, strict=True):
        stream, packed, size = zlib.decompressobj(), data[offset : offset + count], 0
        while packed and not stream.eof:
            size += len(stream.decompress(packed, _PIECE_BYTES))
            packed = stream.unconsumed_tail
            if size > most:
                raise ValueError("a segment is too large")

"""TIFF files: one picture, its size checked before it is unpacked."""

from __future__ import annotations

import contextlib
import io
import logging
import math
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import tifffile

from chromaperture.capture.picture_format import PictureFormat, mosaic_format
from chromaperture.color.color_space import UNTAGGED, of_icc
from chromaperture.color.encoding import Pattern
from chromaperture.system.errors import CaptureWarning, InputError
from chromaperture.system.validation import MOST_PIXELS

# An error is one line of ours: without a handler, Python prints what libraries log.
logging.getLogger("tifffile").addHandler(logging.NullHandler())
_ICC_PROFILE, _ORIENTATION = 34675, 274  # tags
TURNS = {3: 180, 6: 90, 8: 270}  # codes of an orientation, degrees clockwise; others are mirrored, or upright
_MOST_SAMPLES = 4  # of a pixel: R, G, B and alpha
_DEFLATE = {tifffile.COMPRESSION.ADOBE_DEFLATE, tifffile.COMPRESSION.DEFLATE}
_COMPRESSIONS = _DEFLATE | {tifffile.COMPRESSION.NONE, tifffile.COMPRESSION.LZW, tifffile.COMPRESSION.PACKBITS}
# That are looked at for their pixels, and for their tags: finding all pages of a hostile file can take minutes.
_MOST_PAGES, _MOST_PICTURES = 8, 32
_REDUCED, _MASK = 1, 4  # bits of NewSubfileType: a preview, a transparency mask
_COLOURS = {3: "palette", 5: "CMYK", 6: "YCbCr", 8: "L*a*b*", 9: "L*a*b*", 10: "L*a*b*", 32844: "LogL", 32845: "LogLuv"}
Found = TypeVar("Found")
_PIECE_BYTES = 1_000_000  # unpacked at a time where only the size is wanted


def decode_tiff(data: bytes, name: str, *, check: Callable[[int, int], None] | None = None) -> np.ndarray:
    """Decode the largest picture among the first pages, as stored; ``check`` gets its width and height before."""
    with _opened(data, name) as (page, others):
        _check_page(page, name)
        if check is not None:
            check(page.imagewidth, page.imagelength)
        _check_segments(page, data)
        counts = np.asarray(page.asarray(maxworkers=1))
        if page.planarconfig == tifffile.PLANARCONFIG.SEPARATE and counts.ndim == 3:
            counts = np.ascontiguousarray(np.moveaxis(counts, 0, -1))
    if others:
        text = f"{name} holds more than one picture of this size: the first is read"
        warnings.warn(text, CaptureWarning, stacklevel=5)
    return counts


@contextlib.contextmanager
def _opened(data: bytes, name: str) -> Iterator[tuple[tifffile.TiffPage, bool]]:
    """Open a file at its picture, see `_picture`; what is raised on a damaged one becomes InputError."""
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            yield _picture(file)
    except InputError:
        raise
    except Exception as error:  # tifffile raises anything on a damaged file
        if "imagecodecs" in str(error):
            raise InputError(
                f"{name} is compressed by LZW, which needs: pip install imagecodecs; or export it without compression"
            ) from None
        raise InputError(
            f"{name} is damaged or not a TIFF file with a picture; copy or export the file again"
        ) from None


def tiff_format(data: bytes, name: str, mosaic: Pattern | None) -> PictureFormat:
    """Return what the picture of a file is; raises InputError like `decode_tiff`, and for colours that are not read."""
    with _opened(data, name) as (page, _):
        _check_page(page, name)
        size, bits = (int(page.imagewidth), int(page.imagelength)), 8 * np.dtype(page.dtype).itemsize
        profile, orientation = (page.tags.get(code) for code in (_ICC_PROFILE, _ORIENTATION))
        turn = 0 if orientation is None else TURNS.get(int(orientation.value), 0)
        if profile is not None and not isinstance(profile.value, bytes):  # a number would become as many zeros
            raise ValueError("no colour profile")
    if mosaic is not None and page.samplesperpixel == 1:
        return mosaic_format("TIFF", size, bits, mosaic, known_from="option")
    space = UNTAGGED if profile is None else of_icc(profile.value)
    return PictureFormat("TIFF", size, bits, space=space, turn_degrees=turn)


def from_pages(path: str | Path, find: Callable[[Iterator[tifffile.TiffPage]], Found], default: Found) -> Found:
    """Return what is found in the first pictures of a file, and those within them; the default of a damaged file."""
    try:
        with tifffile.TiffFile(path) as file:
            return find(islice(_every_page(file.pages), _MOST_PICTURES))
    except Exception:  # tifffile raises anything on a damaged file, which whoever reads its pixels reports
        return default


def _every_page(pages: Iterable[Any]) -> Iterator[tifffile.TiffPage]:
    for page in pages:
        if isinstance(page, tifffile.TiffPage):
            yield page
            yield from _every_page(page.pages or ())


def _picture(file: tifffile.TiffFile) -> tuple[tifffile.TiffPage, bool]:
    """Return the largest of the first pages that are no previews or masks, and whether another is as large."""
    top = [page for page in islice(file.pages, _MOST_PAGES) if isinstance(page, tifffile.TiffPage)]
    inner = (part for page in top for part in islice(page.pages or (), _MOST_PAGES))
    pages = [*top, *(page for page in inner if isinstance(page, tifffile.TiffPage))]
    full = [page for page in pages if not page.subfiletype & (_REDUCED | _MASK) and page.shape] or pages[:1]
    sizes = [page.imagewidth * page.imagelength for page in full]
    return full[sizes.index(max(sizes))], sizes.count(max(sizes)) > 1


def _check_page(page: tifffile.TiffPage, name: str) -> None:
    """Raise InputError where a page is no picture of a camera."""
    shape = page.shape
    if page.dtype is None or not shape or min(shape) < 1:
        raise InputError(f"{name} holds no pixel; export the picture again")
    tile = page.tilewidth * page.tilelength if page.is_tiled else 0
    too_many = page.imagewidth * page.imagelength > MOST_PIXELS or tile > MOST_PIXELS
    if too_many or page.samplesperpixel > _MOST_SAMPLES or page.imagedepth != 1 or math.prod(shape) > 4 * MOST_PIXELS:
        raise InputError(f"{name} holds an array of shape {shape}; one RGB picture is needed")
    if page.photometric in _COLOURS:
        raise InputError(
            f"{name} holds {_COLOURS[page.photometric]} colours, not RGB; export it as RGB of 16 bits, linear"
        )
    if page.compression not in _COMPRESSIONS:
        raise InputError(f"{name} is compressed in a way that is not read; export it as TIFF without compression")


def _check_segments(page: tifffile.TiffPage, data: bytes) -> None:
    """Raise ValueError where strips or tiles are cut off, or unpack to more than they hold, as zip bombs do."""
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

"""RAW files (CR2, NEF, DNG, ...) to half-size colour through LibRaw, without interpolation between channels.

What LibRaw does not tell is read from the container: whether the file is RAW, whole, and of a kind that can be used.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import tifffile

from chromaperture.capture.bayer import check_not_quad, quad_message, superpixels
from chromaperture.capture.picture_format import PictureFormat, mosaic_format
from chromaperture.capture.picture_header import TIFF_MARKS, check_size
from chromaperture.capture.tiff import from_pages
from chromaperture.color.encoding import PATTERNS, Encoding
from chromaperture.system.errors import InputError, needed
from chromaperture.system.validation import quoted

_TURNS = {3: 180, 5: 270, 6: 90}  # LibRaw's codes of an orientation, degrees clockwise
_BOX_TYPE = b"ftyp"  # of the first box of an ISO base media file (ISO 14496-12), which CR3 is
_MARKS = (b"FUJIFILMCCD-RAW", b"IIU\0", b"IIRO", b"IIRS", b"MMOR", b"FOVb")  # RAF, RW2, three of ORF, X3F
# Tags and photometric interpretations of TIFF/EP and of the DNG specification 1.7.
_COMPRESSION, _PHOTOMETRIC, _CFA_PATTERN, _DNG_VERSION, _ACTIVE_AREA = 259, 262, 33422, 50706, 50829
_BLACK_REPEAT, _BLACK_LEVEL = 50713, 50714
_MOSAIC, _DEMOSAICED = 32803, 34892
_MOST_LEVELS = 256  # of a cell of black levels
_UNREADABLE = {  # by compression, by photometric interpretation
    34892: "a DNG of lossy JPEG; convert the camera's own RAW file to DNG without lossy compression",
    52546: "a DNG of JPEG XL (DNG 1.7), which LibRaw does not read; convert the camera's own RAW file to DNG for "
    "Camera Raw 11.2, without lossy compression",
    -_DEMOSAICED: "a linear DNG: demosaiced already, which moves edges between the colours; give the camera's own RAW "
    "file (of phones: RAW that is not ProRAW)",
}


def raw_format(path: Path) -> PictureFormat:
    """Return what a RAW file is; raises like `read_raw`."""
    with _opened(path) as raw:
        size, bits = (raw.sizes.width, raw.sizes.height), int(raw.white_level).bit_length()
        turn = _TURNS.get(raw.sizes.flip, 0)
        return mosaic_format("RAW", size, bits, "Bayer", known_from="tag", turn_degrees=turn)


def read_raw(path: Path, *, size_px: tuple[int, int] | None = None, shot: int = 0) -> tuple[np.ndarray, Encoding]:
    """Read the mosaic and make one pixel of every 2 x 2 cell; counts and levels are twice the file's."""
    with _opened(path, shot) as raw:
        check_size(raw.sizes.width // 2, raw.sizes.height // 2, path.name, size_px)
        layout = None if raw.raw_pattern is None else np.asarray(raw.raw_pattern)
        if layout is None or layout.shape != (2, 2) or raw.raw_image_visible.ndim != 2:
            what = "an X-Trans mosaic" if layout is not None and layout.shape == (6, 6) else "no Bayer mosaic"
            raise InputError(f"{path.name} has {what}, of which no 2 x 2 cells can be made; {developed(path.name)}")
        # The pattern begins at the sensor's corner, the picture behind a masked border: perhaps an odd pixel away.
        top, left = raw.sizes.top_margin, raw.sizes.left_margin
        layout = np.roll(layout, (-top, -left), axis=(0, 1))
        mosaic = raw.raw_image_visible.copy()
        black = black_of_cells(path, top, left)
        if black is None:
            black = np.array(raw.black_level_per_channel, float)[layout]
        names, white = raw.color_desc.decode(), _white_level(raw)
    pattern = "".join(names[i] for i in layout.ravel())
    if pattern not in PATTERNS and set(pattern) <= set("RGB"):  # LibRaw folds the 4 x 4 pattern of a DNG
        raise InputError(quad_message(path.name))
    if np.ptp(black) > 0:
        mosaic = _with_one_black(mosaic, black)
    check_not_quad(mosaic, path.name, black_level=float(black.mean()))
    counts, encoding = superpixels(mosaic, pattern, black_level=float(black.mean()), white_level=white)
    return counts, replace(encoding, given=False)  # the levels of the camera file are more exact


def _white_level(raw: Any) -> float:
    """Return the count up to which all channels are linear: that of the format, or the camera's if lower."""
    stated = getattr(raw, "camera_white_level_per_channel", None) or ()
    return float(min([raw.white_level, *(level for level in stated if level > 0)]))


def _with_one_black(mosaic: np.ndarray, black: np.ndarray) -> np.ndarray:
    """Move the counts of each photosite so that black is at the mean of the repeating cell's levels; (H, W) float32."""
    moved = mosaic.astype(np.float32)
    for (row, column), level in np.ndenumerate(black):
        moved[row :: black.shape[0], column :: black.shape[1]] -= np.float32(level - black.mean())
    return moved


@contextlib.contextmanager
def _opened(path: Path, shot: int = 0) -> Iterator[Any]:
    """Open a file with LibRaw; what it raises becomes InputError."""
    if not os.path.isfile(path):
        raise InputError(f"cannot read {quoted(path)}: no such file")
    hint = f"{path.name} is a RAW file; install the extra that reads them: pip install 'chromaperture[raw]'"
    rawpy = needed("rawpy", hint)
    try:
        check_kind(path)
        with rawpy.imread(str(path), shot_select=shot) as raw:
            check_complete(path)
            yield raw
    except rawpy.LibRawError as error:
        if shot:
            raise InputError(f"{path.name} holds one picture, not the two shots of a dual-pixel sensor") from None
        what = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise InputError(f"{path.name} is damaged or not a RAW file ({what}); copy the file again") from None


def holds_raw(path: Path) -> bool:
    """Recognise a RAW file by its content: makers' own marks, or a TIFF file with a mosaic or DNGVersion in it."""
    if not os.path.isfile(path):  # a pipe would wait
        return False
    try:
        with open(path, "rb") as file:
            start = file.read(16)
    except OSError:
        return False
    if start[:4] not in TIFF_MARKS:
        return start.startswith(_MARKS) or start[4:12] == _BOX_TYPE + b"crx "
    return from_pages(path, lambda pages: start[8:10] == b"CR" or any(map(_is_raw_page, pages)), default=False)


def _is_raw_page(page: tifffile.TiffPage) -> bool:
    return page.photometric == _MOSAIC or _CFA_PATTERN in page.tags or _DNG_VERSION in page.tags


def check_kind(path: Path) -> None:
    """Raise InputError where a file holds no mosaic that LibRaw reads, with what to do."""
    with open(path, "rb") as file:
        if file.read(4) == b"FOVb":
            raise InputError(f"{path.name} is of a Foveon sensor, which has no Bayer mosaic; {developed(path.name)}")
    tags = _dng_tags(path)
    kinds = (int(tags.get(_COMPRESSION, 0)), -int(tags.get(_PHOTOMETRIC, 0)))
    reason = next((_UNREADABLE[kind] for kind in kinds if kind in _UNREADABLE), None)
    if reason is not None:
        raise InputError(f"{path.name} is {reason}")


def developed(name: str) -> str:
    """Return how to develop a mosaic that is no Bayer one: a matrix of colours exaggerates parallax by 40 to 49 %."""
    return (
        "develop it to a linear TIFF in the camera's own colours, bilinear, which mixes no channels: "
        f"dcraw -v -4 -q 0 -o 0 -r 1 1 1 1 -T {name}"
    )


def black_of_cells(path: Path, top: int, left: int) -> np.ndarray | None:
    """Return the black levels of a DNG's repeating cell from a photosite on; None where LibRaw's are right."""
    tags = _dng_tags(path)
    rows, columns = (int(n) for n in tags.get(_BLACK_REPEAT, (1, 1)))
    y, x = (int(n) for n in tags.get(_ACTIVE_AREA, (0, 0))[:2])  # where the levels begin
    levels = np.ravel(tags.get(_BLACK_LEVEL, 0.0))
    is_usual = rows <= 2 and columns <= 2 and y % 2 == x % 2 == 0
    if levels.size != rows * columns or not 1 < levels.size <= _MOST_LEVELS or is_usual:
        return None
    return np.roll(levels.reshape(rows, columns), (y - top, x - left), axis=(0, 1))


def _dng_tags(path: Path) -> dict[int, Any]:
    """Return tags of the picture in a DNG file, of rationals the quotients; empty where it is none, or damaged."""

    def find(found: Iterator[tifffile.TiffPage]) -> dict[int, Any]:
        pages = list(found)
        page = max(pages, key=lambda p: (p.photometric in (_MOSAIC, _DEMOSAICED), p.imagewidth * p.imagelength))
        codes = (_COMPRESSION, _PHOTOMETRIC, _ACTIVE_AREA, _BLACK_REPEAT, _BLACK_LEVEL)
        tags = [page.tags[code] for code in codes if code in page.tags and _DNG_VERSION in pages[0].tags]
        return {tag.code: np.divide(tag.value[::2], tag.value[1::2]) if tag.dtype == 5 else tag.value for tag in tags}

    return from_pages(path, find, default={})


def check_complete(path: Path) -> None:
    """Check that a file is as long as its container says: LibRaw reads what is missing as black."""
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        start = file.read(8)
        stated = 0
        if start[:4] in TIFF_MARKS:
            stated = _end_of_mosaic(path)
        elif start[4:] == _BOX_TYPE:
            stated = _end_of_boxes(file, size)
    if stated > size:
        raise InputError(f"{path.name} ends too early: {size} of {stated} bytes are there; copy the file again")


def _end_of_mosaic(path: Path) -> int:
    """Return where the data of the largest picture of a TIFF file end, bytes; 0 where none is described."""

    def find(pages: Iterator[tifffile.TiffPage]) -> int:
        pieces = [(page.dataoffsets, page.databytecounts) for page in pages if page.databytecounts]
        largest = ((sum(counts), max(map(sum, zip(offsets, counts, strict=True)))) for offsets, counts in pieces)
        return max(largest, default=(0, 0))[1]

    return from_pages(path, find, default=0)


def _end_of_boxes(file: BinaryIO, size: int) -> int:
    """Return where the last box of an ISO base media file ends, bytes."""
    end = 0
    while end + 8 <= size:
        file.seek(end)
        head = file.read(16)
        length = int.from_bytes(head[:4], "big")
        if length == 1:  # the length follows, in 64 bits
            length = int.from_bytes(head[8:], "big")
        if length < 8:  # 0: the box reaches to the end of the file
            break
        end += length
    return end

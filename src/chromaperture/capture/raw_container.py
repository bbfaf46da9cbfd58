"""Whether a RAW file is complete: LibRaw reads what is missing at the end of a file as black, without an error."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import tifffile

from chromaperture.capture.picture_header import TIFF_MARKS
from chromaperture.errors import InputError

_BOX_TYPE = b"ftyp"  # of the first box of an ISO base media file (ISO 14496-12), which CR3 is


def check_complete(path: Path) -> None:
    """Check that a file is as long as its container says; raises InputError.

    DNG, CR2, NEF and ARW are TIFF files, CR3 is an ISO base media file. Other forms are not checked.
    """
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
    try:
        with tifffile.TiffFile(path) as file:
            sizes_and_ends = [
                (sum(page.databytecounts), max(map(sum, zip(page.dataoffsets, page.databytecounts, strict=True))))
                for page in _pages(file.pages)
                if page.databytecounts
            ]
    except Exception:  # tifffile raises anything; LibRaw says what is wrong with the file
        return 0
    return max(sizes_and_ends, default=(0, 0))[1]


def _pages(pages: Iterable[Any]) -> Iterator[Any]:
    """Walk the pictures of a TIFF file, and those within them: the mosaic is often beside a small preview."""
    for page in pages:
        if isinstance(page, tifffile.TiffPage):
            yield page
            yield from _pages(page.pages or ())


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

"""The header of an image file: format and size, before anything is decoded."""

from __future__ import annotations

import io
import logging
import struct
import warnings
from zlib import crc32

from PIL import (
    AvifImagePlugin,
    BmpImagePlugin,
    ImageFile,
    JpegImagePlugin,
    PngImagePlugin,
    PpmImagePlugin,
    TiffImagePlugin,
    WebPImagePlugin,
)

from chromaperture.system.errors import InputError
from chromaperture.system.validation import MOST_PIXELS

logging.getLogger("PIL").addHandler(logging.NullHandler())  # as for tifffile: an error is one line of ours
# PNG packs an even area to 340 pixels a byte, JPEG a photograph to 20. libjpeg paints what is missing grey.
_MOST_PIXELS_A_BYTE = 1000
PNG_MARK = b"\x89PNG"
TIFF_MARKS = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")  # the last two: files beyond 4 GB

_KINDS: tuple[tuple[tuple[bytes, ...], int, type[ImageFile.ImageFile]], ...] = (  # marks, where they are, reader
    ((PNG_MARK,), 0, PngImagePlugin.PngImageFile),
    ((b"\xff\xd8",), 0, JpegImagePlugin.JpegImageFile),
    ((b"BM",), 0, BmpImagePlugin.BmpImageFile),
    ((b"WEBP",), 8, WebPImagePlugin.WebPImageFile),
    (tuple(b"P%d" % number for number in range(1, 7)), 0, PpmImagePlugin.PpmImageFile),
    (TIFF_MARKS, 0, TiffImagePlugin.TiffImageFile),
)
_TO_PICTURE = "export it as PNG or TIFF"
_TO_FRAMES = "'chromaperture export' measures videos; or give a photograph"
_OTHERS = (  # marks, where they are, what such a file is and what to do
    ((b"GIF8",), 0, f"a GIF picture of at most 256 colours: {_TO_PICTURE} from the original"),
    ((b"avis",), 8, "an animated AVIF picture; give one photograph a file"),
    ((b"\xff\x0a", b"\x00\x00\x00\x0cJXL "), 0, f"a JPEG XL picture, which is not read: {_TO_PICTURE}"),
    ((b"\x00\x00\x00\x0cjP  ", b"\xff\x4f\xff\x51"), 0, f"a JPEG 2000 picture, which is not read: {_TO_PICTURE}"),
    ((b"8BPS",), 0, f"a Photoshop document: {_TO_PICTURE}"),
    ((b"\x76\x2f\x31\x01",), 0, f"an OpenEXR picture, which is not read: {_TO_PICTURE} (16 bit, linear)"),
    ((b"%PDF",), 0, f"a PDF document: {_TO_PICTURE}"),
    ((b"\x1aE\xdf\xa3", b"RIFF", b"YUV4MPEG2", b"\x00\x00\x01\xba"), 0, f"a video: {_TO_FRAMES}"),
    ((b"moov", b"ftyp", b"mdat", b"wide"), 4, f"a video: {_TO_FRAMES}"),
)


def other_kind(data: bytes) -> str | None:
    """Say what a file is that is known but not read as a photograph, and what to do; None for all others."""
    if any(data.startswith(marks, at) for marks, at, _ in _KINDS) or {b"avif"} <= set(brands(data)) - {b"avis"}:
        return None
    return next((what for marks, at, what in _OTHERS if data.startswith(marks, at)), None)


def open_picture(data: bytes) -> ImageFile.ImageFile:
    """Open a picture of the formats that we read, whatever its size, and read its header; raises ValueError."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow's, of damaged tags
        for marks, at, kind in _KINDS:
            if data.startswith(marks, at):
                return kind(io.BytesIO(data))
        if b"avif" in brands(data):
            return AvifImagePlugin.AvifImageFile(io.BytesIO(data))
    raise ValueError("no image format that is read")


def brands(data: bytes) -> list[bytes]:
    """Return what an ISO base media file says it is (ISO 14496-12, 4.3); empty for others."""
    if data[4:8] != b"ftyp":
        return []
    end = min(int.from_bytes(data[:4], "big"), 256)
    return [data[at : at + 4] for at in (8, *range(16, end, 4))]


def check_png_sums(data: bytes) -> None:
    """Check length and checksum of every chunk of a PNG file, four times as fast as Pillow's ``verify``."""
    view, at, name = memoryview(data), 8, b""  # 8 bytes of signature
    while name != b"IEND":
        if at + 12 > len(data):
            raise ValueError("the PNG file ends too early")
        length, name = struct.unpack_from(">I4s", data, at)
        after = at + 8 + length
        if after + 4 > len(data):
            raise ValueError("the PNG file ends too early")
        if crc32(view[at + 4 : after]) != int.from_bytes(data[after : after + 4], "big"):
            raise ValueError("a checksum in the PNG file is wrong")
        at = after + 4


def other_size(width: int, height: int, size_px: tuple[int, int]) -> str:
    """Return what to say of an image whose size, px, is not that of the camera."""
    rotated = (height, width) == tuple(size_px)
    advice = (
        "it looks rotated: turn it back, the filters in the lens did not turn with it"
        if rotated
        else "give an original of that size or of its aspect, or say with --crop-origin where this part of it begins"
    )
    return f"the image is {width}x{height} px but the camera was calibrated at {size_px[0]}x{size_px[1]}; {advice}"


def same_frame(size_px: tuple[int, int], other_px: tuple[int, int]) -> bool:
    """Return whether two sizes, width and height, have one aspect, but for a side that was rounded by a pixel."""
    (width, height), (other_width, other_height) = size_px, other_px
    return abs(width * other_height - height * other_width) <= max(width, height, other_width, other_height)


def check_size(
    width: int, height: int, name: str, size_px: tuple[int, int] | None, *, file_bytes: int | None = None
) -> None:
    """Raise InputError where a header's size is nothing, not this camera's, or more than a camera or the file has."""
    if width < 1 or height < 1:
        raise InputError(f"{name} holds no pixel; export the picture again")
    if size_px is not None and (width, height) != tuple(size_px):
        raise InputError(f"{name}: {other_size(width, height, size_px)}")
    if width * height > MOST_PIXELS:
        raise InputError(
            f"{name} declares {width}x{height} px, more than {MOST_PIXELS / 1e6:g} megapixels; "
            "give the picture of a camera"
        )
    if file_bytes is not None and width * height > _MOST_PIXELS_A_BYTE * file_bytes:
        raise InputError(f"{name} is cut off: {file_bytes} bytes do not hold {width}x{height} px; copy the file again")

"""The header of an image file: format and size, before anything is decoded."""

from __future__ import annotations

import io
import logging

from PIL import BmpImagePlugin, Image, JpegImagePlugin, PngImagePlugin, PpmImagePlugin, TiffImagePlugin, WebPImagePlugin

from chromaperture.errors import InputError
from chromaperture.validation import MOST_PIXELS

logging.getLogger("PIL").addHandler(logging.NullHandler())  # as for tifffile: an error is one line of ours
TIFF_MARKS = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")  # the last two: files beyond 4 GB


def open_picture(data: bytes) -> Image.Image:
    """Open a PNG, JPEG, PNM, BMP, WebP or TIFF file and read its header.

    Other formats that Pillow has are not tried, and its own limit of 179 megapixels does not apply: `check_size` has ours.

    Raises
    ------
    InputError
        It is in none of these formats.
    """
    if data.startswith(b"\x89PNG"):
        kind = PngImagePlugin.PngImageFile
    elif data.startswith(b"\xff\xd8"):
        kind = JpegImagePlugin.JpegImageFile
    elif data.startswith(b"BM"):
        kind = BmpImagePlugin.BmpImageFile
    elif data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        kind = WebPImagePlugin.WebPImageFile
    elif data[:1] == b"P" and data[1:2].isdigit():
        kind = PpmImagePlugin.PpmImageFile
    elif data.startswith(TIFF_MARKS):
        kind = TiffImagePlugin.TiffImageFile
    else:
        raise InputError("no image format that is read")
    return kind(io.BytesIO(data))


def check_size(width: int, height: int, name: str, size_px: tuple[int, int] | None) -> None:
    """Check the size that a header declares.

    Parameters
    ----------
    width, height : int, px
    name : str
        Of the file.
    size_px : (int, int), optional
        Width and height of the camera.

    Raises
    ------
    InputError
        There are no pixels, more than any camera has, or not those of this camera.
    """
    if width < 1 or height < 1:
        raise InputError(f"{name} holds no pixel; export the picture again")
    if size_px is not None and (width, height) != tuple(size_px):
        raise InputError(
            f"{name}: the image is {width}x{height} px but the camera was calibrated at "
            f"{size_px[0]}x{size_px[1]}; give an original of that size, or calibrate at this one"
        )
    if width * height > MOST_PIXELS:
        raise InputError(
            f"{name} declares {width}x{height} px, more than {MOST_PIXELS / 1e6:g} megapixels; give the picture of a camera"
        )

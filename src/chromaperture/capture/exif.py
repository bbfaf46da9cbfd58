"""What a photograph's tags tell: lens, iris, focus and exposure, the camera, and whether a colour matrix was applied.

A matrix takes camera colours to those of a screen. It subtracts one channel from another, and with it an edge that
stands at another place: displacements between channels, which are the signal, come out too large, by the colour of the
object (docs/batches.md, *Developed files*).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image

from chromaperture.capture.heif import is_heif
from chromaperture.capture.picture_header import TIFF_MARKS, open_picture
from chromaperture.capture.shots import is_raw
from chromaperture.capture.tiff import from_pages
from chromaperture.system.validation import MOST_FILE_BYTES, read_bytes

UNMIXED = "'dcraw -4 -q 0 -o 0 -r 1 1 1 1 -T FILE' (linear, camera colours, unmixed)"  # tried: docs/batches.md
_JPEG_MARK = b"\xff\xd8"  # the first bytes of the file
# Tags of the EXIF standard.
_EXIF_IFD = 0x8769
_MODEL, _NOISE_PROFILE, _COLOUR_PROFILE = 0x0110, 51041, 34675
_FNUMBER, _SUBJECT_DISTANCE, _FOCAL_LENGTH = 0x829D, 0x9206, 0x920A
_EXPOSURE_S, _SENSITIVITY = 0x829A, 0x8827
_HEAD_BYTES = 1 << 20  # profiles stand before the pixels


@dataclass(frozen=True)
class Exif:
    """Settings of the camera; None where they are not in the file."""

    focal_length_mm: float | None = None
    f_number: float | None = None
    subject_distance_mm: float | None = None
    # s, times ISO 100, over the square of the f-number: only ratios of photographs of one camera mean anything.
    exposure: float | None = field(default=None, compare=False)


def read_exif(path: str | Path) -> Exif:
    """Read the settings of a photograph; an empty `Exif` for a file without them."""
    try:
        tags = _header(path).get_ifd(_EXIF_IFD)
    except Exception:  # decoders raise anything; errors of the picture itself are reported by `read_image`
        return Exif()
    distance_m, seconds = (_positive(tags.get(code)) for code in (_SUBJECT_DISTANCE, _EXPOSURE_S))
    sensitivity, f_number = tags.get(_SENSITIVITY), _positive(tags.get(_FNUMBER))
    gain = _positive(sensitivity[0] if isinstance(sensitivity, tuple) and sensitivity else sensitivity)
    return Exif(
        focal_length_mm=_positive(tags.get(_FOCAL_LENGTH)),
        f_number=f_number,
        subject_distance_mm=None if distance_m is None else 1000 * distance_m,
        exposure=None if seconds is None else seconds * (gain or 100.0) / 100 / (f_number or 1.0) ** 2,
    )


def read_model(path: str | Path) -> str | None:
    """Read the camera's name from a photograph, RAW files of TIFF's form (DNG, CR2, NEF, ARW) too; None if absent."""
    name = str(read_tag(path, _MODEL) or "").strip("\0 ")
    return name or None


def read_noise_profile(path: str | Path) -> tuple[float, float] | None:
    """Read slope and offset of the noise variance over light from a DNG file's NoiseProfile, or None."""
    values = read_tag(path, _NOISE_PROFILE)
    if values is None or np.size(values) < 2 or np.size(values) % 2:
        return None
    pairs = np.reshape(np.asarray(values, float), (-1, 2))
    slope, offset = pairs.mean(axis=0)
    valid = np.isfinite(pairs).all() and (pairs[:, 0] > 0).all() and (pairs[:, 1] >= 0).all()
    return (float(slope), float(offset)) if valid else None


def read_tag(path: str | Path, code: int) -> Any:
    """Return a tag of a TIFF or JPEG file, of others without decoding their pixels; None where there is none."""
    try:
        with open(path, "rb") as file:
            begin = file.read(4)
        if begin not in TIFF_MARKS:
            return _header(path).get(code) if begin.startswith(_JPEG_MARK) else None
    except Exception:  # decoders raise anything; errors of the picture itself are reported by `read_image`
        return None

    def find(pages: Iterator[tifffile.TiffPage]) -> Any:
        # A DNG's mosaic may lie behind a small picture, with tags of its own.
        first = next(pages)
        found = (page.tags.get(code) for page in (first, *(first.pages or ())))
        return next((tag.value for tag in found if tag is not None), None)

    return from_pages(path, find, default=None)


def is_developed(path: str | Path) -> bool | None:
    """Return whether a colour matrix was applied to a photograph, by its tags; None where they do not tell."""
    if is_raw(Path(path)):
        return False
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD_BYTES)
        if is_heif(head):
            return True
        is_tiff = head.startswith(TIFF_MARKS)
        profile = read_tag(path, _COLOUR_PROFILE) if is_tiff else open_picture(head).info.get("icc_profile")
    except Exception:  # decoders raise anything; errors of the picture itself are reported by `read_image`
        return None
    return True if profile or (head.startswith(_JPEG_MARK) and read_model(path)) else None


def other_colours(path: str | Path, provenance: Mapping[str, Any]) -> str | None:
    """Return what to say of a photograph in other colours than those of the camera file's; None for the same."""
    calibrated = provenance.get("developed")
    found = None if calibrated is None else is_developed(path)
    if found is None or found == calibrated:
        return None
    matrix, none = "went through a colour matrix (JPEG, developed RAW)", "hold camera colours (RAW)"
    this, others = (matrix, none) if found else (none, matrix)
    return (
        f"files like this one {this}, but those of the camera file {others}: distances will be wrong by some 20 %; "
        "give files as the calibration had, or calibrate with files like this one"
    )


def _header(path: str | Path) -> Image.Exif:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow's, of damaged tags
        return open_picture(read_bytes(Path(path), most_bytes=MOST_FILE_BYTES)).getexif()


def _positive(value: Any) -> float | None:
    """Convert a rational to a number; None for 0, which means unknown, and for infinity (2^31 and more)."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and 0 < number < 2**31 else None

"""Settings of lens, iris and focus from a photograph's EXIF data."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from chromaperture.capture.picture_header import open_picture
from chromaperture.validation import MOST_FILE_BYTES, read_bytes

# Tags of the EXIF standard.
_EXIF_IFD = 0x8769
_FNUMBER, _SUBJECT_DISTANCE, _FOCAL_LENGTH = 0x829D, 0x9206, 0x920A


@dataclass(frozen=True)
class Exif:
    """Settings of the camera; None where they are not in the file."""

    focal_length_mm: float | None = None
    f_number: float | None = None
    subject_distance_mm: float | None = None


def read_exif(path: str | Path) -> Exif:
    """Read the settings of a photograph; an empty `Exif` for a file without them."""
    try:
        data = read_bytes(path, most_bytes=MOST_FILE_BYTES)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's, of damaged tags
            tags = open_picture(data).getexif().get_ifd(_EXIF_IFD)
    except Exception:  # decoders raise anything; errors of the picture itself are reported by `read_image`
        return Exif()
    distance_m = _positive(tags.get(_SUBJECT_DISTANCE))
    return Exif(
        focal_length_mm=_positive(tags.get(_FOCAL_LENGTH)),
        f_number=_positive(tags.get(_FNUMBER)),
        subject_distance_mm=None if distance_m is None else 1000 * distance_m,
    )


def _positive(value: Any) -> float | None:
    """Convert a rational to a number; None for 0, which means unknown, and for infinity (2^31 and more)."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and 0 < number < 2**31 else None

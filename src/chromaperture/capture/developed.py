"""Photographs in other colours than the sensor's: camera JPEG files, and RAW files that were developed.

A matrix takes camera colours to those of a screen. It subtracts one channel from another, and with it an edge that
stands at another place: displacements between channels, which are the signal, come out too large, by the colour of the
object (docs/batches.md, *Developed files*).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from chromaperture.capture.exif import JPEG_MARK, read_model, read_tag
from chromaperture.capture.files import is_raw
from chromaperture.capture.heif import is_heif
from chromaperture.capture.picture_header import TIFF_MARKS, open_picture

UNMIXED = "'dcraw -4 -q 0 -o 0 -r 1 1 1 1 -T FILE' (linear, camera colours, unmixed)"  # tried: docs/batches.md
_PROFILE = 34675  # the tag of a colour profile in a TIFF file
_HEAD_BYTES = 1 << 20  # profiles stand before the pixels


def is_developed(path: str | Path) -> bool | None:
    """Return whether a colour matrix was applied to a photograph, by its tags; None where they do not tell.

    To RAW files none was; to HEIC files one was, to JPEG files that name their camera, and to files with a colour
    profile, which camera colours have none of.
    """
    if is_raw(Path(path)):
        return False
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD_BYTES)
        if is_heif(head):
            return True
        is_tiff = head.startswith(TIFF_MARKS)
        profile = read_tag(path, _PROFILE) if is_tiff else open_picture(head).info.get("icc_profile")
    except Exception:  # decoders raise anything; errors of the picture itself are reported by `read_image`
        return None
    return True if profile or (head.startswith(JPEG_MARK) and read_model(path)) else None


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

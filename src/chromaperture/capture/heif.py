"""HEIC files through libheif, which puts tiles together and repeats chroma, so that its samples can be had back."""

from __future__ import annotations

import io
import re
from typing import Any

import numpy as np

from chromaperture.capture.native_planes import ENCODED_WHITE, Planes, rgb_of_planes
from chromaperture.capture.picture_format import LUMA_WEIGHTS, PictureFormat
from chromaperture.capture.picture_header import brands
from chromaperture.color.color_space import UNTAGGED, of_codes, of_icc
from chromaperture.system.errors import InputError, needed

_CHROMA = {420: (2, 2), 422: (2, 1), 444: (1, 1)}
# Boxes of ISO 23008-12, 6.5.10 and 6.5.12: quarters of a turn, counterclockwise, and a mirror.
_TURN, _MIRROR = re.compile(rb"\0\0\0\x09irot(.)", re.DOTALL), re.compile(rb"\0\0\0\x09imir")
_MOST_META_BYTES = 1 << 20  # where properties are looked for: before the coded pictures


def is_heif(data: bytes) -> bool:
    """Recognise a HEIF file that holds HEVC by the brands in its first box."""
    return not {b"heic", b"heix", b"heim", b"heis", b"hevc"}.isdisjoint(brands(data))


def stored_turn(data: bytes, name: str) -> int:
    """Return by how many degrees, clockwise, a file's picture is to be turned; raises InputError where mirrored."""
    if _MIRROR.search(data, 0, _MOST_META_BYTES):
        raise InputError(f"{name} is mirrored by its tag; switch off mirroring in the phone's camera settings")
    turns = {found[1][0] & 3 for found in _TURN.finditer(data, 0, _MOST_META_BYTES)} or {0}
    if len(turns) > 1:
        raise InputError(f"{name} holds pictures turned in different ways; export the one picture as PNG")
    return -90 * turns.pop() % 360


def read_heif(data: bytes, form: PictureFormat, name: str) -> tuple[np.ndarray, float]:
    """Return counts of a file's primary picture as stored, its turn taken back, and the highest; raises InputError."""
    try:
        rgb = np.asarray(_opened(data, name))[..., :3]
    except InputError:
        raise
    except Exception as error:  # libheif's errors come as several kinds
        raise InputError(f"{name} is damaged ({_one_line(error)}); copy the file again") from None
    rgb = np.rot90(rgb, form.turn_degrees // 90)
    if rgb.dtype == np.uint16:
        rgb = rgb >> (16 - form.bits)
    if form.reduction == 1:
        return np.ascontiguousarray(rgb), float((1 << form.bits) - 1)
    light = rgb.astype(np.float32) * np.float32(ENCODED_WHITE / ((1 << form.bits) - 1))
    red, blue = form.luma_weights or LUMA_WEIGHTS[2]
    luma = light @ np.array([red, 1 - red - blue, blue], np.float32)
    # Chroma is the same all over a cell, so that its mean is the sample, but where a colour was cut off.
    wide = _of_cells(light[..., 2] - luma, form), _of_cells(light[..., 0] - luma, form)
    chroma = (part / np.float32(2 * (1 - weight)) + 128 for part, weight in zip(wide, (blue, red), strict=True))
    whole = PictureFormat("", form.size_px, 8, form.chroma_factors, form.siting, form.luma_weights)
    return rgb_of_planes(Planes(luma, *chroma), whole), ENCODED_WHITE


def _of_cells(values: np.ndarray, form: PictureFormat) -> np.ndarray:
    """Return the mean of the pixels that share a chroma sample."""
    across, down = form.chroma_factors
    rows, columns = (-(-side // n) * n - side for side, n in zip(values.shape, (down, across), strict=True))
    whole = np.pad(values, ((0, rows), (0, columns)), mode="edge")
    return whole.reshape(whole.shape[0] // down, down, whole.shape[1] // across, across).mean(axis=(1, 3))


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _opened(data: bytes, name: str) -> Any:
    pillow_heif = needed("pillow_heif", f"{name} is a HEIC file; to read it: pip install pillow-heif")
    try:
        return pillow_heif.open_heif(io.BytesIO(data), convert_hdr_to_8bit=False)
    except Exception as error:
        raise InputError(f"{name} is damaged or not a HEIC file ({_one_line(error)}); copy the file again") from None


def heif_format(data: bytes, name: str) -> PictureFormat:
    """Return what a file is by its header; raises InputError, also of what is grey or mirrored."""
    picture = _opened(data, name)
    info, (width, height) = picture.info, picture.size
    if not picture.mode.startswith("RGB"):
        raise InputError(f"{name} is a grey picture; the depth is in the colours, so give the colour original")
    turn = stored_turn(data, name)
    if turn and (width % 2 or height % 2) and info.get("chroma") != 444:
        raise InputError(f"{name} has an odd side and is turned, so that chroma has lost its place; export it as PNG")
    codes, profile = info.get("nclx_profile") or {}, info.get("icc_profile")
    matrix = codes.get("matrix_coefficients", 2)
    if matrix not in LUMA_WEIGHTS:
        raise InputError(f"{name}: its colour matrix (code {matrix} of H.273) is not read; export it as PNG")
    space = of_icc(profile) if profile else UNTAGGED
    if not profile and codes:
        space = of_codes(codes["color_primaries"], codes["transfer_characteristics"])
    size = (height, width) if turn % 180 else (width, height)
    factors, bits = _CHROMA.get(info.get("chroma", 420), (2, 2)), int(info.get("bit_depth", 8))
    return PictureFormat(  # libheif hands out the full range
        "HEIC", size, bits, factors, luma_weights=LUMA_WEIGHTS[matrix], space=space, turn_degrees=turn
    )

"""Pixel formats of machine-vision cameras, by their names in GenICam's convention (PFNC), to counts of R, G and B."""

from __future__ import annotations

import re

import numpy as np

from chromaperture.capture.bayer import superpixels
from chromaperture.color.encoding import Encoding
from chromaperture.system.errors import InputError

# Of Bayer, by preference: more than 12 bits only cost bandwidth, and packed ones only time to unpack.
_ORDER = ("12", "12p", "12Packed", "10", "10p", "10Packed", "16", "8")
_BAYER = re.compile(r"Bayer(RG|BG|GR|GB)(8|10|12|16|10p|12p|10Packed|12Packed)")
_PATTERNS = {"RG": "RGGB", "BG": "BGGR", "GR": "GRBG", "GB": "GBRG"}
_RGB = {"RGB8": 3, "RGB8Packed": 3, "RGBa8": 4}  # bytes of a pixel; the fourth is transparency


def best_format(available: list[str]) -> str:
    """Choose the pixel format with the best resolution of colour; raises InputError where there is none."""
    for bits in _ORDER:
        for name in available:
            if (found := _BAYER.fullmatch(name)) and found[2] == bits:
                return name
    if rgb := next((name for name in _RGB if name in available), None):
        return rgb
    is_mono = bool(available) and all(name.startswith("Mono") for name in available)
    raise InputError(
        f"the camera offers {', '.join(available) or 'no format'}; depth needs Bayer (8 to 16 bit) or RGB8"
        + (": it is a monochrome camera, and depth is in the colours" if is_mono else "")
    )


def chosen_format(wanted: str | None, available: list[str]) -> str:
    """Return the pixel format that was asked for, or the best; raises InputError where it cannot be."""
    if wanted is None:
        return best_format(available)
    bits_of(wanted)
    if wanted not in available:
        raise InputError(f"the camera has no pixel format {wanted}: choose {', '.join(available)}")
    return wanted


def bits_of(pixel_format: str) -> int:
    """Return the bits of a colour; raises InputError for a format that is not read."""
    if pixel_format in _RGB:
        return 8
    if found := _BAYER.fullmatch(pixel_format):
        return int(re.sub(r"\D", "", found[2]))
    raise InputError(f"pixel format {pixel_format} is not read; choose Bayer (8 to 16 bit) or RGB8")


def unpack(
    data: bytes | np.ndarray,
    width: int,
    height: int,
    pixel_format: str,
    black_level: float = 0.0,
    white_level: float | None = None,
) -> tuple[np.ndarray, Encoding]:
    """Convert the bytes of a picture: Bayer in 8 to 16 bits, packed or not, RGB8 or RGBa8; raises InputError."""
    raw = np.frombuffer(data, np.uint8) if isinstance(data, bytes) else data.ravel().view(np.uint8)
    if pixel_format in _RGB:
        size = _RGB[pixel_format]
        counts = _first(raw, size * width * height, pixel_format).reshape(height, width, size)[..., :3].copy()
        return counts, Encoding(black_level, white_level or 255.0)
    bits, number = bits_of(pixel_format), width * height
    order, packing = pixel_format[5:7], pixel_format[7:]
    if packing == "8":
        mosaic = _first(raw, number, pixel_format)
    elif packing.isdigit():
        mosaic = _first(raw, 2 * number, pixel_format).view("<u2")
    elif packing.endswith("p"):
        mosaic = _of_stream(_first(raw, -(-number * bits // 8), pixel_format), bits, number)
    else:
        mosaic = _of_pairs(_first(raw, -(-number * 3 // 2), pixel_format), bits, number)
    white = white_level or 2**bits - 1
    return superpixels(mosaic.reshape(height, width), _PATTERNS[order], black_level=black_level, white_level=white)


def _first(raw: np.ndarray, number: int, pixel_format: str) -> np.ndarray:
    """Take the first bytes; raises InputError where there are fewer."""
    if raw.size < number:
        raise InputError(f"half a picture: {raw.size} bytes of {number} in {pixel_format}")
    return raw[:number]


def _of_stream(raw: np.ndarray, bits: int, number: int) -> np.ndarray:
    """Unpack pixels that follow each other bit by bit, the lowest bit first (PFNC's "p"): groups of 3 or 5 bytes."""
    size, pixels = (3, 2) if bits == 12 else (5, 4)
    groups = _groups(raw, size)
    values = np.empty((len(groups), pixels), np.uint16)
    for i in range(pixels):
        byte, shift = divmod(i * bits, 8)
        values[:, i] = (groups[:, byte] >> shift | groups[:, byte + 1] << (8 - shift)) & (2**bits - 1)
    return values.ravel()[:number]


def _of_pairs(raw: np.ndarray, bits: int, number: int) -> np.ndarray:
    """Unpack pairs in 3 bytes, as GigE Vision's "Packed": high bits of both around a byte of their low bits."""
    groups = _groups(raw, 3)
    low, mask = bits - 8, 2 ** (bits - 8) - 1
    first = groups[:, 0] << low | (groups[:, 1] & mask)
    second = groups[:, 2] << low | (groups[:, 1] >> 4 & mask)
    return np.stack([first, second], axis=1).ravel()[:number]


def _groups(raw: np.ndarray, size: int) -> np.ndarray:
    """Lay bytes out in groups, the last filled up with zeros; (N, size) uint16."""
    groups = np.zeros((-(-raw.size // size), size), np.uint16)
    groups.ravel()[: raw.size] = raw
    return groups

"""Colour spaces by what files state: ICC profiles, chunks of PNG, and Exif."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from chromaperture.color.color_space import (
    ADOBE_RGB_PRIMARIES,
    SRGB_PRIMARIES,
    ColorSpace,
    Transfer,
    of_codes,
    of_values,
    to_linear,
)
from chromaperture.system.errors import InputError

MAX_PROFILE_BYTES = 4 << 20  # in PNG; profiles by primaries and curves have up to 60 KB, by tables some 2 MB
_MAX_TAGS = 100  # as littlecms; profiles have 10 to 30
_MAX_ENTRIES = 65536  # of a table: one for each level of 16 bits
_MAX_TEXT_BYTES = 160
_CODES = np.linspace(0, 1, 256)  # where curves are compared
_KINDS = {b"GRAY": "grey", b"CMYK": "CMYK", b"Lab ": "L*a*b*"}
_COLUMNS, _CURVES = (b"rXYZ", b"gXYZ", b"bXYZ"), (b"rTRC", b"gTRC", b"bTRC")
_CHUNKS = (b"cICP", b"iCCP", b"sRGB", b"gAMA", b"cHRM")
_DAMAGED = "the colour profile is damaged: export the file as sRGB"


def of_icc(profile: bytes) -> ColorSpace:
    """Colour space by an ICC profile (ICC.1:2022, and version 2) of primaries and one curve for R, G and B.

    Codes in the profile (tag ``cicp``) go before the rest. A curve within half a level of 8 bits of a named one is
    taken for it: profiles of a few hundred bytes approximate sRGB by 20 to 40 entries.

    ``profile``: the whole profile. Raises InputError: the profile is damaged, is not one for R, G and B, works by
    tables alone, or has curves that differ or do not rise from black to white.
    """
    try:
        return _of_icc(profile)
    except struct.error as error:  # it ends too early
        raise InputError(_DAMAGED) from error


def of_png(data: bytes) -> ColorSpace | None:
    """Colour space by the chunks of a PNG file: cICP before iCCP, sRGB, gAMA and cHRM (PNG, third edition, 4.3).

    A gamma of 1/2.2 with the primaries of sRGB, or none, is the curve of sRGB: writers add it for readers that do not
    know the chunk sRGB (11.3.2.5).

    ``data``: the file, at least up to its first IDAT. Raises InputError: the file is not a PNG, one of these chunks is
    damaged, or it states what is not undone: Y'CbCr, narrow range, a curve or profile that `of_codes` or `of_icc`
    refuses.
    """
    try:
        chunks = _png_chunks(data)
        if b"cICP" in chunks:
            primaries, transfer, matrix, full_range = struct.unpack(">4B", chunks[b"cICP"])
            if matrix != 0 or full_range != 1:
                raise InputError(
                    "the chunk cICP states Y'CbCr or narrow range, which is not undone: export the file as sRGB"
                )
            space = of_codes(primaries, transfer)
            if space.primaries or space.transfer:
                return space
        if b"iCCP" in chunks:
            return of_icc(_inflated(chunks[b"iCCP"].partition(b"\0")[2][1:]))
        if b"sRGB" in chunks:
            return of_values(SRGB_PRIMARIES, Transfer("srgb"))
        return _of_gamma_and_primaries(chunks)
    except struct.error as error:  # it ends too early
        raise InputError("the file is damaged where it states its colours: export it again") from error


def of_exif(color_space: int | None, interoperability: str | None) -> ColorSpace | None:
    """Colour space by Exif, for a picture without an ICC profile.

    Cameras that are set to Adobe RGB state it so, and most of them in no other way (DCF 2.0, option file).

    ``color_space``: ColorSpace (tag 0xA001 of the Exif directory): 1 is sRGB, 0xFFFF any other, 2 some writers' Adobe
    RGB; ``interoperability``: InteroperabilityIndex (tag 1 of the directory at 0xA005): "R03" is Adobe RGB.
    """
    if color_space == 1:  # goes before an index that an editor has left behind
        return of_values(SRGB_PRIMARIES, Transfer("srgb"))
    if color_space == 2 or interoperability == "R03":
        return of_values(ADOBE_RGB_PRIMARIES, Transfer("power", (563 / 256,)))  # its encoding of 1998: exactly 2 51/256
    return None


def _of_icc(profile: bytes) -> ColorSpace:
    size, kind, connection, magic = struct.unpack_from(">I12x4s4s12x4s", profile)
    (count,) = struct.unpack_from(">I", profile, 128)
    if magic != b"acsp" or size > len(profile) or count > _MAX_TAGS:
        raise InputError(_DAMAGED)
    tags = {
        name: profile[at : at + length]
        for name, at, length in (struct.unpack_from(">4sII", profile, 132 + 12 * k) for k in range(count))
        if name in (b"desc", b"cicp", *_COLUMNS, *_CURVES)
    }
    described = _text(tags.get(b"desc", b""))

    def refused(why: str) -> InputError:
        return InputError(f"the colour profile ({described or 'without a name'}) {why}: export the file as sRGB")

    if kind != b"RGB ":
        raise refused(f"is for {_KINDS.get(kind, 'other colours')}, not for R, G and B")
    if b"cicp" in tags:
        primaries, transfer = struct.unpack_from(">8x2B", tags[b"cicp"])
        space = of_codes(primaries, transfer)
        if space.primaries and space.transfer:
            return space
    if connection != b"XYZ " or not tags.keys() >= {*_COLUMNS, *_CURVES}:
        raise refused("works by tables, not by primaries and curves, which is not undone")
    columns = [struct.unpack_from(">3i", tags[name], 8) for name in _COLUMNS]
    columns.append(tuple(map(sum, zip(*columns, strict=True))))  # white, D50 where the profile is as it should be
    if min(map(sum, columns)) <= 0:
        raise refused("states impossible primaries")
    curves = {_curve(tags[name]) for name in _CURVES}
    if None in curves:
        raise refused("has a curve that does not rise from black to white, or is of an unknown kind")
    if len(curves) > 1:
        raise refused("has three curves for R, G and B, which is not undone")
    pairs = [(x / (x + y + z), y / (x + y + z)) for x, y, z in columns]
    return of_values(pairs, curves.pop(), described or "other primaries")


def _text(tag: bytes) -> str:
    """Read a profile's description, in English where there is one; shortened."""
    if tag[:4] == b"mluc":
        (count,) = struct.unpack_from(">I", tag, 8)
        records = [struct.unpack_from(">2s2xII", tag, 16 + 12 * k) for k in range(min(count, _MAX_TAGS))]
        _, length, at = min(records, key=lambda record: record[0] != b"en", default=(b"", 0, 0))
        text = tag[at : at + min(length, _MAX_TEXT_BYTES)].decode("utf-16-be", "replace")
    else:
        text = tag[12:_MAX_TEXT_BYTES].partition(b"\0")[0].decode("latin-1")
    return "".join(filter(str.isprintable, text))


def _curve(tag: bytes) -> Transfer | None:
    """Read a profile's curve; None where it does not rise from black to white, or is of an unknown kind."""
    kind, count = struct.unpack_from(">4s4xI", tag)
    function = count >> 16  # of a parametric curve: half the field
    if kind == b"curv" and count < 2:
        curve = Transfer("power", (struct.unpack_from(">H", tag, 12)[0] / 256,)) if count else Transfer("linear")
    elif kind == b"curv" and count <= _MAX_ENTRIES:
        curve = Transfer("table", tuple(value / 65535 for value in struct.unpack_from(f">{count}H", tag, 12)))
    elif kind == b"para" and function <= 4:
        size = (1, 3, 4, 5, 7)[function]
        values = [value / 65536 for value in struct.unpack_from(f">{size}i", tag, 12)]
        g, a, b, c, d, e, f = values + [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0][size:]
        if not (0 < g <= 16 and a > 0 and a + b <= 2):  # of no camera or editor; further ones overflow
            return None
        if function in (1, 2):
            c, d, e, f = 0.0, -b / a, c, c
        curve = Transfer("parametric", (g, a, b, c, d, e, f))
    else:
        return None
    with np.errstate(all="ignore"):  # curves that are refused
        light = to_linear(_CODES, curve)
        if not (np.all(np.diff(light) >= 0) and light[0] < 0.01 and light[-1] > 0.99):
            return None
        exponent = float(np.median(np.log(light[64:-16]) / np.log(_CODES[64:-16])))
        for named in (
            Transfer("linear"),
            Transfer("srgb"),
            Transfer("bt709"),
            Transfer("power", (round(exponent, 4),)),
        ):
            low, high = (to_linear(_CODES + sign / 510, named) + sign / 65535 for sign in (-1, 1))  # rounded to 16 bits
            if np.all((low <= light) & (light <= high)):
                return named
    return curve


def _of_gamma_and_primaries(chunks: dict[bytes, bytes]) -> ColorSpace | None:
    primaries = transfer = None
    if b"cHRM" in chunks:
        white_x, white_y, *rest = (value / 1e5 for value in struct.unpack(">8I", chunks[b"cHRM"]))
        pairs = [*zip(rest[::2], rest[1::2], strict=True), (white_x, white_y)]
        primaries = of_values(pairs, None).primaries
    if b"gAMA" in chunks:
        (gamma,) = struct.unpack(">I", chunks[b"gAMA"])
        if not 10_000 <= gamma <= 1_000_000:
            raise InputError(f"a gamma of {gamma / 1e5:g} is impossible: export the file as sRGB")
        transfer = Transfer("linear") if gamma == 100_000 else Transfer("power", (1e5 / gamma,))
        if abs(gamma - 45455) <= 1 and primaries in (None, SRGB_PRIMARIES):
            primaries, transfer = SRGB_PRIMARIES, Transfer("srgb")
    return of_values(primaries, transfer) if primaries or transfer else None


def _png_chunks(data: bytes) -> dict[bytes, bytes]:
    """Collect the chunks about colour before the pixels; of two with one name the first, as libpng does."""
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise InputError("not a PNG file")
    chunks: dict[bytes, bytes] = {}
    at = 8
    while at + 8 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        if name in (b"IDAT", b"IEND"):
            break
        if name in _CHUNKS and name not in chunks:
            (check,) = struct.unpack_from(">I", data, at + 8 + length)
            chunks[name] = data[at + 8 : at + 8 + length]
            if check != zlib.crc32(name + chunks[name]):
                raise struct.error("wrong checksum")
        at += 12 + length
    return chunks


def _inflated(data: bytes) -> bytes:
    """Inflate a profile, up to MAX_PROFILE_BYTES."""
    stream = zlib.decompressobj()
    try:
        profile = stream.decompress(data, MAX_PROFILE_BYTES)
    except zlib.error as error:
        raise InputError(_DAMAGED) from error
    if not stream.eof:
        raise InputError("the colour profile is cut short or larger than 4 MB: export the file as sRGB")
    return profile

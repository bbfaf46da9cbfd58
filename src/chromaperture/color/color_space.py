"""What the numbers of a picture mean, primaries and curve, and the way from them to linear sRGB."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np

from chromaperture.color.srgb import srgb_to_linear
from chromaperture.system.errors import InputError

Pair = tuple[float, float]
Primaries = tuple[Pair, Pair, Pair, Pair]

# How far x and y of a primary may be off those of a known set, once both have the same white. Profiles rounded
# to 4 decimals are within 6e-5; the two closest sets, BT.601 with 525 lines and EBU Tech 3213, are 15e-3 apart.
_SAME_XY = 2e-4
_LEAST_AREA = 1e-3  # of the triangle of the primaries in x, y; that of sRGB has 0.11
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])

_D65, _D50, _C = (0.3127, 0.3290), (0.3457, 0.3585), (0.310, 0.316)
SRGB_PRIMARIES: Primaries = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), _D65)
ADOBE_RGB_PRIMARIES: Primaries = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06), _D65)
_SETS: tuple[tuple[str, Primaries, str], ...] = (  # name, primaries, name of the usual curve
    ("sRGB", SRGB_PRIMARIES, "srgb"),
    ("BT.709", SRGB_PRIMARIES, "bt709"),
    ("Display P3", ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06), _D65), "srgb"),
    ("DCI-P3", ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06), (0.314, 0.351)), "power"),
    ("Adobe RGB", ADOBE_RGB_PRIMARIES, "power"),
    ("ProPhoto RGB", ((0.7347, 0.2653), (0.1596, 0.8404), (0.0366, 0.0001), _D50), "power"),
    ("BT.2020", ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), _D65), "bt709"),
    ("BT.601 (625 lines)", ((0.64, 0.33), (0.29, 0.60), (0.15, 0.06), _D65), "bt709"),
    ("BT.601 (525 lines)", ((0.630, 0.340), (0.310, 0.595), (0.155, 0.070), _D65), "bt709"),
    ("BT.470 M", ((0.67, 0.33), (0.21, 0.71), (0.14, 0.08), _C), "power"),
    ("EBU Tech 3213", ((0.630, 0.340), (0.295, 0.605), (0.155, 0.077), _D65), "bt709"),
)
_NOT_STATED = (0, 2)  # of H.273; 0 is reserved, but some writers mean 2 by it
_PRIMARIES_OF_CODE = {  # H.273, table 2
    1: "sRGB", 4: "BT.470 M", 5: "BT.601 (625 lines)", 6: "BT.601 (525 lines)", 7: "BT.601 (525 lines)", 9: "BT.2020",
    11: "DCI-P3", 12: "Display P3", 22: "EBU Tech 3213",
}  # fmt: skip


class Transfer(NamedTuple):
    """The curve that encoded a picture.

    ``name`` is ``linear``; ``srgb`` (IEC 61966-2-1); ``bt709`` (BT.709, 601 and 2020); ``power`` (one parameter, the
    exponent that decodes); ``parametric`` (g, a, b, c, d, e, f: ICC.1:2022, 10.18, function type 4); ``table`` (the
    light at evenly spaced values from 0 to 1); ``hlg`` or ``pq`` (BT.2100).
    """

    name: str
    parameters: tuple[float, ...] = ()


_TRANSFER_OF_CODE = {  # H.273, table 3
    **dict.fromkeys((1, 6, 11, 14, 15), Transfer("bt709")),
    4: Transfer("power", (2.2,)),
    5: Transfer("power", (2.8,)),
    8: Transfer("linear"),
    13: Transfer("srgb"),
    16: Transfer("pq"),
    18: Transfer("hlg"),
}
_NOT_UNDONE = {7: "SMPTE 240M", 9: "logarithm, 100:1", 10: "logarithm, 316:1", 12: "BT.1361", 17: "ST 428"}


def to_linear(values: np.ndarray, transfer: Transfer) -> np.ndarray:
    """Undo a curve: encoded values in [0, 1], clipped but for ``srgb``, to linear light in [0, 1], float32.

    ``bt709`` and ``hlg`` give light of the scene (inverse OETF: BT.709, item 1.2; BT.2100, table 5), ``pq`` light of
    the display (EOTF: BT.2100, table 4). For the last two 1 is the diffuse white of BT.2408 (a signal of 0.75; 203
    cd/m2): what is brighter counts as saturated.
    """
    if transfer.name == "srgb":
        return srgb_to_linear(values)
    v = np.clip(np.asarray(values, np.float32), 0, 1)
    if transfer.name == "bt709":
        light = np.where(v < 0.081, v / 4.5, ((v + 0.099) / 1.099) ** (1 / 0.45))
    elif transfer.name == "power":
        light = v ** transfer.parameters[0]
    elif transfer.name == "parametric":
        g, a, b, c, d, e, f = transfer.parameters
        light = np.where(v >= d, np.maximum(a * v + b, 0) ** g + e, c * v + f)
    elif transfer.name == "table":
        light = np.interp(v, np.linspace(0, 1, len(transfer.parameters)), transfer.parameters)
    elif transfer.name == "hlg":
        light = _hlg(v) / _hlg(np.float32(0.75))
    elif transfer.name == "pq":
        power = v.astype(np.float64) ** (32 / 2523)  # float32 would lose dark values in the difference
        light = (np.maximum(power - 3424 / 4096, 0) / (2413 / 128 - 2392 / 128 * power)) ** (16384 / 2610) * 1e4 / 203
    else:
        light = v
    return np.clip(light, 0, 1).astype(np.float32)


@dataclass(frozen=True)
class ColorSpace:
    """Primaries and curve of a picture's numbers."""

    name: str  # for people, such as "Display P3"
    primaries: Primaries | None  # CIE x, y of red, green, blue and white; None where they are not stated
    transfer: Transfer | None  # the curve; None where it is not stated

    def to_srgb(self) -> tuple[float, ...] | None:
        """Matrix to linear sRGB by rows, whites adapted by Bradford's transform; None where none is needed."""
        if self.primaries is None or _known(self.primaries) == SRGB_PRIMARIES:
            return None
        matrix = np.linalg.solve(_xyz(SRGB_PRIMARIES), _adapted(_xyz(self.primaries), self.primaries[3], _D65))
        return tuple(float(value) for value in matrix.flat)


def of_codes(primaries: int, transfer: int) -> ColorSpace:
    """Colour space by ITU-T H.273 codes (tables 2 and 3; 2 and 0: not stated); raises InputError."""
    if transfer not in _NOT_STATED and transfer not in _TRANSFER_OF_CODE:
        what = _NOT_UNDONE.get(transfer, "unknown")
        raise InputError(f"the curve (H.273 code {transfer}, {what}) is not undone: export the file as sRGB")
    if primaries not in _NOT_STATED and primaries not in _PRIMARIES_OF_CODE:
        raise InputError(f"the primaries (H.273 code {primaries}) are not read: export the file as sRGB")
    stated = {name: values for name, values, _ in _SETS}.get(_PRIMARIES_OF_CODE.get(primaries, ""))
    return of_values(stated, _TRANSFER_OF_CODE.get(transfer))


def of_values(
    primaries: Sequence[Pair] | None, transfer: Transfer | None, other: str = "other primaries"
) -> ColorSpace:
    """Colour space by its values, with a name.

    ``primaries``: CIE x, y of red, green, blue and white, or None. Those of a known set to 2e-4, as they are or adapted
    to another white by Bradford's transform (in ICC profiles D50), become that set's own; ``transfer``: the curve, or
    None; ``other``: what primaries of no known set are called. Raises InputError: the primaries lie on one line, or
    white is not inside of them.
    """
    if primaries is None:
        return ColorSpace(name_of(None, transfer), None, transfer)
    corners = _corners(primaries)
    area, white = abs(np.linalg.det(corners[:, :3])) / 2, corners[:, 3]
    if area < _LEAST_AREA or np.linalg.solve(corners[:, :3], white).min() <= 0 or (_BRADFORD @ white).min() <= 0:
        raise InputError("the file states impossible primaries: export the file as sRGB")
    pairs = cast("Primaries", tuple(primaries))
    pairs = _known(pairs) or pairs
    return ColorSpace(name_of(pairs, transfer, other), pairs, transfer)


def name_of(primaries: Primaries | None, transfer: Transfer | None, other: str = "other primaries") -> str:
    """Name of primaries with a curve, for people: "Display P3", or "BT.2020, HLG" where the curve is not the usual."""
    known = primaries and _known(primaries)
    if primaries and not known:
        return other
    usual = {curve: name for name, values, curve in _SETS if values == known}
    name = next(iter(usual.values()), "primaries not stated")
    if transfer is None:
        return name
    words = {"linear": "linear", "srgb": "sRGB curve", "bt709": "BT.709 curve", "hlg": "HLG", "pq": "PQ"}
    if transfer.name == "power":
        words["power"] = f"gamma {transfer.parameters[0]:.4g}"
    return usual.get(transfer.name, f"{name}, {words.get(transfer.name, 'own curve')}")


def _known(primaries: Primaries) -> Primaries | None:
    """Look for the known set that has these primaries, once it is adapted to their white."""
    for _, values, _ in _SETS:
        xyz = _adapted(_xyz(values), values[3], primaries[3])
        with np.errstate(all="ignore"):  # whites far from all light
            if np.abs((xyz[:2] / xyz.sum(axis=0)).T - primaries[:3]).max() < _SAME_XY:
                return values
    return None


def _corners(primaries: Sequence[Pair]) -> np.ndarray:
    return np.array([(x, y, 1 - x - y) for x, y in primaries]).T


def _xyz(primaries: Primaries) -> np.ndarray:
    """Columns are X, Y, Z of the primaries; together they have the white's, with Y = 1."""
    corners = _corners(primaries)
    return corners[:, :3] * np.linalg.solve(corners[:, :3], corners[:, 3]) / primaries[3][1]


def _adapted(xyz: np.ndarray, white: Pair, other: Pair) -> np.ndarray:
    """Adapt columns of X, Y, Z from one white to another."""
    before, after = (_BRADFORD @ (x / y, 1, (1 - x - y) / y) for x, y in (white, other))
    return np.linalg.solve(_BRADFORD, (_BRADFORD @ xyz) * (after / before)[:, None])


def _hlg(v: np.ndarray | np.float32) -> np.ndarray:
    return np.where(v <= 0.5, v * v / 3, (np.exp((v - 0.55991073) / 0.17883277) + 0.28466892) / 12)


UNTAGGED = ColorSpace("", None, None)
TRANSFERS = ("linear", "srgb", "bt709", "power", "parametric", "table", "hlg", "pq")  # names of a `Transfer`


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
    """Colour space by Exif 0xA001 and tag 1 of 0xA005, where most cameras state Adobe RGB (DCF 2.0)."""
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

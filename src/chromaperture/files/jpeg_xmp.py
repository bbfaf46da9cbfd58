"""XMP metadata in JPEG files, also more than a segment holds (Adobe, XMP Specification Part 3, 1.1.3, 2020).

A segment has 64 KB. What is larger goes into "extended XMP": pieces of a second packet, each with the MD5 sum of the
whole (its GUID), its length, and the place of the piece; the first packet names the GUID.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from xml.sax.saxutils import escape, quoteattr

from chromaperture.system.errors import InputError

_STANDARD = b"http://ns.adobe.com/xap/1.0/\0"
_EXTENDED = b"http://ns.adobe.com/xmp/extension/\0"
_MOST = 65533  # bytes of a segment's content: its length, two bytes that count themselves, is at most 65535
_PIECE = 65400  # of extended XMP in a segment, as the specification recommends
_PACKET = '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>{}<?xpacket end="w"?>'  # its id is of every packet
_HAS_EXTENDED = ("http://ns.adobe.com/xmp/note/", "xmpNote", "HasExtendedXMP")

Property = tuple[str, str, str]  # namespace, prefix, name


def with_xmp(
    jpeg: bytes, properties: Mapping[Property, str], *, inner_xml: str = "", large: frozenset[Property] = frozenset()
) -> bytes:
    """Insert a packet of metadata into a JPEG file.

    ``jpeg``: without XMP; ``properties`` mapping of (namespace, prefix, name) to str: simple values; ``inner_xml``:
    elements besides them, whose namespaces are declared in it; ``large``: which go into extended XMP where not all have
    room in one segment. Raises InputError: what cannot go into extended XMP does not fit into a segment.
    """
    whole = _STANDARD + _packet(_description(properties, inner_xml)).encode("utf-8")
    segments = [whole]
    if len(whole) > _MOST:
        extended = _xmpmeta(_description({p: v for p, v in properties.items() if p in large}, "")).encode("utf-8")
        guid = hashlib.md5(extended, usedforsecurity=False).hexdigest().upper()
        small = {p: v for p, v in properties.items() if p not in large} | {_HAS_EXTENDED: guid}
        segments = [_STANDARD + _packet(_description(small, inner_xml)).encode("utf-8")]
        if len(segments[0]) > _MOST:
            raise InputError("the metadata of the picture do not fit into a JPEG file; write fewer of them")
        for start in range(0, len(extended), _PIECE):
            place = struct.pack(">II", len(extended), start)
            segments.append(_EXTENDED + guid.encode("ascii") + place + extended[start : start + _PIECE])
    at = _after_header(jpeg)
    return jpeg[:at] + b"".join(b"\xff\xe1" + struct.pack(">H", len(s) + 2) + s for s in segments) + jpeg[at:]


def _after_header(jpeg: bytes) -> int:
    """Return where the segments of JFIF and Exif end, which have to be first."""
    if jpeg[:2] != b"\xff\xd8":
        raise InputError("the picture is no JPEG file; encode it as JPEG first")
    at = 2
    while jpeg[at : at + 2] == b"\xff\xe0" or (
        jpeg[at : at + 2] == b"\xff\xe1" and jpeg[at + 4 : at + 10] == b"Exif\0\0"
    ):
        at += 2 + struct.unpack(">H", jpeg[at + 2 : at + 4])[0]
    return at


def _description(properties: Mapping[Property, str], inner_xml: str) -> str:
    namespaces = {(prefix, namespace) for namespace, prefix, _ in properties}
    declared = "".join(f" xmlns:{prefix}={quoteattr(namespace)}" for prefix, namespace in sorted(namespaces))
    elements = "".join(f"<{prefix}:{name}>{escape(v)}</{prefix}:{name}>" for (_, prefix, name), v in properties.items())
    return f'<rdf:Description rdf:about=""{declared}>{elements}</rdf:Description>{inner_xml}'


def _xmpmeta(description: str) -> str:
    rdf = f'<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">{description}</rdf:RDF>'
    return f'<x:xmpmeta xmlns:x="adobe:ns:meta/" x:xmptk="chromaperture">{rdf}</x:xmpmeta>'


def _packet(description: str) -> str:
    return _PACKET.format(_xmpmeta(description))

"""A photograph with its depth inside, as JPEG: GDepth (XMP) and Dynamic Depth 1.0 (pictures behind the picture).

Sources: Google, "Depthmap Metadata" (developers.google.com/depthmap-metadata), for the encoding of both; Google,
"Dynamic Depth 1.0", 2019-03-20, for the second; Adobe, XMP Specification Part 3, 1.1.3, 2020: a segment of JPEG has
64 KB. What is larger goes into "extended XMP": pieces of a second packet, each with the MD5 sum of the whole, its
GUID, its length, and the place of the piece; the first packet names the GUID.
"""

from __future__ import annotations

import base64
import hashlib
import io
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal
from xml.sax.saxutils import escape, quoteattr

import cv2
import numpy as np
from PIL import Image

from chromaperture.files.pictures import encode_png
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
    """Insert metadata into a JPEG file, what is ``large`` into extended XMP where it does not fit."""
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


Form = Literal["inverse", "linear"]
_NAMES = {"inverse": "RangeInverse", "linear": "RangeLinear"}
_GDEPTH = "http://ns.google.com/photos/1.0/depthmap/"
_LEVELS = 65535  # 16 bits: steps of 0.06 mm at 2 m between 0.9 and 5.2 m; 8 bits would be 14 mm
_QUALITY = 95  # of the photograph; Pillow's highest before files grow without a visible gain
_SOFTWARE = "chromaperture"
_DYNAMIC = "http://ns.google.com/photos/dd/1.0/"


@dataclass(frozen=True)
class EncodedDepth:
    """A depth map as a grey picture."""

    # (H, W) uint16: 0 at ``near_mm``, 65535 at ``far_mm``; of unknown pixels that of the nearest known one.
    levels: np.ndarray
    confidence: np.ndarray  # (H, W) uint8: 0 where the depth is unknown, else 1 to 255
    near_mm: float
    far_mm: float
    form: Form  # ``inverse``: even steps of 1 / depth; ``linear``: of depth


def encode_depth(z_mm: np.ndarray, confidence: np.ndarray, *, form: Form = "inverse") -> EncodedDepth:
    """Encode a depth map for both formats: unknown pixels get the nearest depth and confidence 0."""
    if form not in _NAMES:
        raise InputError(f"unknown form of depth {form!r}: choose inverse or linear")
    known = np.isfinite(z_mm) & (z_mm > 0)
    if not known.any():
        raise InputError("no pixel has a depth that can be put into the photograph; widen --max-relative-sigma")
    z = z_mm[known].astype(np.float64)
    near, far = float(z.min()), float(z.max())
    if far - near < 1e-6 * far:  # a plane without noise: the range must not be empty
        near, far = near * (1 - 1e-3), far * (1 + 1e-3)
    normal = (z - near) / (far - near)
    if form == "inverse":
        normal *= far / z
    levels = np.zeros(z_mm.shape, np.uint16)
    levels[known] = np.rint(np.clip(normal, 0, 1) * _LEVELS).astype(np.uint16)
    # Labels of the nearest known pixel: OpenCV measures the distance to zeros.
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros(int(nearest.max()) + 1, np.uint16)
    table[nearest[known]] = levels[known]
    sure = np.where(known, np.rint(1 + 254 * np.clip(np.nan_to_num(confidence), 0, 1)), 0).astype(np.uint8)
    return EncodedDepth(table[nearest], sure, near, far, form)


def gdepth_jpeg(color: np.ndarray, depth: EncodedDepth) -> bytes:
    """Return an sRGB photograph as JPEG with GDepth metadata: depth in mm and confidence, base64 PNG."""
    values = {
        "Format": _NAMES[depth.form],
        "Near": f"{depth.near_mm:.6f}",
        "Far": f"{depth.far_mm:.6f}",
        "Units": "mm",
        "MeasureType": "OpticalAxis",
        "Mime": "image/png",
        "ConfidenceMime": "image/png",
        "Software": _SOFTWARE,
        "ImageWidth": str(color.shape[1]),
        "ImageHeight": str(color.shape[0]),
        "Data": base64.b64encode(encode_png(depth.levels)).decode("ascii"),
        "Confidence": base64.b64encode(encode_png(depth.confidence)).decode("ascii"),
    }
    large = frozenset((_GDEPTH, "GDepth", name) for name in ("Data", "Confidence"))
    return with_xmp(_jpeg(color), {(_GDEPTH, "GDepth", name): value for name, value in values.items()}, large=large)


def dynamic_depth_jpeg(color: np.ndarray, depth: EncodedDepth, *, camera_matrix: np.ndarray) -> bytes:
    """Return a JPEG photograph with Dynamic Depth: depth (m) and confidence as PNG files behind it."""
    items = [("android/depthmap", encode_png(depth.levels)), ("android/confidencemap", encode_png(depth.confidence))]
    return with_xmp(_jpeg(color), {}, inner_xml=_dynamic_xml(color.shape, depth, camera_matrix, items)) + b"".join(
        content for _, content in items
    )


def _dynamic_xml(
    shape: tuple[int, ...], depth: EncodedDepth, matrix: np.ndarray, items: list[tuple[str, bytes]]
) -> str:
    prefixes = ("Container", "Item", "Device", "Profile", "Camera", "Image", "DepthMap", "ImagingModel")
    declared = "".join(f' xmlns:{prefix}="{_DYNAMIC}{prefix.lower()}/"' for prefix in prefixes)

    def attributes(prefix: str, **values: str) -> str:
        return "".join(f" {prefix}:{name}={quoteattr(value)}" for name, value in values.items())

    def listed(entries: list[str]) -> str:
        return "<rdf:Seq>" + "".join(f"<rdf:li>{entry}</rdf:li>" for entry in entries) + "</rdf:Seq>"

    directory = [("image/jpeg", 0, "primary_image")] + [("image/png", len(data), uri) for uri, data in items]
    container = listed([
        f"<Container:Item{attributes('Item', Mime=mime, Length=str(length), DataURI=uri)}/>"
        for mime, length, uri in directory
    ])  # fmt: skip
    image = attributes("Image", ItemSemantic="Primary", ItemURI="primary_image")
    depth_map = attributes(
        "DepthMap", ItemSemantic="Depth", Format=_NAMES[depth.form], Units="Meters", MeasureType="OpticalAxis",
        Near=f"{depth.near_mm / 1000:.9f}", Far=f"{depth.far_mm / 1000:.9f}", DepthURI=items[0][0],
        ConfidenceURI=items[1][0], Software=_SOFTWARE,
    )  # fmt: skip
    model = attributes(
        "ImagingModel", FocalLengthX=f"{matrix[0, 0]:.6f}", FocalLengthY=f"{matrix[1, 1]:.6f}",
        PrincipalPointX=f"{matrix[0, 2]:.6f}", PrincipalPointY=f"{matrix[1, 2]:.6f}", ImageWidth=str(shape[1]),
        ImageHeight=str(shape[0]), Skew="0.0", PixelAspectRatio="1.0",
    )  # fmt: skip
    camera = (
        f'<Device:Camera Camera:Trait="Physical"><Camera:Image{image}/><Camera:DepthMap{depth_map}/>'
        f"<Camera:ImagingModel{model}/></Device:Camera>"
    )
    cameras = f"<Profile:CameraIndices>{listed(['0'])}</Profile:CameraIndices>"
    profile = f'<Device:Profile Profile:Type="DepthPhoto">{cameras}</Device:Profile>'
    return (
        f'<rdf:Description rdf:about=""{declared}>'
        f'<Device:Container rdf:parseType="Resource"><Container:Directory>{container}</Container:Directory>'
        f"</Device:Container><Device:Profiles>{listed([profile])}</Device:Profiles>"
        f"<Device:Cameras>{listed([camera])}</Device:Cameras></rdf:Description>"
    )


def _jpeg(color: np.ndarray) -> bytes:
    """Encode a picture with colours at full resolution."""
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(color)).save(file, "JPEG", quality=_QUALITY, subsampling=0)
    return file.getvalue()

"""PNG, TIFF, PNM, BMP, JPEG, WebP, AVIF and HEIC files: what they are by their headers, and their colours as stored."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
from PIL import Image, JpegImagePlugin

from chromaperture.capture.bayer import check_not_quad, superpixels
from chromaperture.capture.heif import heif_format, is_heif, read_heif, stored_turn
from chromaperture.capture.picture_format import LUMA_WEIGHTS, PictureFormat, mosaic_format
from chromaperture.capture.picture_header import (
    PNG_MARK,
    TIFF_MARKS,
    check_png_sums,
    check_size,
    open_picture,
    other_kind,
)
from chromaperture.capture.tiff import TURNS, decode_tiff, tiff_format
from chromaperture.color.color_space import UNTAGGED, ColorSpace, of_exif, of_icc, of_png
from chromaperture.color.encoding import Encoding, Pattern
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    import av.container

_ORIENTATION, _EXIF_IFD, _COLOR_SPACE, _INTEROP_IFD, _INTEROP_INDEX = 0x0112, 0x8769, 0xA001, 0xA005, 1
_JPEG_END = b"\xff\xd9"  # a marker, which coded data do not hold
_LEAST_TAIL = bytes(4096)  # that no encoder writes: what a broken copy leaves
_KINDS = {"WEBP": "WebP", "PPM": "PNM", "MPO": "JPEG"}  # names for people that are not Pillow's
_CODECS = {"JPEG": "mjpeg", "WebP": "webp"}


def format_of_data(data: bytes, name: str, mosaic: Pattern | None) -> PictureFormat:
    """Return what a file is by its header; raises InputError, or what decoders raise on a damaged file."""
    if (is_heif(data) or data.startswith(b"WEBP", 8)) and data.endswith(_LEAST_TAIL):
        raise ValueError("the file ends in zeros")
    if is_heif(data):
        return heif_format(data, name)
    if data.startswith(TIFF_MARKS):
        return tiff_format(data, name, mosaic)
    if (other := other_kind(data)) is not None:
        raise InputError(f"{name} is {other}")
    picture = open_picture(data)
    if getattr(picture, "n_frames", 1) > 1 and picture.format != "MPO":
        raise InputError(f"{name} holds {picture.n_frames} pictures; give one photograph a file")  # type: ignore[attr-defined]
    if picture.format == "AVIF":
        return _avif_format(data, name)
    kind, bits = _KINDS.get(str(picture.format), str(picture.format)), 16 if _is_deep(data) else 8
    if mosaic is not None and picture.mode.startswith(("L", "I", "F")):
        return mosaic_format(kind, picture.size, bits, mosaic, known_from="option")
    factors, space = _factors(picture, data), _space_of(picture, data)
    is_whole = factors == (1, 1)
    return PictureFormat(
        kind, picture.size, bits, factors, luma_weights=None if is_whole else LUMA_WEIGHTS[2], space=space,
        full_range=kind != "WebP" or is_whole, turn_degrees=TURNS.get(_exif(picture).get(_ORIENTATION, 1), 0),
    )  # fmt: skip


def counts_of_data(data: bytes, form: PictureFormat, name: str) -> tuple[np.ndarray, Encoding]:
    """Return a file's counts at `PictureFormat.read_size_px`, (H, W, S), and how they become light; raises as above."""
    if form.kind == "HEIC":
        counts, white = read_heif(data, form, name)
        return counts, form.encoding(white)
    if form.kind == "AVIF" or (form.reduction > 1 and form.mosaic is None):
        from chromaperture.capture.decoded_frame import counts_of_frame, decode_packet  # FFmpeg takes 0.1 s to load

        if form.kind == "AVIF":
            with _opened_avif(data) as file:
                counts, white = counts_of_frame(next(file.decode(video=0)), form)
        else:
            counts, white = counts_of_frame(decode_packet(_CODECS[form.kind], data), form)
        return counts, form.encoding(white)
    counts, white = samples_of_data(data, name), {8: 255.0, 16: 65535.0}.get(form.bits, 1.0)
    if form.kind == "PNM" and form.bits == 16:
        white = float(_pnm_fields(data)[3])
    if form.mosaic is None:
        return counts, form.encoding(white)
    sites = counts if counts.ndim == 2 else counts[..., 0]
    check_not_quad(sites, name, black_level=0.0)
    cells, own = superpixels(sites, form.mosaic, black_level=0.0, white_level=white)
    return cells, replace(own, given=False)


def samples_of_data(data: bytes, name: str, *, check: Callable[[int, int], None] | None = None) -> np.ndarray:
    """Return the samples of a file that does not subsample chroma, in R, G, B order; raises as `format_of_data`."""
    if data.startswith(TIFF_MARKS):
        return decode_tiff(data, name, check=check)
    picture = open_picture(data)
    if check is not None:
        check(*picture.size)
    if data.startswith(PNG_MARK):
        check_png_sums(data)
    else:
        picture.verify()
    if picture.format in ("JPEG", "MPO") and data.find(_JPEG_END, picture.tile[0].offset) < 0:
        raise ValueError("a JPEG file without its end, which Pillow would paint grey")
    if not _is_deep(data):
        picture = open_picture(data)
        return np.asarray(picture.convert("RGB") if picture.mode in ("P", "RGBA", "YCbCr") else picture)
    if data.startswith(b"P"):
        return _deep_pnm(data, picture)
    counts = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if counts is None:
        raise ValueError("a damaged PNG file")
    # OpenCV stores B, G, R; alpha goes. An index list would leave one plane a channel, which later is copied.
    if counts.ndim == 3 and counts.shape[2] in (3, 4):
        return cv2.cvtColor(counts, cv2.COLOR_BGR2RGB if counts.shape[2] == 3 else cv2.COLOR_BGRA2RGB)
    return counts


def _factors(picture: Image.Image, data: bytes) -> tuple[int, int]:
    """Return columns and rows of luma to one chroma sample."""
    if picture.format == "WEBP":
        return (1, 1) if _is_lossless_webp(data) else (2, 2)
    if not isinstance(picture, JpegImagePlugin.JpegImageFile):
        return 1, 1
    if len(picture.layer) == 4:
        raise InputError("it is in colours for printing (CMYK); export it as RGB")
    sides = [(across, down) for _, across, down, _ in picture.layer]
    return (max(sides)[0] // min(sides)[0], max(s[1] for s in sides) // min(s[1] for s in sides))


def _is_lossless_webp(data: bytes) -> bool:
    """Find the chunk of the picture among those of a RIFF file."""
    at = 12
    while at + 8 <= len(data):
        name, length = data[at : at + 4], int.from_bytes(data[at + 4 : at + 8], "little")
        if name in (b"VP8 ", b"VP8L"):
            return name == b"VP8L"
        at += 8 + length + length % 2
    return False


def _space_of(picture: Image.Image, data: bytes) -> ColorSpace:
    """Return what a picture's tags say of its colours; raises InputError where that cannot be undone."""
    if data.startswith(PNG_MARK) and (tagged := of_png(data)) is not None:
        return tagged
    if profile := picture.info.get("icc_profile"):
        return of_icc(profile)
    exif = _exif(picture)  # most cameras state Adobe RGB here, and write no profile
    color_space, index = exif.get_ifd(_EXIF_IFD).get(_COLOR_SPACE), None
    with contextlib.suppress(KeyError):  # Pillow's, before version 12, where there is none
        index = exif.get_ifd(_INTEROP_IFD).get(_INTEROP_INDEX)
    return of_exif(color_space, index) or UNTAGGED


def _exif(picture: Image.Image) -> Image.Exif:
    """Return the tags before a picture's pixels, which Pillow would decode to look behind them; empty if damaged."""
    exif = Image.Exif()
    with contextlib.suppress(Exception), warnings.catch_warnings():  # Pillow raises anything, and warns of the rest
        warnings.simplefilter("ignore")
        exif.load(picture.info.get("exif") or b"")
    return exif


def _avif_format(data: bytes, name: str) -> PictureFormat:
    """Return what an AVIF file is; its size is Pillow's, for FFmpeg takes a picture made of tiles for the first."""
    from chromaperture.capture.decoded_frame import format_of_frame

    picture = open_picture(data)
    check_size(*picture.size, name, None)
    profile = picture.info.get("icc_profile")
    with _opened_avif(data) as file:
        context = file.streams.video[0].codec_context
        if (context.width, context.height) != picture.size:
            raise InputError(f"{name} is an AVIF picture made of tiles, which is not read; export it as PNG")
        space = of_icc(profile) if profile else None
        return format_of_frame(context, "AVIF", siting="centre", space=space, turn_degrees=stored_turn(data, name))


@contextlib.contextmanager
def _opened_avif(data: bytes) -> Iterator[av.container.InputContainer]:
    import av

    with av.open(io.BytesIO(data), "r", format="mov") as file:
        file.streams.video[0].codec_context.options = {"err_detect": "explode"}
        yield file


def _is_deep(data: bytes) -> bool:
    """Recognise PNG and PNM files of more than 8 bits, which Pillow would reduce to 8."""
    if data.startswith(PNG_MARK):
        return len(data) > 24 and data[24] == 16
    if data[:2] in (b"P5", b"P6"):
        fields = _pnm_fields(data)
        return len(fields) > 3 and int(fields[3]) > 255
    return False


def _pnm_fields(data: bytes) -> list[bytes]:
    """Return the words of a PNM file's header: its kind, width, height and highest count."""
    return [f for line in data[:512].split(b"\n") for f in line.split(b"#")[0].split()]


def _deep_pnm(data: bytes, picture: Image.Image) -> np.ndarray:
    """Return the samples behind the header; raises ValueError where there are too few."""
    channels = 3 if data.startswith(b"P6") else 1
    (width, height), start = picture.size, picture.tile[0].offset  # type: ignore[attr-defined]
    counts = np.frombuffer(data, ">u2", width * height * channels, start)
    return counts.astype(np.uint16).reshape(height, width, channels)

"""Frames that FFmpeg decodes, as stored: of video, JPEG, WebP and AVIF files.

FFmpeg's own conversions to R, G, B are not used: they bring chroma up to the size of luma, and most of them take it for
centred whatever the stream says.
"""

from __future__ import annotations

import logging

import av
import av.logging
import numpy as np

from chromaperture.capture.native_planes import ENCODED_WHITE, Planes, rgb_of_planes
from chromaperture.capture.picture_format import LUMA_WEIGHTS, KnownFrom, PictureFormat
from chromaperture.color.color_space import ColorSpace, of_codes
from chromaperture.color.encoding import Siting
from chromaperture.system.errors import InputError

logging.getLogger("libav").addHandler(logging.NullHandler())  # as for tifffile: an error is one line of ours
av.logging.set_level(av.logging.ERROR)
_FULL_RANGE = 2  # FFmpeg's code
_PACKED = {"yuyv422": (0, 1, 3), "uyvy422": (1, 0, 2), "yvyu422": (0, 3, 1)}  # bytes of two pixels: Y, Cb, Cr
_UNSPECIFIED = (0, 2)  # H.273; FFmpeg writes 2, 0 is reserved


class DamagedError(InputError):
    """Data that FFmpeg cannot decode."""


def decode_packet(codec: str, data: bytes) -> av.VideoFrame:
    """Decode a file that is one packet of a codec, without looking for a container; raises DamagedError."""
    try:
        context = av.CodecContext.create(codec, "r")
        context.options = {"err_detect": "explode"}  # else what is missing becomes grey
        context.thread_count = 1
        frames = [*context.decode(av.Packet(data)), *context.decode(None)]  # type: ignore[attr-defined]
    except av.FFmpegError as error:
        raise DamagedError(f"FFmpeg cannot decode it ({error.strerror}); copy the file again") from None
    if not frames:
        raise DamagedError("it holds no picture; copy the file again")
    return frames[0]


def format_of_frame(
    source: av.VideoFrame | av.VideoCodecContext,
    kind: str,
    *,
    siting: Siting,
    space: ColorSpace | None = None,
    turn_degrees: int = 0,
) -> PictureFormat:
    """Return what the frames of a stream are, by a frame or by the stream's header.

    ``siting`` is that of such files, which FFmpeg tells nowhere; ``space`` what the file around the frame says, in
    place of the stream's own tags. Raises InputError where frames are grey, or in a form that is not read.
    """
    layout = source.format
    if layout is None:
        raise InputError("it holds no picture that FFmpeg decodes")
    bits, code = layout.components[0].bits, int(source.colorspace)
    if not 8 <= bits <= 16 or layout.name.endswith("be"):
        raise InputError(f"its frames are {layout.name}, which is not read; convert them to yuv420p or yuv444p")
    if len(layout.components) < 3 or layout.has_palette:
        raise InputError(f"its frames are {layout.name}: depth is in the colours, so choose a colour format")
    space = of_codes(int(source.color_primaries), int(source.color_trc)) if space is None else space
    size = source.width, source.height
    if layout.is_rgb:
        return PictureFormat(kind, size, bits, space=space, turn_degrees=turn_degrees)
    if code not in LUMA_WEIGHTS:
        raise InputError(f"its colour matrix (code {code} of H.273) is not read; export it as BT.709")
    known: dict[str, KnownFrom] = {
        "matrix": "default" if code in _UNSPECIFIED else "tag",
        "range": "tag" if source.color_range else "default",
    }
    full_range = int(source.color_range) == _FULL_RANGE or layout.name.startswith("yuvj")
    chroma = layout.components[1]
    factors = round(size[0] / chroma.width), round(size[1] / chroma.height)
    return PictureFormat(
        kind, size, bits, factors, siting, LUMA_WEIGHTS[code], full_range, space,
        turn_degrees=turn_degrees, known_from=known,
    )  # fmt: skip


def counts_of_frame(frame: av.VideoFrame, form: PictureFormat) -> tuple[np.ndarray, float]:
    """Return a frame's colours at the places of its chroma samples, (h, w, 3), and the highest count; see `Decoded`."""
    if frame.format.is_rgb:
        return _rgb(frame, form.bits), float((1 << form.bits) - 1)
    counts = rgb_of_planes(_planes(frame), form)
    if form.is_encoded:
        return counts, ENCODED_WHITE
    white = float((1 << form.bits) - 1)  # levels of linear counts are the sensor's
    counts *= np.float32(white / ENCODED_WHITE)
    return counts, white


def _planes(frame: av.VideoFrame) -> Planes:
    """Return luma and chroma of a frame; raises InputError for layouts that no camera writes."""
    name = frame.format.name
    if name in _PACKED:
        pairs = _samples(frame, 0, 2, -(-frame.width // 2) * 2)
        at = _PACKED[name]
        return Planes(pairs[:, at[0] :: 2], pairs[:, at[1] :: 4], pairs[:, at[2] :: 4])
    if len(frame.planes) == 2:  # NV12 and its like: Cb and Cr in turn
        both = _samples(frame, 1, 2)
        blue, red = (
            (both[:, 1::2], both[:, ::2]) if name.startswith(("nv21", "nv42")) else (both[:, ::2], both[:, 1::2])
        )
        luma = _samples(frame, 0, 1)
        shift = 6 if name.startswith("p010") else 4 if name.startswith("p012") else 0  # in the upper bits
        return Planes(*(part >> shift if shift else part for part in (luma, blue, red)))
    if len(frame.planes) < 3:
        raise InputError(f"its frames are {name}, which is not read; convert them to yuv420p or yuv444p")
    return Planes(*(_samples(frame, i, 1) for i in range(3)))


def _samples(frame: av.VideoFrame, number: int, each: int, width: int | None = None) -> np.ndarray:
    """Return a plane's rows of samples, ``each`` of them a pixel."""
    plane, dtype = frame.planes[number], np.dtype(np.uint8 if frame.format.components[0].bits == 8 else "<u2")
    rows = np.frombuffer(memoryview(plane), dtype).reshape(plane.height, plane.line_size // dtype.itemsize)
    return rows[:, : each * (width or plane.width)]


def _rgb(frame: av.VideoFrame, bits: int) -> np.ndarray:
    """Return R, G, B of a frame that stores them; uint8 or uint16."""
    name = frame.format.name
    if name.startswith("gbr"):
        green, blue, red = (_samples(frame, i, 1) for i in range(3))
        return np.stack([red, green, blue], axis=2)
    wide = "rgb24" if bits == 8 else "rgb48le"  # a change of order; counts of more than 8 bits fill 16
    if bits not in (8, 16):
        raise InputError(f"its frames are {name}, which is not read; convert them to gbrp or yuv444p")
    return frame.to_ndarray(format=wide)

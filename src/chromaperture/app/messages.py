"""What the page sends, and bytes for it: a measured frame, and arrays as few bytes, without loss."""

from __future__ import annotations

import contextlib
import json
import struct
import threading
import warnings
import zlib
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np

from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.frame.preview import depth_scale, error_scale, exposed, fitted_size, reduced
from chromaperture.system.errors import CaptureWarning, InputError

MOST_COUNT = 65535  # of a map: 0 is unknown, so the steps of 8 m are 0.12 mm
LARGEST_PX = (1600, 1600)  # of the maps in a page; the files that are saved have every pixel
_JPEG_QUALITY = 90  # of the colour picture, for the eye only; chosen by hand
_PACKED_FROM = 1024  # numbers: shorter arrays are text
_LEVEL = 6  # of deflate; 9 takes three times as long and gains 2 % on the fields of a camera


class File(NamedTuple):
    """An answer that is no plain value."""

    content: bytes
    kind: str | None = "application/octet-stream"
    headers: dict[str, str] | None = None
    status: int = 200


def saved(content: bytes, name: str, kind: str = "application/octet-stream") -> File:
    """Return a file that a browser saves by its name."""
    return File(content, kind, {"Content-Disposition": f'attachment; filename="{name}"'})


def whole(asked: Any, name: str) -> int:
    """Read a positive whole number of a request; raises InputError."""
    text = asked.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) < 8):
        raise InputError(f"{name} must be a whole number")
    return int(text)


def number(asked: Any, name: str) -> float:
    """Read a number of a request; raises InputError."""
    try:
        return float(asked.get(name, ""))
    except ValueError:
        raise InputError(f"{name} must be a number") from None


def pack_frame(
    frame: DepthFrame,
    facts: dict[str, Any],
    *,
    size: tuple[int, int] | None = None,
    color: np.ndarray | None = None,
    hidden: np.ndarray | None = None,
) -> bytes:
    """Return a frame as one message.

    Four bytes hold the length of a JSON text, with ``facts``, little-endian. After it come depth and error bar, each
    (h, w) uint16, and the colours, the restored ones unless others are given (linear RGB), as JPEG. A count c of a map
    means c * step mm, and 0 unknown. Frames of a camera without a calibration have disparity instead, offset by
    ``first``: value = first + c * step. At the end is a bit for each pixel that is no point, where ``hidden``, (H, W)
    bool, says so. ``size`` is width and height of the maps, by default the frame's, or what fits into `LARGEST_PX`.
    """
    size = size or min(fitted_size(frame.disparity_px.shape, LARGEST_PX), frame.disparity_px.shape[1::-1])
    depth, depth_colors, _ = depth_scale(frame)
    sigma, sigma_colors, _ = error_scale(frame)
    maps, described = [], {}
    for name, values, colors in (("depth", depth, depth_colors), ("sigma", sigma, sigma_colors)):
        counts, first, step = to_counts(reduced(values, size))
        maps.append(counts.astype("<u2").tobytes())
        described[name] = {
            "first": first, "step": step, "unit": colors.unit, "low": colors.low, "high": colors.high,
        }  # fmt: skip
    picture = cv2.cvtColor(exposed(frame.color if color is None else color, size), cv2.COLOR_RGB2BGR)
    jpeg = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))[1].tobytes()
    bits = b"" if hidden is None else np.packbits(reduced(hidden, size)).tobytes()
    known = np.isfinite(depth)
    header = facts | described | {
        "width": size[0], "height": size[1],
        "full_width": frame.disparity_px.shape[1], "full_height": frame.disparity_px.shape[0],
        "fill": float(known.mean()), "color_bytes": len(jpeg), "hidden_bytes": len(bits),
    }  # fmt: skip
    text = json.dumps(header, allow_nan=False).encode()
    text += b" " * (-(4 + len(text)) % 2)  # the maps begin at an even place, as arrays of 16 bits must
    return struct.pack("<I", len(text)) + text + b"".join(maps) + jpeg + bits


def to_counts(values: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Divide a map into counts, (h, w) uint16, 0 unknown; returns first and step too: value = first + c * step."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(values.shape, np.uint16), 0.0, 1.0
    low, high = float(values[known].min()), float(values[known].max())
    low = min(low, 0.0)
    step = max(high - low, 1e-6) / (MOST_COUNT - 1)
    counts = np.zeros(values.shape, np.uint16)
    counts[known] = np.rint((values[known] - low) / step + 1).clip(1, MOST_COUNT)
    return counts, low - step, step


def pack_array(values: np.ndarray) -> bytes:
    """Return 32-bit numbers deflated: second differences, byte plane after byte plane; ``plan.js`` has the inverse."""
    bits = np.ascontiguousarray(values).ravel().view(np.uint32)
    twice = np.diff(np.diff(bits, prepend=np.uint32(0)), prepend=np.uint32(0)).view(np.int32)  # they wrap around
    folded = ((twice << 1) ^ (twice >> 31)).view(np.uint32)  # small numbers of either sign become small numbers
    planes = folded.astype("<u4").view(np.uint8).reshape(-1, 4).T
    return zlib.compress(planes.tobytes(), _LEVEL)


class Packing:
    """Arrays behind a text, and what the text says of each."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []

    def put(self, values: np.ndarray) -> dict[str, Any]:
        """Take an array of 32-bit numbers; return what stands for it in the text."""
        kind = {"f": "float32", "i": "int32", "u": "uint32"}[values.dtype.kind]
        if values.size < _PACKED_FROM:
            return {"kind": kind, "numbers": values.tolist()}
        packed = pack_array(values)
        at = sum(map(len, self.parts))
        self.parts.append(packed)
        return {"kind": kind, "at": at, "bytes": len(packed), "size": int(values.size)}

    def message(self, text: dict[str, Any]) -> bytes:
        """Return the text and the arrays as one message."""
        packed = zlib.compress(json.dumps(text, allow_nan=False).encode())
        return struct.pack("<I", len(packed)) + packed + b"".join(self.parts)


# Python's list of filters is one for all threads, and two that record at once would restore each other's.
_ONE_AT_A_TIME = threading.RLock()


@contextlib.contextmanager
def collect_warnings() -> Iterator[Callable[[], list[str]]]:
    """Collect the sentences of warnings about captures; what is yielded returns them."""
    with _ONE_AT_A_TIME, warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        yield lambda: list(dict.fromkeys(str(w.message) for w in found if issubclass(w.category, CaptureWarning)))

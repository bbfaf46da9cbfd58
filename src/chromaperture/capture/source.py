"""Interface of everything that delivers frames: a context manager that yields `Frame`.

>>> with open_source("webcam:0") as source:                                        # doctest: +SKIP
...     for frame in source:
...         depth = camera.measure(frame.image)
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import TracebackType
from typing import Any, Literal, Protocol, Self

import cv2
import numpy as np

from chromaperture.color.image import DARK
from chromaperture.color.srgb import srgb_to_linear
from chromaperture.errors import CaptureWarning, InputError
from chromaperture.threads import each_band

Offsets = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
CENTRED: Offsets = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
_TWELVE_BITS = 4096  # a 16-bit file with no count above is likely that of a sensor of 12 bits or fewer


@dataclass(frozen=True)
class Encoding:
    """Conversion of counts to linear light.

    Attributes
    ----------
    black_level, white_level : float
        Counts of no light and of a full well.
    curve : {"linear", "srgb"}
        sRGB counts are decoded; levels apply before the curve.
    channel_offsets_px : ((dx, dy),) * 3
        Sampling positions of R, G and B from the pixel's centre; not zero for superpixels of a Bayer mosaic.
    given : bool
        False: nobody gave the levels. They are those of the number format or of a RAW file, and a camera file's replace
        them. Not compared: light is the same.
    """

    black_level: float = 0.0
    white_level: float = 65535.0
    curve: Literal["linear", "srgb"] = "linear"
    channel_offsets_px: Offsets = CENTRED
    given: bool = field(default=True, compare=False)

    def __post_init__(self) -> None:
        if not (np.isfinite([self.black_level, self.white_level]).all() and self.white_level > self.black_level):
            raise InputError(
                f"white level {self.white_level:g} must be above black level {self.black_level:g}; check the options"
            )
        if self.curve not in ("linear", "srgb"):
            raise InputError(f"unknown curve {self.curve!r}: choose linear or srgb")


def format_encoding(dtype: np.dtype[Any]) -> Encoding:
    """Return the encoding of counts whose levels nobody gave: 8 bits sRGB, more linear, full scale white."""
    if dtype == np.uint8:
        return Encoding(0.0, 255.0, "srgb", given=False)
    return Encoding(0.0, 1.0 if dtype.kind == "f" else float(np.iinfo(dtype).max), given=False)


def choose_encoding(
    own: Encoding,
    counts: np.ndarray,
    *,
    black_level: float | None = None,
    white_level: float | None = None,
    camera_levels: tuple[float, float] | None = None,
) -> Encoding:
    """Choose levels: the given ones, else the camera's where the counts can hold them, else the file's own.

    Parameters
    ----------
    own : Encoding
        Of the counts, when no level is given.
    counts : (H, W, 3) array
    black_level, white_level : float, optional
        Of the sensor; superpixels hold twice its counts. Given levels make counts linear.
    camera_levels : (float, float), optional
        Of the camera file.

    Warns
    -----
    CaptureWarning
        8 bits cannot hold the camera's levels, or the white level is a guess that looks wrong. The text names no file,
        so that Python shows it once.
    """
    given = (black_level, white_level)
    if camera_levels is not None and counts.dtype == np.uint8 and camera_levels[1] > 255:
        if given == (None, None):
            warnings.warn(
                f"an 8-bit picture, but the camera was calibrated on linear counts up to {camera_levels[1]:g}: "
                "decoded as sRGB, which costs accuracy; use the linear original",
                CaptureWarning,
                stacklevel=4,
            )
        camera_levels = None
    black, white = (
        level if level is not None or camera_levels is None else camera_levels[i] for i, level in enumerate(given)
    )
    if white is None and not own.given and own.white_level == 65535 and 0 < counts.max() < _TWELVE_BITS:
        warnings.warn(
            f"a 16-bit picture without a count above {_TWELVE_BITS - 1}; if the sensor has fewer bits, "
            "give --white-level",
            CaptureWarning,
            stacklevel=4,
        )
    if black is None and white is None:
        return own
    factor = 1 if own.channel_offsets_px == CENTRED else 2
    return Encoding(
        own.black_level if black is None else factor * float(black),
        own.white_level if white is None else factor * float(white),
        "linear",
        own.channel_offsets_px,
    )


def checked_fps(fps: float) -> float:
    """Return a frame rate that is positive and finite; raises InputError for others."""
    if not 0 < fps < math.inf:
        raise InputError(f"fps must be positive, got {fps:g}")
    return fps


@dataclass(frozen=True)
class Frame:
    """One picture of a stream.

    Attributes
    ----------
    counts : (H, W, 3) uint8, uint16 or float32
        R, G, B as delivered; stored by recordings.
    encoding : Encoding
    time_s : float
        Live and replayed: seconds since 1970 when the frame arrived. Files: seconds since the first frame.
    index : int
        Number of the frame in its source, from 0; gaps are dropped frames.
    metadata : Mapping
        JSON values: exposure_us, gain, file, ... if known.
    """

    counts: np.ndarray
    encoding: Encoding
    time_s: float
    index: int
    metadata: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def image(self) -> np.ndarray:
        """(H, W, 3) float32 linear RGB, 1.0 = white level, all channels on one grid; computed on first use."""
        return develop_counts(self.counts, self.encoding)


def develop_counts(counts: np.ndarray, encoding: Encoding) -> np.ndarray:
    """Convert (H, W, 3) counts to linear light on one grid; (H, W, 3) float32, 1.0 = white level."""
    black, span = np.float32(encoding.black_level), np.float32(encoding.white_level - encoding.black_level)
    image = np.empty(counts.shape, np.float32)

    def convert(rows: slice) -> None:
        part = image[rows]
        part[...] = counts[rows]
        part -= black
        part /= span

    each_band(convert, len(image))
    if encoding.curve == "srgb":
        image = srgb_to_linear(image)
    for channel, (dx, dy) in enumerate(encoding.channel_offsets_px):
        if dx or dy:  # interpolate the channel at the pixel's centre, without the other channels
            image[..., channel] = cv2.sepFilter2D(
                np.ascontiguousarray(image[..., channel]), -1, _cubic(-dx), _cubic(-dy), borderType=cv2.BORDER_REPLICATE
            )
    return image


def _cubic(t: float) -> np.ndarray:
    """Compute weights of five neighbours for cubic interpolation at t px from the middle one, |t| <= 1 (Keys 1981)."""
    x = np.abs(np.arange(-2, 3) - t)
    near, far = 1 + x * x * (1.5 * x - 2.5), 2 + x * (-4 + x * (2.5 - 0.5 * x))
    return np.where(x < 1, near, np.where(x < 2, far, 0.0)).astype(np.float32)


@dataclass(frozen=True)
class Event:
    """A message for the user; the stream continues.

    Attributes
    ----------
    kind : {"lost", "reconnected", "size", "dark", "skipped"}
    message : str
        One line.
    """

    kind: Literal["lost", "reconnected", "size", "dark", "skipped"]
    message: str


Listener = Callable[[Event], None]


def log_event(event: Event) -> None:
    """Log an event with Python's logging; the default listener."""
    logging.getLogger("chromaperture.capture").warning(event.message)


class Source(Protocol):
    """A source of frames: a context manager to iterate over; leaving it releases the device.

    Attributes
    ----------
    name : str
        For people.
    live : bool
        Only the newest frame is kept for a slow reader; otherwise every frame is delivered, at the reader's pace.
    dropped : int
        Number of frames that were replaced by newer ones before they were read.
    """

    name: str
    live: bool
    dropped: int

    def __enter__(self) -> Self:
        """Open files or device; raises InputError with what is missing."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Release them."""
        ...

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames of one size until the source ends or is closed."""
        ...


class FileSource:
    """A source that is read at the reader's pace; subclasses implement `open`, `close` and `frames`."""

    live = False
    dropped = 0

    def __init__(self, name: str, *, listener: Listener | None = None) -> None:
        self.name, self.listener = name, listener or log_event

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[Frame]:
        yield from steady(self.frames(), self.listener)

    def open(self) -> None:
        """Check that there is something to read."""

    def close(self) -> None:
        """Release what was opened."""

    def frames(self) -> Iterator[Frame]:
        """Yield frames."""
        raise NotImplementedError


def steady(frames: Iterable[Frame], listener: Listener) -> Iterator[Frame]:
    """Pass frames of the first one's size; report once when others arrive, and when the picture goes dark."""
    shape: tuple[int, ...] | None = None
    odd = dark = False
    for frame in frames:
        shape = shape or frame.counts.shape
        if frame.counts.shape != shape:
            if not odd:
                (rows, columns), (height, width) = frame.counts.shape[:2], shape[:2]
                message = f"frame {frame.index} is {columns}x{rows} px, the first was {width}x{height}"
                listener(Event("size", f"{message}; frames of another size are skipped"))
            odd = True
            continue
        odd = False
        was_dark, dark = dark, is_dark(frame)
        if dark and not was_dark:
            listener(Event("dark", f"frame {frame.index} is all black; lens cap, exposure or levels?"))
        yield frame


def is_dark(frame: Frame) -> bool:
    """Test whether a frame is dark, from every eighth pixel."""
    unshifted = replace(frame.encoding, channel_offsets_px=CENTRED)
    lit = develop_counts(frame.counts[::8, ::8], unshifted)
    return float(np.percentile(lit, 99)) < DARK

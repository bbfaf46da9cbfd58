"""Interface of everything that delivers frames: a context manager that yields `Frame`.

>>> with open_source("webcam:0") as source:                                        # doctest: +SKIP
...     for frame in source:
...         depth = camera.measure(frame.image)
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Protocol, Self

import numpy as np

from chromaperture.color.encoding import CENTRED, Encoding, Levels, develop_counts
from chromaperture.color.image import DARK
from chromaperture.system.errors import InputError


def checked_fps(fps: float) -> float:
    """Return a frame rate that is positive and finite; raises InputError for others."""
    if not 0 < fps < math.inf:
        raise InputError(f"fps must be positive, got {fps:g}")
    return fps


@dataclass(frozen=True)
class Frame:
    """One picture of a stream."""

    counts: np.ndarray  # (H, W, 3) uint8, uint16 or float32: R, G, B as delivered; stored by recordings
    encoding: Encoding
    time_s: float  # live and replayed: seconds since 1970 when the frame arrived. Files: seconds since the first frame
    index: int  # number of the frame in its source, from 0; gaps are frames that were skipped, or did not arrive
    metadata: Mapping[str, Any] = field(default_factory=dict)  # JSON values: exposure_us, gain, file, ... if known

    @cached_property
    def image(self) -> np.ndarray:
        """(H, W, 3) float32 linear RGB, 1.0 = white level, all channels on one grid; computed on first use."""
        return develop_counts(self.counts, self.encoding)


EventKind = Literal["lost", "reconnected", "size", "dark", "skipped", "missing", "clock", "turned", "siting"]


@dataclass(frozen=True)
class Event:
    """A message of one line for the user; the stream continues."""

    kind: EventKind
    message: str


Listener = Callable[[Event], None]


def log_event(event: Event) -> None:
    """Log an event with Python's logging; the default listener."""
    logging.getLogger("chromaperture.capture").warning(event.message)


@dataclass
class FrameCounts:
    """What became of the frames of a live camera, as far as the numbers that it gives them tell."""

    delivered: int = 0  # to the reader
    skipped: int = 0  # whole, and replaced by newer ones before they were read
    incomplete: int = 0  # arrived without some of their data
    lost: int = 0  # did not arrive

    @property
    def sent(self) -> int:
        """All of them."""
        return self.delivered + self.skipped + self.incomplete + self.lost


class Source(Protocol):
    """A source of frames: a context manager to iterate over; leaving it releases the device."""

    # Only the newest frame is kept for a slow reader; otherwise every frame is delivered, at the reader's pace.
    live: bool

    @property
    def dropped(self) -> int:
        """Number of frames that were replaced by newer ones before they were read."""

    @property
    def name(self) -> str:
        """For people."""

    def __enter__(self) -> Self:
        """Open files or device; raises InputError with what is missing."""

    def __exit__(self, *error: object) -> None:
        """Release them."""

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames of one size until the source ends or is closed."""


@dataclass(eq=False)
class FileSource:
    """A source that is read at the reader's pace; the fields of subclasses are settings of `open_source`."""

    place: str  # of files or device
    _: KW_ONLY
    listener: Listener | None = None

    kind = ""
    live = False
    dropped = 0
    total = 0  # frames, as far as is known before they are read; 0 unknown
    camera_size_px = None

    @property
    def name(self) -> str:
        """Kind and place."""
        return ":".join(filter(None, (self.kind, self.place)))

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Frame]:
        yield from steady(self.frames(), self.listener or log_event, self.camera_size_px)

    def report(self, kind: EventKind, message: str) -> None:
        """Tell the listener of an event."""
        (self.listener or log_event)(Event(kind, message))

    def open(self) -> None:
        """Check that there is something to read."""

    def close(self) -> None:
        """Release what was opened."""

    def frames(self) -> Iterator[Frame]:
        """Yield frames."""
        raise NotImplementedError


@dataclass(kw_only=True, eq=False)
class PictureSource(FileSource):
    """A source of files whose levels may be given, as for `choose_encoding`."""

    black_level: float | None = None
    white_level: float | None = None
    camera_encoding: Encoding | None = None

    @property
    def levels(self) -> Levels:
        """What `choose_encoding` takes."""
        return Levels(black_level=self.black_level, white_level=self.white_level, camera_encoding=self.camera_encoding)


def steady(
    frames: Iterable[Frame], listener: Listener, camera_size_px: tuple[int, int] | None = None
) -> Iterator[Frame]:
    """Pass frames of the first one's size; report once when others arrive, and when the picture goes dark.

    Raises InputError for frames that are another part of the sensor than those that a camera was calibrated with.
    """
    shape: tuple[int, ...] | None = None
    odd = dark = False
    for frame in frames:
        if shape is None and camera_size_px is not None:
            _check_region(frame, camera_size_px)
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


def _check_region(frame: Frame, camera_size_px: tuple[int, int]) -> None:
    """Raise InputError for another part of the sensor: of the same aspect it would be measured as a smaller picture."""
    height, width = frame.counts.shape[:2]
    if "region_px" in frame.metadata and (width, height) != camera_size_px:
        raise InputError(
            f"frames are {width}x{height} px of the sensor, the camera file is for {camera_size_px[0]}x"
            f"{camera_size_px[1]}: set width and height as for its calibration, or calibrate with these"
        )


def is_dark(frame: Frame) -> bool:
    """Test whether a frame is dark, from every eighth pixel."""
    unshifted = replace(frame.encoding, channel_offsets_px=CENTRED)
    lit = develop_counts(frame.counts[::8, ::8], unshifted)
    return float(np.percentile(lit, 99)) < DARK

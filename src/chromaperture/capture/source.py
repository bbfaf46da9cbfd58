"""Interface of everything that delivers frames: a context manager that yields `Frame`.

>>> with open_source("webcam:0") as source:                                        # doctest: +SKIP
...     for frame in source:
...         depth = camera.measure(frame.image)
"""

from __future__ import annotations

import importlib
import logging
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Protocol, Self, TypedDict

import numpy as np

from chromaperture.color.encoding import CENTRED, Encoding, develop_counts
from chromaperture.color.image import DARK
from chromaperture.errors import CaptureWarning, InputError, MissingDependencyError

_TWELVE_BITS = 4096  # a 16-bit file with no count above is likely that of a sensor of 12 bits or fewer


class Levels(TypedDict, total=False):
    """Levels that a reader gives, and those of the camera that the files are for; see `choose_encoding`."""

    black_level: float | None
    white_level: float | None
    camera_encoding: Encoding | None


def choose_encoding(
    own: Encoding,
    counts: np.ndarray,
    *,
    black_level: float | None = None,
    white_level: float | None = None,
    camera_encoding: Encoding | None = None,
) -> Encoding:
    """Choose levels: the given ones, else the camera's where the counts can hold them, else the file's own.

    Given levels are the sensor's, make counts linear, and are doubled for superpixels. Pictures of encoded values tell
    nothing of a camera's linear ones, nor linear ones of them. Warns where encoded values cannot hold the camera's
    levels and where the white level is a guess that looks wrong, without a file's name: Python shows each text once.
    """
    camera = None if camera_encoding is None else _camera_of(own, counts, camera_encoding, (black_level, white_level))
    given = (black_level, white_level)
    known = (None, None) if camera is None else (camera.black_level, camera.white_level)
    black, white = (level if level is not None else of_camera for level, of_camera in zip(given, known, strict=True))
    factor = 1 if own.channel_offsets_px == CENTRED else 2
    is_guess = white is None and not (own.given or own.is_encoded) and own.white_level == 65535 * factor
    if is_guess and 0 < counts.max(initial=0) < _TWELVE_BITS * factor:
        warnings.warn(
            f"a 16-bit picture without a count above {_TWELVE_BITS - 1}; if the sensor has fewer bits, "
            "give --white-level",
            CaptureWarning,
            stacklevel=4,
        )
    if black is None and white is None:
        return own
    curve = {} if camera is None else {"curve": camera.curve, "curve_parameters": camera.curve_parameters}
    return replace(
        own,
        **{"curve": "linear", "curve_parameters": ()} | curve,  # type: ignore[arg-type]
        black_level=own.black_level if black is None else factor * float(black),
        white_level=own.white_level if white is None else factor * float(white),
        response=None if camera is None else camera.response,
        given=True,
    )


def _camera_of(
    own: Encoding, counts: np.ndarray, camera: Encoding, given: tuple[float | None, float | None]
) -> Encoding | None:
    """Return the camera's encoding, its levels those of the counts, where it can be that of the counts; else None."""
    is_given = given != (None, None)
    if camera.is_encoded:
        if not own.is_encoded and counts.dtype != np.uint8 and camera.white_level > 255:
            return camera  # a curve that a calibration has found in deep files without a tag
        if is_given or not own.is_encoded:
            return None
        if (own.curve, own.curve_parameters) != (camera.curve, camera.curve_parameters):
            return None  # each is decoded by its own curve; what was measured of the camera's does not apply
        scale = own.white_level / _white_of_encoded(camera)
        return replace(camera, black_level=scale * camera.black_level, white_level=scale * camera.white_level)
    if counts.dtype != np.uint8 and not own.is_encoded:
        return camera
    if counts.dtype == np.uint8 and camera.white_level <= 255:  # linear counts of 8 bits, which no tag tells
        return camera
    if not is_given:
        warnings.warn(
            f"a picture of encoded values, but the camera was calibrated on counts up to {camera.white_level:g}: "
            f"decoded by the curve {own.curve}, which costs accuracy; use the linear original",
            CaptureWarning,
            stacklevel=5,
        )
    return None


def _white_of_encoded(camera: Encoding) -> float:
    """Return the highest count of the numbers that a camera's levels were stated in: of 8 bits, or of 16."""
    return 255.0 if camera.white_level <= 255 else 65535.0


def needed(module: str, hint: str) -> Any:
    """Import an optional package; raises MissingDependencyError with what to do."""
    try:
        return importlib.import_module(module)
    except (ImportError, OSError):  # a shared library may be missing
        raise MissingDependencyError(hint) from None


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


EventKind = Literal["lost", "reconnected", "size", "dark", "skipped", "turned", "siting"]


@dataclass(frozen=True)
class Event:
    """A message of one line for the user; the stream continues."""

    kind: EventKind
    message: str


Listener = Callable[[Event], None]


def log_event(event: Event) -> None:
    """Log an event with Python's logging; the default listener."""
    logging.getLogger("chromaperture.capture").warning(event.message)


class Source(Protocol):
    """A source of frames: a context manager to iterate over; leaving it releases the device.

    Attributes
    ----------
    live : bool
        Only the newest frame is kept for a slow reader; otherwise every frame is delivered, at the reader's pace.
    dropped : int
        Number of frames that were replaced by newer ones before they were read.
    """

    live: bool
    dropped: int

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
    """A source that is read at the reader's pace; subclasses implement `open`, `close` and `frames`.

    Their fields are the settings of `open_source`; `kind` stands before the place in the name.
    """

    place: str  # of files or device
    _: KW_ONLY
    listener: Listener | None = None

    kind = ""
    live = False
    dropped = 0

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
        yield from steady(self.frames(), self.listener or log_event)

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

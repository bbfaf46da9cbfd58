"""How a camera's counts stand for light: levels, the sRGB curve, a tone curve."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, Literal, TypedDict, get_args

import cv2
import numpy as np

from chromaperture.color.color_space import TRANSFERS, Transfer, to_linear
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear
from chromaperture.system.errors import CaptureWarning, InputError
from chromaperture.system.threads import each_band

KNOTS = 10  # exponents of a curve; chosen by hand
_PLACES = 513  # of the table, evenly over sRGB codes; above a value of 0.01 powers 0.5 to 3 are off by less than 2e-5
_LEAST = 1e-6  # decoded value whose logarithm stands for that of 0


@dataclass(frozen=True)
class ResponseCurve:
    """Light of decoded values, one curve for all channels: files' tone curves, gamma; 0 and 1 stay what they are.

    It is stored as local exponents q = d ln light / d ln value at evenly spaced codes of the sRGB curve, steps of equal
    visibility; 1 everywhere where values are linear.
    """

    exponents: tuple[float, ...]  # positive, linear between the codes

    def light(self, values: np.ndarray) -> np.ndarray:
        """Return the linear light of decoded values, float32; beyond 0 and 1 at the scale of the curve's ends."""
        decoded = np.asarray(values, np.float32)
        at, light = response_table(self.exponents)
        found = np.interp(decoded, at, light)
        below = light[1] / at[1]
        return np.where(decoded < at[1], decoded * below, np.where(decoded > 1, decoded, found)).astype(np.float32)

    def exponent(self, values: np.ndarray) -> np.ndarray:
        """Return the local exponent at decoded values; float64 of the same shape."""
        knots = np.linspace(0, 1, len(self.exponents))
        return np.asarray(np.interp(linear_to_srgb(values), knots, self.exponents), float)


@lru_cache(maxsize=256)
def response_table(exponents: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return decoded values at evenly spaced sRGB codes, and their light; (P,) float64 each, both from 0 to 1."""
    codes = np.linspace(0, 1, _PLACES)
    values = srgb_to_linear(codes).astype(float)
    values[-1] = 1.0
    logs = np.log(np.maximum(values, _LEAST))
    q = np.interp(codes, np.linspace(0, 1, len(exponents)), exponents)
    steps = np.diff(logs) * (q[1:] + q[:-1]) / 2
    light = np.exp(-np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]]))
    light[0] = 0.0
    values.setflags(write=False)
    light.setflags(write=False)
    return values, light


Offsets = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
Siting = Literal["centre", "left", "top-left"]
Pattern = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
SITINGS: tuple[Siting, ...] = get_args(Siting)
PATTERNS: tuple[Pattern, ...] = get_args(Pattern)
Halves = Literal["left-right", "right-left"]
_LEVELS = 65536  # of a curve's table: steps of a 250th of a count of 8 bits
_TWELVE_BITS = 4096  # a 16-bit file with no count above is likely that of a sensor of 12 bits or fewer
CENTRED: Offsets = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))


@dataclass(frozen=True)
class StatedFacts:
    """What a person says of files that they do not say themselves; None: nothing."""

    # {"centre", "left", "top-left"}: place of a subsampled file's chroma samples among those of luma.
    siting: Siting | None = None
    primaries: Literal["srgb"] | None = None  # {"srgb"}: of files whose tag is wrong
    mosaic: Pattern | None = None  # {"RGGB", "BGGR", "GRBG", "GBRG"}: grey files are such a mosaic of a Bayer sensor
    # {"left-right", "right-left"}: a photograph is two files, of the halves of a dual-pixel sensor's pixels, see
    # ``capture/dual_pixel.py``; "right-left": the one called left sees the right of the pupil.
    dual_pixel: Halves | None = None

    def __post_init__(self) -> None:
        choices = {"siting": SITINGS, "primaries": ("srgb",), "mosaic": PATTERNS, "dual_pixel": get_args(Halves)}
        for name, known in choices.items():
            value = getattr(self, name)
            if value is not None and value not in known:
                raise InputError(f"unknown {name} {value!r}: choose {', '.join(known)}")

    def or_else(self, other: StatedFacts) -> StatedFacts:
        """Return the same, and of what is not stated what the other states."""
        return StatedFacts(*(getattr(self, f.name) or getattr(other, f.name) for f in fields(self)))


NOTHING_STATED = StatedFacts()


@dataclass(frozen=True)
class Encoding:
    """Conversion of counts to linear light."""

    # ``black_level``, ``white_level``: counts of no light and of a full well.
    black_level: float = 0.0
    white_level: float = 65535.0
    curve: str = "linear"  # transfer by which values are decoded, see `Transfer`; levels apply before it
    # ((dx, dy),) * 3: sampling positions of R, G and B from the pixel's centre; not zero for superpixels of a Bayer
    # mosaic.
    channel_offsets_px: Offsets = CENTRED
    # Light of the values that levels and curve give: the tone curve of a calibrated camera.
    response: ResponseCurve | None = None
    # False: nobody gave the levels. They are those of the number format or of a RAW file, and a camera file's replace
    # them. Not compared: light is the same.
    given: bool = field(default=True, compare=False)
    curve_parameters: tuple[float, ...] = ()  # of the curve
    # (9,) tuple of float: rows of the matrix from the file's primaries to those of sRGB, of light.
    to_srgb: tuple[float, ...] | None = None
    stated: StatedFacts = field(default=NOTHING_STATED, compare=False)  # of a camera: what a person said of its files

    def __post_init__(self) -> None:
        if not (np.isfinite([self.black_level, self.white_level]).all() and self.white_level > self.black_level):
            raise InputError(
                f"white level {self.white_level:g} must be above black level {self.black_level:g}; check the options"
            )
        if self.curve not in TRANSFERS:
            raise InputError(f"unknown curve {self.curve!r}: choose {', '.join(TRANSFERS)}")

    @property
    def is_encoded(self) -> bool:
        """Whether values follow a curve, as those of pictures for people do; else they are light."""
        return self.curve != "linear"


def format_encoding(dtype: np.dtype[Any]) -> Encoding:
    """Return the encoding of counts whose levels nobody gave: 8 bits sRGB, more linear, full scale white."""
    if dtype == np.uint8:
        return Encoding(0.0, 255.0, "srgb", given=False)
    return Encoding(0.0, 1.0 if dtype.kind == "f" else float(np.iinfo(dtype).max), given=False)


class Levels(TypedDict, total=False):
    """Levels that a reader gives, and those of the camera that the files are for; see `choose_encoding`."""

    black_level: float | None
    white_level: float | None
    camera_encoding: Encoding | None


def choose_encoding(
    own: Encoding | None,
    counts: np.ndarray,
    *,
    black_level: float | None = None,
    white_level: float | None = None,
    camera_encoding: Encoding | None = None,
) -> Encoding:
    """Choose levels: the given ones, else the camera's where the counts can hold them, else the file's or format's own.

    Given levels are the sensor's, make counts linear, and are doubled for superpixels. Pictures of encoded values tell
    nothing of a camera's linear ones, nor linear ones of them. Warns where encoded values cannot hold the camera's
    levels and where the white level is a guess that looks wrong, without a file's name: Python shows each text once.
    """
    own = own or format_encoding(counts.dtype)
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


def develop_counts(counts: np.ndarray, encoding: Encoding) -> np.ndarray:
    """Convert (H, W, 3) counts to linear light on one grid; (H, W, 3) float32, 1.0 = white level."""
    if counts.dtype == np.uint8:
        levels = _light(np.arange(256, dtype=np.uint8)[None], encoding)
        image = cv2.LUT(np.ascontiguousarray(counts), np.ascontiguousarray(levels))
    elif counts.dtype == np.uint16 and (encoding.curve != "linear" or encoding.response is not None):
        image = _light(np.arange(65536, dtype=np.uint16)[None], encoding)[0][counts]
    else:
        image = _light(counts, encoding)
    for channel, (dx, dy) in enumerate(encoding.channel_offsets_px):
        if dx or dy:  # interpolate the channel at the pixel's centre, without the other channels
            image[..., channel] = cv2.sepFilter2D(
                np.ascontiguousarray(image[..., channel]), -1, _cubic(-dx), _cubic(-dy), borderType=cv2.BORDER_REPLICATE
            )
    if encoding.to_srgb is not None:
        image = cv2.transform(image, np.reshape(encoding.to_srgb, (3, 3)))
    return image


def _light(counts: np.ndarray, encoding: Encoding) -> np.ndarray:
    """Convert counts to linear light, each on its own; float32 of the same shape."""
    transfer = Transfer(encoding.curve, encoding.curve_parameters)
    black, span = np.float32(encoding.black_level), np.float32(encoding.white_level - encoding.black_level)
    image = np.empty(counts.shape, np.float32)

    def convert(rows: slice) -> None:
        part = image[rows]
        part[...] = counts[rows]
        part -= black
        part /= span

    each_band(convert, len(image))
    if encoding.is_encoded and image.size > _LEVELS:  # a power takes ten times as long as a table
        each_band(lambda rows: _look_up(image[rows], _table(transfer), transfer), len(image))
    elif encoding.is_encoded:
        image = to_linear(image, transfer)
    return image if encoding.response is None else encoding.response.light(image)


def _look_up(values: np.ndarray, table: np.ndarray, transfer: Transfer) -> None:
    """Decode values in place: those in [0, 1] by the entry of a table that is nearest, the few others one by one."""
    is_inside = values.min() >= 0 and values.max() <= 1
    outside = None if is_inside else (values < 0) | (values > 1)
    others = None if outside is None else values[outside]
    scaled = values * np.float32(len(table) - 1)
    scaled += np.float32(0.5)
    np.take(table, scaled.astype(np.int32), out=values, mode="clip")
    if outside is not None and others is not None:
        values[outside] = to_linear(others, transfer)


@lru_cache(maxsize=4)
def _table(transfer: Transfer) -> np.ndarray:
    """Return the light of `_LEVELS` values from 0 to 1; float32."""
    return to_linear(np.arange(_LEVELS, dtype=np.float32) / (_LEVELS - 1), transfer)


def _cubic(t: float) -> np.ndarray:
    """Compute weights of five neighbours for cubic interpolation at t px from the middle one, |t| <= 1 (Keys 1981)."""
    x = np.abs(np.arange(-2, 3) - t)
    near, far = 1 + x * x * (1.5 * x - 2.5), 2 + x * (-4 + x * (2.5 - 0.5 * x))
    return np.where(x < 1, near, np.where(x < 2, far, 0.0)).astype(np.float32)

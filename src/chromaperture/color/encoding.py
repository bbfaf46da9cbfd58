"""How a camera's counts stand for light: levels, the sRGB curve, a tone curve."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal, get_args

import cv2
import numpy as np

from chromaperture.color.color_space import TRANSFERS, Transfer, to_linear
from chromaperture.color.response import ResponseCurve
from chromaperture.system.errors import InputError
from chromaperture.system.threads import each_band

Offsets = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
Siting = Literal["centre", "left", "top-left"]
Pattern = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
SITINGS: tuple[Siting, ...] = get_args(Siting)
PATTERNS: tuple[Pattern, ...] = get_args(Pattern)
_LEVELS = 65536  # of a curve's table: steps of a 250th of a count of 8 bits
CENTRED: Offsets = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))


@dataclass(frozen=True)
class StatedFacts:
    """What a person says of files that they do not say themselves; None: nothing."""

    # {"centre", "left", "top-left"}: place of a subsampled file's chroma samples among those of luma.
    siting: Siting | None = None
    primaries: Literal["srgb"] | None = None  # {"srgb"}: of files whose tag is wrong
    mosaic: Pattern | None = None  # {"RGGB", "BGGR", "GRBG", "GBRG"}: grey files are such a mosaic of a Bayer sensor

    def __post_init__(self) -> None:
        for name, known in {"siting": SITINGS, "primaries": ("srgb",), "mosaic": PATTERNS}.items():
            value = getattr(self, name)
            if value is not None and value not in known:
                raise InputError(f"unknown {name} {value!r}: choose {', '.join(known)}")

    def or_else(self, other: StatedFacts) -> StatedFacts:
        """Return the same, and of what is not stated what the other states."""
        return StatedFacts(self.siting or other.siting, self.primaries or other.primaries, self.mosaic or other.mosaic)


NOTHING_STATED = StatedFacts()


@dataclass(frozen=True)
class Encoding:
    """Conversion of counts to linear light."""

    # ``black_level``, ``white_level``: Counts of no light and of a full well.
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

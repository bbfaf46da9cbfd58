"""How a camera's counts stand for light: levels, the sRGB curve, a tone curve."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import cv2
import numpy as np

from chromaperture.color.response import ResponseCurve
from chromaperture.color.srgb import srgb_to_linear
from chromaperture.errors import InputError
from chromaperture.threads import each_band

Offsets = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
CENTRED: Offsets = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))


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
    response : ResponseCurve, optional
        Light of the values that levels and curve give: the tone curve of a calibrated camera.
    given : bool
        False: nobody gave the levels. They are those of the number format or of a RAW file, and a camera file's replace
        them. Not compared: light is the same.
    mosaic : str, optional
        Of a camera: the Bayer pattern of its grey files, which `capture.files` makes colour pictures of.
    """

    black_level: float = 0.0
    white_level: float = 65535.0
    curve: Literal["linear", "srgb"] = "linear"
    channel_offsets_px: Offsets = CENTRED
    response: ResponseCurve | None = None
    given: bool = field(default=True, compare=False)
    mosaic: str | None = field(default=None, compare=False)

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
    return image


def _light(counts: np.ndarray, encoding: Encoding) -> np.ndarray:
    """Convert counts to linear light, each on its own; float32 of the same shape."""
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
    return image if encoding.response is None else encoding.response.light(image)


def _cubic(t: float) -> np.ndarray:
    """Compute weights of five neighbours for cubic interpolation at t px from the middle one, |t| <= 1 (Keys 1981)."""
    x = np.abs(np.arange(-2, 3) - t)
    near, far = 1 + x * x * (1.5 * x - 2.5), 2 + x * (-4 + x * (2.5 - 0.5 * x))
    return np.where(x < 1, near, np.where(x < 2, far, 0.0)).astype(np.float32)

"""Checks of a capture before it is measured."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from chromaperture.capture.picture_format import FORM, PictureFormat
from chromaperture.capture.picture_header import other_size
from chromaperture.color.encoding import Encoding
from chromaperture.color.image import DARK, SATURATION, checked_image
from chromaperture.system.errors import CaptureWarning, InputError

# Chosen by hand, not tuned:
_MOST_SATURATED, _MUCH_SATURATED = 0.98, 0.05  # fractions of the pixels: an error, a warning
_MOST_DARK = 0.99  # fraction of the samples
# Values beyond are no light and count as unknown: above the white level nothing is told anyway, and noise about black
# is smaller. An area of 1e30 or -0.5 (1/35 of the sample) changed the means, and so depth by 5 % in 0.20 and 0.10 of
# the pixels far away; unknown, it changes 0.02 of them.
_LEAST_LIGHT, _MOST_LIGHT = -0.1, 2.0
# Colours that a tag's primaries bring so far below zero, of the largest channel, are rare: not even the purest red of
# Display P3 is one. Of photographs through film by a true tag 0, of one of sRGB numbers tagged BT.2020 0.08 of the
# pixels are such; the limit between is chosen by hand.
_NEGATIVE, _MOST_NEGATIVE, _SPARSE = -0.05, 0.03, 200  # the last: rows and columns that are looked at
_SAMPLES = 20_000  # pixels that are checked: standard error of a fraction below 0.4 %


def check_capture(image: np.ndarray, width_px: int, height_px: int) -> np.ndarray:
    """Check a photograph of linear RGB before it is measured; (H, W, 3) float32, contiguous, else InputError."""
    image = checked_image(image)
    if image.shape[:2] != (height_px, width_px):
        raise InputError(other_size(image.shape[1], image.shape[0], (width_px, height_px)))
    if np.fmin.reduce(image, axis=None) < _LEAST_LIGHT or np.fmax.reduce(image, axis=None) > _MOST_LIGHT:
        image = np.where((image >= _LEAST_LIGHT) & (image <= _MOST_LIGHT), image, np.float32(np.nan))
    sparse = max(1, round(math.sqrt(width_px * height_px / _SAMPLES)))
    lit = _finite(image[::sparse, ::sparse])
    lit = lit if lit.size else _finite(image)
    if not lit.size:
        raise InputError("the image holds no finite value; export it again")
    saturated = float((np.maximum(np.maximum(lit[:, 0], lit[:, 1]), lit[:, 2]) >= SATURATION).mean())
    if saturated > _MOST_SATURATED:
        raise InputError(
            f"{saturated:.0%} of the image is saturated; lower the exposure, or check --black-level and --white-level"
        )
    if np.count_nonzero(lit < DARK) > _MOST_DARK * lit.size:
        raise all_black()
    if np.ptp(lit, axis=1).max() == 0 and np.ptp(lit) > 0:  # one of a single value is refused by the matcher
        raise InputError(
            "the image is grey: R, G and B are the same; the depth is in the colours, so give the original"
        )
    if saturated > _MUCH_SATURATED:
        warnings.warn(
            f"{saturated:.0%} of the image is saturated; depth is unreliable there", CaptureWarning, stacklevel=3
        )
    return image


def check_form(
    form: PictureFormat, name: str, provenance: Mapping[str, Any], encoding: Encoding | None, *, is_cropped: bool
) -> None:
    """Raise or warn where a photograph is read otherwise than those that the camera was calibrated on."""
    if form.mosaic is not None or form.reduction == 1:
        return
    if is_cropped:
        raise InputError(
            f"{name} has {form.chroma} chroma and is read at 1/{form.reduction} of its size, where --crop-origin does "
            "not apply; give the whole frame, or a file with all colours in every pixel (PNG, TIFF, 4:4:4)"
        )
    if encoding is not None and encoding.is_encoded and FORM not in provenance:
        warnings.warn(
            f"the camera file does not say how its photographs stored their colours: if they had {form.chroma} chroma, "
            "as this one, its distances are wrong by about 10 %; calibrate again",
            CaptureWarning,
            stacklevel=4,
        )


def check_primaries(image: np.ndarray, space_name: str, name: str) -> None:
    """Raise InputError where the primaries that a file is tagged with make negative light of its colours."""
    some = image[:: max(1, image.shape[0] // _SPARSE), :: max(1, image.shape[1] // _SPARSE)].reshape(-1, 3)
    brightest = some.max(axis=1)
    negative = float(((brightest > DARK) & (some.min(axis=1) < _NEGATIVE * brightest)).mean())
    if negative > _MOST_NEGATIVE:
        raise InputError(
            f"{name} is tagged {space_name}, but {negative:.0%} of its pixels would be negative light: the tag "
            "contradicts the pixels; if they are sRGB's, say so with primaries srgb"
        )


def all_black() -> InputError:
    """Return the error of a photograph without light."""
    return InputError(
        "the image is all black; remove the lens cap, expose longer, or check the levels: of floats from 0 to 1 the "
        "white level is 1"
    )


def _finite(image: np.ndarray) -> np.ndarray:
    """Select pixels without NaN or infinity, (N, 3)."""
    pixels = np.ascontiguousarray(image).reshape(-1, 3)
    return pixels[np.isfinite(pixels.sum(axis=1))]

"""Checks of a capture before it is measured."""

from __future__ import annotations

import math
import warnings

import numpy as np

from chromaperture.capture.picture_header import other_size
from chromaperture.color.image import DARK, SATURATION, checked_image
from chromaperture.errors import CaptureWarning, InputError

# Chosen by hand, not tuned:
_MOST_SATURATED, _MUCH_SATURATED = 0.98, 0.05  # fractions of the pixels: an error, a warning
_MOST_DARK = 0.99  # fraction of the samples
# Values beyond are no light and count as unknown: above the white level nothing is told anyway, and noise about black
# is smaller. An area of 1e30 or -0.5 (1/35 of the sample) changed the means, and so depth by 5 % in .20 and .10 of the
# pixels far away; unknown, it changes .02 of them.
_LEAST_LIGHT, _MOST_LIGHT = -0.1, 2.0
_SAMPLES = 20_000  # pixels that are checked: standard error of a fraction below 0.4 %


def check_capture(image: np.ndarray, width_px: int, height_px: int) -> np.ndarray:
    """Check a photograph before it is measured.

    Parameters
    ----------
    image : (H, W, 3) float, linear RGB, 1.0 = white level
    width_px, height_px : int
        The camera's size.

    Returns
    -------
    (H, W, 3) float32, contiguous

    Raises
    ------
    InputError
        Wrong shape, type or size; all black, saturated, grey, or not finite.
    """
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

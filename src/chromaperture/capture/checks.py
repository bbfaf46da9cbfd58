"""Captures that cannot be measured are refused here, each with what to do next."""

from __future__ import annotations

import math
import warnings

import numpy as np

from chromaperture.color.image import SATURATION, checked_image
from chromaperture.errors import CaptureWarning, InputError

_DARK = 2e-3


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
        Wrong shape, type or size; all black, saturated, or not finite.
    """
    image = checked_image(image)
    if image.shape[:2] != (height_px, width_px):
        raise InputError(
            f"the image is {image.shape[1]}x{image.shape[0]} px but the camera was calibrated at "
            f"{width_px}x{height_px}; give an original of that size, or calibrate at this one"
        )
    sparse = max(1, round(math.sqrt(width_px * height_px / 20_000)))  # a subset tells the shares as well
    lit = _finite(image[::sparse, ::sparse])
    lit = lit if lit.size else _finite(image)
    if not lit.size:
        raise InputError("the image holds no finite value; export it again")
    saturated = float((np.maximum(np.maximum(lit[:, 0], lit[:, 1]), lit[:, 2]) >= SATURATION).mean())
    if saturated > 0.98:
        raise InputError(
            f"{saturated:.0%} of the image is saturated; lower the exposure, or check --black-level and --white-level"
        )
    if np.count_nonzero(lit < _DARK) > 0.99 * lit.size:
        raise InputError("the image is all black; remove the lens cap, expose longer, or check the levels")
    if saturated > 0.05:
        warnings.warn(
            f"{saturated:.0%} of the image is saturated; depth is guessed there", CaptureWarning, stacklevel=3
        )
    return image


def _finite(image: np.ndarray) -> np.ndarray:
    """Pixels without NaN or infinity, (N, 3): a sum with one of them is not finite."""
    pixels = np.ascontiguousarray(image).reshape(-1, 3)
    return pixels[np.isfinite(pixels.sum(axis=1))]

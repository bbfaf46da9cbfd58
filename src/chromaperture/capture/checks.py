"""Captures that cannot be measured are refused here, each with what to do next."""

from __future__ import annotations

import math
import warnings

import cv2
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
    finite = np.isfinite(cv2.transform(image, np.ones((1, 3), np.float32)))  # a sum with a NaN in it is not finite
    if not finite.any():
        raise InputError("the image holds no finite value; export it again")
    sparse = max(1, round(math.sqrt(finite.size / 20_000)))  # a subset tells the shares as well
    lit = image[::sparse, ::sparse][finite[::sparse, ::sparse]]
    lit = lit if lit.size else image[finite]
    saturated = float((lit.max(axis=1) >= SATURATION).mean())
    if saturated > 0.98:
        raise InputError(
            f"{saturated:.0%} of the image is saturated; lower the exposure, or check --black-level and --white-level"
        )
    if float(np.percentile(lit, 99)) < _DARK:
        raise InputError("the image is all black; remove the lens cap, expose longer, or check the levels")
    if saturated > 0.05:
        warnings.warn(
            f"{saturated:.0%} of the image is saturated; depth is guessed there", CaptureWarning, stacklevel=3
        )
    return image

"""Validation of images."""

from __future__ import annotations

import numpy as np

from chromaperture.system.errors import InputError

SATURATION = 0.995  # of the white level; a pixel at or above it is clipped. Leaves 5 of 1000 counts for noise
_CLIPPED = 0.001  # fraction of saturated samples that is accepted, for hot pixels; chosen by hand, not tuned
DARK = 2e-3  # white level; a darker pixel has no signal: a sensor of 10 bits resolves 1e-3; chosen by hand


def checked_image(image: np.ndarray) -> np.ndarray:
    """Validate an image and return it as contiguous float32; raises InputError."""
    if np.ma.isMaskedArray(image):  # np.asarray would drop the mask
        raise InputError("masked arrays are not read; set the masked pixels to NaN with image.filled(numpy.nan)")
    image = np.asarray(image)
    if image.dtype == object or image.size == 0:
        raise InputError("expected an RGB image of shape (height, width, 3) with pixels; read files with read_image")
    if image.ndim != 3 or image.shape[2] != 3:
        raise InputError(f"expected an RGB image of shape (height, width, 3), got {image.shape}")
    if not np.issubdtype(image.dtype, np.floating):
        raise InputError(
            f"expected linear float values in [0, 1], got {image.dtype}; read files with chromaperture.read_image"
        )
    if min(image.shape[:2]) < 8:
        raise InputError(f"image of {image.shape[1]}x{image.shape[0]} px is smaller than the matching window of 8 px")
    return np.ascontiguousarray(image, dtype=np.float32)


def is_saturated(sheet: np.ndarray) -> bool:
    """Return whether a white sheet, (..., 3) float, has more clipped samples than hot pixels, or unknown ones."""
    return not np.isfinite(sheet).all() or bool((sheet >= SATURATION).mean() > _CLIPPED)

"""Validation of images, and pixels that no lens can have imaged."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from chromaperture.system.errors import InputError
from chromaperture.system.threads import each_band

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


# A pixel is defective where it stands out of all its neighbours by so many standard deviations of noise, by so many
# times the range of those neighbours, which the blur of a lens would have raised with it, and from their median by so
# many times as much as the other channels do there: a point that is imaged sharply shows in all of them. Of 240 hot,
# half hot, weak (0.25 of white) and dead pixels 0.98, 0.93, 0.84 and 0.92 are found; of sound ones 29 in 80 random
# scenes of 720x480 px, most of them points of prints in focus, and none in bench50's scenes.
_SIGMAS, _TIMES_RANGE, _TIMES_OTHERS = 8.0, 2.0, 3.0


def without_defects(image: np.ndarray, variance: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Replace pixels that stand out of their neighbourhood's noise by its median; (H, W, 3)."""
    y, x, stands_out, spread = _standing_out(image)
    if not len(y):
        return image
    median, around = (_medians(values, y, x) for values in (image, variance(image)))
    here = image[y, x]
    apart = np.abs(here - median)
    others = np.maximum(np.roll(apart, 1, axis=1), np.roll(apart, 2, axis=1))
    least = np.maximum(_SIGMAS * np.sqrt(around), _TIMES_RANGE * spread)
    defective = (stands_out > least) & (apart > _TIMES_OTHERS * others)
    if not defective.any():
        return image
    out = image.copy()
    out[y, x] = np.where(defective, median, here)
    return out


def _standing_out(image: np.ndarray) -> list[np.ndarray]:
    """Return rows and columns of pixels beyond the range of all neighbours, by how much, and that range; (P, 3)."""
    ring = np.ones((3, 3), np.uint8)
    ring[1, 1] = 0
    parts: dict[int, tuple[np.ndarray, ...]] = {}

    def look(rows: slice) -> None:
        here, above = image[rows], min(1, rows.start)
        seen = image[rows.start - above : rows.stop + 1]
        highest, lowest = (of(seen, ring)[above:][: len(here)] for of in (cv2.dilate, cv2.erode))
        stands_out, spread = np.maximum(here - highest, lowest - here), highest - lowest
        y, x = np.nonzero(((stands_out > 0) & (stands_out > _TIMES_RANGE * spread)).any(axis=2))  # False for NaN
        parts[rows.start] = y + rows.start, x, stands_out[y, x], spread[y, x]

    each_band(look, len(image))
    return [np.concatenate(part) for part in zip(*(parts[first] for first in sorted(parts)), strict=True)]


def _medians(values: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the median of 3 x 3 px about pixels, in every channel; (P, 3)."""
    rows, columns = (
        np.clip(at + np.array([[-1], [0], [1]]), 0, n - 1) for at, n in zip((y, x), values.shape[:2], strict=True)
    )
    around = np.stack([values[i, j] for i in rows for j in columns])
    return np.asarray(np.sort(around, axis=0)[4])

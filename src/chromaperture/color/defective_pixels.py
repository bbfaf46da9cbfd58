"""Single pixels of one channel that no lens can have imaged: hot, stuck or dead ones, and hits of cosmic rays.

The likelihood of quality "accurate" takes all that is no noise for detail, and detail at one pixel of one channel for
detail in focus: 240 hot pixels among 240 000 took .13 of the pixels within 5 % (docs/decisions.md).
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

# A pixel is defective where it stands out of all its neighbours by so many standard deviations of noise, by so many
# times the range of those neighbours, which the blur of a lens would have raised with it, and from their median by so
# many times as much as the other channels do there: a point that is imaged sharply shows in all of them. Of 240 hot,
# half hot, weak (.25 of white) and dead pixels .98, .93, .84 and .92 are found; of sound ones 29 in 80 random scenes
# of 720x480 px, most of them points of prints in focus, and none in bench50's scenes.
_SIGMAS, _TIMES_RANGE, _TIMES_OTHERS = 8.0, 2.0, 3.0


def without_defects(image: np.ndarray, variance: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Replace defective pixels by the median of their neighbourhood.

    ``image`` (H, W, 3) float32, linear RGB; ``variance``: from the image to the variance of its noise, (H, W, 3). It is
    called only where a pixel stands out of its neighbours. Returns (H, W, 3) float32: the image itself where nothing
    was found.
    """
    ring = np.ones((3, 3), np.uint8)
    ring[1, 1] = 0
    highest, lowest = cv2.dilate(image, ring), cv2.erode(image, ring)
    stands_out, spread = np.maximum(image - highest, lowest - image), highest - lowest
    y, x = np.nonzero(((stands_out > 0) & (stands_out > _TIMES_RANGE * spread)).any(axis=2))  # False for NaN
    if not len(y):
        return image
    median, around = (_medians(values, y, x) for values in (image, variance(image)))
    here, stands_out = image[y, x], stands_out[y, x]
    apart = np.abs(here - median)
    others = np.maximum(np.roll(apart, 1, axis=1), np.roll(apart, 2, axis=1))
    least = np.maximum(_SIGMAS * np.sqrt(around), _TIMES_RANGE * spread[y, x])
    defective = (stands_out > least) & (apart > _TIMES_OTHERS * others)
    if not defective.any():
        return image
    out = image.copy()
    out[y, x] = np.where(defective, median, here)
    return out


def _medians(values: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the median of 3 x 3 px about pixels, in every channel; (P, 3)."""
    padded = np.pad(values, ((1, 1), (1, 1), (0, 0)), mode="edge")
    around = np.stack([padded[y + i, x + j] for i in range(3) for j in range(3)])
    return np.asarray(np.sort(around, axis=0)[4])

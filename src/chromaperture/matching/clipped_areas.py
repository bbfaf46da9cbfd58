"""Clipped areas of a picture, replaced by what is around them."""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.matching.views import FILL_SIGMA_PX

_CLIPPED_REACH_PX = 3  # about clipped pixels: demosaicing and the sensor spread their light; chosen by hand


def clipped_filled(image: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Replace clipped areas, what is next to them, and non-finite pixels by the mean of the usable ones around.

    A clipped disc has its edge at the same place in channels whose light is displaced, and outweighs all texture.
    Single clipped pixels, as noise makes them in bright paper, miss little of their light and are left as they are.

    ``image`` (H, W, 3) float32, linear RGB; ``usable`` (H, W) float32: 1 or 0: `Views.mask`. Returns ``image`` (H, W,
    3) float32; ``usable`` (H, W) float32: 0 in the grown areas, too.
    """
    if usable.all():
        return image, usable
    areas = cv2.morphologyEx((usable == 0).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    grown = cv2.dilate(areas, np.ones((2 * _CLIPPED_REACH_PX + 1,) * 2, np.uint8)) > 0
    replaced = grown | ~np.isfinite(image).all(axis=2)
    usable = np.where(replaced, np.float32(0), usable)
    kept = usable > 0
    if not (replaced.any() and kept.any()):
        return image, usable
    mean = image[kept].mean(axis=0)
    rest = np.where(kept[..., None], image - mean, np.float32(0))
    sigma = 2 * FILL_SIGMA_PX  # that is px of the halved picture
    around = cv2.GaussianBlur(usable, (0, 0), sigma)[..., None] + np.float32(1e-3)  # 1e-3: no division by 0
    fill = cv2.GaussianBlur(rest, (0, 0), sigma) / around
    return np.where(replaced[..., None], mean + fill, image).astype(np.float32), usable

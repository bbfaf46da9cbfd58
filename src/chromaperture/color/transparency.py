"""Light that passes the coded aperture, from two photographs of a white sheet (paper section 4.2)."""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.errors import InputError

_BLUR_SHARE = 0.025  # of the image's width: noise and paper grain go, vignetting stays


def transparency(coded: np.ndarray, bare: np.ndarray) -> np.ndarray:
    """Share of the light that passes the aperture at every pixel, per sensor channel: Eq. (11), T = I^c / I^nc.

    Both pictures are blurred before they are divided: a ratio of means, not a mean of ratios, which noise would bias.

    Parameters
    ----------
    coded, bare : (H, W, 3) float, linear RGB, 1.0 = white level
        The same white sheet with and without the coded aperture, at the same exposure.

    Returns
    -------
    (H, W, 3) float32

    Raises
    ------
    InputError
        The pictures differ in size, or one is saturated or dark.
    """
    if coded.shape != bare.shape:
        raise InputError(f"the two white sheets differ in size: {coded.shape} and {bare.shape}")
    blurred = []
    for name, image in (("coded", coded), ("bare", bare)):
        sheet = np.asarray(image, np.float32)
        if not np.isfinite(sheet).all() or (sheet >= SATURATION).mean() > 0.001:
            raise InputError(f"the {name} white sheet is saturated: photograph both again at a shorter exposure")
        blurred.append(
            cv2.GaussianBlur(sheet, (0, 0), _BLUR_SHARE * sheet.shape[1], borderType=cv2.BORDER_REFLECT)
        )
    if blurred[1].min() <= 0.01:
        raise InputError("the bare white sheet is dark: photograph both again at a longer exposure")
    return blurred[0] / blurred[1]

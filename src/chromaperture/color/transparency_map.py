"""Light that passes the coded aperture, from two photographs of a white sheet (paper sections 4.2 and 4.4)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from chromaperture.color.image import is_saturated
from chromaperture.optics.aperture import LUMINANCE
from chromaperture.system.errors import InputError

_BLUR = 0.025  # sigma over the image's width: removes noise and paper grain, keeps vignetting. Chosen by hand
_MOST_LIGHT = 1.03  # film only absorbs; 3 % is allowed for a flickering lamp or shutter. Chosen by hand, not tuned
_DUST = 0.05  # relative darkness of a speck on sheet or sensor; chosen by hand, not tuned
_DUSTY = 0.8  # fraction of clean pixels below which dark spots are a pattern, not dust; chosen by hand, not tuned


@dataclass(frozen=True)
class LightEfficiency:
    """Light efficiency of an aperture as in Table 1 and Figure 11."""

    minimum: np.ndarray  # minimum, maximum and mean: (3,) float64, transparency over the frame in R, G, B
    maximum: np.ndarray
    mean: np.ndarray
    efficiency: float  # integral light efficiency: the mean over the channels
    luminance: float  # the same, weighted by luminance (ITU-R BT.709)


def transparency(coded: np.ndarray, bare: np.ndarray) -> np.ndarray:
    """Compute the aperture's transparency at every pixel, per channel: Eq. (11), T = I^c / I^nc; (H, W, 3) float32.

    ``coded``, ``bare`` (H, W, 3), linear: the same white sheet with and without the aperture, at the same exposure.
    Both are blurred first: noise would bias a mean of ratios. Uneven lighting cancels; dust is left out of the means.
    Raises InputError: the pictures differ in size or exposure, or one is saturated or dark.
    """
    if coded.shape != bare.shape:
        raise InputError(f"the two white sheets differ in size: {coded.shape} and {bare.shape}")
    blurred = []
    for name, image in (("coded", coded), ("bare", bare)):
        if is_saturated(image):
            raise InputError(f"the {name} white sheet is saturated: photograph both again at a shorter exposure")
        blurred.append(_smooth(np.asarray(image, np.float32)))
    if blurred[1].min() <= 0.01:
        raise InputError("the bare white sheet is dark: photograph both again at a longer exposure")
    transmission = blurred[0] / blurred[1]
    most = float(np.percentile(transmission, 99, axis=(0, 1)).max())
    if most > _MOST_LIGHT:
        raise InputError(
            f"the coded aperture seems to pass {100 * most:.0f} % of the light: the white sheets differ in exposure, "
            "or are swapped; photograph both at the same exposure, or give the ratio of the exposures"
        )
    return transmission


def light_efficiency(transmission: np.ndarray) -> LightEfficiency:
    """Summarise a transparency map, of `transparency`, as in Table 1 and Figure 11."""
    flat = np.asarray(transmission, float).reshape(-1, 3)
    mean = flat.mean(axis=0)
    return LightEfficiency(flat.min(axis=0), flat.max(axis=0), mean, float(mean.mean()), float(mean @ LUMINANCE))


def flat_field(sheet: np.ndarray) -> np.ndarray:
    """Return the shading of a white sheet relative to its middle, for each channel, as rims cut a coded pupil."""
    if is_saturated(sheet):
        raise InputError("the white sheet is saturated: photograph it again at a shorter exposure")
    smooth = _smooth(np.asarray(sheet, np.float32))
    rows, columns = (slice(n * 9 // 20, n * 11 // 20 + 1) for n in sheet.shape[:2])
    middle = smooth[rows, columns].mean(axis=(0, 1))
    if smooth.min() < 0.02 * float(middle.max()) or middle.min() <= 0:
        raise InputError("the white sheet is dark in places: light it evenly, or fill the frame with it")
    return smooth / middle


def compensate_vignetting(image: np.ndarray, shading: np.ndarray) -> np.ndarray:
    """Divide the channels of a restored picture by their shading, which amplifies the corners' noise."""
    if image.shape != shading.shape:
        raise InputError(f"image {image.shape} and white sheet {shading.shape} differ in size: they are of one camera")
    return np.asarray(image, np.float32) / np.asarray(shading, np.float32)


def _smooth(sheet: np.ndarray) -> np.ndarray:
    """Blur, leaving out specks of dust."""
    sigma = _BLUR * sheet.shape[1]
    first = cv2.GaussianBlur(sheet, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    fine = cv2.GaussianBlur(sheet, (0, 0), 2.0, borderType=cv2.BORDER_REFLECT)  # noise is not dust
    clean = np.asarray((fine > (1 - _DUST) * first).all(axis=-1), np.float32)
    if clean.all() or clean.mean() < _DUSTY:
        return np.asarray(first)
    # Where less than a fifth of the weight is clean, the plain blur is used.
    weight = np.asarray(cv2.GaussianBlur(clean, (0, 0), sigma, borderType=cv2.BORDER_REFLECT))[..., None]
    total = np.asarray(cv2.GaussianBlur(sheet * clean[..., None], (0, 0), sigma, borderType=cv2.BORDER_REFLECT))
    return np.asarray(np.where(weight > 0.2, total / np.maximum(weight, 0.2), first))

"""Match at a fraction of the photograph's pixels, and answer at all of them.

Blur is many pixels of a real sensor wide and windows are wider: neither the volume nor the surface needs them all
(``optics/lens_blur.py`` chooses the fraction). Area averages lose no light, and their noise is as much lower.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from chromaperture.color.saturation_kernels import mark_cut_off
from chromaperture.matching.execution import Execution
from chromaperture.matching.readable.upsample import Coarse
from chromaperture.matching.result import Disparity, Method
from chromaperture.matching.views import guide_unit, guide_weights
from chromaperture.optics.aperture import Aperture
from chromaperture.settings.methods import MatcherConfig


@dataclass(frozen=True)
class ScaledMethod(Method):
    """A method that matches reduced pictures."""

    method: Method  # of the camera of reduced pictures
    config: MatcherConfig  # of that method
    size_px: tuple[int, int]  # (int, int): width and height of the reduced picture
    aperture: Aperture  # its centre view is the guide
    run: Execution

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3), in its own px."""
        small = reduced(image, self.size_px)
        found = self.method.match(small)
        rgb = guide_weights(self.aperture)
        guide = np.nan_to_num(small @ rgb.astype(np.float32))
        unit = guide_unit(guide, self.config.views)
        return Disparity(*self.run.upsample(coarse_maps(found, guide * np.float32(unit)), image, rgb * unit))


def reduced(image: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """Reduce a picture by area averages.

    ``image`` (H, W, 3) float32, linear RGB; ``size_px`` (int, int): width and height of the result. Returns (h, w, 3)
    float32; NaN where a pixel is saturated or not finite: the mean of what was cut off is not known.
    """
    small = cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)
    mark_cut_off(image, small)
    return small


def coarse_maps(disparity: Disparity, guide: np.ndarray) -> Coarse:
    """Return maps without NaN: what is unknown takes the nearest known values, where there are any."""
    values, sigma, confidence = disparity.value_px, disparity.sigma_px, disparity.confidence
    unknown = ~np.isfinite(values)
    if unknown.all():
        values, sigma = np.zeros_like(values), np.zeros_like(values)
    elif unknown.any():
        rows, columns = distance_transform_edt(unknown, return_distances=False, return_indices=True)
        values, sigma, confidence = (part[rows, columns] for part in (values, sigma, confidence))
    return Coarse(values, np.nan_to_num(sigma), confidence, unknown, guide)

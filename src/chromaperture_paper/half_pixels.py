"""Rays of a dual-pixel sensor, whose pixels each record the light of their left and of their right half apart.

A microlens images the pupil onto the two halves of its pixel, but blurred and with crosstalk: neither half sees half a
pupil. To first order the sensitivity is a ramp across the pupil, ``1 +- s(x) xi``, which is flatter towards the sides
of the sensor, where light meets the pixels at an angle. The slope at the centre and the place where it is halved are
two numbers of the sensor; everything else is the lens's prescription.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from chromaperture.optics.ray_table import RayTable
from chromaperture.system.errors import InputError

HALF_PUPIL_CENTROID = 4 / (3 * np.pi)  # of a half disc, in its radii


@dataclass(frozen=True)
class HalfPixels:
    """How the two halves of a pixel see the pupil.

    Attributes
    ----------
    slope : float
        s in the middle of the sensor: a half sees ``1 + s xi`` of the light at the pupil coordinate xi, the other
        ``1 - s xi``.
    half_slope_px : float
        Distance from the middle, along the rows, at which the slope is half as large: s / (1 + (x / half_slope)^2).

    Raises
    ------
    InputError
        The slope is not between 0 and 1, or the distance not positive.
    """

    slope: float
    half_slope_px: float

    def __post_init__(self) -> None:
        if not (0 < self.slope <= 1 and self.half_slope_px > 0):
            raise InputError("half pixels need a slope between 0 and 1 and a positive half_slope_px")

    def slope_at(self, x_px: np.ndarray) -> np.ndarray:
        """Return the slope at distances from the middle of the sensor; the shape of ``x_px``."""
        return np.asarray(self.slope / (1 + (np.asarray(x_px, float) / self.half_slope_px) ** 2))

    def film(self) -> dict[str, tuple[float, float, float]]:
        """Return the leaking film of halves whose centroids are those of the ramps in the middle of the sensor."""
        contrast = self.slope / 4 / HALF_PUPIL_CENTROID  # the centroid of 1 + s xi over a disc is s / 4
        low, high = (1 - contrast) / 2, (1 + contrast) / 2
        return {"cyan": (low, 0.5, high), "yellow": (high, 0.5, low)}


def half_pixel_rays(open_rays: RayTable, halves: HalfPixels, *, pupil_radius_mm: float) -> RayTable:
    """Weight the rays of an open pupil as a dual-pixel sensor does: red one half, blue the other, green their mean.

    Red is the half that sees the right of the pupil, as it is behind halves of cyan and yellow film. Each image point
    gives both halves the same light, as in files whose shading is corrected.

    ``open_rays``: of the lens without film; green is used for all; ``pupil_radius_mm``: of the entrance pupil.
    """
    green = 1 if len(open_rays.origin) == 3 else 0
    xi = (open_rays.origin[green, ..., 0] - open_rays.chief[..., None, 0]) / pupil_radius_mm
    slope = halves.slope_at(open_rays.x_px - (open_rays.width_px - 1) / 2)[None, :, None]
    light = open_rays.weight[1]
    both = light.sum(axis=-1, keepdims=True)
    sides = [light * np.maximum(1 + sign * slope * xi, 0) for sign in (1, -1)]
    right, left = (side * both / side.sum(axis=-1, keepdims=True) / 2 for side in sides)
    weight = np.stack([right, light / 2, left]).astype(np.float32)
    origin, slopes = (part[green : green + 1] for part in (open_rays.origin, open_rays.slope))
    return replace(open_rays, origin=origin, slope=slopes, weight=weight)

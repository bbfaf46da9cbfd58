"""The colour picture back: every sensor channel is moved to the view of the pupil's centre (paper section 5.1)."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from chromaperture.color.unmixing import ideal_unmixing
from chromaperture.optics.aperture import Aperture, centroids


def channel_directions(aperture: Aperture, film: dict[str, np.ndarray]) -> np.ndarray:
    """Displacement of the sensor's R, G, B per px of disparity.

    Film leaks, so the red channel sees a little of the cyan half too and moves less than the unmixed yellow view.

    Parameters
    ----------
    aperture : Aperture
    film : dict of str to (3,) float
        Measured transmission of each filter; missing ones keep the design's ideal film.

    Returns
    -------
    (3, 2) float64, (x, y), in units of the views' displacement
    """
    reach = np.linalg.norm(centroids(aperture, ideal_unmixing(aperture)), axis=1).mean()
    return np.nan_to_num(centroids(aperture.with_film(film))) / reach


def fill_unknown(values: np.ndarray) -> np.ndarray:
    """Give every NaN the value of the nearest known pixel; all zero where none is known; (H, W)."""
    unknown = ~np.isfinite(values)
    if unknown.all():
        return np.zeros_like(values)
    if not unknown.any():
        return values
    rows, columns = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return values[rows, columns]


def align_channels(image: np.ndarray, disparity_px: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Shift each channel back by its disparity.

    Parameters
    ----------
    image : (H, W, 3) float32, linear RGB
    disparity_px : (H, W) float32, px; NaN is filled from the nearest known pixel
    directions : (3, 2) float
        From `channel_directions`.

    Returns
    -------
    (H, W, 3) float32, linear RGB, in the view of the pupil's centre
    """
    height, width = disparity_px.shape
    filled = fill_unknown(disparity_px).astype(np.float32)
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    planes = []
    for k in range(3):
        dx, dy = (np.float32(u) for u in directions[k])
        plane = np.ascontiguousarray(image[..., k], np.float32)
        if dx or dy:
            source = (x + dx * filled, y + dy * filled)
            plane[:] = cv2.remap(plane, *source, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        planes.append(plane)
    return np.stack(planes, axis=-1)


def white_balance(color: np.ndarray, white_rgb: np.ndarray) -> np.ndarray:
    """Scale the channels so that a white sheet seen through the aperture comes out white; (H, W, 3) linear."""
    white = np.asarray(white_rgb, np.float32)
    balanced = cv2.transform(np.ascontiguousarray(color, np.float32), np.diag(white.max() / white))
    return np.maximum(balanced, 0, out=balanced)

"""Depth of pictures of many megapixels, by bands of rows.

The curves of every pixel and their covariances take 100 bytes a pixel, for a whole frame gigabytes.
"""

from __future__ import annotations

import numpy as np

from chromaperture.depth.conversion import disparity_to_depth
from chromaperture.depth.field import DepthField

_BAND_PX = 1_000_000  # of a band: 60 MB of curves and their covariances


def field_to_depth(
    disparity_px: np.ndarray, sigma_px: np.ndarray, field: DepthField, *, max_depth_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute depth and its standard deviation in mm, as `disparity_to_depth` with the curves of the whole frame.

    ``disparity_px``, ``sigma_px`` (H, W) float32, px; ``max_depth_mm`` float, mm from the sensor. Returns ``depth_mm,
    sigma_mm`` (H, W) float32; NaN unknown.
    """
    height, width = disparity_px.shape
    step = height if len(field.scale_px_mm) == 1 else max(1, _BAND_PX // width)
    if step >= height:
        return disparity_to_depth(disparity_px, field.model(width, height), sigma_px, max_depth_mm=max_depth_mm)
    depth, sigma = (np.empty((height, width), np.float32) for _ in range(2))
    for top in range(0, height, step):
        rows = slice(top, min(top + step, height))
        depth[rows], sigma[rows] = disparity_to_depth(
            disparity_px[rows], field.model(width, height, rows), sigma_px[rows], max_depth_mm=max_depth_mm
        )
    return depth, sigma

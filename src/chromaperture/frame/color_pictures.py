"""The colours of a frame as files need them, made band by band: of many megapixels the colours are not kept."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.frame.preview import preview_size, reduced_by_whole, whole_factor


class ColorPictures(NamedTuple):
    """What files have of a frame's colours."""

    srgb: np.ndarray  # (H, W, 3) uint8
    small: np.ndarray  # (h, w, 3) float32, linear RGB: averages of whole pixels, not smaller than the preview


def color_pictures(frame: DepthFrame) -> ColorPictures:
    """Return the colours of a frame as sRGB, and reduced for the preview."""
    height, width = frame.disparity_px.shape
    factor = whole_factor((height, width), preview_size((height, width)))
    srgb = np.empty((height, width, 3), np.uint8)
    small = np.empty((height // factor, width // factor, 3), np.float32)

    def take(rows: slice, color: np.ndarray) -> None:
        linear_to_srgb_bytes(color, out=srgb[rows])
        means = reduced_by_whole(color, factor)
        small[rows.start // factor :][: len(means)] = means

    frame.color_bands(take, multiple=factor)
    return ColorPictures(srgb, small)

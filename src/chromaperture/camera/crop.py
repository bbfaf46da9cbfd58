"""Photographs of a part of the sensor, such as a region of interest, whose place in the frame is known.

Blur, distortion and the curves from disparity to depth change over the frame, so a part is measured where it lies: the
rest of the frame is unknown.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.model.camera_file import Calibration
from chromaperture.system.errors import InputError

_MAPS = ("depth_mm", "sigma_mm", "disparity_px", "disparity_sigma_px", "confidence", "color", "image")


def in_whole_frame(
    image: np.ndarray, origin_px: tuple[int, int], size_px: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Put a part of a photograph where it belongs.

    ``image`` (h, w, 3) float32; ``origin_px`` (int, int): column and row of the part's first pixel in the frame;
    ``size_px`` (int, int): width and height of the frame. Returns ``known`` (H, W, 3) float32: NaN outside of the part;
    ``continued`` (H, W, 3) float32: the part's border goes on outside of it. Raises InputError: the part does not lie
    in the frame.
    """
    (height, width), (left, top) = image.shape[:2], origin_px
    right, below = size_px[0] - left - width, size_px[1] - top - height
    if min(right, below) < 0:
        raise InputError(
            f"a part of {width}x{height} px from {left},{top} does not lie in the camera's {size_px[0]}x{size_px[1]} "
            "px; --crop-origin is the column and row of its first pixel"
        )
    continued = np.pad(image, ((top, below), (left, right), (0, 0)), mode="edge")
    known = np.full_like(continued, np.nan)
    known[top : top + height, left : left + width] = image
    return known, continued


def cut_out(frame: DepthFrame, origin_px: tuple[int, int], size_px: tuple[int, int]) -> DepthFrame:
    """Return a part of a frame, of width and height ``size_px``; its camera has the pinhole of that part."""
    (left, top), (width, height) = origin_px, size_px
    part = np.s_[top : top + height, left : left + width]
    maps: dict[str, Any] = {name: values[part].copy() for name in _MAPS if (values := getattr(frame, name)) is not None}
    camera = None if frame.calibration is None else _part_of(frame.calibration, origin_px, size_px)
    return replace(frame, **maps, calibration=camera)


def _part_of(calibration: Calibration, origin_px: tuple[int, int], size_px: tuple[int, int]) -> Calibration:
    """Return a camera of a part of the sensor, for its size and its rays; its other properties are the frame's."""
    matrix = np.array(calibration.lens.camera_matrix, float)
    matrix[:2, 2] -= origin_px
    sensor = replace(calibration.sensor, width_px=size_px[0], height_px=size_px[1])
    return replace(calibration, sensor=sensor, lens=replace(calibration.lens, camera_matrix=matrix))

"""Colour alignment on the device: ``color/alignment.py`` and ``color/visibility.py``, in WGSL.

For channels that are displaced by disparity times direction: qualities ``real-time`` and ``paper``, not below the
photograph's own resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from chromaperture.color.visibility import FEWEST, OCCLUSION_PX, RADIUS_PX, RIDGE, SAME_SURFACE_PX, STILL
from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.view_stages import SHARED
from chromaperture.disparity.gpu.workgroups import groups_for


@dataclass(frozen=True)
class Alignment:
    """What the alignment needs to know besides a disparity.

    Attributes
    ----------
    directions : (3, 2) float64
        Displacement (x, y) of R, G, B per px of disparity.
    gains : (3,) float64
        Of the white balance.
    """

    directions: np.ndarray
    gains: np.ndarray


def add_alignment(chain: Chain, image: Array, disparity: Array, size: tuple[int, int], alignment: Alignment) -> None:
    """Add the stages from an image (H, W, 3) and ``disparity`` to ``color``, (H, W, 3)."""
    height, width = size
    pixels = height * width
    frame: dict[str, Any] = {"width": width, "height": height}
    rows, filled = chain.array("nearest_rows", pixels, np.int32), chain.array("filled", pixels)
    chain.add("nearest_rows", [disparity, rows], groups=groups_for(width), uses=SHARED, **frame)
    chain.add("nearest_known", [disparity, rows, filled], groups=groups_for(pixels), uses=SHARED, **frame)
    nearest = chain.array("depth_buffers", 3 * pixels, np.uint32)
    shifted, visible = chain.array("shifted", 3 * pixels), chain.array("visible", pixels, np.uint32)
    order = np.argsort(np.linalg.norm(alignment.directions, axis=1), kind="stable")
    views: dict[str, Any] = {"directions": np.ravel(alignment.directions), "still": STILL, **frame}
    chain.add("fill_zero", [nearest], groups=groups_for(nearest.size), uses=SHARED, size=nearest.size)
    with_views = (*SHARED, "channel_views")
    chain.add("depth_buffer", [filled, nearest], groups=groups_for(pixels), uses=with_views, **views)
    chain.add(
        "channels_shifted", [image, filled, nearest, shifted, visible], groups=groups_for(pixels), uses=with_views,
        occlusion_px=OCCLUSION_PX, **views,
    )  # fmt: skip
    color = chain.array("color", 3 * pixels)
    chain.add(
        "hidden_filled", [shifted, visible, filled, color], groups=groups_for(pixels), uses=SHARED,
        order=[float(k) for k in order], gains=np.ravel(alignment.gains), radius_px=RADIUS_PX,
        same_surface_px=float(SAME_SURFACE_PX), fewest=float(FEWEST), ridge=RIDGE, **frame,
    )  # fmt: skip

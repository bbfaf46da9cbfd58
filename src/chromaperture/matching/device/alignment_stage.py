"""Colour alignment on the device: ``color/alignment.py``, ``lens_shift.py`` and ``visibility.py``, in WGSL."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from chromaperture.color.lens_shift import LensMoves
from chromaperture.color.visibility import FEWEST, OCCLUSION_PX, RADIUS_PX, RIDGE, SAME_SURFACE_PX, STILL
from chromaperture.matching.device.device import Array, Chain
from chromaperture.matching.device.workgroups import groups_for

_PLACES, _TAPS = 32, 8  # of OpenCV's Lanczos filter: places between two pixels, and samples


@dataclass(frozen=True)
class Alignment:
    """What the alignment needs to know besides a disparity.

    Attributes
    ----------
    directions : (3, 2) float64
        Displacement (x, y) of R, G, B per px of disparity.
    gains : (3,) float64
        Of the white balance.
    step : int
        Of `color.alignment.fill_unknown`.
    lens : LensMoves, optional
        Displaces the channels in place of the directions, by which only occlusion is found then.
    """

    directions: np.ndarray
    gains: np.ndarray
    step: int = 1
    lens: LensMoves | None = None


def add_alignment(chain: Chain, image: Array, disparity: Array, size: tuple[int, int], alignment: Alignment) -> None:
    """Add the stages from an image (H, W, 3) and ``disparity`` to ``color``, (H, W, 3)."""
    height, width = size
    pixels = height * width
    frame: dict[str, Any] = {"width": width, "height": height}
    filled = _add_filled(chain, disparity, size, alignment.step)
    nearest = chain.array("depth_buffers", 3 * pixels, np.uint32)
    shifted, visible = chain.array("shifted", 3 * pixels), chain.array("visible", pixels, np.uint32)
    order = np.argsort(np.linalg.norm(alignment.directions, axis=1), kind="stable")
    views: dict[str, Any] = {"directions": np.ravel(alignment.directions), "still": STILL, **frame}
    chain.add("fill_zero", [nearest], groups=groups_for(nearest.size), size=nearest.size)
    chain.add("depth_buffer", [filled, nearest], groups=groups_for(pixels), **views)
    lens = alignment.lens
    of_lens = {} if lens is None else _constants_of(lens)
    tables = [] if lens is None else [chain.constant("lens", lens.table), chain.constant("lanczos", lanczos_weights())]
    chain.add(
        "channels_shifted", [image, filled, nearest, shifted, visible, *tables], groups=groups_for(pixels),
        uses=("moved_by_disparity" if lens is None else "moved_by_lens",),
        occlusion_px=OCCLUSION_PX, **views, **of_lens,
    )  # fmt: skip
    color = chain.array("color", 3 * pixels)
    chain.add(
        "hidden_filled", [shifted, visible, filled, color], groups=groups_for(pixels),
        order=[float(k) for k in order], gains=np.ravel(alignment.gains), radius_px=RADIUS_PX,
        same_surface_px=float(SAME_SURFACE_PX), fewest=float(FEWEST), ridge=RIDGE, **frame,
    )  # fmt: skip


def _add_filled(chain: Chain, disparity: Array, size: tuple[int, int], step: int) -> Array:
    """Add a map without unknown pixels, (H, W)."""
    filled = chain.array("filled", disparity.size)
    if step == 1:
        _add_nearest(chain, disparity, filled, size)
        return filled
    few_tall, few_wide = (len(range(step // 2, side, step)) for side in size)
    of_few: dict[str, Any] = {"width": size[1], "spacing": step, "few_tall": few_tall, "few_wide": few_wide}
    few, few_filled = (chain.array(name, few_tall * few_wide) for name in ("few", "few_filled"))
    chain.add("every_nth", [disparity, few], groups=groups_for(few.size), **of_few)
    _add_nearest(chain, few, few_filled, (few_tall, few_wide))
    chain.add(
        "filled_from_few", [disparity, few_filled, filled], groups=groups_for(filled.size),
        height=size[0], **of_few,
    )  # fmt: skip
    return filled


def _add_nearest(chain: Chain, values: Array, filled: Array, size: tuple[int, int]) -> None:
    """Add the value of the nearest known pixel."""
    frame: dict[str, Any] = {"width": size[1], "height": size[0]}
    rows = chain.array("nearest_rows", values.size, np.int32)
    chain.add("nearest_rows", [values, rows], groups=groups_for(size[1]), **frame)
    chain.add("nearest_known", [values, rows, filled], groups=groups_for(values.size), **frame)


def _constants_of(lens: LensMoves) -> dict[str, Any]:
    rows, columns, radii = lens.table.shape[:3]
    return {
        "table_rows": rows, "table_columns": columns, "table_radii": radii, "first_radius_px": lens.first_px,
        "radius_step_px": lens.step_px, "at_zero_px": lens.at_zero_px, "per_px": lens.per_px,
        "lens_factor": float(lens.factor), "by_lanczos": lens.exact,
    }  # fmt: skip


def lanczos_weights() -> np.ndarray:
    """Return Lanczos' filter of 8 samples as OpenCV has it, sinc(t) sinc(t / 4) of sum 1; (32, 8) float64."""
    apart = np.arange(_PLACES)[:, None] / _PLACES - (np.arange(_TAPS) - 3)
    weights = np.sinc(apart) * np.sinc(apart / 4)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))

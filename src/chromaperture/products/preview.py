"""Draw a preview: capture, depth with a colour bar in mm, error bar, restored colour."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from chromaperture.camera import DepthFrame
from chromaperture.color.color_maps import DISTANCE, ERROR, color_map
from chromaperture.color.srgb import linear_to_srgb

_DARK, _LIGHT = "#14161a", "#e8e6e3"
_CAPTION_INCHES = 0.22  # a line of 13 points, 1/72 inch each, and its gap


def write_preview(
    path: Path,
    image: np.ndarray,
    frame: DepthFrame,
    *,
    title: str,
    caption: str = "",
    depth_range_mm: tuple[float, float] | None = None,
) -> None:
    """Draw the preview of a capture (H, W, 3), linear RGB, channels not aligned, as PNG, a caption below its title.

    It shows disparity instead of depth where the camera is not calibrated. The colours of depth reach from
    ``depth_range_mm`` to its end, or over the middle 96 % of the pixels.
    """
    height, width = image.shape[:2]
    inches = 0.4 + 12.8 * height / width * 0.93 + (_CAPTION_INCHES if caption else 0)
    figure = Figure(figsize=(12.8, inches), dpi=110, facecolor=_DARK, layout="constrained")
    figure.suptitle(f"{title}\n{caption}" if caption else title, color=_LIGHT, fontsize=13)
    capture, depth, restored, sigma = figure.subplots(2, 2).ravel()
    _picture(capture, image, "capture through the colour-coded aperture")
    _picture(restored, frame.color, "restored colour, channels aligned")
    if frame.valid.any():
        title, unit = "depth from the sensor plane", "mm"
        values, error, ends = frame.depth_mm, frame.sigma_mm, depth_range_mm or middle_range(frame.depth_mm, 2)
    else:
        title, unit = "disparity (0 in focus, + beyond); depth needs a calibration", "px"
        values, error, ends = frame.disparity_px, frame.disparity_sigma_px, middle_range(frame.disparity_px, 1)
    _map(depth, values, title, unit, DISTANCE, ends, extend="both")
    longest = middle_range(error, 10)[1]
    _map(sigma, error, "error bar (one standard deviation)", unit, ERROR, (0.0, longest), extend="max")
    figure.savefig(path, format="png", facecolor=_DARK)


def middle_range(values: np.ndarray, percent: float) -> tuple[float, float]:
    """Return the ends of what is known without so many percent at either end; (0, 1) where nothing is known."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, (percent, 100 - percent)) if known.size else (0.0, 1.0)
    return float(low), float(high)


def _picture(axes: Axes, picture: np.ndarray, title: str) -> None:
    exposure = 1 / max(float(np.nanpercentile(picture, 99.5)), 1e-6)
    axes.imshow(linear_to_srgb(picture * exposure), interpolation="antialiased")
    _label(axes, title)


def _map(
    axes: Axes, values: np.ndarray, title: str, unit: str, colors: str, ends: tuple[float, float], *, extend: str
) -> None:
    bottom, top = ends[0], max(ends[1], ends[0] + 1e-6)  # a map of one value has no range of its own
    options: dict[str, Any] = {"cmap": color_map(colors), "vmin": bottom, "vmax": top}
    shown = axes.imshow(np.ma.masked_invalid(values), interpolation="nearest", **options)
    bar = axes.figure.colorbar(shown, ax=axes, fraction=0.035, pad=0.015, extend=extend)
    bar.set_label(unit, color=_LIGHT)
    bar.ax.tick_params(colors=_LIGHT, labelsize=9)
    bar.outline.set_visible(False)
    _label(axes, title if np.isfinite(values).all() else f"{title}; grey is unknown")


def _label(axes: Axes, title: str) -> None:
    axes.set_title(title, color=_LIGHT, fontsize=10, loc="left")
    axes.set_axis_off()

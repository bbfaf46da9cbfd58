"""Draw a preview: capture, depth with a colour bar in mm, error bar, restored colour."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from chromaperture.camera import DepthFrame
from chromaperture.color.color_maps import DISTANCE, ERROR, color_map
from chromaperture.color.srgb import linear_to_srgb

_DARK, _LIGHT = "#14161a", "#e8e6e3"


def write_preview(path: Path, image: np.ndarray, frame: DepthFrame, *, title: str, caption: str = "") -> None:
    """Draw the preview of a capture (H, W, 3), linear RGB, channels not aligned, as PNG, a caption below its title.

    It shows disparity instead of depth where the camera is not calibrated.
    """
    height, width = image.shape[:2]
    figure = Figure(figsize=(12.8, 0.4 + 12.8 * height / width * 0.93), dpi=110, facecolor=_DARK, layout="constrained")
    figure.suptitle(f"{title}\n{caption}" if caption else title, color=_LIGHT, fontsize=13)
    capture, depth, restored, sigma = figure.subplots(2, 2).ravel()
    _picture(capture, image, "capture through the colour-coded aperture")
    _picture(restored, frame.color, "restored colour, channels aligned")
    if frame.valid.any():
        title, unit, percentiles = "depth from the sensor plane", "mm", (2, 98)
        values, error = frame.depth_mm, frame.sigma_mm
    else:
        title, unit = "disparity (0 in focus, + beyond); depth needs a calibration", "px"
        percentiles = (1, 99)
        values, error = frame.disparity_px, frame.disparity_sigma_px
    _map(depth, values, title, unit, DISTANCE, percentiles)
    _map(sigma, error, "error bar (one standard deviation)", unit, ERROR, (0, 90), low=0.0)
    figure.savefig(path, format="png", facecolor=_DARK)


def _picture(axes: Axes, picture: np.ndarray, title: str) -> None:
    exposure = 1 / max(float(np.nanpercentile(picture, 99.5)), 1e-6)
    axes.imshow(linear_to_srgb(picture * exposure), interpolation="antialiased")
    _label(axes, title)


def _map(
    axes: Axes, values: np.ndarray, title: str, unit: str, colors: str, percentiles: tuple[float, float],
    low: float | None = None,
) -> None:  # fmt: skip
    known = values[np.isfinite(values)]
    ends = np.percentile(known, percentiles) if known.size else np.array([0.0, 1.0])
    bottom = float(ends[0]) if low is None else low
    top = max(float(ends[1]), bottom + 1e-6)
    shown = axes.imshow(
        np.ma.masked_invalid(values), cmap=color_map(colors), vmin=bottom, vmax=top, interpolation="nearest"
    )
    bar = axes.figure.colorbar(shown, ax=axes, fraction=0.035, pad=0.015, extend="both" if low is None else "max")
    bar.set_label(unit, color=_LIGHT)
    bar.ax.tick_params(colors=_LIGHT, labelsize=9)
    bar.outline.set_visible(False)
    _label(axes, f"{title}; grey is unknown" if known.size < values.size else title)


def _label(axes: Axes, title: str) -> None:
    axes.set_title(title, color=_LIGHT, fontsize=10, loc="left")
    axes.set_axis_off()

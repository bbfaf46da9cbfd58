"""Draw a frame with Matplotlib, for notebooks and scripts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from chromaperture.color.color_maps import color_map
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.frame.preview import ColorScale, depth_scale, error_scale, exposed, fitted_size, reduced
from chromaperture.frame.summary import one_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LARGEST = (1200, 1200)  # px: finer than a figure on a screen


def show(frame: DepthFrame) -> Figure:
    """Draw photograph, depth and error bar in one row, see `DepthFrame.show`."""
    from matplotlib import pyplot

    size = fitted_size(frame.color.shape, _LARGEST)
    if size[0] > frame.color.shape[1]:
        size = (frame.color.shape[1], frame.color.shape[0])
    height, width = frame.color.shape[:2]
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)  # pixels of the photograph, also where fewer are drawn
    figure, (photograph, depth, error) = pyplot.subplots(
        1, 3, figsize=(15, 0.8 + 4.4 * height / width), layout="constrained", sharex=True, sharey=True
    )
    figure.suptitle(one_line(frame))
    taken = frame.image is not None
    photograph.imshow(exposed(frame.color if frame.image is None else frame.image, size), extent=extent)
    photograph.set_title("photograph" if taken else "restored colour")

    def draw(axes: Axes, values: np.ndarray, scale: ColorScale, title: str) -> None:
        shown = axes.imshow(
            reduced(values, size),
            cmap=color_map(scale.colors),
            vmin=scale.low,
            vmax=scale.high,
            extent=extent,
            interpolation="nearest",
        )
        extend = "both" if scale.open_below else "max"
        figure.colorbar(shown, ax=axes, label=scale.unit, extend=extend, shrink=0.9)
        axes.set_title(title)

    draw(depth, *depth_scale(frame))
    draw(error, *error_scale(frame))
    if "inline" in pyplot.get_backend():
        pyplot.close(figure)  # else the notebook would draw it twice: as the cell's value and at its end
    elif figure.canvas.required_interactive_framework:
        pyplot.show()
    return figure

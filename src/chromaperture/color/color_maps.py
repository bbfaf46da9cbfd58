"""Colours of maps: one choice for every picture, plot and page of the package.

Turbo, reversed: near is red, far is blue, as in disparity maps; it was made for depth (A. Mikhailov, Google, 2019),
shows more small steps than a map of one hue, and has no false edges.
"""

from __future__ import annotations

from functools import cache

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Colormap

DISTANCE = "turbo_r"  # red is the lowest value
ERROR = "magma"  # error bars, rms: dark is certain
DIFFERENCE = "RdBu_r"  # signed; 0, white, in the middle
OTHER = "viridis"  # transparency, fill, baseline: unlike a distance at a glance
UNKNOWN = "#3a3d44"  # a dark grey, in none of these


def color_map(name: str) -> Colormap:
    """Return a colour map of Matplotlib that draws NaN and masked values as unknown."""
    return mpl.colormaps[name].with_extremes(bad=UNKNOWN)


def draw_levels(levels: np.ndarray, name: str) -> np.ndarray:
    """Colour (H, W) levels from 0 to 1, clipped, NaN unknown, fast enough for a live page; (H, W, 3) uint8 sRGB."""
    known = np.isfinite(levels)
    index = np.clip(np.where(known, levels, 0) * 256, 0, 255).astype(np.uint16)  # as Matplotlib rounds
    index[~known] = 256
    return np.take(_table(name), index, axis=0)


@cache
def _table(name: str) -> np.ndarray:
    """Return the 256 colours and that of unknown pixels; (257, 3) uint8."""
    colors = color_map(name)
    rgba = np.vstack([colors(np.arange(256)), np.atleast_2d(colors.get_bad())])
    return np.rint(255 * rgba[:, :3]).astype(np.uint8)

"""Whether all boards were photographed with one white balance, in light of one colour.

A chessboard is grey, and blur hardly changes its mean colour: what changes from board to board is the gain of a
channel, by an automatic white balance or by other light. Film and blur are fitted as if all boards had one colour. Of
boards alone that matters little: gains of 8 % rms cost quality "accurate" .003 and .006 of the pixels within 2 and 5 %
(16 simulated scenes through halves). But white sheets and scenes by the same settings may have other gains, too.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

# Largest change of the logarithm of red or blue over green that is no fault; chosen by hand. Without a fault it is at
# most .013 in eight sessions of ray-traced lenses, .052 in one of the magenta annulus, whose views have unlike colours.
_LARGEST_CHANGE = 0.08


def board_color(image: np.ndarray, corners_px: np.ndarray) -> np.ndarray:
    """Return the mean colour between the inner corners of a chessboard; (3,) float64, NaN if a pixel is.

    Parameters
    ----------
    image : (H, W, 3) float, linear RGB
    corners_px : (N, 2) float, as `find_corners` returns them
    """
    inside = np.zeros(image.shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, cv2.convexHull(np.asarray(corners_px, np.float32)).round().astype(np.int32), 1)
    return np.asarray(image[inside > 0].mean(axis=0), float)


def color_notes(colors: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Return a sentence where the colour of boards changes; none where it does not.

    Parameters
    ----------
    colors : dict of str to (3,) float
        `board_color` by name of the board.
    """
    known = {name: color for name, color in colors.items() if np.isfinite(color).all() and color.min() > 0}
    if not known:
        return ()
    ratios = np.log([color[[0, 2]] / color[1] for color in known.values()])
    change = np.abs(ratios - np.median(ratios, axis=0)).max(axis=1)
    worst = int(change.argmax())
    if change[worst] < _LARGEST_CHANGE:
        return ()
    return (
        f"the colour of the boards changes by up to {np.expm1(change[worst]):.0%} ({list(known)[worst]}): set the "
        "camera's white balance by hand, and light all boards alike",
    )

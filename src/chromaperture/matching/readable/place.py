"""Where between two layers a pixel of quality "real-time" lies, and its error bar, in plain NumPy.

The oracle of ``compiled/place.py``.
"""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.matching.error_bar import local_range, sigma_of_range
from chromaperture.matching.labels import LabelMap, PathWinner, Surface

# Of the error bar, fitted to twelve simulated captures through each of four designs (docs/decisions.md, *Constants
# of the error bar*). A place whose neighbourhood holds the information I scatters by SCATTER / sqrt(I) labels:
# cells share pixels. Where I is small the place is also biased, by BIAS / I: noise leaves only the coarse part of weak
# texture, which blur displaces less than the fine part.
SCATTER, BIAS = 1.1, 4.8
# Of the width of an even posterior: what is wider is unknown. In pictures of pure noise 0 to .11 of the posteriors are
# narrower (`tests/depth/test_confidence.py`).
WIDEST_SHARE = 0.75
SEEN_REACH = 1  # cells or px; farther from usable pixels a surface is only carried on from the border of a spot
# Of the range of the disparity within so many px of the halved picture: next to depth edges a pixel may belong to
# either side. The share was fitted with SCATTER and BIAS.
EDGE_SHARE, EDGE_REACH_PX = 0.2, 7
# Layers from the middle of five to the vertex of their parabola. Flatter parabolas are bent so far that it lies there,
# their slope is kept: docs/decisions.md, *Weak texture through three filters*.
FARTHEST_OF_FIVE = 4.0
LEAST_INFORMATION = 1e-4  # where correlations have no peak the place is that of the layer
# By the best correlation, of two and of three views; keep the information of noiseless pictures finite. The second:
# docs/decisions.md, *Weak texture through three filters*.
LEAST_UNEXPLAINED, LEAST_UNEXPLAINED_OF_THREE = 3e-3, 1e-3
# Windows beside a nearer thing hold its edge, whose contrast outweighs the texture behind it. Cells that have a label
# nearer by more than one within so many cells along x and y know so much of what their scores say:
# docs/decisions.md, *Cells beside nearer things*.
NEARER_REACH, BESIDE_NEARER = 2, 0.05


def place_by_correlation(winner: PathWinner, layer_count: int, *, view_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the place that a pixel's own correlations have near its layer, and its information.

    The correlations, not the costs: summed costs have been cut off at the penalties and hold little between the layers.
    At its peak a correlation rho earns information rho rho'' / (1 - rho^2) a sample. Taken at the layer instead it
    would be least for peaks between the layers, and averages over neighbours would be biased to the layers.

    Of two views the parabola goes through three layers, and the information counts to the power of 1.25: noise draws
    the places of weak texture to the layer and leaves only its coarse part, so that clear texture knows more than its
    information tells. Of three views it goes through five, by least squares, and rho is that at the layer: flat boards
    are drawn less to the layers so (docs/decisions.md, *Clear texture*, *Channels where the lens moves them*). Where
    the range ends one layer away, the fifth is that of the parabola through the three others. Information times offset
    is a multiple of the parabola's slope, however flat it is: noise adds to slopes what cancels in their sum, and draws
    the place of weak texture less to the layer so than if places far away were cut off.

    Cells beside nearer things count less, see `BESIDE_NEARER`.

    Parameters
    ----------
    winner : PathWinner
    layer_count : int
    view_count : {2, 3}

    Returns
    -------
    place, information : two (H, W) float32; the place in layers
    """
    inside = np.clip(winner.layer, 1, layer_count - 2)
    if view_count == 2:
        low, middle, high = (
            np.sqrt(np.maximum(1 - np.exp(np.float32(-2) * part), 0))
            for part in (winner.before, winner.at, winner.after)
        )
        bend = np.maximum(2 * middle - low - high, 0)
        offset = np.clip((high - low) / (2 * bend + 1e-9), -1, 1)  # 1e-9: a flat top has no vertex
        peak = np.minimum(middle + offset * (high - low) / 4, 1)
        information = bend * peak / (1 - peak**2 + LEAST_UNEXPLAINED)
        information = information * np.sqrt(np.sqrt(information))
    else:
        around = (winner.far_before, winner.before, winner.at, winner.after, winner.far_after)
        far_low, low, middle, high, far_high = (1 - np.exp(-part) for part in around)
        far_low = np.where(inside == 1, 3 * (low - middle) + high, far_low)
        far_high = np.where(inside == layer_count - 2, 3 * (high - middle) + low, far_high)
        rise = (2 * (far_high - far_low) + high - low) / 5
        least_bend = np.abs(rise) / (2 * FARTHEST_OF_FIVE)
        bend = np.maximum((2 * middle + low + high - 2 * (far_low + far_high)) / 7, least_bend)
        offset = rise / (2 * bend + 1e-9)
        information = bend * middle / (1 - middle + LEAST_UNEXPLAINED_OF_THREE)
    information = (information + LEAST_INFORMATION) * np.where(beside_nearer(winner.layer), BESIDE_NEARER, 1)
    return (inside + offset).astype(np.float32), information.astype(np.float32)


def beside_nearer(layer: np.ndarray) -> np.ndarray:
    """Whether a label nearer by more than one lies within `NEARER_REACH` of each, along x and y; (h, w) bool."""
    layer = np.asarray(layer, np.float32)
    square = np.ones((2 * NEARER_REACH + 1, 2 * NEARER_REACH + 1), np.uint8)
    return np.asarray(layer - cv2.erode(layer, square) > 1)


def halved_surface(
    winner: PathWinner,
    place: np.ndarray,
    information: np.ndarray,
    layers_px: np.ndarray,
    label_map: LabelMap,
    mask: np.ndarray,
    *,
    cell_px: int = 1,
) -> Surface:
    """Return the surface of the halved picture in its own px.

    It is unknown where the best layer is an end of the range, where it is known hardly better than the range, and
    within spots of unusable pixels, of which nothing is seen: the paths carry the depth of their borders there, with
    error bars as if it were seen.

    Parameters
    ----------
    winner : PathWinner
    place : (h, w) float
        In layers.
    information : (h, w) float, 1/layer^2
        Of `place_by_correlation`, summed over all that the place is an average of.
    layers_px : (D,) float, px
    label_map : LabelMap
    mask : (h, w) float
        0 where a pixel is unusable.
    cell_px : int
        Px of the halved picture from one pixel of the maps to the next.
    """
    first, step = np.float32(layers_px[0]), np.float32(layers_px[1] - layers_px[0])
    widest = np.float32(sigma_of_range(layers_px))
    known = (
        (winner.layer > 0) & (winner.layer < len(layers_px) - 1) & (winner.sigma_px < np.float32(WIDEST_SHARE) * widest)
    )
    known &= near_usable(mask)
    disparity = np.asarray(label_map.disparity(first + step * place), np.float32)
    variance = (SCATTER**2 + BIAS**2 / information) / information  # layers^2
    own = label_map.scale * step * np.sqrt(variance).astype(np.float32)
    at_edge = np.float32(EDGE_SHARE) * local_range(disparity, -(-EDGE_REACH_PX // cell_px))
    sigma = np.minimum(np.hypot(own, at_edge), label_map.scale * widest)
    peak = np.sqrt(np.maximum(1 - np.exp(-2 * winner.at), 0)).astype(np.float32)
    return Surface(np.where(known, disparity, np.float32(np.nan)), sigma.astype(np.float32), peak)


def near_usable(mask: np.ndarray) -> np.ndarray:
    """Whether there is a usable pixel within `SEEN_REACH` of each, along x and y; (h, w) bool."""
    square = np.ones((2 * SEEN_REACH + 1, 2 * SEEN_REACH + 1), np.uint8)
    return np.asarray(cv2.dilate(np.asarray(mask, np.float32), square) > 0)

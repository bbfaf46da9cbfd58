"""Choose between the planes and the surface that they explain, pixel by pixel.

A plane that runs through an area of weak evidence may be off by far more than the surface, which knows its
neighbourhood: where both differ by more than the error bar, the surface stays. A spot of difference inside an area
where both agree is noise of the surface: there the plane stays. A far plane also stays beside a nearer one: windows
there see the near plane's outline, so that the surface makes near things too large.
"""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.disparity.plane_fit import Planes
from chromaperture.threads import parallel_map

AGREEMENT_SIGMAS = 2.0  # docs/measurements.md has 1, 1.5, 2, 3 and none
AGREEMENT_WINDOW_PX = 9  # two sigmas of the correlation window and the pixel: neighbours decide alike
# Shares of an area that a plane and the surface must agree on: for the plane to hold everywhere in the area, and in the
# spots that it surrounds. docs/measurements.md has 0.4 to 1 for the one; 0.5, 0.6 and 0.8 read the same for the other.
WHOLE_AREA_SHARE = 0.9
SURROUNDED_SHARE = 0.6
BESIDE_PX = 12  # a nearer plane; docs/measurements.md has 8 to 24
BORDER_PX = 2  # a spot closer to the border of its area touches it; chosen by hand


def where_they_agree(planes: Planes, surface_px: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Take the planes where the surface that they explain allows them, else the surface.

    Parameters
    ----------
    planes : Planes
    surface_px, sigma_px : (H, W) float, px
        The surface, and its standard deviation together with a label's place.

    Returns
    -------
    (H, W) float32, px
    """
    label_px = planes.label_px
    apart = (np.abs(label_px - surface_px) > AGREEMENT_SIGMAS * sigma_px).astype(np.uint8)
    apart = _without_noise(cv2.medianBlur(apart, AGREEMENT_WINDOW_PX) > 0, planes.choice)
    apart &= ~_beside_nearer(planes, label_px, surface_px, sigma_px)
    return np.where(apart, surface_px, label_px).astype(np.float32)


def _beside_nearer(planes: Planes, label_px: np.ndarray, surface_px: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Find the pixels next to a nearer plane whose surface lies between theirs and that one; (H, W) bool."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * BESIDE_PX + 1, 2 * BESIDE_PX + 1))
    found = np.zeros(label_px.shape, bool)

    def of_plane(k: int) -> tuple[tuple[slice, slice], np.ndarray]:
        everywhere = (planes.choice == k).view(np.uint8)
        left, top, width, height = cv2.boundingRect(everywhere)
        box = (
            slice(max(0, top - BESIDE_PX), top + height + BESIDE_PX),
            slice(max(0, left - BESIDE_PX), left + width + BESIDE_PX),
        )
        y, x = (np.arange(part.start, min(part.stop, n)) for part, n in zip(box, label_px.shape, strict=True))
        a, b, c = planes.planes[k]
        near_px = (a * x + b * y[:, None] + c).astype(np.float32)
        here, own_px, at_px, sigma = everywhere[box], label_px[box], surface_px[box], sigma_px[box]
        beside = (cv2.dilate(here, disc) > here) & (near_px < own_px)
        # Labels grow with distance: the surface is not beyond its own plane.
        return box, beside & (at_px <= own_px + sigma) & (at_px >= near_px - sigma)

    for box, beside in parallel_map(of_plane, np.unique(planes.choice).tolist()):
        found[box] |= beside
    return found


def _without_noise(apart: np.ndarray, choice: np.ndarray) -> np.ndarray:
    """Leave out the spots of disagreement that lie inside an area of agreement; (H, W) bool."""
    apart = apart.copy()
    for k in np.unique(choice[apart]):
        count, areas, boxes, _ = cv2.connectedComponentsWithStats((choice == k).astype(np.uint8), connectivity=4)
        for area in range(1, count):
            left, top, width, height, size = boxes[area]
            box = (
                slice(max(0, top - BORDER_PX), top + height + BORDER_PX),
                slice(max(0, left - BORDER_PX), left + width + BORDER_PX),
            )
            inside = areas[box] == area
            differing = apart[box] & inside
            agreed = 1 - differing.sum() / size
            if agreed >= WHOLE_AREA_SHARE:
                apart[box] &= ~inside
            elif agreed >= SURROUNDED_SHARE:
                apart[box] &= ~_surrounded(differing, inside)
    return apart


def _surrounded(differing: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Find the spots of which less than the root of their size lies at the border of the area; the frame is none."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * BORDER_PX + 1, 2 * BORDER_PX + 1))
    border = inside & (cv2.erode(inside.astype(np.uint8), disc) == 0)
    count, spots, boxes, _ = cv2.connectedComponentsWithStats(differing.astype(np.uint8), connectivity=4)
    touching = np.bincount(spots[border], minlength=count)
    few = touching <= np.sqrt(boxes[:, cv2.CC_STAT_AREA])
    few[0] = False  # what does not differ
    return np.asarray(few[spots])

"""Displacement of three channels by the lens at every disparity alike, from its fitted blur.

What the lens does to a channel is the displacement after which channels differ least (`color.lens_shift`). Of that, all
channels share a translation and a disparity, which moves each along its direction in the pupil; the rest is returned.
"""

from __future__ import annotations

import numpy as np

from chromaperture.color.lens_shift import LensShift, least_fringes
from chromaperture.matching.views import channel_space
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.lens_blur import traced

_PLACES = (9, 7)  # along width and height; vignetting and lateral colour bend less in between
# Of the blur radius at the far end of the range. Pairs of squares disagree by .2 px more there than in focus; on 16
# simulated scenes squares find .70, .71, .70, .69 of the pixels within 2 % with 0, .25, .5 and .7 of it.
_REFERENCE = 1 / 3


def lens_moves(camera: Calibration) -> np.ndarray | None:
    """Return `Calibration.channel_moves_px`; None without a blur, and for designs that match two channels.

    Parameters
    ----------
    camera : Calibration
        With depth curves and a blur.

    Returns
    -------
    (rows, columns, 3, 2) float64, px, x before y
    """
    blur = camera.field_blur()
    if blur is None or len(camera.unmixing) < 3:
        return None
    pupil_mm = float(camera.on_axis("accurate").sensor_to_pupil_mm)
    shift = LensShift(blur, near_mm=camera.near_mm - pupil_mm, far_mm=camera.far_mm - pupil_mm)
    inverse_mm = float(shift.inverse_mm(_REFERENCE * float(shift.radii_px[-1])))
    directions = channel_space(camera.aperture, camera.unmixing).directions
    places = [np.linspace(0, side - 1, n) for side, n in zip((blur.width_px, blur.height_px), _PLACES, strict=True)]
    table = [[least_fringes(traced(blur, (x, y), inverse_mm)) for x in places[0]] for y in places[1]]
    return beyond_disparity(np.array(table), directions)


def beyond_disparity(moves_px: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Take the common translation and the disparity that explain the most off displacements.

    Parameters
    ----------
    moves_px : (..., K, 2) float, px
    directions : (K, 2) float
        Displacement per px of disparity.

    Returns
    -------
    (..., K, 2) float64, px
        Its mean over the channels is 0, and it has no part along the directions.
    """
    apart = moves_px - moves_px.mean(axis=-2, keepdims=True)
    along = directions - directions.mean(axis=0)
    disparity = np.sum(apart * along, axis=(-2, -1), keepdims=True) / np.sum(along**2)
    return np.asarray(apart - disparity * along, float)

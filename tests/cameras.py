"""Cameras of ideal cyan and yellow halves, for tests of the whole way."""

from __future__ import annotations

import numpy as np

from chromaperture.camera_file import Calibration, CameraSensor, Film, Lens
from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.field import DepthField
from chromaperture.optics.aperture import DESIGNS


def halves_camera(model: DepthModel, width_px: int, height_px: int, **more: object) -> Calibration:
    """One depth curve for all qualities and the whole frame."""
    ideal = {name: np.array(DESIGNS["cy_halves"].filter_named(name).transmission) for name in ("cyan", "yellow")}
    middle = [[1000.0, 0, (width_px - 1) / 2], [0, 1000.0, (height_px - 1) / 2], [0, 0, 1]]
    return Calibration(
        design="cy_halves",
        sensor=CameraSensor(width_px, height_px, 0.05),
        lens=Lens(50.0, np.array(middle)),
        film=Film(ideal, np.ones(3), np.ones(3)),
        depth=dict.fromkeys(("paper", "real-time", "accurate"), DepthField.constant(model)),
        near_mm=900.0,
        far_mm=4200.0,
        **more,
    )

"""The paper's Eqs. (7) to (10) and the parameters they have in common with A, B and delta.

Depth z~ from the sensor of a point with half disparity d, Eq. (9), with pixel pitch mu::

    z~ = (b f z~_of - 2 mu d (z~_of - delta - f) delta) / (b f - 2 mu d (z~_of - delta - f))

Eq. (8) is the same from the entrance pupil, z = z~ - delta; Eq. (7) is (8) for a thin lens, delta = 0; Eq. (10) is (9)
with maps b(i, j) and z~_of(i, j). All are ``z = B / (A - d)``, which ``conversion.py`` computes, with

    B = b F / (2 mu),    A = B / z_of,    1 / f = 1 / F + 1 / z_of,    z_of = z~_of - delta,

F being the distance from the pinhole's centre to its sensor (paper section 3.4); ``docs/equations.md`` derives this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.depth.conversion import DepthModel, Map, focus_from_pupil
from chromaperture.system.errors import InputError


@dataclass(frozen=True)
class PaperParameters:
    """The parameters of Eqs. (8) to (10), each a number for the whole image or (H, W) for every pixel."""

    in_focus_mm: Map  # z~_of: depth of the focus surface from the sensor
    baseline_mm: Map  # b: twice the distance of a view's centroid from the centre of the entrance pupil
    sensor_to_pupil_mm: Map  # delta
    focal_length_mm: Map  # f


def paper_to_model(parameters: PaperParameters, *, pixel_pitch_mm: float) -> DepthModel:
    """Return A, B and delta, exactly known.

    Raises InputError: the focus surface is closer to the entrance pupil than the focal length.
    """
    z_focus = np.asarray(parameters.in_focus_mm, float) - parameters.sensor_to_pupil_mm
    shrink = 1 - parameters.focal_length_mm / z_focus  # f / F, Eq. (2); 1 for focus at infinity
    if np.any(shrink <= 0):
        raise InputError(
            "the focus surface must be farther from the entrance pupil than the focal length, "
            f"{np.max(parameters.focal_length_mm):g} mm"
        )
    scale = parameters.baseline_mm * (parameters.focal_length_mm / shrink) / (2 * pixel_pitch_mm)
    return DepthModel(scale / z_focus, scale, parameters.sensor_to_pupil_mm)


def model_to_paper(model: DepthModel, *, image_distance_mm: float, pixel_pitch_mm: float) -> PaperParameters:
    """Return the paper's parameters of a depth curve.

    ``image_distance_mm``: F, from the pinhole calibration: focal length in px times the pixel pitch.
    """
    z_focus = focus_from_pupil(model.infinity_disparity_px, model.scale_px_mm)
    return PaperParameters(
        in_focus_mm=z_focus + model.sensor_to_pupil_mm,
        baseline_mm=2 * pixel_pitch_mm * model.scale_px_mm / image_distance_mm,
        sensor_to_pupil_mm=model.sensor_to_pupil_mm,
        focal_length_mm=1 / (1 / image_distance_mm + 1 / z_focus),
    )

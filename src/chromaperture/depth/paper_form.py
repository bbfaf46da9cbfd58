"""The paper's own equations for depth, (7) to (10), and their parameters in terms of A, B and delta.

The package computes with `chromaperture.depth.conversion.DepthModel`. These functions show that it is the
same curve, and turn a calibration into the quantities of the paper's Figure 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.depth.conversion import DepthModel, Map, focus_from_pupil
from chromaperture.errors import InputError


def thin_lens_depth(
    disparity_px: Map, *, in_focus_mm: Map, baseline_mm: Map, focal_length_mm: float, pixel_pitch_mm: float
) -> np.ndarray:
    """Distance of an object from a thin lens, Eq. (7).

    Parameters
    ----------
    disparity_px : (H, W) float, px
    in_focus_mm : float or (H, W), mm from the lens
        z_of: distance of the focus surface.
    baseline_mm : float or (H, W), mm
        b: twice the distance of a channel's centroid from the pupil's centre.
    focal_length_mm, pixel_pitch_mm : float, mm

    Returns
    -------
    (H, W) float64, mm from the lens; NaN where no finite distance has that disparity.
    """
    baseline_focal = np.asarray(baseline_mm, float) * focal_length_mm
    swing = 2 * pixel_pitch_mm * np.asarray(disparity_px, float) * (in_focus_mm - focal_length_mm)
    return _ratio(baseline_focal * in_focus_mm, baseline_focal - swing)  # Eq. (7)


def complex_lens_pupil_depth(
    disparity_px: Map,
    *,
    in_focus_mm: Map,
    baseline_mm: Map,
    sensor_to_pupil_mm: float,
    focal_length_mm: float,
    pixel_pitch_mm: float,
) -> np.ndarray:
    """Distance of an object from the entrance pupil of a complex lens, Eq. (8).

    Parameters as in `complex_lens_depth`.

    Returns
    -------
    (H, W) float64, mm from the entrance pupil; NaN where no finite distance has that disparity.
    """
    return thin_lens_depth(  # Eq. (8) is Eq. (7) with both distances counted from the entrance pupil
        disparity_px,
        in_focus_mm=in_focus_mm - sensor_to_pupil_mm,
        baseline_mm=baseline_mm,
        focal_length_mm=focal_length_mm,
        pixel_pitch_mm=pixel_pitch_mm,
    )


def complex_lens_depth(
    disparity_px: Map,
    *,
    in_focus_mm: Map,
    baseline_mm: Map,
    sensor_to_pupil_mm: float,
    focal_length_mm: float,
    pixel_pitch_mm: float,
) -> np.ndarray:
    """Depth of an object from the sensor, Eq. (9); with maps of focus and baseline, Eq. (10).

    Parameters
    ----------
    disparity_px : (H, W) float, px
    in_focus_mm : float or (H, W), mm from the sensor
        z~_of: the focus surface.
    baseline_mm : float or (H, W), mm
        b, in the entrance pupil.
    sensor_to_pupil_mm : float, mm
        delta.
    focal_length_mm, pixel_pitch_mm : float, mm

    Returns
    -------
    (H, W) float64, mm from the sensor; NaN where no finite depth has that disparity.
    """
    baseline_focal = np.asarray(baseline_mm, float) * focal_length_mm
    swing = 2 * pixel_pitch_mm * np.asarray(disparity_px, float)
    swing = swing * (in_focus_mm - sensor_to_pupil_mm - focal_length_mm)
    far = baseline_focal * in_focus_mm - swing * sensor_to_pupil_mm
    return _ratio(far, baseline_focal - swing)  # Eqs. (9) and (10)


@dataclass(frozen=True)
class PaperParameters:
    """The unknowns of the paper's Eqs. (8) to (10), for one image or for every pixel.

    Attributes
    ----------
    in_focus_mm : float or (H, W) array, mm from the sensor
        z~_of.
    baseline_mm : float or (H, W) array, mm
        b.
    sensor_to_pupil_mm : float or (H, W) array, mm
        delta.
    """

    in_focus_mm: Map
    baseline_mm: Map
    sensor_to_pupil_mm: Map


def paper_to_model(
    parameters: PaperParameters,
    *,
    focal_length_mm: float,
    pixel_pitch_mm: float,
    covariance: np.ndarray | None = None,
) -> DepthModel:
    """Turn z~_of, b and delta into A, B and delta: B = b F / (2 mu), A = B / z_of.

    Raises
    ------
    InputError
        The focus surface is closer to the entrance pupil than the focal length.
    """
    z_focus = np.asarray(parameters.in_focus_mm, float) - parameters.sensor_to_pupil_mm
    image_mm = _image_distance(z_focus, focal_length_mm)
    scale = np.asarray(parameters.baseline_mm) * image_mm / (2 * pixel_pitch_mm)
    return DepthModel(
        infinity_disparity_px=scale / z_focus,
        scale_px_mm=scale,
        sensor_to_pupil_mm=parameters.sensor_to_pupil_mm,
        covariance=np.zeros((3, 3)) if covariance is None else covariance,
    )


def model_to_paper(model: DepthModel, *, focal_length_mm: float, pixel_pitch_mm: float) -> PaperParameters:
    """Turn A, B and delta into the paper's z~_of, b and delta, for a known focal length and pixel pitch.

    Raises
    ------
    InputError
        The focus surface is closer to the entrance pupil than the focal length.
    """
    z_focus = np.asarray(focus_from_pupil(model.infinity_disparity_px, model.scale_px_mm))
    image_mm = _image_distance(z_focus, focal_length_mm)
    return PaperParameters(
        in_focus_mm=z_focus + model.sensor_to_pupil_mm,
        baseline_mm=2 * pixel_pitch_mm * np.asarray(model.scale_px_mm) / image_mm,
        sensor_to_pupil_mm=model.sensor_to_pupil_mm,
    )


def _image_distance(z_focus_mm: np.ndarray, focal_length_mm: float) -> np.ndarray:
    """Image distance F behind a thin lens, Eq. (2); in f / z, so that focus at infinity gives F = f."""
    shrink = 1 - focal_length_mm / z_focus_mm
    if np.any(shrink <= 0):
        raise InputError(
            "the focus surface must be farther from the entrance pupil than the focal length, "
            f"{focal_length_mm:g} mm"
        )
    return focal_length_mm / shrink


def _ratio(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
    """Quotient where the denominator is positive, NaN elsewhere: at 0 lies infinity, below nothing real."""
    numerator, denominator = np.broadcast_arrays(numerator, denominator)
    return np.divide(numerator, denominator, out=np.full(denominator.shape, np.nan), where=denominator > 0)

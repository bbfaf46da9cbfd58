"""Fit of one disparity-to-depth curve to boards at measured distances (paper section 3.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from chromaperture.depth.conversion import DepthModel, depth_to_disparity, disparity_to_depth
from chromaperture.system.errors import InputError
from chromaperture.system.robust import HUBER

_MIN_BOARDS = 3  # as many as unknowns
_LEAST_RANGE = 0.05  # of 1 / distance, relative to the nearest board: less is one distance; chosen by hand


@dataclass(frozen=True)
class DepthFit:
    """A fitted curve and its residuals."""

    model: DepthModel  # A, B, delta and their covariance
    residual_mm: np.ndarray  # (N,) float64, mm; measured minus true distance of every board; NaN not measured
    residual_px: np.ndarray  # (N,) float64, px
    rms_mm: float


def fit_depth_model(
    distance_mm: np.ndarray,
    disparity_px: np.ndarray,
    *,
    disparity_sigma_px: np.ndarray,
    distance_sigma_mm: float,
    sensor_to_pupil_mm: float,
    sensor_to_pupil_sigma_mm: float,
) -> DepthFit:
    """Fit d = A - B / (distance - delta), robustly, with a prior on delta.

    Delta is the worst determined of the three (to 3 mm where A is to 0.03 px); its prior comes from the boards' poses
    or from the focal length of the lens.

    Parameters
    ----------
    distance_mm : (N,) float
        Ruler distance from the sensor plane; N >= 3.
    disparity_px : (N,) float
        Half disparity measured there.
    disparity_sigma_px : (N,) float
    distance_sigma_mm : float
        Standard deviation of the ruler.
    sensor_to_pupil_mm, sensor_to_pupil_sigma_mm : float
        Prior of delta.

    Raises
    ------
    InputError
        The boards do not determine the curve, or disparity falls with distance.
    """
    all_distances, all_disparities = np.asarray(distance_mm, float), np.asarray(disparity_px, float)
    sigma = np.asarray(disparity_sigma_px, float)
    good = np.isfinite(all_distances) & np.isfinite(all_disparities) & np.isfinite(sigma)
    distance, disparity, sigma = all_distances[good], all_disparities[good], sigma[good]
    if len(distance) < _MIN_BOARDS or np.ptp(1 / distance) * distance.min() < _LEAST_RANGE:
        raise InputError(
            f"{len(distance)} usable boards do not fix the depth curve: photograph the board at three or more "
            "distances, nearer and farther than the focus"
        )
    # Start with delta at its prior: the curve is then linear in inverse depth.
    inverse = 1 / (distance - sensor_to_pupil_mm)
    slope, offset = np.polyfit(inverse, disparity, 1)
    if slope >= 0:
        raise InputError(
            "disparity falls with distance: the filters are swapped (is cyan on the left, seen from behind the "
            "camera?), or the design is not the one in the pupil"
        )

    def residuals(p: np.ndarray) -> np.ndarray:
        z = distance - p[2]
        error = np.hypot(sigma, -slope / z**2 * distance_sigma_mm)
        prior = (p[2] - sensor_to_pupil_mm) / sensor_to_pupil_sigma_mm
        return np.append((disparity - (p[0] - p[1] / z)) / error, prior)

    start = np.array([offset, -slope, sensor_to_pupil_mm])
    scale = np.maximum(np.abs(start), 1e-3)
    fit = least_squares(residuals, start, x_scale=scale, loss="huber", f_scale=HUBER)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    model = DepthModel(float(fit.x[0]), float(fit.x[1]), float(fit.x[2]), covariance)
    residual_mm = disparity_to_depth(all_disparities, model)[0].astype(float) - all_distances
    residual_px = all_disparities - depth_to_disparity(all_distances, model)
    return DepthFit(model, residual_mm, residual_px, float(np.sqrt(np.nanmean(residual_mm**2))))

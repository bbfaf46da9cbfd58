"""Fit of the disparity-to-depth curve to boards at measured distances (paper section 3.4, one curve a frame)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from chromaperture.depth.conversion import DepthModel, depth_to_disparity, disparity_to_depth
from chromaperture.errors import InputError

_HUBER = 1.345  # standard deviations; 95 % efficient for Gaussian errors


@dataclass(frozen=True)
class DepthFit:
    """A fitted curve and how well it fits.

    Attributes
    ----------
    model : DepthModel
        A, B, delta and their covariance.
    residual_mm : (N,) float64, mm
        Measured minus true distance of every board; NaN where nothing was measured.
    residual_px : (N,) float64, px
    rms_mm : float
    """

    model: DepthModel
    residual_mm: np.ndarray
    residual_px: np.ndarray
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
    """Fit d = A - B / (distance - delta), robustly, with what is known of delta beforehand.

    Three numbers are all a curve d(distance) has; delta is the weakest of them (3 mm where A is good to 0.03 px), so
    it enters with a prior from the boards' own poses or the lens's focal length.

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

    Returns
    -------
    DepthFit

    Raises
    ------
    InputError
        Too few boards, or boards that do not fix the curve.
    """
    all_distances, all_disparities = np.asarray(distance_mm, float), np.asarray(disparity_px, float)
    sigma = np.asarray(disparity_sigma_px, float)
    good = np.isfinite(all_distances) & np.isfinite(all_disparities) & np.isfinite(sigma)
    distance, disparity, sigma = all_distances[good], all_disparities[good], sigma[good]
    if len(distance) < 3 or np.ptp(1 / distance) * distance.min() < 0.05:
        raise InputError(
            f"{len(distance)} usable boards do not fix the depth curve: photograph the board at three or more "
            "distances, nearer and farther than the focus"
        )
    # Straight line in inverse depth for the start: the curve is linear there once delta is known.
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
    fit = least_squares(residuals, start, x_scale=scale, loss="huber", f_scale=_HUBER)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    model = DepthModel(float(fit.x[0]), float(fit.x[1]), float(fit.x[2]), covariance)
    residual_mm = disparity_to_depth(all_disparities, model)[0].astype(float) - all_distances
    residual_px = all_disparities - depth_to_disparity(all_distances, model)
    return DepthFit(model, residual_mm, residual_px, float(np.sqrt(np.nanmean(residual_mm**2))))

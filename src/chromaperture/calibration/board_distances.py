"""Distances of the boards, from ruler and pose together, and boards whose ruler must be wrong.

A ruler measures from the sensor plane and errs by a few mm at any distance. A pose measures from the entrance pupil, is
proportional to the focal length and errs with blur and distance. With z the distance of a board from the pupil::

    ruler = z + delta + e,        scale * pose = z + p

both observe z, the sensor-to-pupil distance delta, and the correction ``scale`` of the focal length: a linear problem
except for the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from chromaperture.system.errors import InputError
from chromaperture.system.robust import huber_weights

_ROUNDS = 20  # of reweighting; chosen by hand, far more than it needs
_UNITS = {"cm": 10.0, "m": 1000.0, "inches": 25.4, "feet": 304.8}  # mm
_OTHER_UNIT = 5.0  # ratio of expected to given distance from which the unit is wrong: half that of cm
_MIN_POSES = 4  # two determine delta and scale; chosen by hand
_SCALE_SIGMA = 0.05  # prior of scale: Zhang's method finds a focal length to better than 5 %
_FIXED_SCALE_SIGMA = 1e-6  # without poses
_MOST_FACTOR, _FACTOR_SIGMA = 5.0, 1.0  # limit of the correction of the corners' error; prior, in natural logarithms
_OUTLIER = 5.0  # standard deviations, and at least twice the ruler's own error; chosen by hand
_NO_WEIGHT = 1e-6  # of a ruler that is off by twice that: a weight of 0 could leave the equations singular


@dataclass(frozen=True)
class BoardDistances:
    """Distances of the boards, and pupil and focal length by them."""

    from_pupil_mm: np.ndarray  # z, (N,) float64, from ruler and pose together
    # sensor_to_pupil_mm, sigma_mm: delta and its standard deviation
    sensor_to_pupil_mm: float
    sigma_mm: float
    scale: float  # factor by which to correct the focal length in px
    covariance: np.ndarray  # (N + 1, N + 1) float64, mm^2, of the z of all boards and, last, of delta
    residual_mm: np.ndarray  # (N,) float64; ruler minus distance from the sensor by pose, NaN without a pose
    residual_sigma_mm: np.ndarray  # (N,) float64; its expected standard deviation


def fit_distances(
    ruler_mm: np.ndarray,
    pose_mm: np.ndarray,
    *,
    ruler_sigma_mm: float,
    pose_sigma_mm: np.ndarray,
    sensor_to_pupil_mm: float,
    sensor_to_pupil_sigma_mm: float,
) -> BoardDistances:
    """Fit distances to rulers and poses, robustly.

    Parameters
    ----------
    ruler_mm : (N,) float
        From the sensor plane.
    pose_mm : (N,) float
        From the entrance pupil, by the corners; NaN where a board was not found.
    ruler_sigma_mm : float
    pose_sigma_mm : (N,) float
    sensor_to_pupil_mm, sensor_to_pupil_sigma_mm : float
        Prior of delta, which alone determines it when fewer than four boards have a pose.
    """
    ruler, pose = np.asarray(ruler_mm, float), np.asarray(pose_mm, float)
    n = len(ruler)
    seen = np.isfinite(pose)
    if seen.sum() < _MIN_POSES:
        pose, seen = np.full(n, np.nan), np.zeros(n, bool)
    # Unknowns: z of every board, delta, scale. Rows: rulers, poses, the two priors.
    rows, values, weights = np.zeros((2 * n + 2, n + 2)), np.zeros(2 * n + 2), np.zeros(2 * n + 2)
    board = np.arange(n)
    rows[board, board], rows[board, n], values[:n] = 1, 1, ruler
    rows[n + board, board], rows[n + board, n + 1] = 1, np.where(seen, -pose, 0)
    rows[2 * n, n], values[2 * n], weights[2 * n] = 1, sensor_to_pupil_mm, 1 / sensor_to_pupil_sigma_mm
    rows[2 * n + 1, n + 1], values[2 * n + 1] = 1, 1.0
    weights[2 * n + 1] = 1 / (_SCALE_SIGMA if seen.any() else _FIXED_SCALE_SIGMA)
    weights[:n] = 1 / ruler_sigma_mm
    robust, pose_sigma = np.ones(n), np.asarray(pose_sigma_mm, float)
    for turn in range(_ROUNDS):  # a misread ruler loses weight; it shows only where there is a pose
        w = weights.copy()
        w[:n] *= np.sqrt(robust)
        w[n : 2 * n] = np.where(seen, 1 / pose_sigma, 0.0)
        information = (rows * (w**2)[:, None]).T @ rows
        solution = np.linalg.solve(information, (rows * (w**2)[:, None]).T @ values)
        by_pose = np.where(seen, solution[n + 1] * pose + solution[n], np.nan)
        expected = np.where(seen, np.hypot(ruler_sigma_mm, np.where(seen, pose_sigma, 0.0)), np.inf)
        standard = np.where(seen, np.abs(ruler - by_pose) / expected, 0.0)
        robust = np.where(standard > 2 * _OUTLIER, _NO_WEIGHT, huber_weights(standard))
        if turn == _ROUNDS // 2 and seen.any():
            factor = _pose_factor((ruler - by_pose)[seen], np.asarray(pose_sigma_mm, float)[seen], ruler_sigma_mm)
            pose_sigma = factor * np.asarray(pose_sigma_mm, float)
    covariance = np.linalg.inv(information)[: n + 1, : n + 1]
    return BoardDistances(
        solution[:n], float(solution[n]), float(np.sqrt(covariance[n, n])), float(solution[n + 1]), covariance,
        ruler - by_pose, np.where(seen, expected, np.nan),
    )  # fmt: skip


def _pose_factor(residual_mm: np.ndarray, pose_sigma_mm: np.ndarray, ruler_sigma_mm: float) -> float:
    """Return the most probable factor on the stated error of the poses, given the residuals against the rulers.

    The precision of corners depends on print, light and lens and is known to a factor of two at best, whereas the error
    of the ruler is stated in the session.
    """
    factors = np.geomspace(1 / _MOST_FACTOR, _MOST_FACTOR, 81)  # steps of 4 %
    variance = ruler_sigma_mm**2 + (factors[:, None] * pose_sigma_mm) ** 2
    degrees = max(len(residual_mm) - 2, 1) / len(residual_mm)  # delta and scale take two degrees of freedom
    squares = np.minimum(residual_mm**2, _OUTLIER**2 * variance)
    cost = 0.5 * (squares / variance + degrees * np.log(variance)).sum(axis=1)
    cost += 0.5 * (np.log(factors) / _FACTOR_SIGMA) ** 2
    return float(factors[int(cost.argmin())])


def check_units(ruler_mm: np.ndarray, expected_mm: np.ndarray | float, *, where: str) -> None:
    """Raise InputError that names the unit, where distances are not in mm.

    Parameters
    ----------
    ruler_mm : (N,) float
    expected_mm : (N,) float or float
        Rough distances from poses or from the focus; NaN is left out.
    where : str
        File of the distances.
    """
    ratios = np.asarray(expected_mm, float) / np.asarray(ruler_mm, float)
    ratios = ratios[np.isfinite(ratios)]
    ratio = float(np.median(ratios)) if ratios.size else 1.0
    if ratio < _OTHER_UNIT:
        return
    unit = min(_UNITS, key=lambda name: abs(np.log(_UNITS[name] / ratio)))
    raise InputError(
        f"{where}: the distances look like {unit}, they are {ratio:.0f} times too small for mm; write them in mm"
    )


def find_outliers(
    names: Sequence[str], ruler_mm: np.ndarray, measured_mm: np.ndarray, sigma_mm: np.ndarray, *, ruler_error_mm: float
) -> dict[str, str]:
    """Find boards whose ruler contradicts the measurement, and pairs that were swapped.

    Parameters
    ----------
    names : sequence of str
    ruler_mm, measured_mm : (N,) float
        Distance from the sensor by ruler, and by corners or fitted curve; NaN unknown.
    sigma_mm : (N,) float
        Standard deviation of their difference.
    ruler_error_mm : float

    Returns
    -------
    dict of name to sentence
    """
    ruler, measured = np.asarray(ruler_mm, float), np.asarray(measured_mm, float)
    limit = np.maximum(_OUTLIER * np.asarray(sigma_mm, float), 2 * ruler_error_mm)
    wrong = np.flatnonzero(np.abs(ruler - measured) > limit).tolist()
    found: dict[str, str] = {}
    for i in wrong:
        others = [j for j in wrong if j != i and abs(measured[i] - ruler[j]) < limit[i]
                  and abs(measured[j] - ruler[i]) < limit[j]]  # fmt: skip
        if others:
            found[names[i]] = f"{names[i]} and {names[others[0]]} are swapped: each stands where the other's ruler says"
        else:
            found[names[i]] = (
                f"{names[i]} is {abs(ruler[i] - measured[i]):.0f} mm off its ruler: it stands at {measured[i]:.0f} mm, "
                f"the ruler says {ruler[i]:.0f} mm"
            )
    return found

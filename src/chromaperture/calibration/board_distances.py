"""Where the boards stood: ruler and the boards' own corners together, and which of them cannot be true.

A ruler starts at the sensor plane and errs by a few mm at any distance; a pose starts at the entrance pupil, is
proportional to the focal length and errs with blur and distance. With one distance z a board from the pupil::

    ruler = z + delta + e,        scale * pose = z + p

both are observations of z, of the common sensor-to-pupil distance delta, and of the correction ``scale`` of the focal
length: a linear problem but for the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from chromaperture.errors import InputError

_HUBER = 1.345
_ROUNDS = 20
_UNITS = {"cm": 10.0, "m": 1000.0, "inches": 25.4, "feet": 304.8}
_OTHER_UNIT = 5.0
_MIN_POSES = 4
_MOST_FACTOR, _FACTOR_SIGMA = 5.0, 1.0  # of the corners' error, the second in natural logarithms
_OUTLIER = 5.0  # standard deviations, and at least twice the ruler's own error


@dataclass(frozen=True)
class BoardDistances:
    """Distances of the boards and what follows from them.

    Attributes
    ----------
    from_pupil_mm : (N,) float64
        z, from ruler and pose together.
    sensor_to_pupil_mm, sigma_mm : float
        delta and its standard deviation.
    scale : float
        What the focal length in px must be multiplied by: a pose is proportional to it.
    covariance : (N + 1, N + 1) float64, mm^2
        Of the z of all boards and, last, of delta.
    residual_mm : (N,) float64
        Ruler minus the distance from the sensor by pose; NaN where there is no pose.
    residual_sigma_mm : (N,) float64
        Its expected standard deviation.
    """

    from_pupil_mm: np.ndarray
    sensor_to_pupil_mm: float
    sigma_mm: float
    scale: float
    covariance: np.ndarray
    residual_mm: np.ndarray
    residual_sigma_mm: np.ndarray


def fit_distances(
    ruler_mm: np.ndarray,
    pose_mm: np.ndarray,
    *,
    ruler_sigma_mm: float,
    pose_sigma_mm: np.ndarray,
    sensor_to_pupil_mm: float,
    sensor_to_pupil_sigma_mm: float,
) -> BoardDistances:
    """Reconcile ruler and poses, robustly.

    Parameters
    ----------
    ruler_mm : (N,) float
        From the sensor plane.
    pose_mm : (N,) float
        From the entrance pupil, by the corners; NaN where a board was not found.
    ruler_sigma_mm : float
    pose_sigma_mm : (N,) float
    sensor_to_pupil_mm, sensor_to_pupil_sigma_mm : float
        What is known of delta beforehand: all there is when fewer than four boards have a pose.

    Returns
    -------
    BoardDistances
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
    weights[2 * n + 1] = 1 / 0.05 if seen.any() else 1e6  # a focal length from Zhang's method is better than 5 %
    weights[:n] = 1 / ruler_sigma_mm
    trust, pose_sigma = np.ones(n), np.asarray(pose_sigma_mm, float)
    for turn in range(_ROUNDS):  # a misread ruler is outvoted by the pose, and only there can it be told
        w = weights.copy()
        w[:n] *= np.sqrt(trust)
        w[n : 2 * n] = np.where(seen, 1 / pose_sigma, 0.0)
        information = (rows * (w**2)[:, None]).T @ rows
        solution = np.linalg.solve(information, (rows * (w**2)[:, None]).T @ values)
        by_pose = np.where(seen, solution[n + 1] * pose + solution[n], np.nan)
        expected = np.where(seen, np.hypot(ruler_sigma_mm, np.where(seen, pose_sigma, 0.0)), np.inf)
        standard = np.where(seen, np.abs(ruler - by_pose) / expected, 0.0)
        trust = np.where(standard > _HUBER, _HUBER / np.maximum(standard, 1e-9), 1.0)
        trust = np.where(standard > 2 * _OUTLIER, 1e-6, trust)
        if turn == _ROUNDS // 2 and seen.any():
            factor = _pose_factor((ruler - by_pose)[seen], np.asarray(pose_sigma_mm, float)[seen], ruler_sigma_mm)
            pose_sigma = factor * np.asarray(pose_sigma_mm, float)
    covariance = np.linalg.inv(information)[: n + 1, : n + 1]
    return BoardDistances(
        solution[:n], float(solution[n]), float(np.sqrt(covariance[n, n])), float(solution[n + 1]), covariance,
        ruler - by_pose, np.where(seen, expected, np.nan),
    )  # fmt: skip


def _pose_factor(residual_mm: np.ndarray, pose_sigma_mm: np.ndarray, ruler_sigma_mm: float) -> float:
    """How much worse or better the corners are than was thought, as the rulers tell; the most probable factor.

    How well corners are found depends on the print, the light and the lens: it cannot be known beforehand to better
    than a factor of two or so, and the rulers' own error is stated by whoever held it.
    """
    factors = np.geomspace(1 / _MOST_FACTOR, _MOST_FACTOR, 81)
    variance = ruler_sigma_mm**2 + (factors[:, None] * pose_sigma_mm) ** 2
    degrees = max(len(residual_mm) - 2, 1) / len(residual_mm)  # delta and the scale took two
    squares = np.minimum(residual_mm**2, _OUTLIER**2 * variance)
    cost = 0.5 * (squares / variance + degrees * np.log(variance)).sum(axis=1)
    cost += 0.5 * (np.log(factors) / _FACTOR_SIGMA) ** 2
    return float(factors[int(cost.argmin())])


def check_units(ruler_mm: np.ndarray, expected_mm: np.ndarray | float, *, where: str) -> None:
    """Refuse distances that are in another unit than mm; raises InputError that names it.

    Parameters
    ----------
    ruler_mm : (N,) float
    expected_mm : (N,) float or float
        What they should be to within tens of per cent, from poses or from the focus; NaN is left out.
    where : str
        The file they come from.
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
    """Name boards whose ruler contradicts what was measured, and pairs that were swapped.

    Parameters
    ----------
    names : sequence of str
    ruler_mm, measured_mm : (N,) float
        Distance from the sensor by ruler, and by the corners or else by the fitted curve; NaN where unknown.
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

"""Statistics that a few outliers cannot spoil."""

from __future__ import annotations

import numpy as np

MAD_TO_SIGMA = 1.4826  # standard deviation of a Gaussian over its median absolute deviation: 1 / Phi^-1(3/4)
MEDIAN_INEFFICIENCY = 1.2533  # standard error of the median over that of the mean, for a Gaussian: sqrt(pi / 2)
HUBER = 1.345  # standard deviations at which Huber's loss turns linear: 95 % efficient for Gaussian errors (Huber 1981)


def robust_sigma(residuals: np.ndarray) -> float:
    """Estimate the standard deviation about 0 from the median absolute value; NaN is missing."""
    known = np.abs(residuals[np.isfinite(residuals)])
    return MAD_TO_SIGMA * float(np.median(known)) if known.size else float("nan")


def huber_weights(standardised: np.ndarray) -> np.ndarray:
    """Return Huber's weights, (0, 1], of standardised residuals for reweighted least squares."""
    return np.asarray(HUBER / np.maximum(np.abs(standardised), HUBER))

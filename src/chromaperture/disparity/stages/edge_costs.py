"""Likelihood of the places of an edge for lines of known covariances, in plain NumPy: the oracle of ``cpu``'s twin."""

from __future__ import annotations

import numpy as np

LEAST_OF_TRACE = 1e-9  # is added to the variances, for the inverse where there is no noise


def edge_costs(
    lines: np.ndarray, near: np.ndarray, far: np.ndarray, share: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Compute negative log-likelihoods of Gaussian lines, at every place of their edge.

    At place t the covariance of a line is ``a a^T o near + (1 - a) (1 - a)^T o far + noise`` with the near side's share
    of the light a, o the product of entries; see ``edge_likelihood.py``.

    Parameters
    ----------
    lines : (P, n) float
    near, far : (n, n) float
        Covariances of both sides alone.
    share : (T, n) float in [0, 1]
        The near side's of the light of every sample, for every place.
    noise : (n, n) float

    Returns
    -------
    (P, T) float64, nats
        Without the constant n / 2 log(2 pi).
    """
    sides = (part[:, :, None] * part[:, None] * side for part, side in ((share, near), (1 - share, far)))
    both = sum(sides) + noise
    least = LEAST_OF_TRACE * np.trace(both[0]) / near.shape[0]
    factors = np.linalg.cholesky(both + least * np.eye(near.shape[0]))
    log_determinant = 2 * np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
    whitened = np.linalg.solve(factors, lines.T[None])
    return np.asarray((np.square(whitened).sum(axis=1).T + log_determinant) / 2)

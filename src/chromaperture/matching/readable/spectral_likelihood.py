"""Likelihood of windows' spectra under Gaussian textures of unknown colours; the oracle of ``cpu``'s twin.

A window's channels y at a frequency have the covariance ``C = S o G + diag(S) G error + N``: S the covariance of the
colours, 3 x 3 and the same at all frequencies, G the power of the texture as the blur of a layer passes it on
(`spectral_model`), o the product of entries, N the noise. S maximises the likelihood, by rounds of expectation and
maximisation: ``S <- S + S M S / F`` with ``M = sum_f G* o C^-1 (y y^H - C) C^-1`` (docs/equations.md).
"""

from __future__ import annotations

import numpy as np

FIRST_ROUNDS = 4  # further rounds at the first layer: the others start from their neighbour's covariance
FIRST_CORRELATION = 0.9  # of two colours, to begin with; chosen by hand
LEAST_AMPLITUDE = 1e-9  # of a colour's power, white level squared: far below a sensor's noise
# Determinant of the colours' correlations: theirs is 2e-5 where all three correlate to 0.998, and not positive where a
# step went too far.
LEAST_DETERMINANT = 1e-7

_PAIRS = ((0, 1), (0, 2), (1, 2))


def spectral_likelihood(
    spectra: np.ndarray, powers: np.ndarray, node: np.ndarray, noise: np.ndarray, *, channel_error: float, rounds: int
) -> np.ndarray:
    """Sum the log-likelihood of windows over their frequencies, at every layer.

    Parameters
    ----------
    spectra : (M, 3, F) complex64
        Of the channels of every window.
    powers : (K, D, 9, F) float32
        G at every node and layer: its diagonal, then real and imaginary parts of G_01, G_02 and G_12.
    node : (M,) int
        Of every window.
    noise : (M, 3) float32
        Power of the noise of every channel at any frequency.
    channel_error : float
    rounds : int

    Returns
    -------
    (M, D) float32, nats
    """
    spectra = np.asarray(spectra, complex).transpose(0, 2, 1)
    observed = spectra[..., :, None] * spectra[..., None, :].conj()
    own = np.asarray(noise, float)[:, None]
    colours = _first_colours(np.abs(spectra) ** 2, np.asarray(powers[node, 0, :3], float), noise)
    out = np.empty((len(spectra), powers.shape[1]), np.float32)
    for layer in range(powers.shape[1]):
        passed = _matrices(np.asarray(powers[node, layer], float))
        for _ in range(rounds + FIRST_ROUNDS * (layer == 0)):
            inverse = np.linalg.inv(_covariance(colours, passed, own, channel_error))
            surplus = inverse @ observed @ inverse - inverse
            gradient = (surplus * passed.conj()).real.sum(axis=1)
            colours = _moved(colours, colours @ gradient @ colours / passed.shape[1])
        covariance = _covariance(colours, passed, own, channel_error)
        explained = np.trace(np.linalg.solve(covariance, observed), axis1=2, axis2=3).real
        out[:, layer] = -(np.linalg.slogdet(covariance)[1] + explained).sum(axis=1)
    return out


def _matrices(entries: np.ndarray) -> np.ndarray:
    """Hermitian matrices (M, F, 3, 3) of their nine numbers (M, 9, F)."""
    out = np.empty((entries.shape[0], entries.shape[2], 3, 3), complex)
    for k in range(3):
        out[..., k, k] = entries[:, k]
    for n, (i, j) in enumerate(_PAIRS):
        out[..., i, j] = entries[:, 3 + 2 * n] + 1j * entries[:, 4 + 2 * n]
        out[..., j, i] = out[..., i, j].conj()
    return out


def _covariance(colours: np.ndarray, passed: np.ndarray, noise: np.ndarray, channel_error: float) -> np.ndarray:
    covariance = colours[:, None] * passed
    for k in range(3):
        covariance[..., k, k] = covariance[..., k, k] * (1 + channel_error) + noise[..., k]
    return covariance


def _moved(colours: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Take a step, or a third of it, which cannot leave the covariances: tr C^-1 (S o G) is 3 at the most."""
    full = colours + step
    power = np.diagonal(full, axis1=1, axis2=2)
    minor = power[:, 0] * power[:, 1] - full[:, 0, 1] ** 2
    product = power.prod(axis=1)
    valid = (power.min(axis=1) > LEAST_AMPLITUDE) & (minor > 0)
    valid &= np.linalg.det(full) > LEAST_DETERMINANT * product
    return np.where(valid[:, None, None], full, colours + step / 3)


def _first_colours(observed: np.ndarray, passed: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Covariance of colours from the channels' powers alone; (M, 3, 3)."""
    surplus = observed.sum(axis=1) - observed.shape[1] * noise
    amplitude = np.sqrt(np.maximum(surplus / passed.sum(axis=2), LEAST_AMPLITUDE))
    correlation = np.where(np.eye(3, dtype=bool), 1.0, FIRST_CORRELATION)
    return np.asarray(correlation * amplitude[:, :, None] * amplitude[:, None])

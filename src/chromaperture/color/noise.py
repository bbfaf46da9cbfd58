"""Noise of the linear image, which the matcher needs to tell texture from grain."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.optimize import nnls

# Immerkaer (1996): the difference of two Laplacians, blind to planes and edges of first order.
_IMMERKAER = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
_BLOCK_PX = 32
_BLOCK_SIGMA = 0.086  # of a block's variance: 1024 px whose responses are correlated count as 271
_CLIPS = 0.98
_FEWEST_BLOCKS = 40
_LEAST_SPREAD = 0.3  # of the brightest level, over which the levels must reach
_BINS, _LOW_QUANTILE = 12, 0.1
_ROUNDS = 10
_MOST_ELECTRONS = 1e7  # no pixel holds more: what is quieter was computed, not photographed


def photon_noise_variance(image: np.ndarray, *, full_well_electrons: float, read_noise_electrons: float) -> np.ndarray:
    """Variance of shot and read noise.

    Parameters
    ----------
    image : (H, W, 3) float, linear, 1.0 = white level
    full_well_electrons : float
        Electrons at white level.
    read_noise_electrons : float
        Standard deviation of the read noise, electrons.

    Returns
    -------
    (H, W, 3) float32, (white level)^2
    """
    # The signal is smoothed first: a variance taken from the noisy pixel itself would correlate with its noise.
    signal = np.maximum(cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), 2.0), 0)
    return signal / np.float32(full_well_electrons) + np.float32((read_noise_electrons / full_well_electrons) ** 2)


def fine_structure(image: np.ndarray) -> np.ndarray:
    """Absolute response to Immerkaer's kernel, whose norm is 6: noise, and little of the picture; of its shape."""
    return np.abs(cv2.filter2D(np.asarray(image, np.float32), cv2.CV_32F, _IMMERKAER))


def estimate_noise_variance(image: np.ndarray) -> np.ndarray:
    """Noise variance per channel from the image alone, where no noise model is known.

    The median of the absolute Immerkaer response over the frame: texture raises a minority of the pixels only.

    Parameters
    ----------
    image : (H, W, 3) float, linear

    Returns
    -------
    (H, W, 3) float32, constant over the frame, (white level)^2
    """
    image = np.asarray(image, np.float32)
    response = fine_structure(image).reshape(-1, image.shape[2])
    response = response[np.isfinite(response).all(axis=1)]  # one bad pixel must not spoil the frame
    if len(response) == 0:
        return np.zeros(image.shape, np.float32)
    sigma = np.median(response, axis=0) / (0.6745 * 6.0)  # the kernel's norm is 6
    return np.broadcast_to((sigma**2).astype(np.float32), image.shape)


def noise_samples(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Brightness of blocks of an image, and the variance of what is finer than any lens draws in them.

    Parameters
    ----------
    image : (H, W, C) float, linear, 1.0 = white level

    Returns
    -------
    level, variance : (B,) float64
        Of each block and channel, white level and its square; blocks that clip or hold no number are left out.
    """
    image = np.asarray(image, np.float32)
    height, width = (n // _BLOCK_PX * _BLOCK_PX for n in image.shape[:2])

    def blocks(values: np.ndarray) -> np.ndarray:
        return values[:height, :width].reshape(height // _BLOCK_PX, _BLOCK_PX, width // _BLOCK_PX, _BLOCK_PX, -1)

    level = blocks(image).mean(axis=(1, 3), dtype=float).ravel()
    variance = (blocks(fine_structure(image)) ** 2).mean(axis=(1, 3), dtype=float).ravel() / 36
    clips = blocks(image).max(axis=(1, 3)).ravel() >= _CLIPS
    usable = np.isfinite(level) & np.isfinite(variance) & ~clips & (level > 0)
    return level[usable], variance[usable]


def fit_photon_noise(level: np.ndarray, variance: np.ndarray) -> tuple[float, float] | None:
    """Find full well and read noise that the flattest blocks of photographs show (photon transfer, Janesick 2007).

    Texture only adds to a block's variance: the line ``level / full_well + (read_noise / full_well)^2`` runs along the
    lower edge of the cloud of blocks.

    Parameters
    ----------
    level, variance : (B,) float
        Blocks of all photographs together, see :func:`noise_samples`.

    Returns
    -------
    full_well_electrons, read_noise_electrons : float
        None where variance does not grow with brightness: too few levels, or photographs that were denoised.
    """
    level, variance = np.asarray(level, float), np.asarray(variance, float)
    if len(level) < _FEWEST_BLOCKS or np.ptp(level) < _LEAST_SPREAD * level.max(initial=0):
        return None
    order = np.array_split(np.argsort(level), _BINS)
    rows = np.array([(np.median(level[i]), np.quantile(variance[i], _LOW_QUANTILE)) for i in order])
    line = _line(rows[:, 0], rows[:, 1], np.ones(len(rows)))
    for _ in range(_ROUNDS):
        expected = line[0] * level + line[1]
        if not np.all(expected > 0):
            return None
        flat = np.abs(variance / expected - 1) < 3 * _BLOCK_SIGMA
        if flat.sum() < _FEWEST_BLOCKS:
            return None
        line = _line(level[flat], variance[flat], expected[flat])
    if line[0] * _MOST_ELECTRONS < 1:
        return None
    full_well = 1 / line[0]
    return float(full_well), float(np.sqrt(line[1]) * full_well)


def _line(level: np.ndarray, variance: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Slope and offset, neither negative, that fit best where errors grow with ``scale``; (2,) float64."""
    unit = float(np.mean(variance / scale)) or 1.0  # variances are small numbers, the solver's tolerances are not
    found, _ = nnls(np.stack([level, np.ones_like(level)], axis=1) / scale[:, None], variance / scale / unit)
    return np.asarray(found * unit)

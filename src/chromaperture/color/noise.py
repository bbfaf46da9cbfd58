"""Noise of the linear image, which the matcher needs to tell texture from grain."""

from __future__ import annotations

import cv2
import numpy as np

# Immerkaer (1996): the difference of two Laplacians, blind to planes and edges of first order.
_IMMERKAER = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)


def photon_noise_variance(
    image: np.ndarray, *, full_well_electrons: float, read_noise_electrons: float
) -> np.ndarray:
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

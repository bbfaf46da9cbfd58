"""Filtering two channels with each other's blur, in plain NumPy: the oracle of ``cpu/cross_filter.py``."""

from __future__ import annotations

import numpy as np
import scipy.fft


def cross_filter(
    spectra: tuple[np.ndarray, np.ndarray], transfers: tuple[np.ndarray, np.ndarray], damping: float
) -> np.ndarray:
    """Compute P and Q of a tile, see ``blur_evidence.py``.

    Parameters
    ----------
    spectra : two (n, n // 2 + 1) complex64
        Y_a and Y_b.
    transfers : two (n, n // 2 + 1) complex64
        H_a and H_b.
    damping : float
        eps.

    Returns
    -------
    (n, n, 2) float32
    """
    (a, b), (h_a, h_b) = spectra, transfers
    power = (np.abs(h_a) ** 2 + np.abs(h_b) ** 2) / 2
    gain = 1 / np.sqrt(power + np.float32(damping))
    shape = (len(a), len(a))
    return np.stack([scipy.fft.irfft2(view * gain, s=shape) for view in (a * h_b, b * h_a)], axis=-1)

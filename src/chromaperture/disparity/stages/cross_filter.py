"""Filtering two channels with each other's blur, in plain NumPy: the oracle of ``cpu/cross_filter.py``."""

from __future__ import annotations

import numpy as np


def cross_filter(
    spectra: tuple[np.ndarray, np.ndarray], transfers: tuple[np.ndarray, np.ndarray], damping: float, out: np.ndarray
) -> None:
    """Write the spectra of P and Q, see ``blur_evidence.py``.

    Parameters
    ----------
    spectra : two (n, n // 2 + 1) complex64
        Y_a and Y_b of a tile.
    transfers : two (n, n // 2 + 1) complex64
        H_a and H_b.
    damping : float
        eps.
    out : (2, n, n // 2 + 1) complex64; written
    """
    (a, b), (h_a, h_b) = spectra, transfers
    power = (np.abs(h_a) ** 2 + np.abs(h_b) ** 2) / 2
    gain = 1 / np.sqrt(power + np.float32(damping))
    out[0] = a * h_b * gain
    out[1] = b * h_a * gain

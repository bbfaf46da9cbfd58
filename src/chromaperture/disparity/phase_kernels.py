"""Filtering two channels with each other's blur, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def cross_filter(view_a, view_b, transfer_a, transfer_b, damping, out):  # type: ignore[no-untyped-def]
    """Write the spectra of P and Q, see ``phase.py``, in one pass: in NumPy the temporaries cost more than the FFT."""
    for y in range(view_a.shape[0]):
        for x in range(view_a.shape[1]):
            a, b = transfer_a[y, x], transfer_b[y, x]
            power = (a.real * a.real + a.imag * a.imag + b.real * b.real + b.imag * b.imag) * np.float32(0.5)
            gain = np.float32(1) / np.sqrt(power + damping)
            out[0, y, x] = view_a[y, x] * b * gain
            out[1, y, x] = view_b[y, x] * a * gain

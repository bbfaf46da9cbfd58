"""Filtering two channels with each other's blur, compiled; ``stages/cross_filter.py`` explains what is computed."""

from __future__ import annotations

import numpy as np

from chromaperture.compilation import compiled


def cross_filter(
    spectra: tuple[np.ndarray, np.ndarray], transfers: tuple[np.ndarray, np.ndarray], damping: float, out: np.ndarray
) -> None:
    """Write the spectra of P and Q, as `stages.cross_filter`."""
    _cross_filter(*spectra, *transfers, np.float32(damping), out)


@compiled()
def _cross_filter(view_a, view_b, transfer_a, transfer_b, damping, out):  # type: ignore[no-untyped-def]
    """One pass: in NumPy the temporaries cost more than the FFT."""
    for y in range(view_a.shape[0]):
        for x in range(view_a.shape[1]):
            a, b = transfer_a[y, x], transfer_b[y, x]
            power = (a.real * a.real + a.imag * a.imag + b.real * b.real + b.imag * b.imag) * np.float32(0.5)
            gain = np.float32(1) / np.sqrt(power + damping)
            out[0, y, x] = view_a[y, x] * b * gain
            out[1, y, x] = view_b[y, x] * a * gain

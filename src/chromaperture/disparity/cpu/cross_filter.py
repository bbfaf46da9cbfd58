"""Filtering two channels with each other's blur, compiled; ``stages/cross_filter.py`` explains what is computed.

P and Q are the real and the imaginary part of one picture, whose spectrum is transformed back at once.
"""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.compilation import compiled


def cross_filter(
    spectra: tuple[np.ndarray, np.ndarray], transfers: tuple[np.ndarray, np.ndarray], damping: float
) -> np.ndarray:
    """Compute P and Q, as `stages.cross_filter`; (n, n, 2) float32."""
    size = len(spectra[0])
    both = np.empty((size, size), np.complex64)
    _cross_filter(*spectra, *transfers, np.float32(damping), both)
    packed = both.view(np.float32).reshape(size, size, 2)
    return np.asarray(cv2.dft(packed, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE))


@compiled(fastmath={"contract", "arcp", "nsz", "afn"}, error_model="numpy")
def _cross_filter(view_a, view_b, transfer_a, transfer_b, damping, both):  # type: ignore[no-untyped-def]
    """Spectrum of P + i Q from halves of spectra: at -w it is P* + i Q*."""
    size = both.shape[0]
    columns = size // 2 + 1
    gain = np.empty(columns, np.float32)
    for y in range(size):
        mirrored = size - y if y > 0 else 0
        for x in range(columns):
            a, b = transfer_a[y, x], transfer_b[y, x]
            power = (a.real * a.real + a.imag * a.imag + b.real * b.real + b.imag * b.imag) * np.float32(0.5)
            gain[x] = np.float32(1) / np.sqrt(power + damping)
        for x in range(columns):
            p = view_a[y, x] * transfer_b[y, x] * gain[x]
            q = view_b[y, x] * transfer_a[y, x] * gain[x]
            both[y, x] = complex(p.real - q.imag, p.imag + q.real)
            if x > 0 and size - x >= columns:
                both[mirrored, size - x] = complex(p.real + q.imag, q.real - p.imag)

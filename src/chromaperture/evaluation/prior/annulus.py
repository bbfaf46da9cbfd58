"""Depth from channels of different blur through a magenta annulus: the paper's [5], design VI.

Green sees the inner disc only and is sharper than red and blue. For each size of blur green is blurred by what it
lacks; where the size is right, the gradients of the three channels lie on a line. Blur before and beyond the focus is
the same disc, so the sign of the disparity is not seen: everything is taken to lie beyond the focus, or before it.
"""

from __future__ import annotations

import cv2
import numpy as np
import scipy.fft

from chromaperture.evaluation.prior.shifts import best_layer

_NOISE = 1e-3  # lambda of the corrective kernels
_WINDOW_PX = 15  # along the gradient


def corrective_kernel_spectrum(
    target: np.ndarray, own: np.ndarray, shape: tuple[int, int], *, noise: float = _NOISE
) -> np.ndarray:
    """Give the transfer function that turns one channel's blur into another's, damped where it has nothing.

    F[k_R] conj(F[k_i]) / (|F[k_i]|^2 + noise (|F dx|^2 + |F dy|^2))

    Parameters
    ----------
    target, own : (h, w // 2 + 1) complex
        Transfer functions of the two blurs.
    shape : (h, w)
    noise : float

    Returns
    -------
    (h, w // 2 + 1) complex
    """
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    gradient = 4 * np.sin(np.pi * fx) ** 2 + 4 * np.sin(np.pi * fy) ** 2
    return np.asarray(target * own.conj() / (np.abs(own) ** 2 + noise * np.maximum(gradient, 1e-6)))


def annulus_radius(
    image: np.ndarray, transfer: list[np.ndarray], radii_px: np.ndarray, padded: tuple[int, int]
) -> np.ndarray:
    """Find the size of the blur, whose sign this design does not show.

    Parameters
    ----------
    image : (H, W, 3) float, linear
    transfer : list of (3, h, w // 2 + 1) complex
        Of R, G, B at each radius, on the padded grid.
    radii_px : (D,) float, >= 0, evenly spaced
    padded : (h, w)
        At least the image's size; the picture is mirrored into the rest.

    Returns
    -------
    (H, W) float64, px; NaN where the largest radius wins
    """
    height, width = image.shape[:2]
    rims = (0, padded[0] - height, 0, padded[1] - width)
    big = cv2.copyMakeBorder(np.asarray(image, np.float32), *rims, borderType=cv2.BORDER_REFLECT_101)
    spectra = [scipy.fft.rfft2(big[..., c]) for c in range(3)]
    score = np.empty((len(radii_px), height, width))
    for i, otf in enumerate(transfer):
        planes = [
            scipy.fft.irfft2(s * corrective_kernel_spectrum(otf[0], otf[c], padded), s=padded)[:height, :width]
            if c
            else scipy.fft.irfft2(s, s=padded)[:height, :width]
            for c, s in enumerate(spectra)
        ]
        score[i] = -misfit(np.stack(planes, axis=-1))
    found = best_layer(score, radii_px)
    return np.where(np.isnan(found) & (score.argmax(axis=0) == 0), radii_px[0], found)


def misfit(channels: np.ndarray) -> np.ndarray:
    """Gradient energy off the local colour line, relative to all of it, summed over four orientations; (H, W) float64.

    In windows along each orientation's gradient: tr L - l_1 of the 3 x 3 second moments. Divided by the trace, for a
    channel that is blurred has less energy and would win for that alone.
    """
    base = cv2.GaussianBlur(np.asarray(channels, np.float32), (0, 0), 1.0)
    gy, gx = np.gradient(base.astype(np.float64), axis=(0, 1))
    root = np.sqrt(0.5)
    directions = ((1.0, 0.0), (0.0, 1.0), (root, root), (root, -root))
    total, energy = np.zeros(channels.shape[:2]), np.full(channels.shape[:2], 1e-12)
    for x, y in directions:
        slope = np.asarray(x * gx + y * gy)
        kernel = _line(x, y)
        moments = np.empty((*channels.shape[:2], 3, 3))
        for a in range(3):
            for b in range(a + 1):
                moments[..., a, b] = moments[..., b, a] = cv2.filter2D(
                    slope[..., a] * slope[..., b], -1, kernel, borderType=cv2.BORDER_REFLECT_101
                )
        trace = np.trace(moments, axis1=2, axis2=3)
        total += trace - _largest_eigenvalue(moments)
        energy += trace
    return total / energy


def _line(x: float, y: float) -> np.ndarray:
    """Mean along a line of 15 px; (15, 15) or smaller, float64."""
    half = _WINDOW_PX // 2
    kernel = np.zeros((_WINDOW_PX, _WINDOW_PX))
    steps = np.arange(-half, half + 1)
    scale = 1 / max(abs(x), abs(y))
    kernel[np.rint(half + steps * y * scale).astype(int), np.rint(half + steps * x * scale).astype(int)] = 1
    return kernel / kernel.sum()


def _largest_eigenvalue(moments: np.ndarray, *, rounds: int = 6) -> np.ndarray:
    """Largest eigenvalue of symmetric 3 x 3 matrices by power iteration; (H, W) float64."""
    vector = np.full((*moments.shape[:2], 3), 1 / np.sqrt(3))
    for _ in range(rounds):
        vector = np.einsum("hwab,hwb->hwa", moments, vector)
        vector /= np.maximum(np.linalg.norm(vector, axis=2, keepdims=True), 1e-30)
    return np.asarray(np.einsum("hwa,hwab,hwb->hw", vector, moments, vector))

"""Depth from channels of different blur through a magenta annulus: the paper's [5], design VI.

Green passes the inner disc only and is sharper than red and blue. For each size of blur, green is given the blur that
it lacks; at the right size, the gradients of the three channels lie on a line. Blur before and beyond the focus is the
same disc, so the sign of the disparity is unknown: everything is taken to be beyond the focus, or before it.
"""

from __future__ import annotations

import cv2
import numpy as np
import scipy.fft

from chromaperture_paper.prior.shifts import WINDOW_PX, best_layer

_NOISE = 1e-3  # lambda of the corrective kernels, on the power of the gradient; chosen by hand


def _corrective(target: np.ndarray, own: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the transfer function that turns one channel's blur into another's, damped at zeros; (h, w // 2 + 1).

    F[k_R] conj(F[k_i]) / (|F[k_i]|^2 + lambda (|F dx|^2 + |F dy|^2)), from the transfer functions of both blurs
    """
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    gradient = 4 * np.sin(np.pi * fx) ** 2 + 4 * np.sin(np.pi * fy) ** 2
    return np.asarray(target * own.conj() / (np.abs(own) ** 2 + _NOISE * np.maximum(gradient, 1e-6)))


def annulus_radius(
    image: np.ndarray, transfer: list[np.ndarray], radii_px: np.ndarray, padded: tuple[int, int]
) -> np.ndarray:
    """Find the size of the blur, whose sign this design does not determine.

    ``image`` (H, W, 3) float, linear; ``transfer`` list of (3, h, w // 2 + 1) complex: of R, G, B at each radius, on
    the padded grid; ``radii_px`` (D,) float, >= 0, evenly spaced; ``padded`` (h, w): at least the image's size; the
    picture is mirrored into the rest. Returns (H, W) float64, px; NaN where the largest radius is best.
    """
    height, width = image.shape[:2]
    rims = (0, padded[0] - height, 0, padded[1] - width)
    big = cv2.copyMakeBorder(np.asarray(image, np.float32), *rims, borderType=cv2.BORDER_REFLECT_101)
    spectra = [scipy.fft.rfft2(big[..., c]) for c in range(3)]
    score = np.empty((len(radii_px), height, width))
    for i, otf in enumerate(transfer):
        corrected = [spectra[0], *(spectra[c] * _corrective(otf[0], otf[c], padded) for c in (1, 2))]
        planes = [scipy.fft.irfft2(s, s=padded)[:height, :width] for s in corrected]
        score[i] = -misfit(np.stack(planes, axis=-1))
    found = best_layer(score, radii_px)
    return np.where(np.isnan(found) & (score.argmax(axis=0) == 0), radii_px[0], found)


def misfit(channels: np.ndarray) -> np.ndarray:
    """Return the fraction of the gradient energy off the local colour line, over four orientations; (H, W) float64.

    In windows along each orientation's gradient: tr L - l_1 of the 3 x 3 second moments, over the trace, since blur
    alone reduces the energy.
    """
    base = cv2.GaussianBlur(np.asarray(channels, np.float32), (0, 0), 1.0)
    gy, gx = np.gradient(base.astype(np.float64), axis=(0, 1))
    root = np.sqrt(0.5)
    directions = ((1.0, 0.0), (0.0, 1.0), (root, root), (root, -root))
    total, energy = np.zeros(channels.shape[:2]), np.full(channels.shape[:2], 1e-12)
    for x, y in directions:
        slope = np.asarray(x * gx + y * gy)
        rr, gg, bb, rg, rb, gb = (
            _mean_along(slope[..., a] * slope[..., b], x, y)
            for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        )
        trace = rr + gg + bb
        total += trace - largest_eigenvalue(rr, gg, bb, rg, rb, gb)
        energy += trace
    return total / energy


def _mean_along(values: np.ndarray, x: float, y: float) -> np.ndarray:
    """Average over 15 px of a row, a column or a diagonal; (H, W) float64."""
    if 0 in (x, y):
        size = (WINDOW_PX, 1) if x else (1, WINDOW_PX)
        return np.asarray(cv2.blur(values, size, borderType=cv2.BORDER_REFLECT_101))
    half, (height, width) = WINDOW_PX // 2, values.shape
    big = cv2.copyMakeBorder(values, half, half, half, half, cv2.BORDER_REFLECT_101)
    down = range(WINDOW_PX) if x * y > 0 else range(WINDOW_PX - 1, -1, -1)
    total = np.zeros_like(values)
    for j, i in enumerate(down):
        total += big[i : i + height, j : j + width]
    return total / WINDOW_PX


def largest_eigenvalue(
    rr: np.ndarray, gg: np.ndarray, bb: np.ndarray, rg: np.ndarray, rb: np.ndarray, gb: np.ndarray
) -> np.ndarray:
    """Return the largest eigenvalue of symmetric 3 x 3 matrices, from their diagonal and the rest; (H, W) float64.

    With q the mean of the diagonal and p^2 = |A - q|^2 / 6 it is q + 2 p cos(arccos(det((A - q) / p) / 2) / 3), the
    cosine solution of the cubic.
    """
    q = (rr + gg + bb) / 3
    r, g, b = rr - q, gg - q, bb - q
    p = np.sqrt(np.maximum((r * r + g * g + b * b + 2 * (rg * rg + rb * rb + gb * gb)) / 6, 1e-60))
    determinant = r * (g * b - gb * gb) - rg * (rg * b - gb * rb) + rb * (rg * gb - g * rb)
    angle = np.arccos(np.clip(determinant / (2 * p**3), -1, 1)) / 3
    return np.asarray(q + 2 * p * np.cos(angle))

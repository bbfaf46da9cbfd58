"""Likelihood of windows' spectra where red and blue are a dual-pixel sensor's halves, whose noise is partly shared.

`readable.spectral_likelihood` takes every channel's noise to be its own. The halves of a pixel share noise, and noise
that is alike in all channels looks like detail in focus: walls without detail stood at the focus. Half the sum and half
the difference of red and blue::

    y_S = (y_R + y_B) / 2,   y_D = (y_R - y_B) / 2

have noise that is not correlated, and green, the halves' mean, tells nothing more. Both halves see the same colour, so
the power A of the texture is the only unknown of a window::

    C = A G + N,   G = h h^H + error |h_S|^2,   h = ((H_R + H_B) / 2, (H_R - H_B) / 2),   N = diag(N_S, N_D)

with G as the taper leaks it (`spectral_model`). With the eigenvalues g_k of N^-1/2 G N^-1/2 and the powers z_k of the
whitened spectra along its eigenvectors, the likelihood is::

    L = -sum_fk [ log(1 + A g_k) + z_k / (1 + A g_k) ]

and A maximises it at every layer, by Fisher's scoring in log A. The noise without texture, A = 0, tells no layer from
another. NumPy alone: only photographs of `color.shared_noise` use it.
"""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.matching.evidence.spectral_model import SpectralModel
from chromaperture.system.threads import parallel_map

# Of the noise variance that `color.shared_noise` measures, three times that of the finest frequencies of half
# the sum. Where photographs hold no detail, half the sum has 2.8 times the finest frequencies' power in the octave of
# sigmas .6 to 1.4 px and 3.8 times in that of 1.4 to 3.2 px (two photographs of the set, light of .25 to .56), half the
# difference 1.0 to 1.3 times in both: white noise of either half, and common noise smoothed by .7 px.
_FINEST = 1 / 3
_COMMON, _COMMON_SIGMA_PX = 3.2, 0.7
_OF_DIFFERENCE = 1.15
_LEAST_POWER = 1e-3  # of A, in units of the power at which the best frequency's texture is as strong as its noise
_ROUNDS = 8  # of scoring
_LONGEST_STEP = 1.5  # of log A; chosen by hand
_ALIKE_PX = 24.0  # sigma of the neighbourhood in which both halves have equal light: three tapers; chosen by hand
_LEAST_LIGHT = np.float32(1e-6)  # against division by 0
_TINY = np.finfo(np.float32).tiny


class HalvesModel(SpectralModel):
    """G of half the sum and half the difference of red and blue, in the order of `SpectralModel.powers`."""

    def _products(self, x: float, y: float) -> np.ndarray:
        at_infinity, scale = self.blur.reference
        rays = self.blur.rays(x, y)
        rows, columns = self._sources
        out = np.zeros((len(self.layers_px), 9, len(rows)), np.float32)
        for layer, products in zip(self.layers_px, out, strict=True):
            inverse_mm = (at_infinity - layer) / scale
            transfer = self.blur.transfer_of(rays, inverse_mm, self.size, transform=self.run.point_transforms)
            red, blue = transfer[0, rows, columns], transfer[2, rows, columns]
            both, apart = (red + blue) / 2, (red - blue) / 2
            products[:2] = np.abs(both) ** 2, np.abs(apart) ** 2
            cross = both * apart.conj()
            products[3:5] = cross.real, cross.imag
        return out


def of_equal_light(image: np.ndarray) -> np.ndarray:
    """Bring red and blue to green's light, which differs by shading; (H, W, 3) float32."""
    mean = np.maximum(cv2.GaussianBlur(image, (0, 0), _ALIKE_PX), _LEAST_LIGHT)
    return np.asarray(image * (mean[..., 1:2] / mean), np.float32)


def sum_and_difference(spectra: np.ndarray) -> np.ndarray:
    """Return half the sum and half the difference of red and blue; (M, 2, F) of (M, 3, F)."""
    red, blue = spectra[:, 0], spectra[:, 2]
    return np.stack([(red + blue) / 2, (red - blue) / 2], axis=1)


def noise_of_frequencies(radius: np.ndarray) -> np.ndarray:
    """Return the noise of half the sum and half the difference, in units of the measured variance; (2, F).

    ``radius`` (F,) float: frequencies, cycles a px.
    """
    common = _COMMON * np.exp(-((2 * np.pi * radius * _COMMON_SIGMA_PX) ** 2))
    return _FINEST * np.stack([1 + common, np.full_like(common, _OF_DIFFERENCE)])


def half_pixel_likelihood(
    spectra: np.ndarray,
    powers: np.ndarray,
    node: np.ndarray,
    noise: np.ndarray,
    of_frequencies: np.ndarray,
    *,
    channel_error: float,
) -> np.ndarray:
    """Sum the log-likelihood of windows over their frequencies, at every layer.

    ``spectra`` (M, 2, F) complex: of `sum_and_difference`; ``powers`` (K, D, 9, F) float32: of `HalvesModel`; ``node``
    (M,) int: of every window; ``noise`` (M,) float: variance of the noise as it was measured; ``of_frequencies`` (2, F)
    float: of `noise_of_frequencies`; ``channel_error``: fraction of the sum's power by which either is another than the
    blur says. Returns (M, D) float32, nats.
    """
    out = np.empty((len(spectra), powers.shape[1]), np.float32)
    floor = np.sqrt(of_frequencies)
    scale = np.maximum(np.asarray(noise, float), _TINY)
    whitened = spectra / (floor * np.sqrt(scale)[:, None, None])

    def of_node(k: int) -> None:
        here = np.flatnonzero(node == k)
        if here.size:
            gain, axes = _eigen(powers[k], floor, channel_error)
            seen = _along(whitened[here].astype(np.complex64), axes.astype(np.complex64))
            out[here] = _profile(seen, gain.astype(np.float32))

    parallel_map(of_node, range(len(powers)))
    return out


def _eigen(powers: np.ndarray, floor: np.ndarray, error: float) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (D, 2 F) and first eigenvectors (D, 2, F) of N^-1/2 G N^-1/2 at a node."""
    both, apart = powers[:, 0].astype(float), powers[:, 1].astype(float)
    a, b = (1 + error) * both / floor[0] ** 2, (apart + error * both) / floor[1] ** 2
    c = (powers[:, 3] + 1j * powers[:, 4].astype(float)) / (floor[0] * floor[1])
    middle, half = (a + b) / 2, np.sqrt(((a - b) / 2) ** 2 + np.abs(c) ** 2)
    # Of the two ways to write the first eigenvector that without a difference of numbers that are alike
    first = np.where(a >= b, half + (a - b) / 2, c)
    second = np.where(a >= b, c.conj(), half + (b - a) / 2)
    length = np.sqrt(np.abs(first) ** 2 + np.abs(second) ** 2)
    known = length > 0
    length = np.where(known, length, 1.0)
    axes = np.stack([np.where(known, first, 1.0) / length, np.where(known, second, 0.0) / length], axis=1)
    return np.concatenate([middle + half, np.maximum(middle - half, 0)], axis=1), axes


def _along(whitened: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Powers of whitened spectra (m, 2, F) along the eigenvectors of every layer and across; (m, D, 2 F)."""
    first, second = whitened[:, None, 0], whitened[:, None, 1]
    projected = axes[:, 0].conj() * first + axes[:, 1].conj() * second
    along = projected.real**2 + projected.imag**2
    total = (whitened.real**2 + whitened.imag**2).sum(axis=1)[:, None]
    return np.concatenate([along, np.maximum(total - along, 0)], axis=2)


def _profile(seen: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Log-likelihood of every layer at the most likely power of the texture; (m, D)."""
    least = np.log(_LEAST_POWER / np.maximum(gain.max(axis=1), _TINY))
    start = (seen.sum(axis=2) - seen.shape[2]) / np.maximum(gain.sum(axis=1), _TINY)
    power = np.maximum(np.log(np.maximum(start, _TINY)), least)
    for _ in range(_ROUNDS):
        noise = 1 / (1 + np.exp(power)[..., None] * gain)  # the noise's share; the texture's is what is left
        share = 1 - noise
        score = np.einsum("mdf,mdf->md", share, seen * noise - 1)
        step = score / np.maximum(np.einsum("mdf,mdf->md", share, share), _TINY)
        power = np.maximum(power + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP), least)
    noise = 1 / (1 + np.exp(power)[..., None] * gain)
    return np.asarray((np.log(noise) - seen * noise).sum(axis=2))

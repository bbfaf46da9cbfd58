"""Deconvolve all channels at once, layer by layer: fast, and the start of the joint solution.

With transfer functions H_k, noise n_k and a sharp picture whose channels have the covariance C S(w), the linear
estimate of least error is

    X = (H* N^-1 H + (C S)^-1)^-1 H* N^-1 Y,

a 3x3 matrix per frequency. The channels of a coded aperture have their zeros at different frequencies, and C lets one
channel restore what another has lost.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import scipy.fft

from chromaperture.effects.layered_model import Blur, blurred_layers

# Chosen by hand; not tuned.
_SAME_PX, _SAME_RADIUS = 0.8, 0.12  # blur radii that differ by less, px plus a fraction, are of one surface
_UNCORRELATED = 0.02  # variance of a channel that no other has, of the mean variance: bounds the inverse of C


def colour_covariance(image: np.ndarray) -> np.ndarray:
    """Return the covariance of the channels' fine structure, unit mean variance; (3, 3) float64.

    ``image`` (H, W, 3) float32, linear RGB, channels aligned.
    """
    smooth = cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), 1.5)
    detail = (smooth - cv2.GaussianBlur(smooth, (0, 0), 4.0)).reshape(-1, 3).astype(float)
    covariance = detail.T @ detail / len(detail)
    mean = float(np.trace(covariance)) / 3
    if mean <= 0:
        return np.eye(3)
    return np.asarray(covariance / mean + _UNCORRELATED * np.eye(3))


def natural_spectrum(shape: tuple[int, int]) -> np.ndarray:
    """Return the power spectrum 1 / f^2 of natural images, of unit variance; (h, w // 2 + 1) float64."""
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None]
    power = 1 / np.maximum(fx**2 + fy**2, 1 / max(shape) ** 2)
    weight = np.full(power.shape, 2.0)  # for the half that rfft2 omits
    weight[:, 0] = 1.0
    return np.asarray(power / (power * weight).sum() * (shape[0] * shape[1]))


def joint_filter(
    spectra: np.ndarray, otf: np.ndarray, *, noise_variance: np.ndarray, signal: np.ndarray, colour: np.ndarray
) -> np.ndarray:
    """Estimate the sharp spectra of three channels from blurred ones.

    ``spectra``, ``otf`` (3, h, w) complex; ``noise_variance`` (3,) or (3, h, w) float; ``signal`` (h, w) float: S:
    power of the sharp picture per frequency; ``colour`` (3, 3) float: C: covariance of its channels. Returns (3, h, w)
    complex64.
    """
    inverse = np.linalg.inv(colour)
    noise = np.asarray(noise_variance, float)
    weight = 1 / np.maximum(noise if noise.ndim == 3 else noise[:, None, None], 1e-12)
    right = np.conj(otf) * spectra * weight
    prior = 1 / np.maximum(signal, 1e-30)
    # A real symmetric 3x3 matrix a frequency, inverted by its adjugate.
    a, d, f = (np.abs(otf[k]) ** 2 * weight[k] + inverse[k, k] * prior for k in range(3))
    b, c, e = inverse[0, 1] * prior, inverse[0, 2] * prior, inverse[1, 2] * prior
    m00, m11, m22 = d * f - e * e, a * f - c * c, a * d - b * b
    m01, m02, m12 = c * e - b * f, b * e - c * d, b * c - a * e
    determinant = a * m00 + b * m01 + c * m02
    r, g, s = right
    out = np.stack([m00 * r + m01 * g + m02 * s, m01 * r + m11 * g + m12 * s, m02 * r + m12 * g + m22 * s])
    return np.asarray(out / determinant).astype(np.complex64)


def padded_size(shape: tuple[int, int], radius_px: np.ndarray) -> tuple[int, tuple[int, int]]:
    """Return a margin that prevents blur from wrapping round, and a padded size that is fast to transform."""
    pad = min(math.ceil(float(np.abs(radius_px).max())) + 8, min(shape) - 1)
    height, width = (scipy.fft.next_fast_len(n + 2 * pad, real=True) for n in shape)
    return pad, (int(height), int(width))


def mirrored(picture: np.ndarray, pad: int, size: tuple[int, int]) -> np.ndarray:
    """Extend a picture by its mirror image to the given size."""
    bottom, right = size[0] - picture.shape[0] - pad, size[1] - picture.shape[1] - pad
    # The margin below and to the right includes the few px that make the size a product of small primes.
    return np.asarray(cv2.copyMakeBorder(picture, pad, bottom, pad, right, borderType=cv2.BORDER_REFLECT))


def sharpen_layers(
    image: np.ndarray,
    radius_px: np.ndarray,
    blur: Blur,
    *,
    noise_variance: np.ndarray,
    colour: np.ndarray,
    kernel_error: float = 0.0,
) -> np.ndarray:
    """Deconvolve a picture layer by layer, and compose the layers by their weights.

    ``image`` (H, W, 3) float32, linear RGB, as captured but white balanced; ``radius_px`` (H, W) float32: signed blur
    radius, no NaN; ``noise_variance`` (3,) float; ``colour`` (3, 3) float: from `colour_covariance`; ``kernel_error``:
    error of the transfer functions where they are far from 1. It counts as noise of the picture's own spectrum, and
    prevents ringing at frequencies where all channels have their zeros. Returns (H, W, 3) float32.
    """
    pad, size = padded_size(radius_px.shape, radius_px)
    mean = image.mean(axis=(0, 1))
    padded = mirrored(image - mean, pad, size)
    radius = mirrored(radius_px, pad, size)
    signal = natural_spectrum(size) * float(image.var(axis=(0, 1)).mean()) + 1e-12
    error = kernel_error**2 * np.diag(colour)[:, None, None] * signal
    out = np.zeros_like(image)
    crop = np.s_[pad : pad + image.shape[0], pad : pad + image.shape[1]]
    with scipy.fft.set_workers(-1):
        for layer_px, weight, otf in blurred_layers(radius_px, blur, size):
            tolerance = np.float32(_SAME_PX + _SAME_RADIUS * abs(layer_px))
            surface = extrapolated(padded, np.abs(radius - np.float32(layer_px)) < tolerance)
            spectra = scipy.fft.rfft2(surface.transpose(2, 0, 1))
            # No blur, no error of the blur.
            noise = error * np.maximum(1 - np.abs(otf) ** 2, 0) + np.asarray(noise_variance)[:, None, None]
            sharp = joint_filter(spectra, otf, noise_variance=noise, signal=signal, colour=colour)
            picture = scipy.fft.irfft2(sharp, s=size).transpose(1, 2, 0)
            out += weight[..., None] * picture[crop]
    return np.maximum(out + mean, 0)


def extrapolated(picture: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Extrapolate a surface (H, W, 3) smoothly beyond what is ``known``, so that others do not ring in it.

    Push-pull (Gortler et al. 1996): known pixels are averaged down a pyramid; on the way up unknown pixels take the
    colour of the coarser level.
    """
    if known.all():
        return picture
    weight = known.astype(np.float32)
    levels: list[tuple[np.ndarray, np.ndarray]] = [(picture * weight[..., None], weight)]
    while min(levels[-1][1].shape) > 2 and levels[-1][1].min() < 0.5:
        weight = levels[-1][1]
        half = ((weight.shape[1] + 1) // 2, (weight.shape[0] + 1) // 2)
        color, weight = (np.asarray(cv2.resize(v, half, interpolation=cv2.INTER_AREA), np.float32) for v in levels[-1])
        # Full weight wherever anything is known, so that the next level reaches farther.
        gain = np.minimum(weight * 4, 1) / np.maximum(weight, 1e-6)
        levels.append((color * gain[..., None], weight * gain))
    color, weight = levels[-1]
    everywhere = color.sum(axis=(0, 1)) / max(float(weight.sum()), 1e-6)  # where even the coarsest level is empty
    filled = np.where(weight[..., None] > 1e-6, color / np.maximum(weight, 1e-6)[..., None], everywhere)
    for color, weight in reversed(levels[:-1]):
        up = cv2.resize(filled, weight.shape[::-1], interpolation=cv2.INTER_LINEAR)
        filled = color + (1 - weight[..., None]) * up
    return np.ascontiguousarray(filled, np.float32)

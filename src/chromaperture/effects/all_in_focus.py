"""Restore everything in focus: the sharp picture of which the capture is most probably a blurred copy.

All layers and all channels are solved for together, so that no layer rings into its neighbours:

    min_x  sum_k |y_k - (A x)_k|^2 / sigma_k^2  +  sum_p w_p sum_i (D_i x)_p^T C_p^-1 (D_i x)_p

D_i are differences to the right and downwards, C_p the covariance of the channels' differences around pixel p: a
small neighbourhood has its colours on a line, across which differences are improbable. The weights w_p are those of a
heavy-tailed prior |D x|^0.8, found by reweighting; each quadratic problem is solved by conjugate gradients.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft
from scipy.sparse.linalg import LinearOperator, cg

from chromaperture.effects.layered_model import Blur, LayeredModel, blurred_layers
from chromaperture.system.errors import InputError

# Chosen by hand; not tuned.
_SAME_PX, _SAME_RADIUS = 0.8, 0.12  # blur radii that differ by less, px plus a fraction, are of one surface
_UNCORRELATED = 0.02  # variance of a channel that no other has, of the mean variance: bounds the inverse of C


def colour_covariance(image: np.ndarray) -> np.ndarray:
    """Return the covariance of the fine structure of aligned channels, unit mean variance; (3, 3)."""
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
    """Estimate the sharp spectra (3, h, w) of three channels by their noise, signal and colour covariance."""
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
    """Extrapolate a surface smoothly beyond what is ``known`` by push-pull (Gortler et al. 1996)."""
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


# Chosen by hand; not tuned.
_PRIOR_EXPONENT = 0.8  # of the gradients' size: 2 is Gaussian, below 1 favours few strong edges
_COLOUR_SIGMA_PX = 4.0  # standard deviation of the window over which a colour line is estimated
_ITERATIONS = 10  # conjugate gradients in each round
_RADIUS_ERROR_PX, _RADIUS_ERROR = 0.5, 0.08  # error of the blur radius, px and relative, at which a pixel weighs half
_CONTRAST_PX, _JUMP_PX = 9, 5  # sides of the windows of the local contrast, and of the jumps of the blur radius
_COLOUR_FLOOR = 0.05  # variance across the colour line, of the mean variance: bounds the inverse
_GRADIENT_FLOOR = 0.02  # squared gradient, of its mean, below which the prior is quadratic: bounds its curvature


@dataclass(frozen=True)
class SharpenConfig:
    """Settings of the restoration; chosen by hand unless a measurement is stated."""

    # Error of the blur model as a fraction of the local contrast: kernels are never known exactly.
    model_error: float = 0.25
    kernel_error: float = 0.15  # error of the transfer functions; docs/colour.md shows which fit which design
    reweightings: int = 3  # outer rounds; 0 return the layered Wiener estimate


def all_in_focus(
    image: np.ndarray,
    radius_px: np.ndarray,
    blur: Blur,
    *,
    noise_variance: np.ndarray,
    aligned: np.ndarray,
    radius_sigma_px: np.ndarray | None = None,
    saturated: np.ndarray | None = None,
    config: SharpenConfig | None = None,
) -> np.ndarray:
    """Restore the sharp picture in the view of the pupil's centre; (H, W, 3) float32, linear RGB.

    ``image`` (H, W, 3): the capture, white balanced, channels not aligned; ``radius_px`` (H, W): signed blur radius, +
    beyond focus, no NaN, with ``radius_sigma_px``; ``noise_variance`` (3,): of the white-balanced image; ``aligned``:
    the capture with its channels aligned, source of the colour lines, and kept where the blur is uncertain;
    ``saturated`` (H, W) bool: clipped pixels, lower bounds only, get no weight. Raises InputError: the maps differ in
    size, or the blur radius is not known everywhere.
    """
    config = config or SharpenConfig()
    if image.shape[:2] != radius_px.shape or aligned.shape != image.shape:
        raise InputError(f"image {image.shape[:2]} and depth {radius_px.shape} differ in size: of two photographs")
    if not np.isfinite(radius_px).all():
        raise InputError("the blur radius must be known everywhere; fill the holes of the disparity first")
    misfit = np.float32(config.model_error**2) * local_variance(aligned, _CONTRAST_PX)
    noise = np.asarray(noise_variance, float) + misfit.mean(axis=(0, 1))
    start = sharpen_layers(
        image, radius_px, blur, noise_variance=noise, colour=colour_covariance(aligned),
        kernel_error=config.kernel_error,
    )  # fmt: skip
    certain = certainty(radius_px, radius_sigma_px)
    start = certain[..., None] * start + (1 - certain[..., None]) * aligned
    if config.reweightings == 0:
        return start
    pad, size = padded_size(radius_px.shape, radius_px)
    model = LayeredModel(mirrored(radius_px.astype(np.float32), pad, size), blur)
    y, x, guide = (_planes(mirrored(v, pad, size)) for v in (image, start, aligned))
    variance = _planes(mirrored(misfit + np.asarray(noise_variance, np.float32), pad, size))
    precision = model.data_weight * mirrored(certain, pad, size) / variance
    crop = np.s_[pad : pad + image.shape[0], pad : pad + image.shape[1]]
    measured = np.zeros(size, np.float32)  # 0 in the margin
    measured[crop] = 1
    if saturated is not None:
        measured *= mirrored(1 - np.asarray(saturated, np.float32), pad, size)
    precision *= measured
    # At depth edges a layer's own estimate rings, and few data would correct it: start from the blurred picture.
    smooth_weight = cv2.GaussianBlur(model.data_weight.min(axis=0), (0, 0), 1.0) ** 2
    x = smooth_weight * x + (1 - smooth_weight) * guide
    solution = _solved(model, y, precision, x, guide, rounds=config.reweightings)
    return np.ascontiguousarray(solution[:, *crop].transpose(1, 2, 0))


def _solved(
    model: LayeredModel, capture: np.ndarray, precision: np.ndarray, x: np.ndarray, guide: np.ndarray, *, rounds: int
) -> np.ndarray:
    """Minimise the sum above from a start x, all (3, H, W) float32."""
    metric, scale = colour_lines(guide, sigma_px=_COLOUR_SIGMA_PX)
    right, shape = model.adjoint(precision * capture), x.shape
    for _ in range(rounds):
        weight = _weights(x, metric, scale)

        def normal(v: np.ndarray, weight: np.ndarray = weight) -> np.ndarray:
            v = v.reshape(shape)
            return (model.adjoint(precision * model.forward(v)) + smoothness(v, metric, weight)).ravel()

        # A fixed number of steps from a good start; atol only stops at a residual of 0, by which the next would divide.
        x = cg(
            LinearOperator((x.size, x.size), normal, dtype=np.float32), right.ravel(), x.ravel(),
            rtol=0.0, atol=float(np.finfo(np.float32).tiny), maxiter=_ITERATIONS,
        )[0].reshape(shape)  # fmt: skip
        np.maximum(x, 0, out=x)
    return x


def local_variance(values: np.ndarray, side_px: int) -> np.ndarray:
    """Return the variance of each channel in a window around every pixel; (H, W, 3) or (H, W) float32."""
    mean = cv2.boxFilter(values, -1, (side_px, side_px))
    return np.maximum(cv2.boxFilter(values * values, -1, (side_px, side_px)) - mean * mean, 0)


def certainty(radius_px: np.ndarray, sigma_px: np.ndarray | None) -> np.ndarray:
    """Return the weight of a blur radius: low where it is noisy or jumps; (H, W) float32 in [0, 1]."""
    radius = np.asarray(radius_px, np.float32)
    variance = local_variance(radius, _JUMP_PX)
    if sigma_px is not None:
        variance = variance + np.square(np.asarray(sigma_px, np.float32))
    # A large blur tolerates more: the error relative to it counts.
    allowed = np.float32(_RADIUS_ERROR_PX) ** 2 + (np.float32(_RADIUS_ERROR) * radius) ** 2
    return np.asarray(1 / (1 + variance / allowed), np.float32)


def colour_lines(guide: np.ndarray, *, sigma_px: float) -> tuple[np.ndarray, float]:
    """Return the inverse covariance of the channels' differences, (3, 3, H, W), and their mean square."""
    steps = [[cv2.GaussianBlur(p, (0, 0), 0.7) for p in d] for d in _differences(guide)]
    covariance = np.empty((3, 3, *guide.shape[1:]), np.float64)
    for i in range(3):
        for j in range(i, 3):
            product = sum(cv2.GaussianBlur(s[i] * s[j], (0, 0), sigma_px) for s in steps)
            covariance[i, j] = covariance[j, i] = product
    mean = np.trace(covariance) / 3
    scale = max(float(mean.mean()), 1e-10)
    covariance /= np.maximum(mean, 1e-3 * scale)
    covariance += _COLOUR_FLOOR * np.eye(3)[..., None, None]
    inverse = np.linalg.inv(covariance.transpose(2, 3, 0, 1)).transpose(2, 3, 0, 1)
    return np.ascontiguousarray(inverse, np.float32), scale


def smoothness(v: np.ndarray, metric: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the gradient of half the prior, sum_i D_i^T w C^-1 D_i v; (3, H, W) float32."""
    a, b = (weight * np.einsum("ijhw,jhw->ihw", metric, d) for d in _differences(v))
    out = -a - b
    out[..., 1:] += a[..., :-1]
    out[:, 1:] += b[:, :-1]
    return out


def _weights(x: np.ndarray, metric: np.ndarray, scale: float) -> np.ndarray:
    """Return the curvature of |D x|^p at the present differences; (H, W) float32."""
    squares = sum(np.einsum("ihw,ijhw,jhw->hw", d, metric, d) for d in _differences(x)) / np.float32(3 * scale)
    power = (_PRIOR_EXPONENT - 2) / 2
    return np.asarray(1 / scale * (squares + _GRADIENT_FLOOR) ** power, np.float32)


def _differences(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the differences to the right and downwards, 0 at the last column and row."""
    right, down = np.zeros_like(v), np.zeros_like(v)
    right[..., :-1] = v[..., 1:] - v[..., :-1]
    down[:, :-1] = v[:, 1:] - v[:, :-1]
    return right, down


def _planes(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.asarray(picture, np.float32).transpose(2, 0, 1))

"""Everything in focus: the sharp picture that the capture is most probably a blurred copy of.

All layers and all channels are solved for together, so that no layer rings into its neighbours:

    min_x  sum_k |y_k - (A x)_k|^2 / sigma_k^2  +  sum_p w_p sum_i (D_i x)_p^T C_p^-1 (D_i x)_p

D_i are differences to the right and downwards, C_p the covariance of the channels' differences around pixel p: a
small neighbourhood has its colours on a line, across which differences are improbable. The weights w_p are those of a
heavy-tailed prior |D x|^0.8, found by reweighting; each quadratic problem is solved by conjugate gradients.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from chromaperture.effects.layered_model import LayeredModel
from chromaperture.effects.transfer_functions import Blur
from chromaperture.effects.wiener import colour_covariance, mirrored, padded_size, sharpen_layers
from chromaperture.errors import InputError

_DOUBT_PX, _DOUBT_SHARE = 0.5, 0.08  # error of the blur radius at which a pixel counts half
_CONTRAST_PX = 9

Map = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class SharpenConfig:
    """Settings of the restoration.

    Attributes
    ----------
    prior_exponent : float
        Of the gradients' size: 2 is Gaussian, below 1 favours few strong edges.
    prior_weight : float
        1 takes the differences to be as large as the capture's own.
    model_error : float
        What the blur model is wrong by, as a share of the local contrast: kernels are never known exactly.
    kernel_error : float
        What the transfer functions are wrong by.
    colour_sigma_px : float
        Reach of a colour line.
    reweightings, iterations : int
        Outer rounds, and conjugate gradients in each; 0 rounds give the layered Wiener estimate.
    """

    prior_exponent: float = 0.8
    prior_weight: float = 1.0
    model_error: float = 0.25
    kernel_error: float = 0.15
    colour_sigma_px: float = 4.0
    reweightings: int = 3
    iterations: int = 10


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
    center: tuple[float, float] | None = None,
) -> np.ndarray:
    """Restore the sharp picture in the view of the pupil's centre.

    Parameters
    ----------
    image : (H, W, 3) float32, linear RGB
        The capture, white balanced, channels where they fell.
    radius_px : (H, W) float32, px
        Signed blur radius of every pixel, + beyond focus; no NaN.
    blur : Blur
    noise_variance : (3,) float
        Of the white-balanced image.
    aligned : (H, W, 3) float32
        The capture with its channels aligned: tells the colour lines, and stays where the blur is in doubt.
    radius_sigma_px : (H, W) float32, optional
        Standard deviation of the blur radius.
    saturated : (H, W) bool, optional
        Clipped pixels of the capture, which only say "at least this much": they are no data.
    config : SharpenConfig, optional
    center : (x, y), optional
        Of this picture in the frame, -1 to 1.

    Returns
    -------
    (H, W, 3) float32, linear RGB

    Raises
    ------
    InputError
        The maps differ in size, or the blur radius is not known everywhere.
    """
    config = config or SharpenConfig()
    if image.shape[:2] != radius_px.shape or aligned.shape != image.shape:
        raise InputError(f"image {image.shape[:2]} and depth {radius_px.shape} differ in size: of two photographs")
    if not np.isfinite(radius_px).all():
        raise InputError("the blur radius must be known everywhere; fill the holes of the disparity first")
    misfit = np.float32(config.model_error**2) * local_variance(aligned)
    noise = np.asarray(noise_variance, float) + misfit.mean(axis=(0, 1))
    start = sharpen_layers(
        image, radius_px, blur, noise_variance=noise, colour=colour_covariance(aligned),
        kernel_error=config.kernel_error, center=center,
    )  # fmt: skip
    sure = certainty(radius_px, radius_sigma_px)
    start = sure[..., None] * start + (1 - sure[..., None]) * aligned
    if config.reweightings == 0:
        return start
    pad, size = padded_size(radius_px.shape, radius_px)
    model = LayeredModel(mirrored(radius_px.astype(np.float32), pad, size), blur, center=center)
    y, x, guide = (_planes(mirrored(v, pad, size)) for v in (image, start, aligned))
    trust = model.trust
    variance = _planes(mirrored(misfit + np.asarray(noise_variance, np.float32), pad, size))
    precision = trust * mirrored(sure, pad, size) / variance
    # At depth edges a layer's own estimate rings, and little data would correct it: start from the blurred picture.
    sure = cv2.GaussianBlur(trust.min(axis=0), (0, 0), 1.0) ** 2
    x = sure * x + (1 - sure) * guide
    inside = np.zeros(size, np.float32)  # what lies outside the frame was not measured
    inside[pad : pad + image.shape[0], pad : pad + image.shape[1]] = 1
    if saturated is not None:
        inside *= mirrored(1 - np.asarray(saturated, np.float32), pad, size)
    precision *= inside
    metric, scale = colour_lines(guide, sigma_px=config.colour_sigma_px)
    right = model.adjoint(precision * y)
    for _ in range(config.reweightings):
        weight = _weights(x, metric, scale, config)

        def normal(v: np.ndarray, weight: np.ndarray = weight) -> np.ndarray:
            return model.adjoint(precision * model.forward(v)) + smoothness(v, metric, weight)

        x = conjugate_gradients(normal, right, x, iterations=config.iterations)
        np.maximum(x, 0, out=x)
    crop = x[:, pad : pad + image.shape[0], pad : pad + image.shape[1]]
    return np.ascontiguousarray(crop.transpose(1, 2, 0))


def local_variance(picture: np.ndarray) -> np.ndarray:
    """Variance of each channel around every pixel; (H, W, 3) float32."""
    mean = cv2.boxFilter(picture, -1, (_CONTRAST_PX, _CONTRAST_PX))
    return np.maximum(cv2.boxFilter(picture * picture, -1, (_CONTRAST_PX, _CONTRAST_PX)) - mean * mean, 0)


def certainty(radius_px: np.ndarray, sigma_px: np.ndarray | None) -> np.ndarray:
    """How far a blur radius can be relied on: little where it is noisy or jumps; (H, W) float32 in [0, 1]."""
    radius = np.asarray(radius_px, np.float32)
    mean = cv2.boxFilter(radius, -1, (5, 5))
    doubt = np.maximum(cv2.boxFilter(radius * radius, -1, (5, 5)) - mean * mean, 0)
    if sigma_px is not None:
        doubt = doubt + np.square(np.asarray(sigma_px, np.float32))
    # A large blur forgives more: what counts is the error relative to it.
    allowed = np.float32(_DOUBT_PX) ** 2 + (np.float32(_DOUBT_SHARE) * radius) ** 2
    return np.asarray(1 / (1 + doubt / allowed), np.float32)


def colour_lines(guide: np.ndarray, *, sigma_px: float) -> tuple[np.ndarray, float]:
    """Inverse covariance of the channels' differences around every pixel, and the differences' mean square.

    Parameters
    ----------
    guide : (3, H, W) float32

    Returns
    -------
    (3, 3, H, W) float32, of unit mean variance; float, (white level)^2
    """
    steps = [_smooth(d, 0.7) for d in (_right(guide), _down(guide))]
    covariance = np.empty((3, 3, *guide.shape[1:]), np.float64)
    for i in range(3):
        for j in range(i, 3):
            product = sum(cv2.GaussianBlur(s[i] * s[j], (0, 0), sigma_px) for s in steps)
            covariance[i, j] = covariance[j, i] = product
    mean = np.trace(covariance) / 3
    scale = max(float(mean.mean()), 1e-10)
    covariance /= np.maximum(mean, 1e-3 * scale)
    covariance += 0.05 * np.eye(3)[..., None, None]
    inverse = np.linalg.inv(covariance.transpose(2, 3, 0, 1)).transpose(2, 3, 0, 1)
    return np.ascontiguousarray(inverse, np.float32), scale


def smoothness(v: np.ndarray, metric: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Gradient of half the prior: sum_i D_i^T w C^-1 D_i v; (3, H, W) float32."""
    a, b = (weight * np.einsum("ijhw,jhw->ihw", metric, d) for d in (_right(v), _down(v)))
    out = -a - b
    out[..., 1:] += a[..., :-1]
    out[:, 1:] += b[:, :-1]
    return out


def conjugate_gradients(normal: Map, right: np.ndarray, start: np.ndarray, *, iterations: int) -> np.ndarray:
    """Solve normal(x) = right for a symmetric positive map, a few steps from a good start."""
    x = start.astype(np.float32)
    residual = right - normal(x)
    direction = residual.copy()
    energy = float(np.vdot(residual, residual).real)
    for _ in range(iterations):
        if energy <= 0:
            break
        image = normal(direction)
        step = np.float32(energy / max(float(np.vdot(direction, image).real), 1e-30))
        x += step * direction
        residual -= step * image
        left = float(np.vdot(residual, residual).real)
        direction = residual + np.float32(left / energy) * direction
        energy = left
    return x


def _weights(x: np.ndarray, metric: np.ndarray, scale: float, config: SharpenConfig) -> np.ndarray:
    """Curvature of |D x|^p at the present differences; (H, W) float32."""
    squares = sum(np.einsum("ihw,ijhw,jhw->hw", d, metric, d) for d in (_right(x), _down(x))) / np.float32(3 * scale)
    power = (config.prior_exponent - 2) / 2
    return np.asarray(config.prior_weight / scale * (squares + 0.02) ** power, np.float32)


def _right(v: np.ndarray) -> np.ndarray:
    out = np.zeros_like(v)
    out[..., :-1] = v[..., 1:] - v[..., :-1]
    return out


def _down(v: np.ndarray) -> np.ndarray:
    out = np.zeros_like(v)
    out[:, :-1] = v[:, 1:] - v[:, :-1]
    return out


def _smooth(planes: np.ndarray, sigma: float) -> np.ndarray:
    return np.stack([cv2.GaussianBlur(p, (0, 0), sigma) for p in planes])


def _planes(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.asarray(picture, np.float32).transpose(2, 0, 1))

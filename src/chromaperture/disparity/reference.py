"""The whole matcher in plain NumPy: slow, readable, and the oracle of ``kernels.py``.

Shifted views are correlated in an exponentially weighted window; the score volume is smoothed by a recursive
bilateral filter; the best layer is refined by a parabola. The picture goes on for ever beyond its border with the
border's value: then windows and shifts commute and a correlation never leaves [-1, 1].
"""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from chromaperture.config import MatcherConfig
from chromaperture.disparity.views import MatchInputs, view_pairs
from chromaperture.disparity.winner import Winner, parabola_winner

MIN_VARIANCE_SHARE = 0.05  # noise debiasing never takes more of a variance than leaves this share
RELATIVE_EPSILON = 1e-6  # of a view's overall variance: even areas score 0, not noise / noise
MIN_WEIGHT = 1e-4


def match(inputs: MatchInputs, config: MatcherConfig) -> Winner:
    """Match the views; see `chromaperture.disparity.views.MatchInputs` for shapes and units."""
    score = score_volume(inputs, config)
    weights = texture_weights(inputs, config)
    if config.bilateral_sigma_px > 0:
        score = recursive_bilateral(score, inputs.guide, weights, config.bilateral_sigma_px)
    return parabola_winner(score, inputs.layers_px)


def score_volume(inputs: MatchInputs, config: MatcherConfig) -> np.ndarray:
    """Score every layer: the correlation of two views, or 1 - sqrt(det) of the correlation matrix of three.

    Returns
    -------
    (H, W, D) float64
    """
    height, width, view_count = inputs.views.shape
    pad = padding(inputs)
    padded = _pad(inputs.views.astype(np.float64), pad)
    noise = _pad(inputs.noise_variance.astype(np.float64), pad)
    covariance = _pad(inputs.noise_covariance.astype(np.float64), pad)
    epsilon = variance_floor(inputs.views)

    volume = np.empty((height, width, len(inputs.layers_px)))
    for s, d in enumerate(inputs.layers_px):
        moved = [shift(padded[..., k], d * inputs.directions[k]) for k in range(view_count)]
        means = [exponential_window(m, config.window_decay) for m in moved]
        gains = []
        for k in range(view_count):
            variance = exponential_window(moved[k] ** 2, config.window_decay) - means[k] ** 2
            noise_k = shift(noise[..., k], d * inputs.directions[k]) * config.noise_debiasing
            clean = np.maximum(variance - noise_k, MIN_VARIANCE_SHARE * variance)
            gains.append(1 / np.sqrt(clean + epsilon[k]))
        rho = []
        for p, (k, m) in enumerate(view_pairs(view_count)):
            cross = exponential_window(moved[k] * moved[m], config.window_decay) - means[k] * means[m]
            cross -= covariance[..., p] * inputs.noise_overlap[s, p] * config.noise_debiasing
            rho.append(np.clip(cross * gains[k] * gains[m], -1, 1))
        layer = rho[0] if view_count == 2 else three_view_score(*rho)
        volume[..., s] = layer[pad[1] : pad[1] + height, pad[0] : pad[0] + width]
    return volume


def three_view_score(r01: np.ndarray, r02: np.ndarray, r12: np.ndarray) -> np.ndarray:
    """Give 1 - sqrt(det R) of three views' correlation matrix; 1 on a colour line, 0 without any correlation.

    Two eigenvalues of R vanish together where the views agree, so det R has a minimum of fourth order there, whose
    parabola locks to the layers (by 0.05 px at a step of 0.5); its root has one of second order.
    """
    determinant = 1 + 2 * r01 * r02 * r12 - r01**2 - r02**2 - r12**2
    return 1 - np.sqrt(np.maximum(determinant, 0))


def texture_weights(inputs: MatchInputs, config: MatcherConfig) -> np.ndarray:
    """Weight of each pixel in the aggregation: texture against noise, 0 where the capture is unusable; (H, W)."""
    weights = np.ones(inputs.mask.shape)
    if config.texture_weighting:
        count = inputs.views.shape[2]
        for k in range(count):
            view = inputs.views[..., k].astype(np.float64)
            mean = exponential_window(view, config.window_decay)
            variance = exponential_window(view**2, config.window_decay) - mean**2
            noise = inputs.noise_variance[..., k].astype(np.float64)
            signal = np.maximum(variance - noise, 0)
            weights *= (signal / (signal + noise + variance_floor(inputs.views)[k])) ** (1 / count)
    return np.maximum(weights * inputs.mask, MIN_WEIGHT)


def variance_floor(views: np.ndarray) -> np.ndarray:
    """Variance below which a view counts as even; (K,) float64."""
    return RELATIVE_EPSILON * views.astype(np.float64).var(axis=(0, 1)) + 1e-30


def padding(inputs: MatchInputs) -> tuple[int, int]:
    """Border (x, y) in px beyond which every shifted view is constant."""
    reach = np.abs(inputs.layers_px).max() * np.abs(inputs.directions).max(axis=0)
    x, y = (math.ceil(r) + 2 if r > 0 else 0 for r in reach)
    return x, y


def _pad(maps: np.ndarray, pad: tuple[int, int]) -> np.ndarray:
    return np.pad(maps, ((pad[1], pad[1]), (pad[0], pad[0]), (0, 0)), mode="edge")


def shift(view: np.ndarray, offset_px: np.ndarray) -> np.ndarray:
    """Sample ``view`` at x + offset by cubic convolution (Catmull-Rom), borders replicated.

    Parameters
    ----------
    view : (H, W) float
    offset_px : (2,) float, (x, y)
    """
    for axis, offset in ((1, offset_px[0]), (0, offset_px[1])):
        whole = math.floor(offset)
        taps = cubic_taps(offset - whole)
        index = np.arange(view.shape[axis])
        view = sum(
            tap * np.take(view, np.clip(index + whole + i, 0, view.shape[axis] - 1), axis=axis)
            for i, tap in zip((-1, 0, 1, 2), taps, strict=True)
        )
    return view


def cubic_taps(t: float) -> tuple[float, float, float, float]:
    """Catmull-Rom weights of the samples at -1, 0, 1, 2 for the point t in [0, 1)."""
    return (
        0.5 * (-t + 2 * t**2 - t**3),
        0.5 * (2 - 5 * t**2 + 3 * t**3),
        0.5 * (t + 4 * t**2 - 3 * t**3),
        0.5 * (-(t**2) + t**3),
    )


def exponential_window(maps: np.ndarray, decay: float) -> np.ndarray:
    """Average with the weights ((1-a)/(1+a))^2 a^(|x|+|y|), the picture continued beyond its border.

    Two first-order recursions an axis; their start values are the exact response to an endless constant border.
    """
    for axis in (0, 1):
        first = np.take(maps, [0], axis=axis)
        last = np.take(maps, [-1], axis=axis)
        forward, _ = lfilter([1 - decay], [1, -decay], maps, axis=axis, zi=decay * first)
        end = last + (np.take(forward, [-1], axis=axis) - last) / (1 + decay)
        # Backward over the samples before the last one, started from the closed form at the last.
        body = np.flip(np.delete(forward, -1, axis=axis), axis=axis)
        back, _ = lfilter([1 - decay], [1, -decay], body, axis=axis, zi=decay * end)
        maps = np.concatenate([np.flip(back, axis=axis), end], axis=axis)
    return maps


def recursive_bilateral(
    score: np.ndarray, guide: np.ndarray, weights: np.ndarray, sigma_px: float
) -> np.ndarray:
    """Smooth each layer along paths on which the guide is even (Yang, ECCV 2012).

    The weight of a neighbour falls by ``exp(-sqrt(2) / sigma_px)`` a px and by ``exp(-|difference of the guide|)``.

    Parameters
    ----------
    score : (H, W, D) float
    guide : (H, W) float, in units of the range sigma
    weights : (H, W) float, > 0
    sigma_px : float
    """
    numerator = _two_way(_two_way(score * weights[..., None], guide, sigma_px, axis=1), guide, sigma_px, axis=0)
    denominator = _two_way(_two_way(weights[..., None], guide, sigma_px, axis=1), guide, sigma_px, axis=0)
    return numerator / denominator


def link_weights(guide: np.ndarray, sigma_px: float, axis: int) -> np.ndarray:
    """Weight with which a sample hears the one before it along an axis; one shorter than the guide there."""
    return math.exp(-math.sqrt(2) / sigma_px) * np.exp(-np.abs(np.diff(guide.astype(np.float64), axis=axis)))


def _two_way(maps: np.ndarray, guide: np.ndarray, sigma_px: float, *, axis: int) -> np.ndarray:
    """Sum of the forward and the backward recursion along an axis; an end sample stands for itself."""
    gain = 1 - math.exp(-math.sqrt(2) / sigma_px)
    x = np.moveaxis(maps, axis, 0)
    link = np.moveaxis(link_weights(guide, sigma_px, axis), axis, 0)[..., None]
    forward, backward = x.astype(np.float64).copy(), x.astype(np.float64).copy()
    for i in range(1, len(x)):
        forward[i] = gain * x[i] + link[i - 1] * forward[i - 1]
    for i in range(len(x) - 2, -1, -1):
        backward[i] = gain * x[i] + link[i] * backward[i + 1]
    return np.moveaxis(forward + backward, 0, axis)

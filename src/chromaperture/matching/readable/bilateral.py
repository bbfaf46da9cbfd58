"""Recursive bilateral filter over the scores, and the best layer, in NumPy: the oracle of ``compiled/bilateral.py``."""

from __future__ import annotations

import math

import numpy as np

from chromaperture.matching.labels import Winner, parabola_winner
from chromaperture.matching.readable.correlation import MIN_WEIGHT, correlate, texture_weights
from chromaperture.matching.views import Views
from chromaperture.settings.stages import BilateralConfig, CorrelationConfig


def bilateral_winner(
    views: Views, layers_px: np.ndarray, *, correlation: CorrelationConfig, bilateral: BilateralConfig
) -> Winner:
    """Correlate the views, filter every layer, take the best layer and refine it by a parabola.

    Parameters
    ----------
    views : Views
    layers_px : (D,) float, px
    correlation : CorrelationConfig
    bilateral : BilateralConfig
    """
    score = correlate(views, layers_px, config=correlation)
    if bilateral.sigma_px > 0:
        weights = np.maximum(views.mask, MIN_WEIGHT)
        if bilateral.texture_weighting:
            weights = texture_weights(views, config=correlation)
        score = recursive_bilateral(score, views.guide, weights, bilateral.sigma_px)
    return parabola_winner(score, layers_px)


def recursive_bilateral(score: np.ndarray, guide: np.ndarray, weights: np.ndarray, sigma_px: float) -> np.ndarray:
    """Smooth each layer along paths on which the guide is even (Yang, ECCV 2012).

    The weight of a neighbour falls by ``exp(-sqrt(2) / sigma_px)`` a px and by ``exp(-|difference of the guide|)``.

    ``score`` (H, W, D) float; ``guide`` (H, W) float, in units of ``guide_range``; ``weights`` (H, W) float, > 0.
    """
    numerator = _both_ways(_both_ways(score * weights[..., None], guide, sigma_px, axis=1), guide, sigma_px, axis=0)
    denominator = _both_ways(_both_ways(weights[..., None], guide, sigma_px, axis=1), guide, sigma_px, axis=0)
    return numerator / denominator


def even_link(sigma_px: float) -> float:
    """Weight of the link between two neighbours on an even guide, for a reach; 0 switches the filter off."""
    return math.exp(-math.sqrt(2) / sigma_px) if sigma_px > 0 else 0.0


def link_weights(guide: np.ndarray, sigma_px: float, axis: int) -> np.ndarray:
    """Weight of the link from each sample to the one before it along an axis; one shorter than the guide there."""
    return even_link(sigma_px) * np.exp(-np.abs(np.diff(guide.astype(np.float64), axis=axis)))


def _both_ways(maps: np.ndarray, guide: np.ndarray, sigma_px: float, *, axis: int) -> np.ndarray:
    """Sum of the forward and the backward recursion along an axis; the sample at an end has no gain."""
    gain = 1 - even_link(sigma_px)
    x = np.moveaxis(maps, axis, 0)
    link = np.moveaxis(link_weights(guide, sigma_px, axis), axis, 0)[..., None]
    forward, backward = x.astype(np.float64).copy(), x.astype(np.float64).copy()
    for i in range(1, len(x)):
        forward[i] = gain * x[i] + link[i - 1] * forward[i - 1]
    for i in range(len(x) - 2, -1, -1):
        backward[i] = gain * x[i] + link[i] * backward[i + 1]
    return np.moveaxis(forward + backward, 0, axis)

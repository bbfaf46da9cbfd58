"""From the shape of the score's peak to an error bar and a confidence (``docs/equations.md``)."""

from __future__ import annotations

import math

import numpy as np

from chromaperture.config import MatcherConfig
from chromaperture.disparity.winner import Winner

CONFIDENCE_SCALE_PX = 0.25
MAX_SIGMA_PX = 4.0


def disparity_sigma(
    winner: Winner, config: MatcherConfig, view_count: int, signal_share: np.ndarray | None = None
) -> np.ndarray:
    """Give the standard deviation of the disparity, px; NaN where the disparity is unknown.

    Gaussian signals of correlation determinant D have the log-likelihood -(N/2) ln D, so the variance is
    ``2 / (N (ln D)'')``: for two views ``(1 - rho^2) / (N rho kappa)``, for three, with the
    score S = 1 - sqrt(D), ``(1 - S) / (N kappa)``. These are correlations of the views as they are, noise included.
    ``config.sigma_scale`` widens the bar; an optimiser's winner brings the width of its posterior instead.

    Parameters
    ----------
    winner : Winner
    config : MatcherConfig
    view_count : int
        2 or 3.
    signal_share : (H, W) float, optional
        Texture's share of the views' variance, where the scores were cleaned of noise: what the noise would have
        lowered the correlations by.

    Returns
    -------
    (H, W) float32, px
    """
    if winner.spread_px is not None:
        floor = 0.0 if config.coarse is None else config.coarse.floor_px
        spread = np.minimum(np.hypot(winner.spread_px, np.float32(floor)), MAX_SIGMA_PX)
        return np.where(np.isfinite(winner.disparity_px), spread, np.nan).astype(np.float32)
    samples = effective_samples(config.window_decay) / noise_correlation_factor(config.presmooth_sigma_px)
    share = np.float32(1) if signal_share is None else np.asarray(signal_share, np.float32)
    peak = np.clip(winner.peak, 1e-3, 1 - 1e-6)
    curvature = np.maximum(winner.curvature, 1e-9) * share
    if view_count == 2:
        raw = peak * share
        variance = (1 - raw**2) / (samples * raw * curvature)
    else:
        # sqrt(D) of three views alike but for their noise: eigenvalues 1 + 2 share, 1 - share, 1 - share.
        noise = (1 - share) * np.sqrt(1 + 2 * share)
        variance = (1 - peak + noise) / (samples * curvature)
    sigma = np.minimum(config.sigma_scale * np.sqrt(variance), MAX_SIGMA_PX)
    return np.where(np.isfinite(winner.disparity_px), sigma, np.nan).astype(np.float32)


def effective_samples(decay: float) -> float:
    """Independent samples in the exponential window, both axes together."""
    return ((1 + decay) ** 3 / ((1 - decay) * (1 + decay**2))) ** 2


def noise_correlation_factor(presmooth_sigma_px: float) -> float:
    """How many px share one independent noise sample after the pre-smoothing."""
    return max(1.0, 0.8 * 4 * math.pi * presmooth_sigma_px**2 * 0.57)


def confidence(sigma_px: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Confidence in [0, 1]: 1 for a sharp, high peak; 0 where unknown; (H, W) float32."""
    value = np.exp(-sigma_px / CONFIDENCE_SCALE_PX) * np.clip(peak, 0, 1)
    return np.nan_to_num(value, nan=0.0).astype(np.float32)

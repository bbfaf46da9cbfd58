"""The types of all methods: noise in, disparity out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from chromaperture.color.noise import estimate_noise_variance


class NoiseModel(NamedTuple):
    """Noise of a sensor's images."""

    # From an image (H, W, 3) to the noise variance of its channels, (H, W, 3), (white level)^2.
    variance: Callable[[np.ndarray], np.ndarray]
    # From the sensor's electrons; else estimated in the image, whose fine texture then counts as noise: good enough for
    # weights, but not to subtract from scores.
    is_known: bool

    def given_or_computed(self, image: np.ndarray, noise_variance: np.ndarray | None) -> np.ndarray:
        """Return the variance of an image's noise, (H, W, 3): what was computed before, if there is something."""
        return self.variance(image) if noise_variance is None else noise_variance


ESTIMATED_NOISE = NoiseModel(estimate_noise_variance, is_known=False)


@dataclass(frozen=True, repr=False)
class Disparity:
    """Disparity of every pixel, anchored in the view of the pupil's centre.

    Attributes
    ----------
    value_px : (H, W) float32
        Half disparity, px; 0 in focus, + beyond the focus surface, NaN unknown.
    sigma_px : (H, W) float32
        One standard deviation, px; NaN unknown.
    confidence : (H, W) float32
        In [0, 1]; 0 where unknown.
    """

    value_px: np.ndarray
    sigma_px: np.ndarray
    confidence: np.ndarray

    def __repr__(self) -> str:
        height, width = self.value_px.shape
        known = np.isfinite(self.value_px)
        median = f", median {np.median(self.value_px[known]):.2f} px" if known.any() else ""
        return f"Disparity({width}x{height} px, {known.mean():.1%} filled{median})"


class Method(Protocol):
    """One way to estimate disparity, for one camera."""

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3) float32, linear."""

"""Quality "paper": the published method, section 3.1."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from chromaperture.color.noise import estimate_noise_variance
from chromaperture.config import PaperConfig
from chromaperture.disparity.error_bar import confidence, peak_sigma
from chromaperture.disparity.execution import Execution
from chromaperture.disparity.result import Disparity, NoiseModel
from chromaperture.disparity.views import ViewSpace, filtered_views


@dataclass(frozen=True)
class PaperMethod:
    """Correlate shifted views, smooth the scores by a bilateral filter, take every pixel's best layer.

    Attributes
    ----------
    config : PaperConfig
    space : ViewSpace
        The aperture's colour space, Eq. (1).
    run : Execution
    """

    config: PaperConfig
    space: ViewSpace
    run: Execution

    def match(self, image: np.ndarray, noise: NoiseModel | None) -> Disparity:
        """Return the disparity of an image (H, W, 3); its noise is estimated where no model is given."""
        config, correlation = self.config, self.config.correlation
        if noise is None:  # a blind estimate takes fine texture for noise: good enough for weights, not to subtract
            noise, correlation = estimate_noise_variance, replace(correlation, noise_debiasing=False)
        views = filtered_views(image, self.space, config=config.views, noise_variance=noise(image))
        layers_px = config.layers.values_px
        winner = self.run.bilateral_winner(views, layers_px, correlation=correlation, bilateral=config.bilateral)
        texture = np.ones(winner.peak.shape, np.float32)
        if correlation.noise_debiasing:  # the peak then lacks the noise that lowers a correlation
            texture = self.run.texture_weights(views, config=correlation).astype(np.float32)
        sigma = peak_sigma(winner, config, len(self.space.rows), texture)
        return Disparity(winner.disparity_px, sigma, confidence(sigma, winner.peak))

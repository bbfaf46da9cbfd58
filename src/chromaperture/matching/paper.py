"""Quality "paper": the published method, section 3.1."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from chromaperture.matching.error_bar import confidence, local_range, peak_sigma, sigma_of_range, surface_sigma
from chromaperture.matching.execution import Execution
from chromaperture.matching.result import Disparity, NoiseModel
from chromaperture.matching.unlike_views import mixed_share, unlike_share
from chromaperture.matching.views import ViewSpace, filtered_views, moved_px
from chromaperture.matching.winner import Surface
from chromaperture.settings.methods import PaperConfig

EDGE_REACH_PX = 8  # twice the reach of a matching window, and the pixel


@dataclass(frozen=True)
class PaperMethod:
    """Correlate shifted views, smooth the scores by a bilateral filter, take every pixel's best layer."""

    config: PaperConfig
    space: ViewSpace  # the aperture's colour space, Eq. (1)
    noise: NoiseModel
    run: Execution

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3)."""
        config = self.config
        debiased = config.correlation.noise_debiasing and self.noise.is_known
        correlation = replace(config.correlation, noise_debiasing=debiased)
        variance, layers_px = self.noise.variance(image), config.layers.values_px
        views = filtered_views(image, self.space, config=config.views, noise_variance=variance)
        winner = self.run.bilateral_winner(views, layers_px, correlation=correlation, bilateral=config.bilateral)
        texture = np.ones(winner.peak.shape, np.float32)
        if debiased:  # the peak then lacks the noise that lowers a correlation
            texture = self.run.texture_weights(views, config=correlation).astype(np.float32)
        sigma = peak_sigma(winner, config, len(self.space.rows), texture)
        widest = np.float32(sigma_of_range(layers_px))
        known = sigma < widest
        disparity = np.where(known, winner.disparity_px, np.float32(np.nan))
        at_edges = np.float32(config.edge_share) * local_range(disparity, EDGE_REACH_PX)
        wider = np.hypot(sigma, at_edges)
        hue_share = np.float32(config.hue_share * mixed_share(self.space.rows))
        if hue_share > 0:
            unlike = unlike_share(views.pictures, disparity, self.space.directions)
            wider = np.hypot(wider, hue_share * widest * unlike)
        found = Surface(disparity, wider, winner.peak)
        sigma = np.minimum(surface_sigma(found, floor_px=config.floor_px / moved_px(self.space.directions)), widest)
        return Disparity(disparity, sigma, confidence(sigma, winner.peak))

"""Evidence for every layer from correlated views, for a camera whose blur is not known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.matching.blocks import BLOCK_PX, block_means
from chromaperture.matching.execution import Execution
from chromaperture.matching.labels import LabelMap
from chromaperture.matching.result import NoiseModel
from chromaperture.matching.views import ViewSpace, filtered_views
from chromaperture.settings.stages import CorrelationEvidenceConfig, ViewsConfig

# What each factor of the determinant explains is scaled by this, so that a perfect one earns 3.5 nats and does not
# outweigh the whole neighbourhood; chosen by hand. An upper bound in its place makes the tops of peaks flat:
# flat boards through three views locked to the labels by .11 px (`benchmarks/locking.py`).
MOST_EXPLAINED = 0.999
_ROWS = 16  # of blocks that are read at once: 26 MB of 720 columns and 143 labels; chosen by hand


@dataclass(frozen=True)
class CorrelationEvidence:
    """Mean log-likelihood of every label over one or several view spaces."""

    config: CorrelationEvidenceConfig
    views: ViewsConfig
    spaces: tuple[ViewSpace, ...]
    label_maps: tuple[LabelMap, ...]  # one for each space; they bring the disparities of the spaces to one scale
    noise: NoiseModel
    run: Execution

    def at(
        self,
        image: np.ndarray,
        layers_px: np.ndarray,
        labels_px: np.ndarray,
        *,
        noise_variance: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return nats a pixel in blocks; (H // 4, W // 4, N) float32."""
        variance = self.noise.variance_of(image, noise_variance)
        likelihood = np.zeros((*(n // BLOCK_PX for n in image.shape[:2]), len(labels_px)), np.float32)
        for space, label_map in zip(self.spaces, self.label_maps, strict=True):
            views = filtered_views(image, space, config=self.views, noise_variance=variance)
            score = self.run.correlate(views, layers_px, config=self.config.correlation)
            view_count = len(space.rows)
            evidence = log_likelihood(score, view_count=view_count)
            factors = view_count - 1  # see `log_likelihood`: three views square theirs
            for first in range(0, len(likelihood), _ROWS):
                rows = np.arange(first * BLOCK_PX, min(first + _ROWS, len(likelihood)) * BLOCK_PX)
                of_rows = label_map.at(rows, np.arange(image.shape[1]))
                nats = self.run.read_at_labels(evidence[rows], layers_px, labels_px, of_rows, factors=factors)
                likelihood[first : first + _ROWS] += block_means(nats)
        return likelihood / len(self.spaces)  # the mean keeps the scale of the penalties


def log_likelihood(score: np.ndarray, *, view_count: int) -> np.ndarray:
    """Log-likelihood of every layer against uncorrelated views, nats a pixel.

    Gaussian views whose correlation matrix has the determinant D earn -(1/2) ln D a pixel: D = 1 - rho^2
    for two views, the square of one minus the score for three. An anti-correlation is no evidence. The score must not
    be debiased: noise must lower the correlation here, or noise alone would look certain.

    ``score`` (H, W, D) float; ``view_count`` {2, 3}. Returns (H, W, D) float32, >= 0.
    """
    explained = np.clip(score, 0, 1, dtype=np.float32)
    explained = np.float32(MOST_EXPLAINED) * (explained**2 if view_count == 2 else explained)
    return np.float32(-0.5 if view_count == 2 else -1) * np.log1p(-explained)

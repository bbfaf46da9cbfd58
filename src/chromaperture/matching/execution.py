"""The stages of every method as one interface, and the executions that implement it.

``readable/`` is NumPy and explains each stage; ``compiled/`` has the same names compiled by Numba. Both are packages
whose functions have the signatures below; `execution_named` chooses between them, and nothing else does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from chromaperture.matching.labels import LabelMap, PathWinner, Surface, Winner
from chromaperture.matching.readable.cross_filter import Tile
from chromaperture.matching.readable.pair_evidence import Fallback
from chromaperture.matching.readable.paths import Posterior
from chromaperture.matching.readable.planes import PlaneCosts
from chromaperture.matching.readable.upsample import Coarse
from chromaperture.matching.views import Views
from chromaperture.settings.methods import ExecutionName
from chromaperture.settings.stages import BilateralConfig, CorrelationConfig, FourPathsConfig, SurfaceConfig
from chromaperture.system.errors import InputError


class Execution(Protocol):
    """One implementation of every stage; the docstrings are in ``readable/``."""

    def correlate(self, views: Views, layers_px: np.ndarray, *, config: CorrelationConfig) -> np.ndarray:
        """Score every layer; (H, W, D)."""

    def texture_weights(self, views: Views, *, config: CorrelationConfig) -> np.ndarray:
        """Weight every pixel by its texture against its noise; (H, W)."""

    def bilateral_winner(
        self, views: Views, layers_px: np.ndarray, *, correlation: CorrelationConfig, bilateral: BilateralConfig
    ) -> Winner:
        """Correlate the views, filter every layer, take the best one and refine it by a parabola."""

    def four_path_winner(
        self,
        views: Views,
        layers_px: np.ndarray,
        label_map: LabelMap,
        *,
        correlation: CorrelationConfig,
        paths: FourPathsConfig,
        labels_px: np.ndarray | None = None,
    ) -> PathWinner:
        """Correlate the views and find the best label of every pixel along four paths."""

    def place_by_correlation(
        self, winner: PathWinner, layer_count: int, *, view_count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find the place between the layers by a pixel's own correlations, and its information."""

    def halved_surface(
        self,
        winner: PathWinner,
        place: np.ndarray,
        information: np.ndarray,
        layers_px: np.ndarray,
        label_map: LabelMap,
        mask: np.ndarray,
        *,
        cell_px: int = 1,
    ) -> Surface:
        """Return the surface of the halved picture."""

    def smooth_along_surface(
        self, maps: Sequence[np.ndarray], guide: np.ndarray, layer: np.ndarray, *, sigma_px: float
    ) -> list[np.ndarray]:
        """Sum maps over their neighbourhood on an even guide and an even surface."""

    def enlarge(self, surface: Surface, guide: np.ndarray) -> Surface:
        """Bring a surface to the guide's resolution."""

    def upsample(
        self, coarse: Coarse, image: np.ndarray, guide_rgb: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bring maps of the working scale to the photograph's pixels; three (H, W)."""

    def point_transforms(self, points_px: np.ndarray, weights: np.ndarray, size: int, samples: int) -> np.ndarray:
        """Transform point-spread functions; (C, samples, samples // 2 + 1)."""

    def cross_filter(
        self,
        tiles: Sequence[Tile],
        channels: np.ndarray,
        defocus_px: np.ndarray,
        canvas: np.ndarray,
        *,
        size_px: int,
        damping: float,
    ) -> None:
        """Filter channels of tiles with each other's blur, and add them to a canvas, (P, H, W, 2)."""

    def band_correlation(
        self,
        fine: np.ndarray,
        coarse: np.ndarray,
        *,
        sigma: float,
        seen: np.ndarray | None = None,
        allowed_growth: float = 1.0,
    ) -> np.ndarray:
        """Correlate both pictures of a pair in one band, in windows around every second sample; (H / 2, W / 2)."""

    def band_powers(self, fine: np.ndarray, coarse: np.ndarray, *, sigma: float) -> np.ndarray:
        """Return the powers of both pictures in the same windows; (H / 2, W / 2, 2)."""

    def pair_evidence(
        self,
        correlation: np.ndarray,
        places: np.ndarray,
        *,
        primary: int,
        band_weights: Sequence[float],
        fallback: Fallback,
    ) -> np.ndarray:
        """Return what the correlations of all pairs and bands earn at every layer; (H, W, D)."""

    def spectral_likelihood(
        self,
        spectra: np.ndarray,
        powers: np.ndarray,
        node: np.ndarray,
        noise: np.ndarray,
        *,
        channel_error: float,
        rounds: int,
    ) -> np.ndarray:
        """Sum the log-likelihood of windows of all channels over their frequencies, at every layer; (M, D)."""

    def read_at_labels(
        self,
        likelihood: np.ndarray,
        layers_px: np.ndarray,
        labels_px: np.ndarray,
        label_map: LabelMap,
        *,
        factors: float = 1.0,
        places: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> np.ndarray:
        """Interpolate a volume of log-likelihoods at the labels of a map and between its samples; (H, W, N)."""

    def aggregate_paths(
        self, likelihood: np.ndarray, guide: np.ndarray, layers_px: np.ndarray, *, config: SurfaceConfig
    ) -> np.ndarray:
        """Sum the path costs of every pixel and layer; (H, W, D)."""

    def posterior(self, cost: np.ndarray, layers_px: np.ndarray, *, temperature: float) -> Posterior:
        """Return mean and variance of the layers of every pixel by their cost."""

    def plane_costs(
        self, likelihood: np.ndarray, planes: np.ndarray, labels_px: np.ndarray, costs: PlaneCosts
    ) -> np.ndarray:
        """Cost of every plane at every pixel; (H, W, K)."""

    def agreed_plane(
        self,
        corners: np.ndarray,
        x: np.ndarray,
        y: np.ndarray,
        label: np.ndarray,
        weight: np.ndarray,
        *,
        tolerance_px: float,
        rounds: int,
    ) -> np.ndarray:
        """Find the plane through three points that most points agree with, and fit it to these; (3,)."""

    def join_regions(
        self, total: np.ndarray, pairs: np.ndarray, border: np.ndarray, *, plane_penalty: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Join neighbouring regions while the energy falls: which one each became part of, (R,), and costs, (R, K)."""


def execution_named(name: ExecutionName) -> Execution:
    """Return the execution of a name; raises InputError."""
    if name == "numpy":
        from chromaperture.matching import readable

        return readable
    if name == "numba":
        from chromaperture.matching import compiled  # compiling starts here, not at import

        return compiled
    raise InputError(f"unknown execution {name!r}: choose numba or numpy")

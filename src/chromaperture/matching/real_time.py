"""Quality "real-time": the picture is halved, matched along rows and columns, and the surface enlarged again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.matching.error_bar import confidence, sigma_of_range, surface_sigma, widened, without_two_views
from chromaperture.matching.execution import Execution
from chromaperture.matching.labels import MOST_APART_PX, LabelMap, Surface, labels_between
from chromaperture.matching.result import Disparity, Method
from chromaperture.matching.views import Views, ViewSpace, halved_views, moved_px
from chromaperture.settings.methods import RealTimeConfig


@dataclass(frozen=True)
class RealTimeMethod(Method):
    """Find the best layer along four paths, then its place between the layers, at half the resolution."""

    config: RealTimeConfig
    space: ViewSpace
    label_map: LabelMap  # what equal depth means at every pixel of the full picture
    run: Execution

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3)."""
        surface = self.surface(*halved_views(image, self.space, config=self.config.views))
        sigma = surface_sigma(surface, floor_px=self.floor_px)
        range_sigma = self.label_map.scale * sigma_of_range(self.config.layers.values_px)
        sigma = widened(sigma, without_two_views(image, self.space.rows), range_sigma)
        return Disparity(surface.disparity_px, sigma, confidence(sigma, surface.peak))

    @property
    def floor_px(self) -> float:
        """Least standard deviation of a disparity."""
        return self.config.floor_px / moved_px(self.space.directions)

    @property
    def layers_px(self) -> np.ndarray:
        """Layers of the halved picture, in its px; (D,) float64."""
        return self.config.layers.values_px / 2

    @property
    def labels_px(self) -> np.ndarray:
        """Labels of the halved picture, in its px; (N,) float64."""
        return labels_between(self.layers_px, self.space.directions, most_px=MOST_APART_PX / 2)

    def surface(self, views: Views, guide: np.ndarray) -> Surface:
        """Return the surface at the guide's (H, W) for halved views; see `halved_views`."""
        config, run = self.config, self.run
        cell_px = config.correlation.cell_px
        layers_px, labels_px, label_map = self.layers_px, self.labels_px, self.label_map.halved().of_cells(cell_px)
        winner = run.four_path_winner(
            views, layers_px, label_map, correlation=config.correlation, paths=config.paths, labels_px=labels_px
        )

        place, weight = run.place_by_correlation(winner, len(labels_px), view_count=views.pictures.shape[2])
        guide_of_cells, mask = (part[::cell_px, ::cell_px] for part in (views.guide, views.mask))
        even = guide_of_cells / np.float32(config.smoothing_edge_range)
        sums = run.smooth_along_surface(
            (weight, place * weight), even, winner.layer, sigma_px=config.smoothing_sigma_px / cell_px
        )
        surface = run.halved_surface(winner, sums[1] / sums[0], sums[0], labels_px, label_map, mask, cell_px=cell_px)
        surface = Surface(2 * surface.disparity_px, 2 * surface.sigma_px, surface.peak)
        if cell_px > 1:
            surface = run.enlarge(surface, views.guide)
        return run.enlarge(surface, guide)

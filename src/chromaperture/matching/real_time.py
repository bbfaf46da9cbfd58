"""Quality "real-time": the picture is halved, matched along rows and columns, and the surface enlarged again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.matching.error_bar import confidence, sigma_of_range, surface_sigma, widened, without_two_views
from chromaperture.matching.execution import Execution
from chromaperture.matching.labels import MOST_APART_PX, LabelMap, Surface, labels_between
from chromaperture.matching.result import Disparity, Method
from chromaperture.matching.views import Views, ViewSpace, halved_views
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
        moved = float(np.linalg.norm(self.space.directions, axis=1).mean())  # px of the views a px of disparity
        sigma = surface_sigma(surface, floor_px=self.config.floor_px / moved)
        range_sigma = self.label_map.scale * sigma_of_range(self.config.layers.values_px)
        sigma = widened(sigma, without_two_views(image, self.space.rows), range_sigma)
        return Disparity(surface.disparity_px, sigma, confidence(sigma, surface.peak))

    def surface(self, views: Views, guide: np.ndarray) -> Surface:
        """Return the surface at the guide's (H, W) for halved views; see `halved_views`."""
        config, run = self.config, self.run
        cell_px = config.correlation.cell_px
        layers_px, label_map = config.layers.values_px / 2, self.label_map.halved().of_cells(cell_px)
        labels_px = labels_between(layers_px, views.directions, most_px=MOST_APART_PX / 2)  # px of the halved picture
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

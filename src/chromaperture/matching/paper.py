"""Quality "paper": the published method, section 3.1."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from chromaperture.matching.error_bar import confidence, local_range, peak_sigma, sigma_of_range, surface_sigma
from chromaperture.matching.execution import Execution
from chromaperture.matching.labels import Surface
from chromaperture.matching.result import Disparity, Method, NoiseModel
from chromaperture.matching.views import ViewSpace, filtered_views, moved_px
from chromaperture.settings.methods import PaperConfig
from chromaperture.system.threads import parallel_map

EDGE_REACH_PX = 8  # twice the reach of a matching window, and the pixel


@dataclass(frozen=True)
class PaperMethod(Method):
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
        if self.hue_share > 0:
            unlike = unlike_share(views.pictures, disparity, self.space.directions)
            wider = np.hypot(wider, np.float32(self.hue_share) * widest * unlike)
        found = Surface(disparity, wider, winner.peak)
        sigma = np.minimum(surface_sigma(found, floor_px=self.floor_px), widest)
        return Disparity(disparity, sigma, confidence(sigma, winner.peak))

    @property
    def floor_px(self) -> float:
        """Least standard deviation of a disparity."""
        return self.config.floor_px / moved_px(self.space.directions)

    @property
    def hue_share(self) -> float:
        """Share of the range's standard deviation that unlike views add to the error bar."""
        return self.config.hue_share * mixed_share(self.space.rows)


CELL_PX = 4  # side of the squares whose mean and variance the window sums; chosen by hand, for speed
# Side of the window: 28 px, as wide as a Gaussian of 8 px; one of 4 px ranks alike (docs/decisions.md, *Hues in
# unmixed views*).
WINDOW_CELLS = 7
LEAST_VARIANCE = 1e-12  # no division by 0 on even areas: a thousandth of a 10-bit step, squared


def unlike_share(pictures: np.ndarray, disparity_px: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return which share of the views' variance is not that of their mean, moved by the disparity; (H, W) float32.

    0 where all views show the same, 1 where their mean is even. Eq. (1) makes the views from sensor channels that see
    several filters each, and takes all views to show a surface equally bright. A pattern of hues breaks that: what only
    one channel shows lies undisplaced in every view, with one sign or the other. The determinant of the views'
    correlations does not see the sign, so that its best layer is near the focus, sharply, wherever the surface is. The
    mean of the views, moved by the disparity, sees it: it has little of their variance.

    ``pictures`` (H, W, K) float32: views, as in `Views.pictures`; ``disparity_px`` (H, W) float32, px: NaN where
    unknown: there the views are not moved; ``directions`` (K, 2) float: displacement (x, y) of each view per px of
    disparity.
    """
    height, width, count = pictures.shape
    moved = np.empty((count, height, width), np.float32)
    known = np.where(np.isfinite(disparity_px), disparity_px, 0).astype(np.float32)
    rows, columns = np.indices((height, width), np.float32)

    def move(k: int) -> None:
        x = columns + np.float32(directions[k, 0]) * known
        y = rows + np.float32(directions[k, 1]) * known
        view = np.ascontiguousarray(pictures[..., k])
        cv2.remap(view, x, y, cv2.INTER_LINEAR, dst=moved[k], borderMode=cv2.BORDER_REPLICATE)

    parallel_map(move, range(count))
    common, *of_views = parallel_map(_variance, [moved.mean(axis=0), *moved])
    total = np.mean(of_views, axis=0)
    share = np.clip((total - common) / (total + LEAST_VARIANCE), 0, 1).astype(np.float32)
    return np.asarray(cv2.resize(share, (width, height), interpolation=cv2.INTER_LINEAR))


def mixed_share(rows: np.ndarray) -> float:
    """Return how far three views are mixed from several channels: 0 of one channel each, 1 of two with equal weights.

    ``rows`` (K, 3) float: weights of R, G, B in the views. The second largest weight of each counts, as a share of the
    largest. Of two views 0: their correlation has a sign, so that they do not take hues for a match.
    """
    if len(rows) == 2:
        return 0.0
    weights = np.sort(np.abs(np.asarray(rows, float)), axis=1)
    return float(np.mean(weights[:, 1] / weights[:, 2]))


def cell_moments(plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and mean square in squares of `CELL_PX`; what is left over at the right and below is not read.

    Returns two (h, w) float64: h = max(1, H // `CELL_PX`), w alike: of a picture that is smaller than a cell the border
    counts several times. With 64 bits, since a dark area of little texture is far from the mean of the frame.
    """
    height, width = plane.shape
    rows, columns = (max(1, size // CELL_PX) for size in (height, width))
    if min(height, width) < CELL_PX:
        beyond = (max(0, CELL_PX - size) for size in (height, width))
        plane = np.pad(plane, [(0, more) for more in beyond], mode="edge")
    whole = plane[: rows * CELL_PX, : columns * CELL_PX].astype(np.float64)
    mean, square = (cv2.resize(m, (columns, rows), interpolation=cv2.INTER_AREA) for m in (whole, whole * whole))
    return np.asarray(mean), np.asarray(square)


def _variance(plane: np.ndarray) -> np.ndarray:
    size = (WINDOW_CELLS, WINDOW_CELLS)
    mean, square = (cv2.blur(m, size, borderType=cv2.BORDER_REPLICATE) for m in cell_moments(plane))
    return np.asarray(np.maximum(square - mean * mean, 0))

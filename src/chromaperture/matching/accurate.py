"""Quality "accurate": one surface optimised through the whole volume, instead of a best layer for every pixel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np

from chromaperture.matching.blocks import BLOCK_PX, at_pixels, block_means, of_pixels
from chromaperture.matching.error_bar import (
    confidence,
    local_range,
    pooled_sigma,
    sigma_of_range,
    surface_sigma,
    widened,
    without_pixels,
    without_two_views,
)
from chromaperture.matching.execution import Execution
from chromaperture.matching.labels import LabelMap, Surface, parabola_winner
from chromaperture.matching.learned_error_bar import learned_bar, signs
from chromaperture.matching.planes.block_surface import BlockSurface, read_along, surface_of_blocks
from chromaperture.matching.planes.depth_edges import edge_log_odds
from chromaperture.matching.readable.between_layers import between_layers
from chromaperture.matching.readable.paths import Posterior, path_temperature
from chromaperture.matching.result import Disparity, Method, NoiseModel, Pending
from chromaperture.matching.views import ViewSpace, clipped_filled, filtered_views
from chromaperture.settings.methods import AccurateConfig
from chromaperture.system.errors import InputError
from chromaperture.system.threads import submit

EDGE_REACH_PX = 8  # two sigmas of the correlation window
POOLED_PX = 8.0  # sigma of the window in which the posterior's variance is averaged: paths draw streaks into it
# Of the range of the disparity about a pixel; a place anywhere in the range has a standard deviation of 0.29. With 0.4
# the bar is too narrow: of the errors on real boxes 0.46 lay within it, with 1.0 they were 0.53.
EDGE_SHARE = 1.0
FALL_LABELS = 4  # by which a region's surface is shifted to see whether its evidence falls
ALL_CHANNELS = np.eye(3)  # every pair of channels is evidence, the widest pairs first


class Evidence(Protocol):
    """Log-likelihood of every label in every block."""

    @property
    def noise(self) -> NoiseModel:
        """Noise of the photographs."""

    def at(
        self,
        image: np.ndarray,
        layers_px: np.ndarray,
        labels_px: np.ndarray,
        *,
        noise_variance: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return nats a pixel, (H // 4, W // 4, N) float32, for labels between ``layers_px``, the layers to evaluate.

        ``noise_variance`` is that of the image, (H, W, 3); without it, it is computed.
        """


class Prepared(NamedTuple):
    """A photograph as it is matched, (H, W, 3) and (H, W) float32."""

    image: np.ndarray  # clipped areas filled, see `clipped_filled`
    usable: np.ndarray  # 1 or 0
    guide: np.ndarray  # (h, w), of blocks: see `Views.guide`
    variance: np.ndarray  # of the image's noise


class PathSurface(NamedTuple):
    """What paths through the evidence of blocks find."""

    label_px: np.ndarray  # (h, w) float32: without NaN
    posterior: Posterior  # of the labels, px
    nats: np.ndarray  # (h, w, N) float32: the evidence, nats a pixel


@dataclass(frozen=True)
class AccurateMethod(Method):
    """Find the surface of labels that explains the evidence of all pixels."""

    config: AccurateConfig
    space: ViewSpace  # its guide steers the penalties
    evidence: Evidence  # `BlurEvidence` where the camera's blur is known, else `CorrelationEvidence`
    label_map: LabelMap  # from labels to the disparities of every pixel
    run: Execution

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3)."""

        def at_once(prepared: Prepared) -> Pending[PathSurface]:
            found = self.path_surface(prepared)
            return Pending(lambda: found)

        return self.begin(image, at_once).result()

    def begin(self, image: np.ndarray, find: Callable[[Prepared], Pending[PathSurface]]) -> Pending[Disparity]:
        """Begin with an image (H, W, 3); ``find`` is `path_surface`, or a device that finds the same.

        Of an image with fewer than two blocks along a side nothing is known.
        """
        if min(image.shape[:2]) < 2 * BLOCK_PX:
            unknown = np.full(image.shape[:2], np.nan, np.float32)
            return Pending(lambda: Disparity(unknown, unknown.copy(), np.zeros_like(unknown)))
        prepared = self.prepared(image)
        pending = find(prepared)
        depth_edges = submit(partial(edge_log_odds, prepared.image))

        def result() -> Disparity:
            found = pending.result()
            surface = explained_surface(
                found, depth_edges(), self.labels_px, image.shape[:2], config=self.config, run=self.run
            )
            return self.of_labels(surface, prepared.image, prepared.usable)

        return Pending(result)

    def prepared(self, image: np.ndarray) -> Prepared:
        """Return what is matched of an image (H, W, 3)."""
        views = filtered_views(image, self.space, config=self.config.views)
        image, usable = clipped_filled(image, views.mask)
        return Prepared(image, usable, block_means(views.guide), self.evidence.noise.variance(image))

    @property
    def labels_px(self) -> np.ndarray:
        """Labels, half a layer apart; (2 D - 1,) float64."""
        return with_halves(self.config.layers.values_px)

    def path_surface(self, prepared: Prepared) -> PathSurface:
        """Return the surface of least cost along paths through the evidence."""
        image, usable, guide, variance = prepared
        likelihood = self.evidence.at(image, self.config.layers.values_px, self.labels_px, noise_variance=variance)
        if not usable.all():
            likelihood *= block_means(usable)[..., None]
        return path_surface(likelihood, guide, self.labels_px, config=self.config, run=self.run)

    def of_labels(self, surface: Surface, image: np.ndarray, usable: np.ndarray) -> Disparity:
        """Return the disparity of a surface of labels; image and where it is usable as `clipped_filled` has them."""
        at_places = Surface(
            self.label_map.disparity(surface.disparity_px), self.label_map.scale * surface.sigma_px, surface.peak
        )
        unmeasured = without_two_views(image, ALL_CHANNELS) | without_pixels(usable)
        range_sigma = self.label_map.scale * sigma_of_range(self.labels_px)
        sigma = widened(surface_sigma(at_places), unmeasured, range_sigma)
        return Disparity(at_places.disparity_px, sigma, confidence(sigma, at_places.peak))


def with_halves(layers_px: np.ndarray) -> np.ndarray:
    """Return layers with one more between every two; (2 D - 1,) float64, px."""
    return np.linspace(layers_px[0], layers_px[-1], 2 * len(layers_px) - 1)


def path_surface(
    likelihood: np.ndarray, guide: np.ndarray, labels_px: np.ndarray, *, config: AccurateConfig, run: Execution
) -> PathSurface:
    """Find the surface of least cost along paths, and the posterior of its labels.

    ``likelihood`` (h, w, N) float, nats a pixel of blocks; ``guide`` (h, w) float: centre view, in units of
    ``guide_range``; ``labels_px`` (N,) float, px. Raises InputError: shapes do not fit together.
    """
    if likelihood.ndim != 3 or likelihood.shape[:2] != guide.shape or likelihood.shape[2] != len(labels_px):
        raise InputError(
            f"a volume of shape {likelihood.shape} does not fit a guide of shape {guide.shape} and "
            f"{len(labels_px)} layers"
        )
    surface = config.surface
    likelihood = np.ascontiguousarray(likelihood, np.float32)
    cost = run.aggregate_paths(likelihood, guide, labels_px, config=surface)
    least = least_cost(cost, labels_px)
    label_px = between_layers(least, likelihood, labels_px, sigma=surface.interpolation_sigma_px / BLOCK_PX)
    posterior = run.posterior(cost, labels_px, temperature=path_temperature(surface))
    return PathSurface(label_px, posterior, likelihood)


def explained_surface(
    found: PathSurface,
    log_odds: np.ndarray,
    labels_px: np.ndarray,
    shape: tuple[int, int],
    *,
    config: AccurateConfig,
    run: Execution,
) -> Surface:
    """Explain the evidence of blocks by one surface, with its error bar.

    ``log_odds`` (2, h, w) float32: as `edge_log_odds`; ``labels_px`` (N,) float, px; ``shape``: of the picture. Returns
    the disparity (H, W), NaN where it is unknown and within half a layer of an end of the range.
    """
    step = float(labels_px[1] - labels_px[0])
    first = (found.label_px - np.float32(labels_px[0])) / np.float32(step)
    blocks = surface_of_blocks(
        found.nats * np.float32(BLOCK_PX**2), first, found.posterior.sigma_px(found.label_px) / np.float32(step),
        log_odds, planes=config.planes, plate=config.plate, run=run,
    )  # fmt: skip
    posterior_px = found.posterior.sigma_px(np.asarray(labels_px[0] + step * blocks.label, np.float32))
    as_region = known_blocks(blocks, config.planes.known_from_nats)
    known = of_pixels((posterior_px < sigma_of_range(labels_px)) | as_region, shape)
    peak = np.sqrt(np.maximum(-np.expm1(-2 * read_along(found.nats, np.rint(blocks.label))), 0))
    label_px = np.asarray(labels_px[0] + step * at_pixels(blocks.label, shape), np.float32)
    pooled_px = pooled_sigma(posterior_px, POOLED_PX / BLOCK_PX)
    if config.surface.learned_error_bar == "none":
        sigma_px = np.hypot(of_pixels(pooled_px, shape), EDGE_SHARE * local_range(label_px, EDGE_REACH_PX))
    else:
        bar = learned_bar(signs(blocks, first, posterior_px / np.float32(step)), config.surface.learned_error_bar)
        # Where not even a region's evidence tells one place from others, the posterior is all there is.
        bar_px = np.where(as_region, step * bar, np.maximum(step * bar, pooled_px))
        sigma_px = np.asarray(step * at_pixels(bar_px / step, shape), np.float32)
    return Surface(_inside(label_px, known, labels_px), sigma_px, of_pixels(peak, shape))


def _inside(label_px: np.ndarray, known: np.ndarray, labels_px: np.ndarray) -> np.ndarray:
    """Return labels, NaN where they are unknown and within half a label of an end of the range; float32."""
    half = float(labels_px[1] - labels_px[0]) / 2
    inside = (label_px > labels_px[0] + half) & (label_px < labels_px[-1] - half)
    return np.where(known & inside, label_px, np.nan).astype(np.float32)


def known_blocks(surface: BlockSurface, from_nats: float) -> np.ndarray:
    """Find the regions whose evidence falls by ``from_nats`` a pixel when their surface is shifted; (h, w) bool.

    One pixel may suit several places, where the texture repeats; all pixels of its region together single out one. The
    evidence of noise hardly falls.
    """
    region = surface.regions.region
    before, here, after = (read_along(surface.nats, surface.label + shift) for shift in (-FALL_LABELS, 0, FALL_LABELS))
    fall = here - (before + after) / 2
    mean = np.bincount(region.ravel(), fall.ravel()) / np.maximum(np.bincount(region.ravel()), 1) / BLOCK_PX**2
    return np.asarray(mean >= max(from_nats, math.ulp(1.0)))[region]  # a region without any evidence is not known


def least_cost(cost: np.ndarray, labels_px: np.ndarray) -> np.ndarray:
    """Return the label of least cost, between labels by a parabola; (h, w) float32, px."""
    label = parabola_winner(cost, labels_px, lower_is_better=True).disparity_px
    at_end = ~np.isfinite(label)
    label[at_end] = labels_px[cost[at_end].argmin(axis=1)]
    return label

"""Quality "accurate": one surface optimised through the whole volume, instead of a best layer for every pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import cv2
import numpy as np

from chromaperture.config import AccurateConfig
from chromaperture.disparity.clipped_areas import clipped_filled
from chromaperture.disparity.depth_edges import edge_log_odds
from chromaperture.disparity.edge_likelihood import EdgeLikelihood
from chromaperture.disparity.error_bar import (
    confidence,
    local_range,
    pooled_sigma,
    sigma_of_range,
    surface_sigma,
    widened,
    without_pixels,
    without_two_views,
)
from chromaperture.disparity.evidence_signs import known_planes
from chromaperture.disparity.execution import Execution
from chromaperture.disparity.labels import LabelMap
from chromaperture.disparity.learned_error_bar import learned_sigma
from chromaperture.disparity.planar import needs_depth_edges, planes_of_surface
from chromaperture.disparity.plane_agreement import where_they_agree
from chromaperture.disparity.plane_edges import LineCosts
from chromaperture.disparity.plane_fit import Planes
from chromaperture.disparity.plane_voting import planes_or_surface
from chromaperture.disparity.result import Disparity, NoiseModel
from chromaperture.disparity.stages.between_layers import between_layers
from chromaperture.disparity.views import ViewSpace, filtered_views
from chromaperture.disparity.winner import Surface, parabola_winner
from chromaperture.errors import InputError
from chromaperture.planes_config import PlanesConfig
from chromaperture.stage_config import SurfaceConfig
from chromaperture.threads import each_band

EDGE_REACH_PX = 8  # two sigmas of the correlation window
# Sigma of the window in which the posterior's variance is averaged. On four ray-traced scenes that no table shows, the
# area under the risk-coverage curve is .050 without, .047, .046, .050 with 4, 8, 16 px; of the tenth with the longest
# bars .79, .86, .88, .84 of the errors lie within two.
POOLED_PX = 8.0
# Of the range of the disparity about a pixel, for a surface without planes; a place anywhere in the range has a
# standard deviation of 0.29. With 0.4, as for planes, the bar is too narrow: of the errors on real boxes 0.46 lay
# within it, with 1.0 they were 0.53 (benchmarks/dual_pixel.py).
EDGE_SHARE = 1.0
# Labels by which all evidence of a plane together misses its place. On four ray-traced scenes the tenth with the
# shortest bars has 1.0, .74, .59 of its errors within one bar and 1.0, 1.0, .90 within two with 0.3, 0.2, 0.1.
# The learned bar has the same least: of a simulated room in plain light .61 of the errors lie within two bars without
# it, .99 with it (benchmarks/hard_scenes.py, "easy").
BIAS_OF_PLANES = 0.2
ALL_CHANNELS = np.eye(3)  # every pair of channels is evidence, the widest pairs first
WITHOUT_PLANES = PlanesConfig(rounds=0)
# Depth edges are placed line by line, so that they have teeth. Two passes take away those of one and two lines: within
# 10 px of depth edges .001 to .003 more pixels are within 5 % (docs/measurements.md, *A median of the answer*); four
# passes have as many.
MEDIAN_PX, MEDIAN_PASSES = 5, 2


class Evidence(Protocol):
    """Log-likelihood of every label at every pixel."""

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
        """Return nats a pixel, (H, W, N) float32, for labels between ``layers_px``, the layers to evaluate.

        ``noise_variance`` is that of the image, (H, W, 3); without it, it is computed.
        """


@dataclass(frozen=True)
class AccurateMethod:
    """Find the surface of labels that explains the evidence of all pixels.

    Attributes
    ----------
    config : AccurateConfig
    space : ViewSpace
        Its guide steers the penalties.
    evidence : Evidence
        `BlurEvidence` where the camera's blur is known, else `CorrelationEvidence`.
    label_map : LabelMap
        From labels to the disparities of every pixel.
    run : Execution
    edges : EdgeLikelihood, optional
        Where near planes end; without, the guide alone tells.
    """

    config: AccurateConfig
    space: ViewSpace
    evidence: Evidence
    label_map: LabelMap
    run: Execution
    edges: EdgeLikelihood | None = None

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3)."""
        views = filtered_views(image, self.space, config=self.config.views)
        layers_px = self.config.layers.values_px
        labels_px = with_halves(layers_px)
        image, usable = clipped_filled(image, views.mask)
        variance = self.evidence.noise.variance(image)  # once: all stages that follow need it
        likelihood = self.evidence.at(image, layers_px, labels_px, noise_variance=variance)
        if not usable.all():
            each_band(
                lambda rows: np.multiply(likelihood[rows], usable[rows, :, None], out=likelihood[rows]), len(usable)
            )
        surface = optimised_surface(
            likelihood, views.guide, labels_px, config=self.config.surface, planes=self.config.planes, run=self.run,
            known_within_px=sigma_of_range(labels_px), line_costs=self.line_costs(image, variance),
            depth_edges=self.depth_edges(image),
        )  # fmt: skip
        return self.of_labels(surface, image, usable, labels_px)

    def depth_edges(self, image: np.ndarray) -> np.ndarray | None:
        """Return the log odds of depth edges in an image, as `clipped_filled` has it; None where nothing needs them."""
        planes = self.config.planes
        if not needs_depth_edges(planes) or min(image.shape[:2]) < 2 * planes.block_px:
            return None
        return edge_log_odds(image)

    def line_costs(self, image: np.ndarray, noise_variance: np.ndarray) -> LineCosts | None:
        """Return what tells where edges are in an image, as `clipped_filled` has it.

        ``noise_variance`` is that of the image; (H, W, 3) each.
        """
        if self.edges is None or not self.config.planes.edge_lines:
            return None
        return partial(self.edges.costs, self.edges.photograph(image, noise_variance))

    def of_labels(self, surface: Surface, image: np.ndarray, usable: np.ndarray, labels_px: np.ndarray) -> Disparity:
        """Return the disparity of a surface of labels; image and where it is usable as `clipped_filled` has them."""
        at_pixels = Surface(
            self.label_map.disparity(surface.disparity_px), self.label_map.scale * surface.sigma_px, surface.peak
        )
        unmeasured = without_two_views(image, ALL_CHANNELS) | without_pixels(usable)
        sigma = widened(surface_sigma(at_pixels), unmeasured, self.label_map.scale * sigma_of_range(labels_px))
        return Disparity(at_pixels.disparity_px, sigma, confidence(sigma, at_pixels.peak))


def with_halves(layers_px: np.ndarray) -> np.ndarray:
    """Return layers with one more between every two; (2 D - 1,) float64, px."""
    return np.linspace(layers_px[0], layers_px[-1], 2 * len(layers_px) - 1)


def optimised_surface(
    likelihood: np.ndarray,
    guide: np.ndarray,
    labels_px: np.ndarray,
    *,
    config: SurfaceConfig,
    planes: PlanesConfig = WITHOUT_PLANES,
    run: Execution,
    known_within_px: float = math.inf,
    line_costs: LineCosts | None = None,
    depth_edges: np.ndarray | None = None,
) -> Surface:
    """Find the surface that explains the whole volume.

    Parameters
    ----------
    likelihood : (H, W, N) float, nats a pixel
    guide : (H, W) float
        Centre view, in units of ``guide_range``.
    labels_px : (N,) float, px
    config : SurfaceConfig
    planes : PlanesConfig
        Without it the surface is not explained by planes.
    run : Execution
    known_within_px : float, px
        Standard deviation of the posterior from which on the disparity is unknown.
    line_costs : callable, optional
        See `placed_edges`.
    depth_edges : (2, H // 4, W // 4) float, optional
        See `planes_of_surface`.

    Returns
    -------
    Surface
        The disparity is NaN where it is unknown and within half a layer of an end of the range.

    Raises
    ------
    InputError
        Shapes do not fit together.
    """
    if likelihood.ndim != 3 or likelihood.shape[:2] != guide.shape or likelihood.shape[2] != len(labels_px):
        raise InputError(
            f"a volume of shape {likelihood.shape} does not fit a guide of shape {guide.shape} and "
            f"{len(labels_px)} layers"
        )
    step = float(labels_px[1] - labels_px[0])
    likelihood = np.ascontiguousarray(likelihood, np.float32)
    cost = run.aggregate_paths(likelihood, guide, labels_px, config=config)
    start = between_layers(least_cost(cost, labels_px), likelihood, labels_px, sigma_px=config.interpolation_sigma_px)
    disparity = run.coupled_variation(start, likelihood, guide, labels_px, config=config)
    posterior = run.posterior(cost, labels_px, temperature=config.temperature * config.paths)
    del cost  # as large as the volume: what follows takes its memory
    sigma, first = posterior.sigma_px(disparity), disparity
    explained_by = planes_of_surface(
        disparity, sigma, likelihood, guide, labels_px, config=planes, surface=config, run=run,
        line_costs=line_costs, depth_edges=depth_edges,
    )  # fmt: skip
    if explained_by is not None:
        if explained_by.trusted is None:
            disparity = where_they_agree(explained_by, disparity, np.hypot(sigma, step))
        else:
            disparity = planes_or_surface(explained_by, disparity, step)
        sigma = posterior.sigma_px(disparity)
    layer = np.clip(np.rint((disparity - labels_px[0]) / step).astype(np.intp), 0, len(labels_px) - 1)
    explained = -np.expm1(-2 * np.take_along_axis(likelihood, layer[..., None], axis=2)[..., 0])
    surface = Surface(disparity, sigma, np.sqrt(explained))
    extent = local_range(disparity, EDGE_REACH_PX)
    found = judged(
        surface, extent, labels_px, first_px=first, explained_by=explained_by, learned=config.learned_error_bar,
        known_within_px=known_within_px, known_from_nats=planes.known_from_nats,
        edge_share=EDGE_SHARE if explained_by is None else planes.edge_share,
    )  # fmt: skip
    if explained_by is None:
        return found
    known = np.isfinite(found.disparity_px)
    return found._replace(disparity_px=np.where(known, median_filtered(disparity), np.float32(np.nan)))


def median_filtered(disparity_px: np.ndarray) -> np.ndarray:
    """Return a map (H, W) of finite values with shorter teeth at its edges, float32; pixels at the border repeat."""
    out = np.ascontiguousarray(disparity_px, np.float32)
    for _ in range(MEDIAN_PASSES):
        out = np.asarray(cv2.medianBlur(out, MEDIAN_PX))
    return out


def least_cost(cost: np.ndarray, labels_px: np.ndarray) -> np.ndarray:
    """Return the label of least cost, between labels by a parabola; (H, W) float32, px."""
    out = np.empty(cost.shape[:2], np.float32)

    def find(rows: slice) -> None:
        label = parabola_winner(cost[rows], labels_px, lower_is_better=True).disparity_px
        at_end = ~np.isfinite(label)
        label[at_end] = labels_px[cost[rows][at_end].argmin(axis=1)]
        out[rows] = label

    each_band(find, len(out))
    return out


def judged(
    surface: Surface,
    extent_px: np.ndarray,
    labels_px: np.ndarray,
    *,
    first_px: np.ndarray,
    explained_by: Planes | None,
    learned: bool,
    known_within_px: float,
    known_from_nats: float,
    edge_share: float,
) -> Surface:
    """Widen the error bar of a surface by what its posterior does not see, and leave out what is unknown.

    Parameters
    ----------
    surface : Surface
        Without NaN; its error bar is that of the posterior.
    extent_px : (H, W) float, px
        `local_range` of the surface.
    labels_px : (N,) float, px
    first_px : (H, W) float, px
        The surface before planes explained it.
    explained_by : Planes or None
    learned : bool
        Whether the bar is that of `learned_sigma`.
    known_within_px : float, px
        As `optimised_surface`.
    known_from_nats, edge_share : float
        See `PlanesConfig`; a learned bar has weights in place of the share.
    """
    step = float(labels_px[1] - labels_px[0])
    disparity, sigma = surface.disparity_px, surface.sigma_px
    inside = (disparity > labels_px[0] + step / 2) & (disparity < labels_px[-1] - step / 2)
    certain = sigma < known_within_px
    if explained_by is not None and explained_by.blocks is not None:
        # Beside a border windows see the other plane, and in a texture that repeats several places are as likely: there
        # the posterior of a pixel is wide, but the evidence of its whole plane says where it is.
        label = (disparity - labels_px[0]) / step
        of_plane = known_planes(explained_by.blocks, label, explained_by.choice, from_nats=known_from_nats)
        certain |= of_plane[explained_by.choice] & (disparity == explained_by.label_px)
    known = inside & certain
    bias = 0.0 if explained_by is None else BIAS_OF_PLANES * step
    if learned:
        sigma = np.hypot(learned_sigma(surface, step, first_px=first_px, explained_by=explained_by), bias)
    else:
        sigma = np.hypot(np.hypot(pooled_sigma(sigma, POOLED_PX), bias), edge_share * extent_px)
    return Surface(np.where(known, disparity, np.nan).astype(np.float32), sigma, surface.peak)

"""Every default of the method, one frozen dataclass a stage.

A stage receives only its own section. ``MatcherConfig.preset`` gives the three qualities the command line offers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from chromaperture.errors import InputError

Quality = Literal["paper", "real-time", "accurate"]
QUALITIES: tuple[Quality, ...] = get_args(Quality)


@dataclass(frozen=True)
class OptimiserConfig:
    """Global optimisation of the disparity (quality "accurate"). Likelihoods count in nats a pixel.

    Attributes
    ----------
    paths : int
        Directions of semi-global matching, 4 or 8.
    slope_penalty : float
        Cost of a change of disparity between two neighbours, nats per px. Large, because the windows of
        neighbours see the same pixels: their likelihoods are no independent witnesses.
    jump_penalty : float
        The most a change costs, nats: a depth edge.
    edge_range : float
        Guide difference, in units of ``bilateral_range``, at which the penalties fall to 1/e.
    edge_floor : float
        Share of the penalties that remains across the strongest edge of the guide.
    huber_layers : float
        Slopes below, layers per px, are smoothed by the variation, not flattened into steps.
    pooling_px : float
        Reach over which neighbours tell where between two layers the paths' surface lies, from where the variation
        starts.
    coupling_layers2 : (float, float)
        First and last coupling theta of variation and volume, layers squared.
    coupling_rounds, variation_iterations : int
        Rounds of the coupling, 0 switches the variation off; primal-dual iterations in each.
    temperature : float
        Nats a path by which a layer may cost more and still be 1/e as probable: the one calibrated number of
        the error bar.
    """

    paths: int = 8
    slope_penalty: float = 25.0
    jump_penalty: float = 25.0
    edge_range: float = 0.5
    edge_floor: float = 0.05
    huber_layers: float = 0.05
    pooling_px: float = 8.0
    coupling_layers2: tuple[float, float] = (2.0, 0.02)
    coupling_rounds: int = 25
    variation_iterations: int = 40
    temperature: float = 0.5

    def __post_init__(self) -> None:
        if self.paths not in (4, 8):
            raise InputError(f"paths must be 4 or 8, got {self.paths}")
        positive = (self.slope_penalty, self.jump_penalty, self.edge_range, self.pooling_px, self.temperature)
        if min(*positive, *self.coupling_layers2) <= 0:
            raise InputError("penalties, edge_range, pooling_px, temperature and couplings must be positive")
        if not 0 <= self.edge_floor <= 1 or self.huber_layers < 0:
            raise InputError("edge_floor must lie in [0, 1] and huber_layers must be >= 0")
        if self.coupling_rounds < 0 or self.variation_iterations < 1:
            raise InputError("coupling_rounds must be >= 0 and variation_iterations >= 1")


@dataclass(frozen=True)
class PhaseConfig:
    """PSF-aware matching (quality "accurate" of a camera whose blur is known).

    Attributes
    ----------
    bands_px : tuple of (float, float)
        Bands that are correlated apart: sigmas of the two Gaussians whose difference passes one, px. A coarser third
        octave costs: its windows hold too few waves, and colours that change slowly look like displacement.
    band_weights : tuple of float
    window_sigma_px : float
        Gaussian window of the correlation.
    damping : float
        eps of ``disparity/phase.py``, against noise where the blur leaves nothing.
    noise_margin : float
        What counts as noise: frequencies of a tile that hold less than this many times the sensor's noise are left out.
    fallback_weight, fallback_nats : float
        Weight of the pairs of channels whose views lie closer together, where the best pair finds nothing; it falls to
        1/e where that pair's best layer earns ``fallback_nats``. They agree better on strongly coloured surfaces, but
        are less exact.
    """

    bands_px: tuple[tuple[float, float], ...] = ((0.6, 1.4), (1.4, 3.2))
    band_weights: tuple[float, ...] = (1.0, 0.5)
    window_sigma_px: float = 4.0
    damping: float = 0.04
    noise_margin: float = 1.0
    fallback_weight: float = 0.5
    fallback_nats: float = 0.1

    def __post_init__(self) -> None:
        if len(self.bands_px) != len(self.band_weights) or not self.bands_px:
            raise InputError("bands_px and band_weights must be of one length, at least 1")
        if not all(0 < fine < coarse for fine, coarse in self.bands_px) or min(self.band_weights) < 0:
            raise InputError("every band needs 0 < fine < coarse, and weights must be >= 0")
        if (
            min(self.window_sigma_px, self.damping, self.noise_margin, self.fallback_nats) <= 0
            or self.fallback_weight < 0
        ):
            raise InputError("window_sigma_px, damping and fallback_nats must be positive, fallback_weight >= 0")


@dataclass(frozen=True)
class CoarseConfig:
    """Matching at half the resolution with semi-global pooling along rows and columns (quality "real-time").

    Blur is several px wide and windows are larger still, so the volume need not exist at every pixel; a guided
    interpolation brings the answer back to full resolution. Lengths of the matcher, window and pre-smoothing, then
    count px of the halved picture; disparities never do.

    Attributes
    ----------
    slope_penalty, jump_penalty : float
        Nats that a change by one layer, and by more, costs between two neighbours.
    edge_range, edge_floor : float
        As in `OptimiserConfig`.
    temperature : float
        Nats by which a layer may cost more and still count for the error bar: its one calibrated number.
    floor_px : float, px
        Least standard deviation, whatever the texture: what disparities of flat boards between 1 and 4 m scatter by,
        because halves of a pupil blur unlike.
    """

    slope_penalty: float = 10.0
    jump_penalty: float = 20.0
    edge_range: float = 0.3
    edge_floor: float = 0.05
    temperature: float = 3.2
    floor_px: float = 0.05

    def __post_init__(self) -> None:
        if min(self.slope_penalty, self.jump_penalty, self.edge_range, self.temperature) <= 0:
            raise InputError("penalties, edge_range and temperature must be positive")
        if not (math.isfinite(self.floor_px) and self.floor_px >= 0):
            raise InputError(f"floor_px must be >= 0, is {self.floor_px:g}")
        if not 0 <= self.edge_floor <= 1:
            raise InputError("edge_floor must lie in [0, 1]")
        if not self.slope_penalty <= self.jump_penalty <= 2 * self.slope_penalty:
            raise InputError("jump_penalty must lie between slope_penalty and twice slope_penalty")


@dataclass(frozen=True)
class MatcherConfig:
    """Disparity estimation (paper section 3.1). All disparities are half disparities in px, + is beyond focus.

    Attributes
    ----------
    min_disparity_px, max_disparity_px : float
        Ends of the search range. A winner at either end is reported as unknown, so leave a layer of margin.
    step_px : float
        Distance of two layers. Above 0.5 the parabola locks to the layers (bias 0.045 px at 1.0, 0.006 at 0.5).
    presmooth_sigma_px : float
        Gaussian before matching; makes the noise left by sub-pixel interpolation independent of its phase.
    window_decay : float
        ``a`` in the correlation window ``a**(|x| + |y|)``; .80 has the variance of a 21 px box.
    bilateral_sigma_px : float
        Reach of the recursive bilateral filter over the cost volume on an even guide; 0 switches it off.
    bilateral_range : float
        Guide difference, linear light relative to the guide's 99th percentile, at which the reach falls to 1/e a px.
    texture_weighting : bool
        Weight the cost by texture against noise, so that even areas listen to their textured neighbours.
    sigma_scale : float
        Widens the error bar of ideal, Gaussian pictures (1.0) to that of real ones, in which windows see two depths
        and blurred views are mirrored, not moved. The one number of the error bar that is calibrated, on captures of
        known depth.
    views : "unmixed", "pure" or "both"
        Match the views in the aperture's colour space, Eq. (1), as the paper does; or take the sensor channels that
        see one filter each, where the design has them: less noise, and saturated colours do no harm. Both need an
        optimiser, and a calibrated camera, which knows how their disparities compare.
    noise_debiasing : bool
        Subtract the known noise covariance of the unmixed channels, which otherwise digs a hole at disparity 0.
    optimiser : OptimiserConfig or None
        Find the best surface through the whole volume instead of filtering it and taking every pixel's best layer.
    phase : PhaseConfig or None
        Match with the camera's blur instead of shifted views, where the camera file holds it; needs an optimiser.
    coarse : CoarseConfig or None
        Match the halved picture, with semi-global pooling; excludes an optimiser.
    """

    min_disparity_px: float = -8.0
    max_disparity_px: float = 7.5
    step_px: float = 0.5
    presmooth_sigma_px: float = 0.7
    window_decay: float = 0.80
    bilateral_sigma_px: float = 14.0
    bilateral_range: float = 0.06
    sigma_scale: float = 2.0
    views: Literal["unmixed", "pure", "both"] = "pure"
    texture_weighting: bool = True
    noise_debiasing: bool = True
    optimiser: OptimiserConfig | None = None
    phase: PhaseConfig | None = None
    coarse: CoarseConfig | None = None

    def __post_init__(self) -> None:
        if self.phase is not None and self.optimiser is None:
            raise InputError("phase needs an optimiser: choose quality accurate")
        numbers = (self.min_disparity_px, self.max_disparity_px, self.step_px)
        if not all(map(math.isfinite, numbers)) or self.step_px <= 0:
            raise InputError("disparity range and step must be finite and the step positive, in px")
        if len(self.layers_px) < 3:
            raise InputError(
                f"the disparity range {self.min_disparity_px:g}..{self.max_disparity_px:g} px holds fewer than three "
                f"layers of {self.step_px:g} px: widen it"
            )
        if not 0 < self.window_decay < 1:
            raise InputError(f"window_decay must lie between 0 and 1, got {self.window_decay:g}")
        if not (math.isfinite(self.sigma_scale) and self.sigma_scale > 0):
            raise InputError(f"sigma_scale must be positive, is {self.sigma_scale:g}")
        if self.views not in ("unmixed", "pure", "both"):
            raise InputError(f"views must be unmixed, pure or both, is {self.views!r}")
        if self.views == "both" and self.optimiser is None:
            raise InputError("views = both needs an optimiser: choose quality accurate")
        if self.coarse is not None and self.optimiser is not None:
            raise InputError("coarse and optimiser exclude each other: choose quality real-time or accurate")
        reaches = (self.bilateral_sigma_px, self.presmooth_sigma_px, self.bilateral_range)
        if not all(map(math.isfinite, reaches)) or min(reaches) < 0 or self.bilateral_range == 0:
            raise InputError(
                "bilateral_sigma_px and presmooth_sigma_px must be finite and >= 0, and bilateral_range > 0"
            )

    @property
    def layers_px(self) -> np.ndarray:
        """(D,) float64, px: the disparities that are tried."""
        count = math.floor((self.max_disparity_px - self.min_disparity_px) / self.step_px + 1e-6) + 1
        return self.min_disparity_px + self.step_px * np.arange(count)

    @classmethod
    def preset(cls, quality: Quality) -> MatcherConfig:
        """Give the settings behind ``--quality``.

        ``paper`` is the published method as it is; ``real-time`` pools the scores of the halved picture;
        ``accurate`` matches all views at once and optimises the surface globally, which takes about a second a
        megapixel and layer set.
        """
        if quality == "paper":
            return cls(views="unmixed", texture_weighting=False, noise_debiasing=False)
        if quality == "real-time":
            return cls(
                window_decay=0.30,
                presmooth_sigma_px=0.9,
                bilateral_sigma_px=60.0,
                bilateral_range=0.15,
                noise_debiasing=False,
                coarse=CoarseConfig(),
            )
        if quality == "accurate":
            return cls(step_px=0.25, window_decay=0.70, views="both", optimiser=OptimiserConfig())
        raise InputError(f"unknown quality {quality!r}: choose paper, real-time or accurate")

    @classmethod
    def psf_aware(cls, reach: float) -> MatcherConfig:
        """Give the settings of quality ``accurate`` for a camera whose blur is known.

        Parameters
        ----------
        reach : float
            Px of half disparity for a px by which blur displaces the pupil's edge. Layers and slopes count in blur,
            so that designs whose views lie close together are searched as finely.
        """
        optimiser = OptimiserConfig(slope_penalty=25.0 / reach, edge_range=1.0, huber_layers=0.02, temperature=0.3)
        # Damping leaves out more of the detail, and the noise in it, where blur is wide, which looks like agreement.
        # Views that lie apart outweigh that by the square of their distance.
        phase = PhaseConfig(
            damping=min(PhaseConfig.damping, 0.375 * reach**2), noise_margin=max(1.0, 0.16 / reach**2)
        )
        return replace(cls.preset("accurate"), step_px=0.3 * reach, optimiser=optimiser, phase=phase)

    def with_range(self, min_disparity_px: float, max_disparity_px: float) -> MatcherConfig:
        """Give the same settings over another search range, widened to whole layers."""
        low = self.step_px * math.floor(min_disparity_px / self.step_px)
        high = self.step_px * math.ceil(max_disparity_px / self.step_px)
        return replace(self, min_disparity_px=low, max_disparity_px=high)


@dataclass(frozen=True)
class DepthConfig:
    """Disparity to depth (paper sections 3.2 to 3.4).

    Attributes
    ----------
    max_depth_mm : float
        Depths beyond are reported as unknown: next to the disparity at infinity the error bar exceeds the depth.
    """

    max_depth_mm: float = 50_000.0


@dataclass(frozen=True)
class Config:
    """All stages together, as ``CodedApertureCamera`` takes it and ``STEM.json`` records it."""

    quality: Quality = "real-time"  # whose depth curve in the camera file belongs to the matcher's settings
    matcher: MatcherConfig = field(default_factory=lambda: MatcherConfig.preset("real-time"))
    depth: DepthConfig = field(default_factory=DepthConfig)

"""Defaults of the matcher's stages, one frozen dataclass a stage; `methods.py` composes the methods of them.

The types carry the limits: a value outside raises InputError. docs/decisions.md has the alternatives.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Annotated, Any, Literal, get_type_hints

import numpy as np
from pydantic import Field

from chromaperture.system.errors import InputError
from chromaperture.system.validation import Finite, NotNegative, Positive, checked_value

MOST_LAYERS = 10_000  # of a range; more come of a wrong unit, and a megapixel of 16-bit scores takes 20 GB
_BENCH_FULL_WELL = 5000.0  # electrons, of the sensor of bench50
_ROUNDING = 1e-6  # of the quotient of a range and its step
# Px^2 by which reading a view between its pixels smooths.
SAMPLED_PX2 = {"catmull-rom": 0.0, "b-spline": 1 / 3, "smoothed-cubic": 0.45}
# Of px of half disparity for a px of the pupil edge's displacement, with the samples' real film: the open aperture has
# 0.09, circles 0.20, halves 0.33, three squares 0.42.
LEAST_REACH_OF_PAIRS = 0.15
LEAST_REACH_OF_PAIRS_ALONE = 0.37

Share = Annotated[float, Field(ge=0, le=1)]


@cache
def _types_of(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


@dataclass(frozen=True)
class Settings:
    """A section of settings: every value is checked against its field's type."""

    def __post_init__(self) -> None:
        own: Any = type(self)
        for name, kind in _types_of(own).items():
            value = getattr(self, name)
            if not dataclasses.is_dataclass(value):
                checked_value(kind, value, where=f"{name} ")


def require(valid: bool, rule: str) -> None:
    """Raise InputError with a rule that is broken."""
    if not valid:
        raise InputError(rule)


@dataclass(frozen=True)
class LayersConfig(Settings):
    """The disparities that are tested: half disparities in px, + beyond focus."""

    #: Ends of the search range. A best layer at either end is unknown: leave one layer of margin.
    min_px: Finite = -8.0
    max_px: Finite = 7.5
    #: Distance of two layers; a parabola through shifted views is biased towards them by 0.006 px at 0.5, 0.045 at 1.
    step_px: Positive = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        spacings = (self.max_px - self.min_px) / self.step_px + _ROUNDING
        here = f"the disparity range {self.min_px:g}..{self.max_px:g} px holds"
        require(spacings >= 2, f"{here} fewer than three layers of {self.step_px:g} px: widen it")
        require(spacings < MOST_LAYERS, f"{here} more than {MOST_LAYERS} layers of {self.step_px:g} px: narrow it")

    @property
    def values_px(self) -> np.ndarray:
        """(D,) float64, px: the disparity of every layer."""
        count = math.floor((self.max_px - self.min_px) / self.step_px + _ROUNDING) + 1
        return self.min_px + self.step_px * np.arange(count)

    def over(self, min_px: float, max_px: float) -> LayersConfig:
        """Return layers of the same step over another range, widened to whole layers."""
        low, high = math.floor(min_px / self.step_px), math.ceil(max_px / self.step_px)
        return replace(self, min_px=self.step_px * low, max_px=self.step_px * high)


@dataclass(frozen=True)
class ViewsConfig(Settings):
    """How the views and the guide are smoothed and scaled."""

    #: Sigma of a Gaussian before matching, against noise. Reading the views smooths besides.
    presmooth_sigma_px: NotNegative = 0.4
    #: Difference of the guide that counts as 1, in linear light relative to the guide's 1st to 99th percentile.
    guide_range: Positive = 0.06


@dataclass(frozen=True)
class CorrelationConfig(Settings):
    """Correlation of shifted views."""

    #: ``a`` of the correlation window ``a**(|x| + |y|)``; 0.80 has the variance of a 21 px box.
    window_decay: Annotated[float, Field(gt=0, lt=1)] = 0.80
    #: Subtract the known noise from the views' variances and covariances; unmixing correlates it between the views,
    #: which lowers the score at disparity 0.
    noise_debiasing: bool = False
    #: Cubic by which a view is read between its pixels. The first keeps detail, but at whole pixels more of it than
    #: between them, and draws surfaces there. The others smooth everywhere alike to third order, by 0.58 and 0.67 px;
    #: the last displaces fine detail least.
    sampling: Literal["catmull-rom", "b-spline", "smoothed-cubic"] = "smoothed-cubic"
    #: Side of the squares of pixels that share a score. 2: the window is a triangle of 5 px, ``window_decay`` unused.
    cell_px: Literal[1, 2] = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        apart = self.cell_px == 1 or not self.noise_debiasing
        require(apart, "noise_debiasing does not apply to quality real-time, whose cells are of 2 px")

    @property
    def sampling_variance_px2(self) -> float:
        """By how much reading a view between its pixels widens the smoothing, px^2 an axis."""
        return SAMPLED_PX2[self.sampling]

    @property
    def window_px(self) -> float:
        """Width of the window along an axis: the sum of its weights over the greatest; px of the matched picture."""
        if self.cell_px == 2:
            return (1 + 2 + 3 + 2 + 1) / 3  # the triangle
        return (1 + self.window_decay) / (1 - self.window_decay)


@dataclass(frozen=True)
class BilateralConfig(Settings):
    """Recursive bilateral filter over the volume of scores."""

    #: Reach on an even guide; 0 switches the filter off.
    sigma_px: NotNegative = 14.0
    #: Weight the scores by texture against noise: even areas take the scores of textured neighbours.
    texture_weighting: bool = False


@dataclass(frozen=True)
class FourPathsConfig(Settings):
    """Semi-global matching along rows and columns (quality "real-time")."""

    #: Nats that any change of the layer costs between two neighbours.
    jump_penalty: Positive = 11.0
    #: Difference of the guide, in units of ``guide_range``, at which the penalties have fallen to 1/e.
    edge_range: Positive = 0.25
    #: Fraction of the penalties that remains across the strongest edge of the guide.
    edge_floor: Share = 0.1
    #: Share of the costs along the rows that the columns take for evidence of their own.
    row_share: Share = 0.25
    #: Nats by which a layer may cost more and still be 1/e as probable. Where the layers that are left are as wide as
    #: the range, a pixel is unknown. Fitted on captures of known depth.
    temperature: Positive = 1.5


@dataclass(frozen=True)
class CorrelationEvidenceConfig(Settings):
    """Evidence of quality "accurate" for a camera whose blur is not known: shifted views."""

    #: As `PaperConfig.space`; "both" takes the mean of the two where a design has both, and the sensor's channels where
    #: three views would be mixed of channels that see several filters each: unmixing takes hues for displacement.
    space: Literal["unmixed", "pure", "both"] = "both"
    #: A smaller window than for a local best layer: the surface aggregates the rest.
    correlation: CorrelationConfig = field(default_factory=lambda: CorrelationConfig(window_decay=0.70))

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.correlation.cell_px == 1, "cell_px does not apply to quality accurate")
        # Noise must lower the correlation here, or noise alone would look certain.
        require(not self.correlation.noise_debiasing, "noise_debiasing does not apply to quality accurate")


@dataclass(frozen=True)
class CrossFilterConfig(Settings):
    """Evidence of quality "accurate" for a camera whose blur is known: channels filtered with each other's blur."""

    #: Bands that are correlated separately: sigmas of the two Gaussians whose difference passes one, px.
    bands_px: Annotated[tuple[tuple[Positive, Positive], ...], Field(min_length=1)] = ((0.6, 1.4), (1.4, 3.2))
    band_weights: tuple[NotNegative, ...] = (1.0, 0.5)
    #: Of the correlation's Gaussian.
    window_sigma_px: Positive = 4.0
    #: Epsilon of ``evidence/blur.py``, against noise where the blur leaves no signal.
    damping: Positive = 0.04
    #: Frequencies of a tile with less than this many times the sensor's noise power are left out.
    noise_margin: Positive = 1.0
    #: Weight of the pairs of channels whose views lie closer together, where the widest pair finds nothing: they agree
    #: better on strongly coloured surfaces, but are less exact.
    fallback_weight: NotNegative = 0.5
    #: Nats of the widest pair's best layer at which that weight has fallen to 1/e.
    fallback_nats: Positive = 0.1
    #: Whether evidence counts as far as it is a pixel's own (``matching/evidence/spectral.py``).
    own_detail: bool = False
    #: Growth of a window's power beyond which detail comes from elsewhere (``readable/band_correlation.py``); 0 is any.
    allowed_growth: NotNegative = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.bands_px) == len(self.band_weights), "bands_px and band_weights must be of one length")
        require(all(fine < coarse for fine, coarse in self.bands_px), "every band of bands_px needs 0 < fine < coarse")

    @classmethod
    def for_blur(cls, reach: float, *, full_well_electrons: float | None = None) -> CrossFilterConfig:
        """Return the settings for a lens; ``reach`` is px of half disparity for a px of the pupil edge's displacement.

        Damping leaves out more of the detail, and of the noise in it, where blur is wide, which looks like agreement;
        views that lie apart outweigh that by the square of their distance. A sensor quieter than that of bench50
        (5000 electrons) can leave out more, because less noise is left to agree.
        """
        quiet = 1.0 if full_well_electrons is None else max(1.0, full_well_electrons / _BENCH_FULL_WELL)
        return cls(damping=min(cls.damping, 0.375 * reach**2 * quiet), noise_margin=max(1.0, 0.16 / reach**2))


@dataclass(frozen=True)
class SurfaceConfig(Settings):
    """The surface that explains the whole volume (quality "accurate"); log-likelihoods in nats a pixel."""

    #: Directions of semi-global matching, 4 or 8.
    paths: int = 8
    #: Cost of a change of disparity between two blocks, nats per px; large, because the windows of neighbours overlap:
    #: their log-likelihoods are not independent.
    slope_penalty: Positive = 25.0
    #: Largest cost of a change, nats: a depth edge.
    jump_penalty: Positive = 25.0
    #: Difference of the guide, in units of ``guide_range``, at which the penalties have fallen to 1/e.
    edge_range: Positive = 4.0
    #: Fraction of the penalties that remains across the strongest edge of the guide.
    edge_floor: Share = 0.05
    #: Gaussian window over which neighbours decide where between two layers the surface lies.
    interpolation_sigma_px: Positive = 8.0
    #: Nats a path by which a layer may cost more and still be 1/e as probable. With 0.6 shifted views of noise look
    #: surer than the range allows (``tests/depth/test_confidence.py``); that of known blur is fitted.
    temperature: Positive = 0.7
    #: Judge the surface by ``matching/error_bar.py``, as learned from evidence of that kind, or by its
    #: posterior and its range alone.
    learned_error_bar: Literal["blur", "views", "none"] = "views"

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.paths in (4, 8), f"paths must be 4 or 8, is {self.paths}")


@dataclass(frozen=True)
class PlanesConfig(Settings):
    """Planes between depth edges, from which the plate starts; see ``matching/planes/regions.py``."""

    #: Sizes of the squares to which planes are fitted.
    tiles_px: Annotated[tuple[Annotated[int, Field(ge=8)], ...], Field(min_length=1)] = (48, 96, 192, 480)
    #: Nats that a plane costs.
    plane_penalty: NotNegative = 60.0
    #: Nats that a border between two blocks costs, a unit of the log odds of no depth edge between them.
    border_nats: NotNegative = 1.25
    #: Nats a block of a slope of one label a block; it grows with the square.
    slope_penalty: NotNegative = 0.3
    #: Nats a pixel where a plane leaves the search range.
    outside_penalty: NotNegative = 0.05
    #: Upper bound of the nats by which a plane is worse than the best one at a block; 0 is no bound.
    max_block_nats: NotNegative = 3.0
    #: How much blocks count there that a likely depth edge touches: their windows see both sides.
    edge_block_weight: Share = 0.3
    #: Nats a pixel by which the evidence of a region must fall when its surface is shifted for all of its pixels to be
    #: known. Shifted views of noise alone reach 0.012, blurred ones 0.00012.
    known_from_nats: NotNegative = 0.02


@dataclass(frozen=True)
class PlateConfig(Settings):
    """The plate that follows the evidence from planes; labels are half a layer apart, 0.15 px of blur."""

    rounds: Annotated[int, Field(ge=1, le=100)] = 2
    #: Share of the pixels' nats that counts: windows overlap, so that neighbours say much the same.
    evidence_share: Positive = 0.15
    #: Share of that for blocks that a likely depth edge touches.
    edge_block_weight: NotNegative = 0.3
    #: Upper bound of what a block earns at its best label.
    max_block_nats: Positive = 3.0
    #: Nats a block, for a second difference of one label; it grows with the square up to ``bend_labels``.
    bend_penalty: Positive = 3000.0
    #: Second difference from which on a bend is a fold, whose cost grows no more.
    bend_labels: Positive = 0.006
    #: The same for first differences.
    slope_penalty: Positive = 0.02
    slope_labels: Positive = 1.0
    #: Added to the log odds of depth edges: the plate is better cut once too often.
    edge_log_odds: Finite = 2.0
    #: Sigma by which evidence is smoothed along the labels before a parabola is laid through it.
    smoothed_labels: Positive = 1.0
    #: By which blocks within a window must earn more on the surface of the paths than on their plane for the plate to
    #: start from that surface.
    own_evidence_nats: NotNegative = 6.4


@dataclass(frozen=True)
class SpectralConfig(Settings):
    """Evidence of all channels together: ``matching/evidence/spectral.py``."""

    #: Factor on the log-likelihood beside that of the pairs of channels; 0 switches this evidence off.
    gain: NotNegative = 3.0
    #: The most that it earns a pixel: windows that see a depth edge, or a texture that is not Gaussian, can be wrong.
    cap_nats: Positive = 0.5
    #: Sigma of the windows' Gaussian taper.
    taper_px: Positive = 8.0
    #: Distance of two windows.
    stride_px: Annotated[int, Field(ge=1)] = 14
    #: Slopes of the texture's power spectrum f^(-2 slope) that are tried; the last one is that of shading, which has no
    #: detail that blur could take.
    slopes: Annotated[tuple[Positive, ...], Field(min_length=1)] = (0.75, 1.0, 1.3, 1.7, 3.0)
    #: Fraction of a channel's power that is its own: error of the calibrated blur, and limit of the correlation of
    #: colours.
    channel_error: Positive = 0.002
    #: Of expectation and maximisation for the covariance of the colours, at each layer, from that of the layer before.
    rounds: Annotated[int, Field(ge=1)] = 2
    #: Red and blue are the halves of a dual-pixel sensor and green is their mean: noise is partly shared
    #: (``matching/evidence/half_pixels.py``). On the CPU alone.
    dual_pixel: bool = False

    @classmethod
    def for_blur(cls, reach: float) -> SpectralConfig:
        """Return the settings for a lens; ``reach`` is px of half disparity for a px of the pupil edge's displacement.

        Where views lie close together blur tells more than parallax. Where they lie far apart the pairs alone are
        exact, and their small windows know edges. In between a weak dose finds walls that hardly have texture.
        """
        if reach < LEAST_REACH_OF_PAIRS:
            return cls()
        return cls(gain=1.0, cap_nats=0.15) if reach < LEAST_REACH_OF_PAIRS_ALONE else cls(gain=0.0)

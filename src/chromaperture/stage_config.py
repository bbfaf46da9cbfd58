"""Every default of the matcher's stages, one frozen dataclass a stage; `config.py` composes the methods of them.

bench50 is the set of ray-traced captures of ``benchmarks/bench50.py``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from chromaperture.errors import InputError

MOST_LAYERS = 10_000  # of a range; more come of a wrong unit, and a megapixel of 16-bit scores takes 20 GB
_BENCH_FULL_WELL = 5000.0  # electrons, of the sensor of bench50
_ROUNDING = 1e-6  # of the quotient of a range and its step
# Px^2 by which reading a view between its pixels smooths. Of textures of 1/f behind a Gaussian of 0.4 px a displacement
# comes out wrong by at most .0128, .0083, .0047, .0023, .0013, .0033 px with 1/3, .38, .42, .45, .49, .55 px^2, and
# detail differs between the phases by .031, .019, .011, .008, .014, .025 (docs/measurements.md, *Flat boards and the
# layers*).
SAMPLED_PX2 = {"catmull-rom": 0.0, "b-spline": 1 / 3, "smoothed-cubic": 0.45}


def require(valid: bool, rule: str) -> None:
    """Raise InputError with a rule that is broken."""
    if not valid:
        raise InputError(rule)


def require_space(space: str, *known: str) -> None:
    """Raise InputError unless a view space is known."""
    require(space in known, f"space must be {' or '.join(known)}, is {space!r}")


def all_finite(*values: float) -> bool:
    """Return whether no value is NaN or infinite."""
    return all(map(math.isfinite, values))


@dataclass(frozen=True)
class LayersConfig:
    """The disparities that are tested: half disparities in px, + beyond focus.

    Attributes
    ----------
    min_px, max_px : float
        Ends of the search range. A best layer at either end is reported as unknown: leave one layer of margin.
    step_px : float
        Distance of two layers. A parabola through shifted views is biased towards the layers by 0.045 px at 1.0, by
        0.006 px at 0.5 (``benchmarks/locking.py``).
    """

    min_px: float = -8.0
    max_px: float = 7.5
    step_px: float = 0.5

    def __post_init__(self) -> None:
        finite = all_finite(self.min_px, self.max_px, self.step_px)
        require(finite and self.step_px > 0, "the range of the layers must be finite and step_px positive, in px")
        spacings = (self.max_px - self.min_px) / self.step_px + _ROUNDING
        require(
            spacings >= 2,
            f"the disparity range {self.min_px:g}..{self.max_px:g} px holds fewer than three layers of "
            f"{self.step_px:g} px: widen it",
        )
        require(
            spacings < MOST_LAYERS,
            f"the disparity range {self.min_px:g}..{self.max_px:g} px holds more than {MOST_LAYERS} layers of "
            f"{self.step_px:g} px: narrow it",
        )

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
class ViewsConfig:
    """How the views and the guide are smoothed and scaled.

    Attributes
    ----------
    presmooth_sigma_px : float
        Gaussian before matching, against noise. Reading the views smooths besides, see `CorrelationConfig`.
    guide_range : float
        Difference of the guide that counts as 1, in linear light relative to the guide's 1st to 99th percentile.
    """

    presmooth_sigma_px: float = 0.4
    guide_range: float = 0.06

    def __post_init__(self) -> None:
        finite = all_finite(self.presmooth_sigma_px, self.guide_range)
        require(finite and self.presmooth_sigma_px >= 0, "presmooth_sigma_px must be finite and >= 0")
        require(finite and self.guide_range > 0, "guide_range must be finite and positive")


@dataclass(frozen=True)
class CorrelationConfig:
    """Correlation of shifted views.

    Attributes
    ----------
    window_decay : float
        ``a`` of the correlation window ``a**(|x| + |y|)``; 0.80 has the variance of a 21 px box.
    noise_debiasing : bool
        Subtract the known noise from the views' variances and covariances; unmixing correlates it between the views,
        which lowers the score at disparity 0.
    sampling : {"catmull-rom", "b-spline", "smoothed-cubic"}
        Cubic by which a view is read between its pixels. The first keeps detail, but at whole pixels more of it than
        between them, and draws surfaces there. The others smooth everywhere alike to third order, by 0.58 and 0.67 px;
        the last displaces fine detail least wrongly.
    cell_px : {1, 2}
        Side of the squares of pixels that share a score. 2: the window is a triangle of 5 px (``window_decay`` is not
        used), which takes a quarter of the volume and finds more (docs/measurements.md, *Cells*).
    """

    window_decay: float = 0.80
    noise_debiasing: bool = False
    sampling: Literal["catmull-rom", "b-spline", "smoothed-cubic"] = "smoothed-cubic"
    cell_px: Literal[1, 2] = 1

    def __post_init__(self) -> None:
        require(self.cell_px in (1, 2), f"cell_px must be 1 or 2, is {self.cell_px!r}")
        apart = self.cell_px == 1 or not self.noise_debiasing
        require(apart, "noise_debiasing does not apply to quality real-time, whose cells are of 2 px")
        require(self.sampling in SAMPLED_PX2, f"sampling must be one of {', '.join(SAMPLED_PX2)}, is {self.sampling!r}")
        require(0 < self.window_decay < 1, f"window_decay must lie between 0 and 1, got {self.window_decay:g}")

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
class BilateralConfig:
    """Recursive bilateral filter over the volume of scores.

    Attributes
    ----------
    sigma_px : float
        Reach on an even guide; 0 switches the filter off.
    texture_weighting : bool
        Weight the scores by texture against noise: even areas take the scores of textured neighbours.
    """

    sigma_px: float = 14.0
    texture_weighting: bool = False

    def __post_init__(self) -> None:
        require(all_finite(self.sigma_px) and self.sigma_px >= 0, "sigma_px must be finite and >= 0")


@dataclass(frozen=True)
class FourPathsConfig:
    """Semi-global matching along rows and columns (quality "real-time").

    Attributes
    ----------
    jump_penalty : float
        Nats that any change of the layer costs between two neighbours. To let small changes be cheaper was worse
        on simulated captures: where texture is weak, paths creep away.
    edge_range : float
        Difference of the guide, in units of ``guide_range``, at which the penalties have fallen to 1/e.
    edge_floor : float
        Fraction of the penalties that remains across the strongest edge of the guide.
    row_share : float
        Share of the costs along the rows that the columns take for evidence of their own; see
        `disparity.stages.four_paths`, and docs/measurements.md, *Rows before columns*.
    temperature : float
        Nats by which a layer may cost more and still be 1/e as probable. Where the layers that are left are as wide as
        the range, a pixel is unknown. Fitted on captures of known depth.
    """

    jump_penalty: float = 11.0
    edge_range: float = 0.25
    edge_floor: float = 0.1
    row_share: float = 0.25
    temperature: float = 1.5

    def __post_init__(self) -> None:
        numbers = (self.jump_penalty, self.edge_range, self.temperature)
        require(all_finite(*numbers) and min(numbers) > 0, "jump_penalty, edge_range, temperature must be positive")
        require(0 <= self.edge_floor <= 1, "edge_floor must lie in [0, 1]")
        require(0 <= self.row_share <= 1, "row_share must lie in [0, 1]")


@dataclass(frozen=True)
class CorrelationEvidenceConfig:
    """Evidence of quality "accurate" for a camera whose blur is not known: shifted views.

    Attributes
    ----------
    space : {"unmixed", "pure", "both"}
        As `PaperConfig.space`; "both" takes the mean of the two where a design has both, and the sensor's channels
        where three views would be mixed of channels that see several filters each: unmixing takes hues for
        displacement.
    correlation : CorrelationConfig
        A smaller window than for a local best layer: the surface aggregates the rest.
    """

    space: Literal["unmixed", "pure", "both"] = "both"
    correlation: CorrelationConfig = field(default_factory=lambda: CorrelationConfig(window_decay=0.70))

    def __post_init__(self) -> None:
        require_space(self.space, "unmixed", "pure", "both")
        require(self.correlation.cell_px == 1, "cell_px does not apply to quality accurate")
        # Noise must lower the correlation here, or noise alone would look certain.
        require(not self.correlation.noise_debiasing, "noise_debiasing does not apply to quality accurate")


@dataclass(frozen=True)
class CrossFilterConfig:
    """Evidence of quality "accurate" for a camera whose blur is known: channels filtered with each other's blur.

    Attributes
    ----------
    bands_px : tuple of (float, float)
        Bands that are correlated separately: sigmas of the two Gaussians whose difference passes one, px. A third,
        coarser octave lowers the fraction within 2 % of simulated captures: its windows hold
        too few periods, and slow changes of colour look like displacement.
    band_weights : tuple of float
    window_sigma_px : float; of the correlation's Gaussian. 8 px instead of 4: docs/measurements.md, "window of 8 px"
    damping : float
        eps of ``blur_evidence.py``, against noise where the blur leaves no signal.
    noise_margin : float
        Frequencies of a tile with less than this many times the sensor's noise power are left out.
    fallback_weight, fallback_nats : float
        Weight of the pairs of channels whose views lie closer together, where the widest pair finds nothing; it falls
        to 1/e where that pair's best layer earns ``fallback_nats``. They agree better on strongly coloured surfaces,
        but are less exact.
    own_detail : bool; whether evidence counts as far as it is a pixel's own (``disparity/own_detail.py``)
    allowed_growth : float
        Of a window's power, beyond which detail comes from elsewhere (``stages/band_correlation.py``); 0 is any.
    """

    bands_px: tuple[tuple[float, float], ...] = ((0.6, 1.4), (1.4, 3.2))
    band_weights: tuple[float, ...] = (1.0, 0.5)
    window_sigma_px: float = 4.0
    damping: float = 0.04
    noise_margin: float = 1.0
    fallback_weight: float = 0.5
    fallback_nats: float = 0.1
    own_detail: bool = False
    allowed_growth: float = 0.0

    def __post_init__(self) -> None:
        one_each = bool(self.bands_px) and len(self.bands_px) == len(self.band_weights)
        require(one_each, "bands_px and band_weights must be of one length, at least 1")
        ordered = all(len(band) == 2 and 0 < band[0] < band[1] for band in self.bands_px)
        ordered = ordered and all_finite(*self.band_weights, *(sigma for band in self.bands_px for sigma in band))
        require(ordered and min(self.band_weights) >= 0, "every band needs 0 < fine < coarse, weights must be >= 0")
        numbers = (self.window_sigma_px, self.damping, self.noise_margin, self.fallback_nats)
        require(all_finite(*numbers) and min(numbers) > 0, "the numbers of the evidence must be positive")
        others = (self.fallback_weight, self.allowed_growth)
        require(all_finite(*others) and min(others) >= 0, "fallback_weight and allowed_growth must be >= 0")

    @classmethod
    def for_blur(cls, reach: float, *, full_well_electrons: float | None = None) -> CrossFilterConfig:
        """Return the settings for a lens; ``reach`` is px of half disparity for a px of the pupil edge's displacement.

        Damping leaves out more of the detail, and of the noise in it, where blur is wide, which looks like agreement.
        Views that lie apart outweigh that by the square of their distance. Both factors were chosen on the boards of
        bench50 (cy_open, cy_halves) with the lens's ray-traced blur; docs/equations.md, "Noise", has the errors. Their
        sensor holds 5000 electrons; a quieter one can leave out more, because less noise is left to agree: with a
        dual-pixel camera's 160,000, on two ray-traced scenes with blank walls, damping .004, .015 and .04 puts .53,
        .60 and .69 of the pixels within a ratio of 1.25.
        """
        quiet = 1.0 if full_well_electrons is None else max(1.0, full_well_electrons / _BENCH_FULL_WELL)
        return cls(damping=min(cls.damping, 0.375 * reach**2 * quiet), noise_margin=max(1.0, 0.16 / reach**2))


@dataclass(frozen=True)
class SurfaceConfig:
    """The surface that explains the whole volume (quality "accurate"). Log-likelihoods are in nats a pixel.

    Defaults are those of shifted views; `AccurateConfig.for_blur` has those of a known blur. Chosen on simulated
    captures and bench50's still_life.

    Attributes
    ----------
    paths : int
        Directions of semi-global matching, 4 or 8.
    slope_penalty : float
        Cost of a change of disparity between two neighbours, nats per px. It is large because the windows of
        neighbours overlap: their log-likelihoods are not independent.
    jump_penalty : float
        Largest cost of a change, nats: a depth edge.
    edge_range : float
        Difference of the guide, in units of ``guide_range``, at which the penalties have fallen to 1/e.
    edge_floor : float
        Fraction of the penalties that remains across the strongest edge of the guide.
    interpolation_sigma_px : float
        Gaussian window over which neighbours decide where between two layers the surface lies.
    temperature : float
        Nats a path by which a layer may cost more and still be 1/e as probable. Fitted on captures of known depth.
    learned_error_bar : {"blur", "views", "none"}
        Judge the surface by ``disparity/learned_error_bar.py``, as learned from evidence of that kind, or by its
        posterior and its range alone.
    """

    paths: int = 8
    slope_penalty: float = 25.0
    jump_penalty: float = 25.0
    edge_range: float = 0.5
    edge_floor: float = 0.05
    interpolation_sigma_px: float = 8.0
    temperature: float = 0.5
    learned_error_bar: Literal["blur", "views", "none"] = "views"

    def __post_init__(self) -> None:
        require(self.paths in (4, 8), f"paths must be 4 or 8, got {self.paths}")
        lengths = (self.edge_range, self.interpolation_sigma_px, self.temperature)
        numbers = (self.slope_penalty, self.jump_penalty, *lengths)
        positive = all_finite(*numbers) and min(numbers) > 0
        require(positive, "penalties, edge_range, interpolation_sigma_px and temperature must be positive")
        require(0 <= self.edge_floor <= 1, "edge_floor must lie in [0, 1]")
        kinds = ("blur", "views", "none")
        require(self.learned_error_bar in kinds, f"learned_error_bar must be one of {', '.join(kinds)}")

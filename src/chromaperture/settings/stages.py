"""Every default of the matcher's stages, one frozen dataclass a stage; `methods.py` composes the methods of them.

bench50 is the set of ray-traced captures of ``benchmarks/bench50.py`` and ``benchmarks/ablation.py``; the second
measures what each setting gains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from chromaperture.system.errors import InputError

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
        (``benchmarks/ablation.py`` chose it on simulated captures): where texture is weak, paths creep away.
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
        coarser octave lowers the fraction within 2 % (``benchmarks/ablation.py``, "three octaves"): its windows hold
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
    own_detail : bool; whether evidence counts as far as it is a pixel's own (``matching/own_detail.py``)
    allowed_growth : float
        Of a window's power, beyond which detail comes from elsewhere (``readable/band_correlation.py``); 0 is any.
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
    captures and bench50's still_life; ``benchmarks/ablation.py --quality accurate`` measures each.

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
        Judge the surface by ``matching/learned_error_bar.py``, as learned from evidence of that kind, or by its
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


@dataclass(frozen=True)
class PlanesConfig:
    """Planes between depth edges, from which the plate starts; see ``matching/planes/regions.py``.

    Attributes
    ----------
    tiles_px : tuple of int
        Sizes of the squares to which planes are fitted.
    plane_penalty : float
        Nats that a plane costs.
    border_nats : float
        Nats that a border between two blocks costs, a unit of the log odds of no depth edge between them.
    slope_penalty : float
        Nats a block of a slope of one label a block; it grows with the square.
    outside_penalty : float
        Nats a pixel where a plane leaves the search range.
    max_block_nats : float
        Upper bound of the nats by which a plane is worse than the best one at a block; 0 is no bound.
    edge_block_weight : float
        How much blocks count there that a likely depth edge touches, in [0, 1]: their windows see both sides.
    known_from_nats : float
        Nats a pixel by which the evidence of a region must fall when its surface is shifted for all of its pixels to be
        known. Shifted views of noise alone reach .012, blurred ones .00012.
    """

    tiles_px: tuple[int, ...] = (48, 96, 192, 480)
    plane_penalty: float = 60.0
    border_nats: float = 1.25
    slope_penalty: float = 0.3
    outside_penalty: float = 0.05
    max_block_nats: float = 3.0
    edge_block_weight: float = 0.3
    known_from_nats: float = 0.02

    def __post_init__(self) -> None:
        require(bool(self.tiles_px) and min(self.tiles_px) >= 8, "tiles_px must hold sizes of at least 8 px")
        numbers = (
            self.plane_penalty, self.border_nats, self.slope_penalty, self.outside_penalty, self.max_block_nats,
            self.edge_block_weight, self.known_from_nats,
        )  # fmt: skip
        require(all_finite(*numbers) and min(numbers) >= 0, "penalties, nats and weights must be finite and >= 0")
        require(self.edge_block_weight <= 1, "edge_block_weight must be at most 1")


@dataclass(frozen=True)
class PlateConfig:
    """The plate that follows the evidence from a start of planes; see ``matching/planes/thin_plate.py``.

    Labels are half a layer apart: 0.15 px of blur where the blur is known. docs/decisions.md has the alternatives.

    Attributes
    ----------
    rounds : int
    evidence_share : float
        Share of the pixels' nats that counts: windows overlap, so that neighbours say much the same.
    edge_block_weight : float
        Share of that for blocks that a likely depth edge touches.
    max_block_nats : float
        Upper bound of what a block earns at its best label.
    bend_penalty : float
        Nats a block, for a second difference of one label; it grows with the square up to ``bend_labels``.
    bend_labels : float
        Second difference from which on a bend is a fold, whose cost grows no more.
    slope_penalty, slope_labels : float
        The same for first differences.
    edge_log_odds : float
        Added to the log odds of depth edges: the plate is better cut once too often.
    smoothed_labels : float
        Sigma by which evidence is smoothed along the labels before a parabola is laid through it.
    own_evidence_nats : float
        By which blocks within a window must earn more on the surface of the paths than on their plane for the plate to
        start from that surface.
    """

    rounds: int = 3
    evidence_share: float = 0.15
    edge_block_weight: float = 0.3
    max_block_nats: float = 3.0
    bend_penalty: float = 3000.0
    bend_labels: float = 0.006
    slope_penalty: float = 0.02
    slope_labels: float = 1.0
    edge_log_odds: float = 2.0
    smoothed_labels: float = 1.0
    own_evidence_nats: float = 6.4

    def __post_init__(self) -> None:
        require(1 <= self.rounds <= 100, f"rounds must lie between 1 and 100, is {self.rounds}")
        positive = (
            self.evidence_share, self.max_block_nats, self.bend_penalty, self.bend_labels, self.slope_penalty,
            self.slope_labels, self.smoothed_labels,
        )  # fmt: skip
        require(all_finite(*positive) and min(positive) > 0, "shares, penalties, nats and labels must be positive")
        others = (self.edge_block_weight, self.own_evidence_nats)
        require(all_finite(self.edge_log_odds, *others) and min(others) >= 0, "weights and nats must be >= 0")


# Of px of half disparity for a px of the pupil edge's displacement, with the samples' real film: the open aperture has
# .09, circles .20, halves .33, three squares .42 (with film that leaks nothing .13, .27, .42, .50). What this evidence
# gains for each is in docs/measurements.md, *All channels at once*.
LEAST_REACH_OF_PAIRS = 0.15
LEAST_REACH_OF_PAIRS_ALONE = 0.37


@dataclass(frozen=True)
class SpectralConfig:
    """Evidence of all channels together: ``matching/evidence/spectral.py``. docs/measurements.md has what each gains.

    Attributes
    ----------
    gain : float
        Factor on the log-likelihood beside that of the pairs of channels; 0 switches this evidence off.
    cap_nats : float
        The most that it earns a pixel: windows that see a depth edge, or a texture that is not Gaussian, can be wrong.
    taper_px : float
        Sigma of the windows' Gaussian taper.
    stride_px : int
        Distance of two windows.
    slopes : tuple of float
        Slopes of the texture's power spectrum f^(-2 slope) that are tried; the last one is that of shading, which has
        no detail that blur could take.
    channel_error : float
        Fraction of a channel's power that is its own: error of the calibrated blur, and limit of the correlation of
        colours.
    rounds : int
        Of expectation and maximisation for the covariance of the colours, at each layer, from that of the layer before.
    dual_pixel : bool
        Red and blue are the halves of a dual-pixel sensor and green is their mean: noise is partly shared
        (``matching/evidence/half_pixels.py``). On the CPU alone.
    """

    gain: float = 3.0
    cap_nats: float = 0.5
    taper_px: float = 8.0
    stride_px: int = 10
    slopes: tuple[float, ...] = (0.75, 1.0, 1.3, 1.7, 3.0)
    channel_error: float = 0.002
    rounds: int = 2
    dual_pixel: bool = False

    def __post_init__(self) -> None:
        numbers = (self.gain, self.cap_nats, self.taper_px, self.channel_error, *self.slopes)
        positive = all_finite(*numbers) and self.gain >= 0 and min(numbers[1:]) > 0
        require(positive and bool(self.slopes), "the numbers of the spectral evidence must be positive, gain >= 0")
        require(min(self.stride_px, self.rounds) >= 1, "stride_px and rounds must be >= 1")

    @classmethod
    def for_blur(cls, reach: float) -> SpectralConfig:
        """Return the settings for a lens; ``reach`` is px of half disparity for a px of the pupil edge's displacement.

        Where views lie close together blur tells more than parallax. Where they lie far apart the pairs alone are
        exact, and their small windows know edges. In between a weak dose finds walls that hardly have texture.
        """
        if reach < LEAST_REACH_OF_PAIRS:
            return cls()
        return cls(gain=1.0, cap_nats=0.15) if reach < LEAST_REACH_OF_PAIRS_ALONE else cls(gain=0.0)

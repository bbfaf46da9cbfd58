"""Every default of the method: one frozen dataclass a method, composed of its stages'; docs/decisions.md."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Annotated, Literal, TypeVar, get_args

import numpy as np
from pydantic import Field

from chromaperture.settings.stages import (
    LEAST_REACH_OF_PAIRS,
    BilateralConfig,
    CorrelationConfig,
    CorrelationEvidenceConfig,
    CrossFilterConfig,
    FourPathsConfig,
    LayersConfig,
    PlanesConfig,
    PlateConfig,
    Settings,
    SpectralConfig,
    SurfaceConfig,
    ViewsConfig,
    require,
)
from chromaperture.system.errors import InputError
from chromaperture.system.validation import NotNegative, Positive

_HALVES_APART = 2.0  # px by which two halves move apart a px of half disparity
# Px by which views move apart a px of disparity. Three views below the first have their layers farther apart, by the
# second over what they move: 0.8 px instead of 0.5 for CMY circles, which move 0.75 px.
_CLOSE_VIEWS, _LAYERS_APART = 0.9, 1.2
Quality = Literal["paper", "real-time", "accurate"]
QUALITIES: tuple[Quality, ...] = get_args(Quality)
ExecutionName = Literal["numba", "numpy"]
LEAST_LAYERS = 32  # of quality accurate over a camera's working range
ALLOWED_GROWTH = 2.0  # of the power in a window, see `CrossFilterConfig`, where views lie close together
# See `PlanesConfig.known_from_nats`, where blur and noise are known: frames of noise alone reach 0.00012.
KNOWN_FROM_NATS_OF_BLUR = 3e-4
BORDER_NATS_OF_BLUR = 5.0  # see `PlanesConfig.border_nats`, where blur tells more than parallax
# Shifted views have sharper evidence, in windows that overlap less.
PLATE_OF_VIEWS = PlateConfig(evidence_share=0.3, max_block_nats=6.0, own_evidence_nats=2.0)
Method = TypeVar("Method", bound="MatcherConfig")


@dataclass(frozen=True)
class MatcherConfig(Settings):
    """What the settings of every method have in common."""

    layers: LayersConfig = LayersConfig()
    views: ViewsConfig = ViewsConfig()

    @property
    def label_curves(self) -> tuple[Quality, ...]:
        """Depth curves of the camera that define equal depth for this method, one for each view space it matches."""
        return ()

    @property
    def uses_blur(self) -> bool:
        """Whether the method matches with the camera's blur."""
        return False

    def with_range(self: Method, min_px: float, max_px: float) -> Method:
        """Return the same settings over another search range, widened to whole layers."""
        return replace(self, layers=self.layers.over(min_px, max_px))


@dataclass(frozen=True)
class PaperConfig(MatcherConfig):
    """Quality "paper": the published method, section 3.1; the error bar is fitted to captures of known depth."""

    #: Match the views in the aperture's colour space, Eq. (1), as the paper does; or the sensor channels that see one
    #: filter each, where the design has them: less noise, and no error where colours are saturated.
    space: Literal["unmixed", "pure"] = "unmixed"
    correlation: CorrelationConfig = CorrelationConfig()
    bilateral: BilateralConfig = BilateralConfig()
    #: Widens the error bar of ideal, Gaussian pictures (1.0) to that of real ones, where blurred views are mirrored,
    #: not shifted.
    sigma_scale: Positive = 2.0
    #: Of the range of the disparity within `matching.paper.EDGE_REACH_PX`, where windows span two depths; added in
    #: quadrature.
    edge_share: NotNegative = 0.5
    #: Least standard deviation of the views' displacement, px.
    floor_px: NotNegative = 0.1
    #: Of the error bar of the search range, where views mixed of several channels have nothing in common at the
    #: disparity that was found; see `matching.paper.unlike_share`.
    hue_share: NotNegative = 0.7

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.correlation.cell_px == 1, "cell_px does not apply to quality paper")


@dataclass(frozen=True)
class RealTimeConfig(MatcherConfig):
    """Quality "real-time": matching at half the resolution, semi-global along rows and columns.

    Blur is several px wide and windows are wider, so the volume need not exist at every pixel; a guided interpolation
    brings the surface back to full resolution. ``presmooth_sigma_px``, which is that of views that lie 2 px a px of
    disparity apart (`for_views`), and ``smoothing_sigma_px`` count px of the halved picture; disparities do not.
    """

    views: ViewsConfig = ViewsConfig(presmooth_sigma_px=0.4, guide_range=0.15)
    #: As `PaperConfig.space`; "channels" are sensor channels for every design, see `matching.views.channel_space`.
    space: Literal["unmixed", "pure", "channels"] = "channels"
    correlation: CorrelationConfig = CorrelationConfig(window_decay=0.30, sampling="b-spline", cell_px=2)
    paths: FourPathsConfig = FourPathsConfig()
    #: Reach over which places between the layers are averaged on an even guide; 0 switches the average off.
    smoothing_sigma_px: NotNegative = 40.0
    #: Difference of the guide, in units of ``guide_range``, at which a link of that average has fallen to 1/e.
    smoothing_edge_range: Positive = 3.3
    #: Least standard deviation of the views' displacement, px: of whole surfaces, whatever their texture, because
    #: halves of a pupil blur as mirror images. Fitted with `matching.readable.place.SCATTER`.
    floor_px: NotNegative = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        require(not self.correlation.noise_debiasing, "noise_debiasing does not apply to quality real-time")

    @property
    def label_curves(self) -> tuple[Quality, ...]:
        """See `MatcherConfig.label_curves`."""
        return ("real-time",)

    def for_views(self, directions: np.ndarray) -> RealTimeConfig:
        """Return the settings for views that move by ``directions`` (K, 2) px a px of disparity.

        Close views are smoothed more, since their noise counts more: by the root of how much closer they lie than two
        halves do, by its fourth root where there are three. Layers of three such views are farther apart, with a label
        between two of them.
        """
        apart = max(float(np.linalg.norm(a - b)) for a, b in combinations(np.asarray(directions), 2))
        closer = max(1.0, _HALVES_APART / apart) ** (0.5 if len(directions) == 2 else 0.25)
        smoothed = replace(self.views, presmooth_sigma_px=self.views.presmooth_sigma_px * closer)
        layers = self.layers
        if len(directions) == 3 and apart < _CLOSE_VIEWS:
            layers = _wider(layers, _LAYERS_APART / apart)
        return replace(self, views=smoothed, layers=layers)


@dataclass(frozen=True)
class AccurateConfig(MatcherConfig):
    """Quality "accurate": one surface optimised through the whole volume."""

    layers: LayersConfig = LayersConfig(step_px=0.25)
    #: With the camera's blur where the camera file has one, else with shifted views.
    evidence: CrossFilterConfig | CorrelationEvidenceConfig = CorrelationEvidenceConfig()
    surface: SurfaceConfig = SurfaceConfig()
    #: Of regions between depth edges: where the surface of weak evidence is looked for.
    planes: PlanesConfig = PlanesConfig()
    #: The surface, which starts from those planes and follows the evidence.
    plate: PlateConfig = PLATE_OF_VIEWS
    #: Evidence of all channels together, beside that of pairs, where the camera's blur and noise are known.
    spectral: SpectralConfig = SpectralConfig()

    @property
    def label_curves(self) -> tuple[Quality, ...]:
        """See `MatcherConfig.label_curves`: those of the unmixed and of the pure views."""
        return ("accurate",) if self.uses_blur else ("accurate", "real-time")

    @property
    def uses_blur(self) -> bool:
        """See `MatcherConfig.uses_blur`."""
        return isinstance(self.evidence, CrossFilterConfig)

    @classmethod
    def for_range(cls, min_px: float, max_px: float) -> AccurateConfig:
        """Return the settings for a working range, px, of a camera whose blur is not known."""
        plain = cls()
        step = min(plain.layers.step_px, (max_px - min_px) / LEAST_LAYERS)
        surface = replace(plain.surface, slope_penalty=plain.surface.slope_penalty * plain.layers.step_px / step)
        layers = replace(plain.layers, step_px=step).over(min_px, max_px)
        return replace(plain, layers=layers, surface=surface)

    @classmethod
    def for_blur(
        cls, reach: float, *, one_pair: bool = False, full_well_electrons: float | None = None
    ) -> AccurateConfig:
        """Return the settings for a camera whose blur is known.

        ``reach`` is px of half disparity for a px by which blur displaces the pupil's edge: layers (0.3 px of blur) and
        slopes count in blur, so that designs whose views lie close together are searched as finely. ``one_pair``: the
        widest separation is that of one pair of channels, as of two halves; where such views lie apart, evidence counts
        as far as it is a pixel's own. ``full_well_electrons``: of the sensor, see `CrossFilterConfig.for_blur`.
        """
        surface = SurfaceConfig(slope_penalty=25.0 / reach, temperature=0.3, learned_error_bar="blur")
        layers = LayersConfig(step_px=0.3 * reach)
        evidence = CrossFilterConfig.for_blur(reach, full_well_electrons=full_well_electrons)
        planes = PlanesConfig(known_from_nats=KNOWN_FROM_NATS_OF_BLUR)
        if reach < LEAST_REACH_OF_PAIRS:
            evidence = replace(evidence, allowed_growth=ALLOWED_GROWTH)
            planes = replace(planes, border_nats=BORDER_NATS_OF_BLUR)
        elif one_pair:
            evidence = replace(evidence, own_detail=True)
        spectral = SpectralConfig.for_blur(reach)
        plate = PlateConfig()
        return cls(layers=layers, evidence=evidence, surface=surface, planes=planes, plate=plate, spectral=spectral)

    def with_half_pixels(self) -> AccurateConfig:
        """Return the settings for a dual-pixel sensor whose blur is known.

        Red and blue are the light of the pixels' halves, green their mean. Both halves see most of the pupil: what a
        layer's blur brings from elsewhere is no evidence, and evidence counts as far as it is a pixel's own. They share
        noise (``matching/evidence/half_pixels.py``). The error bar is not the learned one, which knows other
        evidence.

        Raises
        ------
        InputError
            These settings are for shifted views.
        """
        if not isinstance(self.evidence, CrossFilterConfig):
            raise InputError("half pixels are matched with the blur: start from AccurateConfig.for_blur")
        evidence = replace(self.evidence, own_detail=True, allowed_growth=ALLOWED_GROWTH)
        surface = replace(self.surface, learned_error_bar="none")
        spectral = replace(self.spectral, dual_pixel=True)
        return replace(self, evidence=evidence, surface=surface, spectral=spectral)


@dataclass(frozen=True)
class DepthConfig(Settings):
    """Disparity to depth (paper sections 3.2 to 3.4)."""

    #: Depths beyond are reported as unknown: next to the disparity at infinity the error bar exceeds the depth.
    max_depth_mm: float = 50_000.0


@dataclass(frozen=True)
class Config(Settings):
    """All stages together, as ``CodedApertureCamera`` takes it and ``STEM.json`` records it."""

    #: Whose depth curve in the camera file belongs to the matcher's settings.
    quality: Quality = "real-time"
    #: Counts px of the picture that is matched, whose sides are 1 / ``scale`` of the photograph's.
    matcher: MatcherConfig = RealTimeConfig()
    depth: DepthConfig = DepthConfig()
    #: Working scale, see `chromaperture.model.scale.working_scale`.
    scale: Annotated[float, Field(ge=1)] = 1
    #: Photographs show a part of the sensor: column and row of its first pixel. None: they show the whole frame.
    crop_origin_px: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] | None = None


def preset(quality: Quality) -> MatcherConfig:
    """Return the settings behind ``--quality`` for a camera whose blur is not known; raises InputError."""
    presets: dict[str, MatcherConfig] = {
        "paper": PaperConfig(), "real-time": RealTimeConfig(), "accurate": AccurateConfig(),
    }  # fmt: skip
    if quality not in presets:
        raise InputError(f"unknown quality {quality!r}: choose paper, real-time or accurate")
    return presets[quality]


def _wider(layers: LayersConfig, factor: float) -> LayersConfig:
    """Return layers so many times as far apart, three at least, from the first on to the range's end or beyond."""
    step = factor * layers.step_px
    spacings = max(2, math.ceil((layers.max_px - layers.min_px) / step - 1e-6))  # 1e-6: what fits but for rounding fits
    return replace(layers, max_px=layers.min_px + spacings * step, step_px=step)

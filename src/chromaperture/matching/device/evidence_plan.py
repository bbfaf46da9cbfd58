"""Sizes and constants of the evidence from the camera's blur on a device: of one camera and one set of layers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from chromaperture.matching.device.device import DeviceError
from chromaperture.matching.device.surface_stages import AT_ONCE, gaussian_taps
from chromaperture.matching.evidence.blur import SHARP_PX, SPACING_PX, TAILS_PX, BlurEvidence, finest_px
from chromaperture.matching.readable.tiles import SAMPLING_PX, Nodes
from chromaperture.settings.stages import CrossFilterConfig

MOST_TRANSFORMED = 1024  # complex numbers of two lines: they fill 16 KB of shared memory
MOST_BANDS = 8  # whose numbers fit into 32 bits
ROUND_BYTES = 1 << 28  # of the arrays that a round of layers works on; chosen by hand


class Part(NamedTuple):
    """Computed layers that have the same pairs of channels.

    Attributes
    ----------
    pairs : tuple of (int, int)
        The first of `BlurEvidence.all_pairs`, or all.
    begin, end : int
        Of the computed layers.
    """

    pairs: tuple[tuple[int, int], ...]
    begin: int
    end: int

    @property
    def channels(self) -> tuple[int, ...]:
        """Channels that the pairs use."""
        return tuple(sorted({k for pair in self.pairs for k in pair}))


@dataclass(frozen=True)
class EvidencePlan:
    """Sizes and constants of the evidence for one camera and one set of layers.

    Attributes
    ----------
    source : BlurEvidence
    layers_px : (D,) float, px
        An odd number; see `BlurEvidence.at`.
    computed_px : (E,) float, px
        Those whose correlations are computed: every second one, and the others where blur is narrow. First those of
        secondary pairs, too: every fourth, and the last.
    places : (D,) int32
        Where a layer is among these, -1 where it is interpolated.
    parts : tuple of Part
    nodes : Nodes
    """

    source: BlurEvidence
    layers_px: np.ndarray
    computed_px: np.ndarray
    places: np.ndarray
    parts: tuple[Part, ...]
    nodes: Nodes

    @property
    def samples(self) -> tuple[int, int]:
        """Height and width of the evidence."""
        blur = self.source.blur
        return -(-blur.height_px // SPACING_PX), -(-blur.width_px // SPACING_PX)

    @property
    def factors(self) -> float:
        """See `stages.read_at_labels`."""
        return float(sum(self.source.config.band_weights))


def plan_evidence(source: BlurEvidence, layers_px: np.ndarray) -> EvidencePlan:
    """Choose layers and tiles; raises DeviceError where a tile is too large for the device."""
    step = layers_px[1] - layers_px[0]
    layers_px = layers_px[0] + step * np.arange(len(layers_px) // 2 * 2 + 1)
    numbers = np.arange(len(layers_px))
    sharp = (numbers % 2 == 1) & (np.abs(layers_px) < SHARP_PX * source.blur.reach)
    of_all_pairs = (numbers % 4 == 0) | (numbers == numbers[-1])
    computed = np.concatenate([numbers[of_all_pairs], numbers[~of_all_pairs & ((numbers % 2 == 0) | sharp)]])
    places = np.full(len(layers_px), -1, np.int32)
    places[computed] = np.arange(len(computed))
    parts = [
        Part(source.all_pairs, 0, int(of_all_pairs.sum())),
        Part(source.blur.pairs, int(of_all_pairs.sum()), len(computed)),
    ]
    if source.all_pairs == source.blur.pairs:
        parts = [Part(source.all_pairs, 0, len(computed))]
    margin = 2 * float(np.abs(layers_px).max()) / source.blur.reach + TAILS_PX
    nodes = Nodes(source.blur.height_px, source.blur.width_px, margin_px=margin)
    if nodes.size_px > MOST_TRANSFORMED:
        raise DeviceError(
            f"tiles of {nodes.size_px} px are too large for the GPU, at most {MOST_TRANSFORMED}: "
            "use --device cpu, or a smaller --scale"
        )
    return EvidencePlan(
        source, layers_px, layers_px[computed], places, tuple(part for part in parts if part.end > part.begin), nodes
    )


class RoundSizes:
    """Sizes of what a round of layers of a part works on; ``layers_px`` are all that are computed."""

    def __init__(self, plan: EvidencePlan, part: Part, layers_px: np.ndarray) -> None:
        nodes, source = plan.nodes, plan.source
        self.size, self.kept = nodes.size, nodes.size // 2
        self.tiles, self.middle = len(nodes.places), 2 * nodes.half
        self.pairs, self.bands = len(part.pairs), len(source.config.bands_px)
        self.part, self.pictures = part, self.tiles * len(part.channels)
        at_infinity, scale = source.blur.reference
        inverse = (at_infinity - layers_px[part.begin : part.end]) / scale
        self.defocus = source.blur.model.scale_px_mm * inverse
        self.rays = [source.blur.rays(*place, part.channels) for place in nodes.places]
        self.reach = self._reach(source.blur.pupil.points)
        self.side = 2 * int(self.reach.max()) + 2
        self.smooths = _smooths(source.config)
        height, width = nodes.shape
        frame, small = self.pairs * height * width, self.pairs * -(-height // 2) * -(-width // 2)
        self.arrays = dict(  # numbers a layer
            point_rows=2 * self.pictures * self.side * self.kept,
            transfers=2 * self.pictures * self.size * self.kept,
            cross_columns=4 * self.tiles * self.pairs * self.kept * self.middle,
            tile_views=2 * self.tiles * self.pairs * self.middle**2,
            joined=2 * frame,
            smooth_rows=2 * self.smooths.taps.shape[1] * frame,
            band_views=2 * self.bands * frame,
            products=3 * self.bands * small,
            product_rows=3 * self.bands * small,
        )
        most = ROUND_BYTES // (4 * sum(self.arrays.values()))
        self.count = part.end - part.begin
        self.rounds = math.ceil(self.count / max(1, most))
        self.layers = math.ceil(self.count / self.rounds)

    def _reach(self, points: np.ndarray) -> np.ndarray:
        """Px from the chief ray that light reaches at every layer."""
        at_infinity = np.stack([rays.at_infinity_px for rays in self.rays])
        lit = np.stack([rays.light for rays in self.rays])[..., None] > 0
        return np.array([math.ceil(np.abs((at_infinity - d * points) * lit).max()) for d in self.defocus])


class Smooths(NamedTuple):
    """Gaussians of all bands, after the finest of all, which is number 0.

    Attributes
    ----------
    taps : (2 reach + `AT_ONCE`, S) float32
        Of the others, numbers 1, 2, ..., zeros at the end.
    reach : int
    fine, coarse : int
        Number of the Gaussian of every band, four bits each.
    """

    taps: np.ndarray
    reach: int
    fine: int
    coarse: int


def _smooths(config: CrossFilterConfig) -> Smooths:
    finest = finest_px(config)
    others = sorted({sigma for band in config.bands_px for sigma in band} - {finest})
    if len(config.bands_px) > MOST_BANDS or len(others) >= 16:
        raise DeviceError(f"{len(config.bands_px)} bands are too many for the GPU, at most {MOST_BANDS}")
    each = [gaussian_taps(math.sqrt(sigma**2 - finest**2) / SAMPLING_PX) for sigma in others]
    reach = max(len(taps) // 2 for taps in each)
    wide = [np.pad(taps, (reach - len(taps) // 2, reach - len(taps) // 2 + AT_ONCE - 1)) for taps in each]
    fine, coarse = (
        sum(([finest, *others].index(band[k])) << 4 * i for i, band in enumerate(config.bands_px)) for k in (0, 1)
    )
    return Smooths(np.stack(wide, axis=-1).astype(np.float32), reach, fine, coarse)

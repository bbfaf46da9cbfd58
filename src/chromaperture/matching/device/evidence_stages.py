"""Evidence from the camera's blur on a device: from a photograph to the unexplained fractions of every layer.

``evidence/blur.py`` explains what is computed. Tiles are transformed in shared memory, row by row and column by
column. Transfer functions are not: traced rays fall into a square as small as the blur, whose rows and columns are
transformed directly, at the frequencies that the samples have and no others. Layers go through in rounds, as many at a
time as a quarter of a gigabyte holds; what a round works on is used again by the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
import scipy.fft

from chromaperture.matching.device.device import GROUP, Array, Chain, DeviceError, groups_for
from chromaperture.matching.device.surface_stages import AT_ONCE, add_gaussian, gaussian_taps
from chromaperture.matching.evidence.blur import IN_FOCUS_PX, SPACING_PX, BlurEvidence, finest_px
from chromaperture.matching.readable.band_correlation import LEAST_POWER, LEAST_SEEN
from chromaperture.matching.readable.pair_evidence import CONTRARY, MAX_CORRELATION2_OF_BANDS
from chromaperture.matching.readable.tiles import BACKGROUND_PX, LAG_PX, SAMPLING_PX, NodeAxis, Nodes
from chromaperture.settings.stages import CrossFilterConfig

MOST_TRANSFORMED = 1024  # complex numbers of two lines: they fill 16 KB of shared memory
MOST_BANDS = 8  # whose numbers fit into 32 bits
ROUND_BYTES = 1 << 28  # of the arrays that a round of layers works on; chosen by hand
RADICES = (16, 12, 10, 9, 8, 6, 5, 4, 3, 2)  # of `fourier`
SHARED_NUMBERS = 4000  # of the correlations of a sample in 16 KB of shared memory
CELLS = 4096  # pixels of a point-spread function in 16 KB of shared memory
FEW = 4  # neighbours that an invocation of the other filters has
_NEGLIGIBLE = 1e-8  # of a window's transform


class Part(NamedTuple):
    """Computed layers that have the same pairs of channels."""

    pairs: tuple[tuple[int, int], ...]  # the first of `BlurEvidence.all_pairs`, or all
    begin: int  # of the computed layers
    end: int

    @property
    def channels(self) -> tuple[int, ...]:
        """Channels that the pairs use."""
        return tuple(sorted({k for pair in self.pairs for k in pair}))


@dataclass(frozen=True)
class EvidencePlan:
    """Sizes and constants of the evidence for one camera and one set of layers."""

    source: BlurEvidence
    layers_px: np.ndarray  # (D,) float, an odd number; see `BlurEvidence.at`
    # (E,) float: every second layer, and the others where blur is narrow. First those of secondary pairs, too: every
    # fourth, and the last.
    computed_px: np.ndarray
    places: np.ndarray  # (D,) int32: where a layer is among these, -1 where it is interpolated
    parts: tuple[Part, ...]
    nodes: Nodes

    @property
    def samples(self) -> tuple[int, int]:
        """Height and width of the evidence."""
        blur = self.source.blur
        return -(-blur.height_px // SPACING_PX), -(-blur.width_px // SPACING_PX)

    @property
    def factors(self) -> float:
        """See `readable.read_at_labels`."""
        return float(sum(self.source.config.band_weights))


def plan_evidence(source: BlurEvidence, layers_px: np.ndarray) -> EvidencePlan:
    """Choose layers and tiles; raises DeviceError where a tile is too large for the device."""
    plan = source.plan(layers_px)
    count = len(plan.computed_px)
    parts = [Part(source.all_pairs, 0, plan.of_all_pairs), Part(source.blur.pairs, plan.of_all_pairs, count)]
    if source.all_pairs == source.blur.pairs:
        parts = [Part(source.all_pairs, 0, count)]
    nodes = source.nodes(plan.layers_px)
    if nodes.size_px > MOST_TRANSFORMED:
        raise DeviceError(
            f"tiles of {nodes.size_px} px are too large for the GPU, at most {MOST_TRANSFORMED}: "
            "use --device cpu, or a smaller --scale"
        )
    parts = [part for part in parts if part.end > part.begin]
    return EvidencePlan(source, plan.layers_px, plan.computed_px, plan.places[0].astype(np.int32), tuple(parts), nodes)


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
    """Gaussians of all bands, after the finest of all, which is number 0."""

    taps: np.ndarray  # (2 reach + `AT_ONCE`, S) float32: of numbers 1, 2, ..., zeros at the end
    reach: int
    fine: int  # number of the Gaussian of every band, four bits each
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


def add_evidence(chain: Chain, plan: EvidencePlan, image: Array, noise: Array) -> Array:
    """Append all stages from a photograph to the unexplained fraction of every layer, (samples, D).

    ``image``: (H, W, 3), linear RGB, finite; ``noise``: (tiles, 3), `Nodes.noise_powers`, 0 where it is not known.
    """
    spectra, signal = _add_spectra(chain, plan, image, noise)
    correlation = _add_correlations(chain, plan, spectra, signal)
    config, pairs = plan.source.config, plan.source.all_pairs
    samples = plan.samples[0] * plan.samples[1]
    unexplained = chain.array("unexplained", samples * len(plan.layers_px))
    evens, lists = len(plan.layers_px) // 2 + 1, len(pairs) * len(config.bands_px)
    if lists * (evens + evens // 2 + 9) > SHARED_NUMBERS:
        raise DeviceError(f"{lists} bands of pairs at {len(plan.layers_px)} layers are too many for the GPU")
    chain.add(
        "pair_evidence", [correlation, chain.constant("places", plan.places), unexplained],
        groups=groups_for(samples, 1), samples=samples, count=len(plan.layers_px), computed=len(plan.computed_px),
        pairs=len(pairs), primary_pairs=len(plan.source.blur.pairs), of_all_pairs=plan.parts[0].end,
        bands=len(config.bands_px), weights=[float(w) for w in config.band_weights],
        most_correlation2=MAX_CORRELATION2_OF_BANDS, contrary_product=CONTRARY,
        fallback_weight=float(config.fallback_weight), fallback_nats=float(config.fallback_nats), factors=plan.factors,
    )  # fmt: skip
    return unexplained


def add_transform(
    chain: Chain,
    stage: str,
    arrays: list[Array],
    span: int,
    lines: int,
    *,
    backwards: bool,
    beside_lines: bool,
    **constants: Any,
) -> None:
    """Append transforms of so many pairs of lines of ``span`` numbers; ``arrays`` follow the table of factors.

    ``beside_lines`` tells that the same numbers of neighbouring lines are neighbours in memory, not those of a line.
    """
    radices = _radices(span)
    most_butterflies = span // min(radices)
    group_size = GROUP * -(-most_butterflies // GROUP)
    lines_of_group = max(1, min(group_size // most_butterflies, MOST_TRANSFORMED // span))
    chain.add(
        stage, [_factors(chain, span), *arrays], groups=groups_for(lines, lines_of_group), span=span, lines=lines,
        lines_of_group=lines_of_group, group_size=group_size, passes=len(radices),
        radices=sum(radix << 8 * i for i, radix in enumerate(radices)), last_radix=radices[-1], backwards=backwards,
        beside_lines=beside_lines, **constants,
    )  # fmt: skip


def _radices(span: int) -> tuple[int, ...]:
    """Cut a length into two to four radices, as few and as even as can be; raises DeviceError where it has others."""
    for passes in (2, 3, 4):
        cuts = [cut for cut in combinations_with_replacement(RADICES, passes) if math.prod(cut) == span]
        if cuts:
            return max(cuts, key=min)
    raise DeviceError(f"a tile's side of {span} has too large factors for the GPU; use --device cpu")


def _factors(chain: Chain, span: int) -> Array:
    """Return exp(-2 pi i k / span), made once."""
    name = f"factors_{span}"
    if name not in chain.arrays:
        turn = -2j * np.pi * np.arange(span) / span
        chain.constant(name, np.exp(turn).astype(np.complex64).view(np.float32))
    return chain.arrays[name]


def _add_spectra(chain: Chain, plan: EvidencePlan, image: Array, noise: Array) -> tuple[Array, Array]:
    """Append `Nodes.spectra`: spectra of the tiles, (tiles, 3, n, n / 2 + 1), and the fraction that is no noise."""
    nodes, blur = plan.nodes, plan.source.blur
    size, size_px, tiles = nodes.size, nodes.size_px, len(nodes.places)
    kept, columns, pictures = size // 2, size // 2 + 1, 3 * tiles
    shading, between = (chain.array(name, image.size) for name in ("shading", "shading_rows"))
    frame = blur.height_px, blur.width_px
    add_gaussian(chain, shading, between, frame, gaussian_taps(BACKGROUND_PX), parts=3, source=image)
    corners = chain.constant("corners", np.array(nodes.corners_px, np.int32))
    rows = chain.array("tile_rows", 2 * pictures * size_px * kept)
    add_transform(
        chain, "tile_rows", [image, shading, corners, rows], size_px, pictures * size_px // 2, backwards=False,
        beside_lines=False, height=blur.height_px, width=blur.width_px, kept=kept,
    )  # fmt: skip
    spectra, power, signal = (
        chain.array(name, parts * pictures * size * columns)
        for name, parts in (("spectra", 2), ("power", 1), ("signal", 1))
    )
    add_transform(
        chain, "tile_columns", [rows, spectra], size_px, pictures * kept // 2, backwards=False, beside_lines=True,
        size=size, kept=kept, gain=1 / SAMPLING_PX**2,
    )  # fmt: skip
    # The autocorrelation under a lag window is the power averaged with the window's transform.
    lags = np.minimum(np.arange(size), size - np.arange(size))
    window = scipy.fft.fft(np.exp(-(lags**2) / (2 * (LAG_PX / SAMPLING_PX) ** 2))).real / size
    reach = int(np.flatnonzero(window[: size // 2] > _NEGLIGIBLE * window[0]).max())
    taps = chain.constant("lag_taps", np.concatenate([window[reach:0:-1], window[: reach + 1], np.zeros(FEW - 1)]))
    between = chain.array("power_columns", pictures * size * columns)
    for before, after, along_x in ((spectra, between, False), (between, power, True)):
        chain.add(
            "tile_smoothing", [before, taps, after],
            pictures * (size * -(-columns // FEW) if along_x else columns * -(-size // FEW)), pictures=pictures,
            size=size, reach=reach, along_x=along_x, is_spectrum=not along_x,
        )  # fmt: skip
    chain.add(
        "tile_signal", [power, noise, signal], pictures * size * columns, pictures=pictures, frequencies=size * columns,
    )  # fmt: skip
    return spectra, signal


def _add_correlations(chain: Chain, plan: EvidencePlan, spectra: Array, signal: Array) -> Array:
    """Append what all layers need, in rounds; correlations, see `correlations`."""
    sizes = [RoundSizes(plan, part, plan.computed_px) for part in plan.parts]
    in_focus = RoundSizes(plan, Part(plan.source.all_pairs, 0, 1), np.array([IN_FOCUS_PX]))
    every = (in_focus, *sizes) if plan.source.config.allowed_growth > 0 else tuple(sizes)
    needed = {name: max(one.layers * one.arrays[name] for one in every) for name in sizes[0].arrays}
    made = {name: chain.array(name, size) for name, size in needed.items()}
    round_, config, samples = chain.array("evidence_round", 1, np.uint32), plan.source.config, math.prod(plan.samples)
    correlation = chain.array(
        "correlation", len(config.bands_px) * samples * sum(one.pairs * one.count for one in sizes)
    )
    low_pass = np.exp(-((2 * np.pi * scipy.fft.fftfreq(sizes[0].size) * finest_px(config) / SAMPLING_PX) ** 2) / 2)
    tiles, span, all_pairs = len(plan.nodes.places), sizes[0].size, plan.source.all_pairs
    of_pairs = chain.array("pair_spectra", 4 * tiles * len(all_pairs) * span * (span // 2))
    chain.add(
        "pair_spectra", [spectra, signal, chain.constant("low_pass", low_pass), of_pairs], of_pairs.size // 4,
        tiles=tiles, pair_count=len(all_pairs), span=span,
        pairs=sum((a | b << 2) << 4 * i for i, (a, b) in enumerate(all_pairs)),
    )  # fmt: skip
    constants = dict(
        pair_spectra=of_pairs,
        across=_near_nodes(chain, "across", plan.nodes.across, plan.nodes.shape[1]),
        down=_near_nodes(chain, "down", plan.nodes.down, plan.nodes.shape[0]),
        starts=chain.constant(
            "starts", np.concatenate([plan.nodes.across.starts, plan.nodes.down.starts]).astype(np.float32)
        ),
        band_taps=chain.constant("band_taps", sizes[0].smooths.taps),
    )
    seen = chain.array("seen", in_focus.arrays["products"] * 2 // 3 if in_focus in every else 2)
    for number, part in enumerate(every):
        rays = _rays(chain, plan, part, number)
        for i in range(part.rounds):
            chain.add("count_up", [round_], groups=(1,), to_zero=i == 0)
            _add_transfers(chain, plan, part, made, (*rays, round_))
            _add_views(chain, plan, part, made, constants)
            _add_windows(chain, plan, part, made, constants["band_taps"])
            if part is in_focus:
                chain.add(
                    "band_powers", [made["products"], seen], seen.size // 2, windows=seen.size // 2,
                )  # fmt: skip
            else:
                _add_correlation(chain, plan, part, made["products"], (seen, round_), correlation)
    return correlation


def _rays(chain: Chain, plan: EvidencePlan, sizes: RoundSizes, number: int) -> tuple[Array, Array, Array]:
    """Send traced rays of a part up: of every tile and channel, and what a layer adds to them."""
    parts = [np.stack([getattr(rays, name) for rays in sizes.rays]) for name in ("at_infinity_px", "light")]
    order = np.argsort(parts[1] <= 0, axis=-1, kind="stable")[..., None]  # those without light at the end
    every = [parts[0], parts[1][..., None]]
    rays = np.concatenate([*(np.take_along_axis(part, order, axis=2) for part in every), order], axis=-1)
    return (
        chain.constant(f"rays_{number}", rays),
        chain.constant(f"pupil_{number}", plan.source.blur.pupil.points),
        chain.constant(f"defocus_{number}", np.stack([sizes.defocus, sizes.reach], axis=-1)),
    )


def _near_nodes(chain: Chain, name: str, axis: NodeAxis, count: int) -> Array:
    """First of two nodes around every sample, and the weights of both."""
    weights = np.zeros((len(axis.starts) + 1, count), np.float32)
    for i, (start, of_tile) in enumerate(zip(axis.starts, axis.weights, strict=True)):
        inside = np.arange(max(0, start), min(count, start + len(of_tile)))
        weights[i, inside] = of_tile[inside - start]
    first = (weights > 0).argmax(axis=0)
    near = np.stack([first, np.zeros(count), *(weights[first + i, np.arange(count)] for i in (0, 1))], axis=-1)
    return chain.constant(name, near)


def _add_transfers(
    chain: Chain, plan: EvidencePlan, sizes: RoundSizes, made: dict[str, Array], inputs: tuple[Array, ...]
) -> None:
    """Append `LensBlur.transfer_of` for all tiles, channels and layers of a round."""
    rays, pupil, defocus, round_ = inputs
    factors = _factors(chain, plan.nodes.size_px)
    rows_of_group = min(CELLS // sizes.side, sizes.side)
    if rows_of_group == 0:
        raise DeviceError(f"a blur of {sizes.side} px is too wide for the GPU, at most {CELLS}: use --device cpu")
    same = dict(
        tile_px=plan.nodes.size_px, pictures=sizes.pictures, side=sizes.side, kept=sizes.kept,
        layers_of_round=sizes.layers, layer_count=sizes.count,
    )  # fmt: skip
    chain.add(
        "point_rows", [factors, rays, pupil, defocus, round_, made["point_rows"]],
        groups=(sizes.pictures, sizes.side / rows_of_group, sizes.layers), points=len(plan.source.blur.pupil.points),
        rows_of_group=rows_of_group, cells=rows_of_group * sizes.side, **same,
    )  # fmt: skip
    chain.add(
        "point_columns", [factors, defocus, round_, made["point_rows"], made["transfers"]],
        groups=(sizes.kept // 2 * -(-sizes.kept // FEW) / GROUP, sizes.pictures, sizes.layers), size=sizes.size, **same,
    )  # fmt: skip


def _add_views(
    chain: Chain, plan: EvidencePlan, sizes: RoundSizes, made: dict[str, Array], constants: dict[str, Array]
) -> None:
    """Append P and Q of the frame, for all pairs and layers of a round."""
    pictures = sizes.layers * sizes.tiles * sizes.pairs
    place_of = sizes.part.channels.index
    pairs = sum((place_of(a) | place_of(b) << 2) << 4 * i for i, (a, b) in enumerate(sizes.part.pairs))
    add_transform(
        chain, "cross_columns", [constants["pair_spectra"], made["transfers"], made["cross_columns"]], sizes.size,
        pictures * sizes.kept, backwards=True, beside_lines=True, tiles=sizes.tiles, channels=len(sizes.part.channels),
        pair_count=sizes.pairs, all_pairs=len(plan.source.all_pairs), pairs=pairs, middle=sizes.middle,
        damping=float(plan.source.config.damping),
    )  # fmt: skip
    add_transform(
        chain, "cross_rows", [made["cross_columns"], made["tile_views"]], sizes.size, pictures * sizes.middle // 2,
        backwards=True, beside_lines=False, middle=sizes.middle,
    )  # fmt: skip
    height, width = plan.nodes.shape
    chain.add(
        "tiles_joined",
        [made["tile_views"], constants["across"], constants["down"], constants["starts"], made["joined"]],
        sizes.layers * sizes.pairs * height * width, height=height, width=width, layers_of_round=sizes.layers,
        pair_count=sizes.pairs, tiles=sizes.tiles, middle=sizes.middle, node_columns=len(plan.nodes.across.starts),
    )  # fmt: skip


def _add_windows(chain: Chain, plan: EvidencePlan, sizes: RoundSizes, made: dict[str, Array], band_taps: Array) -> None:
    """Append the bands of P and Q, and their products in windows around every second sample."""
    height, width = plan.nodes.shape
    small = -(-height // 2), -(-width // 2)
    pictures, config = sizes.layers * sizes.pairs, plan.source.config
    planes = sizes.bands * pictures
    smooths = sizes.smooths
    same: dict[str, Any] = dict(
        height=height, width=width, pictures=pictures, smooths=smooths.taps.shape[1], reach=smooths.reach
    )
    chain.add(
        "bands_rows", [made["joined"], band_taps, made["smooth_rows"]], pictures * height * -(-width // AT_ONCE),
        **same,
    )  # fmt: skip
    chain.add(
        "bands_columns", [made["joined"], made["smooth_rows"], band_taps, made["band_views"]],
        pictures * -(-height // AT_ONCE) * width, bands=sizes.bands, fine=smooths.fine, coarse=smooths.coarse, **same,
    )  # fmt: skip
    chain.add(
        "band_products", [made["band_views"], made["products"]], planes * -(-small[0] // FEW) * small[1], height=height,
        width=width, planes=planes,
    )  # fmt: skip
    rest_px = math.sqrt(max(config.window_sigma_px**2 - SAMPLING_PX**2, 0.01))  # as `blur`
    add_gaussian(
        chain,
        made["products"],
        made["product_rows"],
        small,
        gaussian_taps(rest_px / 2 / SAMPLING_PX),
        parts=3,
        planes=planes,
    )


def _add_correlation(
    chain: Chain,
    plan: EvidencePlan,
    sizes: RoundSizes,
    products: Array,
    inputs: tuple[Array, Array],
    correlation: Array,
) -> None:
    """Append the correlations of P and Q, from their products in windows, and the powers seen in focus."""
    (height, width), config = (-(-n // 2) for n in plan.nodes.shape), plan.source.config
    chain.add(
        "band_correlation", [products, *inputs, correlation], sizes.bands * sizes.layers * sizes.pairs * height * width,
        height=height, width=width, bands=sizes.bands, layers_of_round=sizes.layers, pair_count=sizes.pairs,
        first_layer=sizes.part.begin, all_pairs=len(plan.source.all_pairs), least_power=float(LEAST_POWER),
        least_seen=float(LEAST_SEEN), allowed_growth=config.allowed_growth, takes_off=int(config.allowed_growth > 0),
        layer_count=sizes.part.end, primary_pairs=len(plan.source.blur.pairs), computed=len(plan.computed_px),
        of_all_pairs=plan.parts[0].end, kept_height=plan.samples[0], kept_width=plan.samples[1],
    )  # fmt: skip

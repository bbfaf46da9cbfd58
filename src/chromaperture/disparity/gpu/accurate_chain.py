"""Quality "accurate" on a device.

The photograph goes up once and the maps come down once. Two submissions: the second has what the CPU makes of the
photograph while the device works on the first, links of edges and light along lines. In between planes are found: by
the CPU where depth edges bound them (`regions_between.py`), else by the device, and nothing returns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from operator import call
from typing import NamedTuple

import numpy as np

from chromaperture.disparity.accurate import ALL_CHANNELS, EDGE_SHARE, AccurateMethod, with_halves
from chromaperture.disparity.blur_evidence import BlurEvidence
from chromaperture.disparity.clipped_areas import clipped_filled
from chromaperture.disparity.correlation_evidence import CorrelationEvidence
from chromaperture.disparity.error_bar import sigma_of_range
from chromaperture.disparity.gpu.agreement_stages import add_planes_or_surface
from chromaperture.disparity.gpu.candidate_stages import add_candidates, add_first_choice, most_candidates
from chromaperture.disparity.gpu.device import Array, Chain, Device, Ticket
from chromaperture.disparity.gpu.edge_stages import EdgeGrid, HeardLines, add_placed_edges, add_planes_of_pixels
from chromaperture.disparity.gpu.evidence_plan import EvidencePlan, plan_evidence
from chromaperture.disparity.gpu.evidence_stages import add_evidence
from chromaperture.disparity.gpu.joining_stages import add_joining
from chromaperture.disparity.gpu.judging_stages import Light, OfPlanes, add_judged, add_label_maps, add_median
from chromaperture.disparity.gpu.label_stages import WindowsEarned, add_labels, add_views_evidence
from chromaperture.disparity.gpu.line_stages import add_colours, inputs_of, line_arrays
from chromaperture.disparity.gpu.line_textures import LineTextures, line_textures
from chromaperture.disparity.gpu.measured import NOTHING, Further, Measured, add_further, measured_from, outputs_of
from chromaperture.disparity.gpu.plane_stages import BlockChoice
from chromaperture.disparity.gpu.regions_between import DOWN, add_proposed, regions_found, voted_arrays
from chromaperture.disparity.gpu.spectral_stages import WindowGrid, add_windows
from chromaperture.disparity.gpu.surface_stages import (
    Grid,
    SurfaceArrays,
    add_block_sums,
    add_paths,
    add_posterior,
    add_sigma,
    add_start,
    add_variation,
    surface_arrays,
)
from chromaperture.disparity.gpu.view_stages import STATS, add_two_views
from chromaperture.disparity.gpu.voting_stages import Voted, add_voted_planes
from chromaperture.disparity.gpu.working_stages import Reduction, add_reduced, add_upsampled
from chromaperture.disparity.planar import BORDER_APART_LABELS, block_costs, needs_depth_edges
from chromaperture.disparity.plane_edges import edge_links
from chromaperture.disparity.spectral_evidence import SpectralEvidence
from chromaperture.disparity.views import filtered_views
from chromaperture.disparity.working_scale import reduced
from chromaperture.threads import begun, parallel_map


class Room(NamedTuple):
    """For how much of what is found the chains have room; where there is more they are composed with twice as much.

    Attributes
    ----------
    joins, later_joins : int
        Rounds of joining behind the first choice of blocks, and behind later ones; of `still_life` 19 and 22 joins
        follow the first (720x480) and up to 2 another one (360x240).
    planes : int
        Left in the end, of all fits together; of random scenes 6 to 25 (720x480), where the guide leads 9 to 43.
    lines : int
        Across borders; a tenth of it at 720x480.
    """

    joins: int = 48
    later_joins: int = 4
    planes: int = 64
    lines: int = 1 << 15

    def doubled(self) -> Room:
        """Return room for twice as much."""
        return Room(*(2 * number for number in self))


def pairs_of(method: AccurateMethod) -> BlurEvidence | None:
    """Return the evidence of pairs of channels; None where the blur is not known."""
    evidence = method.evidence
    if isinstance(evidence, SpectralEvidence):
        return evidence.pairs
    return evidence if isinstance(evidence, BlurEvidence) else None


class Started(NamedTuple):
    """A photograph under way: what computes it, and what goes up for either chain, in case that there was no room."""

    chain: Chain
    ticket: Ticket
    first: dict[str, np.ndarray]
    last: dict[str, np.ndarray]


@dataclass
class AccurateChain:
    """The chains of one camera: to the planes, or the surface where none are looked for, and from there to the maps.

    Attributes
    ----------
    method : AccurateMethod
        Of reduced pictures where there is a reduction.
    device : Device
    shape : (int, int)
        Height and width of its photographs.
    room : Room
    reduction : Reduction or None
        Where reduced pictures are matched.
    further : Further
        What is made of the disparity besides.
    plan : EvidencePlan or None
        None where the blur is not known: evidence is that of shifted views.
    grid : Grid
        Of the picture that is matched.
    labels_px : (N,) float64, px
    first, last : Chain
    voted : Voted or None
        What goes up of planes that depth edges bound; None where the device finds planes.
    """

    method: AccurateMethod
    device: Device
    shape: tuple[int, int]
    room: Room = field(default_factory=Room)
    reduction: Reduction | None = None
    further: Further = NOTHING
    plan: EvidencePlan | None = field(init=False)
    grid: Grid = field(init=False)
    labels_px: np.ndarray = field(init=False)
    first: Chain = field(init=False)
    last: Chain = field(init=False)
    arrays: SurfaceArrays = field(init=False)
    light: Light = field(init=False)
    textures: LineTextures | None = field(init=False)
    voted: Voted | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        config = self.method.config
        self.labels_px = with_halves(config.layers.values_px)
        height, width = self.shape if self.reduction is None else self.reduction.size_px[::-1]
        self.grid = Grid(height, width, len(self.labels_px))
        pairs = pairs_of(self.method)
        self.plan = None if pairs is None else plan_evidence(pairs, config.layers.values_px)
        self.textures = None
        if self.uses_planes and self.hears_lines:
            assert self.method.edges is not None
            self.textures = line_textures(self.method.edges, (height, width), self.labels_px)
        self._compose()

    def _compose(self) -> None:
        config = self.method.config
        self.first = chain = Chain(self.device)
        self.arrays = arrays = surface_arrays(chain, self.grid, config.surface)
        if self.reduction is not None:
            photograph = chain.array("photograph", 3 * self.shape[0] * self.shape[1])
            add_reduced(chain, photograph, self.shape, self.reduction)
        image, usable = (chain.array(name, n * self.grid.pixels) for name, n in (("image", 3), ("usable", 1)))
        self.light = Light(usable, *add_two_views(chain, image, self.grid[:2], ALL_CHANNELS))
        self._add_evidence(chain, image, usable, arrays.likelihood)
        add_paths(chain, arrays.likelihood, arrays.guide, arrays.cost, self.grid, self.labels_px, config=config.surface)
        add_start(chain, arrays, self.grid, config=config.surface)
        add_variation(chain, arrays, self.grid, self.labels_px, config=config.surface)
        add_posterior(chain, arrays, self.grid, config=config.surface)
        self.last = Chain(self.device)
        self._add_maps(self.last, self._add_planes() if self.uses_planes else None)

    def _add_planes(self) -> OfPlanes:
        """Compose planes that explain the surface, as `planes_of_surface`, and choose between them and it."""
        config, chain, arrays, room = self.method.config.planes, self.first, self.arrays, self.room
        size = self.grid[:2]
        blocks = add_block_sums(chain, arrays, self.grid, config.block_px)
        add_candidates(
            chain, arrays.label, arrays.sigma, arrays.likelihood, self.grid,
            tiles_px=config.tiles_px, slope_penalty=config.slope_penalty,
        )  # fmt: skip
        if self.uses_depth_edges:
            add_proposed(chain, self.grid, config=config)
            voted, of_planes = voted_arrays(self.last, self.grid, config=config), 1
            self.voted, unfinished = voted, self.last.array("unfinished", 1, np.uint32)
        else:
            voted, of_planes = self._add_guided_planes(blocks), config.block_px
            unfinished = chain.arrays["unfinished"]
        last, edges = self.last, EdgeGrid(*size, config.block_px)
        most = min(room.planes, voted.planes.size // 4)
        planes = add_planes_of_pixels(last, voted.planes, voted.number, unfinished, block=of_planes, most=most)
        heard = None
        if self.textures is not None:
            lines = line_arrays(last, self.textures)
            add_colours(chain, chain.arrays["image"], size, lines.shared)
            heard = HeardLines(lines, min(room.lines, 2 * edges.shape[0] * edges.shape[1]), unfinished)
        links = last.array("edge_links", 2 * edges.shape[0] * edges.shape[1])
        choice = add_placed_edges(
            last, voted.choice, planes, links, heard, edges, reach_px=config.edge_band_px, apart=BORDER_APART_LABELS
        )
        there, first = add_planes_or_surface(
            last, arrays, choice, planes.of_pixels, self.grid, voted=voted, block_px=config.block_px
        )
        add_sigma(last, arrays, self.grid)
        last.arrays |= {array.name: array for array in (voted.number, unfinished)}
        return OfPlanes(
            most, planes.number, choice, there, first, blocks, config.block_px, voted.fits, voted.skipped
        )  # fmt: skip

    def _add_guided_planes(self, blocks: Array) -> Voted:
        """Compose planes whose borders the guide leads."""
        config, chain, room, size = self.method.config.planes, self.first, self.room, self.grid[:2]
        grid = Grid(size[0] // config.block_px, size[1] // config.block_px, self.grid.layers)
        capacity = most_candidates(size, config.tiles_px)
        chooser = BlockChoice(self.device, blocks, grid, capacity, config.sweeps, self.labels_px, block_costs(config))
        unfinished = chain.array("unfinished", 1, np.uint32)

        def add_fit(factor: float = 1.0) -> None:
            add_first_choice(chain, chooser, self.arrays.links, size, config=config, factor=factor)
            for again in range(config.rounds - 1):
                rounds = room.later_joins if again else room.joins
                add_joining(chain, chooser, unfinished, rounds=rounds, config=config)
                chain.dispatches += chooser.chain.dispatches

        if not config.vote_factors:
            add_fit()
            return Voted(chooser.planes, chooser.count, chooser.choice)
        return add_voted_planes(
            chain, chooser, add_fit, self.arrays, self.grid, factors=config.vote_factors, block_px=config.block_px
        )

    def _add_maps(self, chain: Chain, planes: OfPlanes | None) -> None:
        """Compose what is left to do of a surface: its error bar, pixels of the photograph, depth and colours."""
        method, labels_px = self.method, self.labels_px
        judged = add_judged(
            chain, self.arrays, self.grid, planes=planes, learned=method.config.surface.learned_error_bar,
            known_within=sigma_of_range(labels_px) / float(labels_px[1] - labels_px[0]),
            known_from_nats=method.config.planes.known_from_nats,
            edge_share=EDGE_SHARE if planes is None else method.config.planes.edge_share,
        )  # fmt: skip
        if planes is not None:
            judged = add_median(chain, judged, self.grid)
        add_label_maps(chain, judged, self.light, self.grid, method.label_map, labels_px)
        photograph = self.first.arrays["image"]
        if self.reduction is not None:
            photograph, small = (self.first.arrays[name] for name in ("photograph", "reduced"))
            chain.array("stats", STATS)
            add_upsampled(chain, photograph, small, self.shape, self.reduction, method.config.views.guide_range)
        chain.arrays[photograph.name] = photograph
        add_further(chain, photograph, self.shape, self.further)

    def _add_evidence(self, chain: Chain, image: Array, usable: Array, likelihood: Array) -> None:
        layers_px = self.method.config.layers.values_px
        if self.plan is not None:
            noise = chain.array("noise", 3 * len(self.plan.nodes.places))
            unexplained = add_evidence(chain, self.plan, image, noise)
            # What counts of the pairs' evidence: nothing where the picture is not usable, else what is a pixel's own.
            counted = chain.array("counted", self.grid.pixels)
            windows = self._windows(chain, usable) if self.uses_windows else None
            add_labels(chain, self.plan, unexplained, counted, likelihood, self.labels_px, windows=windows)
        else:
            source = self.method.evidence
            assert isinstance(source, CorrelationEvidence)
            add_views_evidence(chain, source, self.grid[:2], (image, usable, likelihood), layers_px, self.labels_px)

    @property
    def hears_lines(self) -> bool:
        """Whether lines across borders tell where edges are."""
        config = self.method.config.planes
        return self.plan is not None and self.method.edges is not None and config.edge_lines and config.edge_band_px > 0

    @property
    def uses_planes(self) -> bool:
        """As `planes_of_surface` decides."""
        config = self.method.config.planes
        return config.rounds > 0 and min(self.grid.height, self.grid.width) >= 2 * config.block_px

    @property
    def uses_depth_edges(self) -> bool:
        """Whether planes end at the photograph's depth edges, as `planes_of_surface` decides."""
        return self.uses_planes and needs_depth_edges(self.method.config.planes)

    @property
    def uses_windows(self) -> bool:
        """Whether windows of all channels together are evidence, too."""
        evidence = self.method.evidence
        return isinstance(evidence, SpectralEvidence) and evidence.is_used(self.method.config.layers.values_px)

    def _windows(self, chain: Chain, usable: Array) -> WindowsEarned:
        evidence = self.method.evidence
        assert isinstance(evidence, SpectralEvidence)
        grid = self.windows
        noise = chain.array("window_noise", 3 * grid.count)
        earned = add_windows(
            chain, evidence, grid, (chain.arrays["image"], chain.arrays["shading"], noise),
            self.method.config.layers.values_px, self.labels_px,
        )  # fmt: skip
        return WindowsEarned(earned, usable, grid)

    @property
    def windows(self) -> WindowGrid:
        """Where windows of all channels are."""
        evidence = self.method.evidence
        assert isinstance(evidence, SpectralEvidence)
        return WindowGrid(self.grid.height, self.grid.width, evidence.config.stride_px)

    def measure(self, image: np.ndarray) -> Measured:
        """Return the disparity of an image (H, W, 3), and what is asked for besides."""
        return self.finish(self.start(image))

    def start(self, image: np.ndarray) -> Started:
        """Send an image (H, W, 3) to the device; at most two are under way, `finish` them in turn.

        Where depth edges bound planes, this waits for the first chain.
        """
        small = image if self.reduction is None else reduced(image, self.reduction.size_px)
        views = filtered_views(small, self.method.space, config=self.method.config.views)
        filled, usable = clipped_filled(small, views.mask)
        variance = self.method.evidence.noise.variance(filled)
        first = self._inputs(filled, usable, views.guide, variance)
        if self.reduction is not None:
            first["photograph"] = image
        ticket = self.first.start(first, DOWN if self.uses_depth_edges else [])
        depth_edges = begun(lambda: self.method.depth_edges(filled))  # while the device works
        last = self._inputs_of_last(filled, views.guide, variance)
        if self.voted is not None:
            last |= regions_found(
                self.first.finish(ticket), depth_edges(), self.voted, self.grid, self.labels_px,
                config=self.method.config.planes, run=self.method.run,
            )  # fmt: skip
        if self.reduction is None and first["image"] is not image:
            last["image"] = image  # no longer without clipped areas: what follows makes colours of it
        return Started(self.last, self.last.start(last, self._outputs), first, last)

    def finish(self, started: Started) -> Measured:
        """Wait for a photograph; where the chains had no room for all that was found, run others with more."""
        got = started.chain.finish(started.ticket)
        while "unfinished" in got and got["unfinished"][0]:
            if started.chain is self.last:
                self.room = self.room.doubled()
                self._compose()
            self.first.start(started.first, [])
            started = started._replace(chain=self.last, ticket=self.last.start(started.last, self._outputs))
            got = self.last.finish(started.ticket)
        if self.uses_planes and not got["plane_count"][0]:  # what found no plane is judged as if none were looked for
            self.first.start(started.first, [])
            alone = Chain(self.device)
            self._add_maps(alone, None)
            photograph = {name: values for name, values in started.last.items() if name in alone.arrays}
            got = alone.run(photograph, outputs_of(self.further))
        return measured_from(got, self.shape)

    @property
    def _outputs(self) -> list[str]:
        return [*outputs_of(self.further), *(("plane_count", "unfinished") if self.uses_planes else ())]

    def _inputs(
        self, image: np.ndarray, usable: np.ndarray, guide: np.ndarray, variance: np.ndarray
    ) -> dict[str, np.ndarray]:
        inputs = {"image": image, "usable": usable, "guide": guide}
        of_noise: dict[str, Callable[[], np.ndarray]] = {}
        if self.plan is not None:
            if not np.isfinite(image).all():
                inputs["image"] = np.where(np.isfinite(image), image, np.float32(0))
            of_noise["noise"] = lambda: self._noise_of_tiles(variance)
            of_noise["counted"] = lambda: self._counted(image, usable, variance)
        if isinstance(evidence := self.method.evidence, SpectralEvidence) and self.uses_windows:
            grid = self.windows
            of_noise["window_noise"] = lambda: evidence.noise_of_windows(variance, grid.rows, grid.columns)
        if self.uses_planes and not self.uses_depth_edges:
            inputs["unfinished"] = np.zeros(1, np.uint32)
        return inputs | dict(zip(of_noise, parallel_map(call, of_noise.values()), strict=True))

    def _noise_of_tiles(self, variance: np.ndarray) -> np.ndarray:
        """Return the power of noise in every tile, (tiles, 3); 0 where it is not known."""
        assert self.plan is not None
        pairs, nodes = self.plan.source, self.plan.nodes
        if not pairs.noise.is_known:
            return np.zeros((len(nodes.places), 3))
        return nodes.noise_powers(variance, noise_margin=pairs.config.noise_margin)

    def _counted(self, image: np.ndarray, usable: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """Return how much of the evidence of pairs counts at every pixel; (H, W)."""
        evidence = self.method.evidence
        own = evidence.own_detail(image, variance) if isinstance(evidence, SpectralEvidence) else None
        return usable if own is None else usable * own

    def _inputs_of_last(self, image: np.ndarray, guide: np.ndarray, variance: np.ndarray) -> dict[str, np.ndarray]:
        if not self.uses_planes:
            return {}
        config, edges = self.method.config.planes, self.method.edges
        inputs = {"edge_links": np.zeros(self.last.arrays["edge_links"].size, np.float32)}
        if config.edge_band_px > 0:  # else edges stay where blocks have them
            inputs["edge_links"] = edge_links(guide, config.edge_band_px)
        if self.textures is not None and edges is not None:
            inputs |= inputs_of(edges.photograph(image, variance))
        if self.uses_depth_edges:
            inputs["unfinished"] = np.zeros(1, np.uint32)
        return inputs

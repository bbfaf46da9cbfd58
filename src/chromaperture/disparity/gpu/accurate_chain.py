"""Quality "accurate" on a device.

The photograph goes up once and the maps come down once. Two submissions: the second has what the CPU makes of the
photograph while the device works on the first, links of edges and light along lines. Nothing returns in between.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from chromaperture.disparity.accurate import BIAS_OF_PLANES, EDGE_REACH_PX, AccurateMethod, judged, with_halves
from chromaperture.disparity.blur_evidence import BlurEvidence
from chromaperture.disparity.clipped_areas import clipped_filled
from chromaperture.disparity.correlation_evidence import CorrelationEvidence
from chromaperture.disparity.error_bar import sigma_of_range
from chromaperture.disparity.gpu.agreement_stages import add_agreement
from chromaperture.disparity.gpu.candidate_stages import add_candidates, add_first_choice, most_candidates
from chromaperture.disparity.gpu.device import Array, Chain, Device, DeviceError
from chromaperture.disparity.gpu.edge_stages import EdgeGrid, HeardLines, add_placed_edges, add_planes_of_pixels
from chromaperture.disparity.gpu.evidence_plan import EvidencePlan, plan_evidence
from chromaperture.disparity.gpu.evidence_stages import add_evidence
from chromaperture.disparity.gpu.joining_stages import add_joining
from chromaperture.disparity.gpu.judging_stages import OfPlanes, add_judged
from chromaperture.disparity.gpu.label_stages import WindowsEarned, add_labels, add_views_evidence
from chromaperture.disparity.gpu.line_stages import add_colours, inputs_of, line_arrays
from chromaperture.disparity.gpu.line_textures import LineTextures, line_textures
from chromaperture.disparity.gpu.plane_stages import BlockChoice, planes_of
from chromaperture.disparity.gpu.spectral_stages import WindowGrid, add_windows
from chromaperture.disparity.gpu.surface_stages import (
    Grid,
    SurfaceArrays,
    add_block_sums,
    add_paths,
    add_posterior,
    add_results,
    add_sigma,
    add_start,
    add_variation,
    surface_arrays,
)
from chromaperture.disparity.planar import BORDER_APART_LABELS, Planes, block_costs
from chromaperture.disparity.plane_edges import edge_links
from chromaperture.disparity.result import Disparity
from chromaperture.disparity.spectral_evidence import SpectralEvidence
from chromaperture.disparity.views import filtered_views
from chromaperture.disparity.winner import Surface
from chromaperture.errors import OutOfMemoryError

_ALIKE = 1e-4  # labels: rounding of a plane's label in single precision


class Room(NamedTuple):
    """For how much of what is found the chains have room; where there is more they are composed with twice as much.

    Attributes
    ----------
    joins, later_joins : int
        Rounds of joining behind the first choice of blocks, and behind later ones; of `still_life` 19 and 22 joins
        follow the first (720x480) and up to 2 another one (360x240).
    planes : int
        Left in the end; of `still_life` 6 to 16.
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


@dataclass
class AccurateChain:
    """The chains of one camera: to the first surface, and from there to the results.

    Attributes
    ----------
    method : AccurateMethod
    device : Device
    shape : (int, int)
        Height and width of its photographs.
    room : Room
    plan : EvidencePlan or None
        None where the blur is not known: evidence is that of shifted views.
    grid : Grid
    labels_px : (N,) float64, px
    first, last : Chain
        Up to the planes, or to the surface where none are looked for; what follows.
    """

    method: AccurateMethod
    device: Device
    shape: tuple[int, int]
    room: Room = field(default_factory=Room)
    plan: EvidencePlan | None = field(init=False)
    grid: Grid = field(init=False)
    labels_px: np.ndarray = field(init=False)
    first: Chain = field(init=False)
    last: Chain = field(init=False)
    arrays: SurfaceArrays = field(init=False)
    textures: LineTextures | None = field(init=False)

    def __post_init__(self) -> None:
        config = self.method.config
        self.labels_px = with_halves(config.layers.values_px)
        self.grid = Grid(*self.shape, len(self.labels_px))
        pairs = pairs_of(self.method)
        self.plan = None if pairs is None else plan_evidence(pairs, config.layers.values_px)
        self.textures = None
        if self.uses_planes and self.hears_lines:
            assert self.method.edges is not None
            self.textures = line_textures(self.method.edges, self.shape, self.labels_px)
        self._compose()

    def _compose(self) -> None:
        config = self.method.config
        self.first = chain = Chain(self.device)
        self.arrays = arrays = surface_arrays(chain, self.grid, config.surface)
        self._add_evidence(chain, arrays.likelihood)
        add_paths(chain, arrays.likelihood, arrays.guide, arrays.cost, self.grid, self.labels_px, config=config.surface)
        add_start(chain, arrays, self.grid, config=config.surface)
        add_variation(chain, arrays, self.grid, self.labels_px, config=config.surface)
        add_posterior(chain, arrays, self.grid, config=config.surface)
        self.last = Chain(self.device)
        if self.uses_planes:
            self._add_planes()
        else:
            add_results(self.last, arrays, self.grid, reach_px=EDGE_REACH_PX)

    def _add_planes(self) -> None:
        """Compose planes that explain the surface, as `planes_of_surface` and `accurate.judged`."""
        config, chain, arrays, room = self.method.config.planes, self.first, self.arrays, self.room
        blocks = add_block_sums(chain, arrays, self.grid, config.block_px)
        add_candidates(
            chain, arrays.label, arrays.sigma, arrays.likelihood, self.grid,
            tiles_px=config.tiles_px, slope_penalty=config.slope_penalty,
        )  # fmt: skip
        grid = Grid(self.shape[0] // config.block_px, self.shape[1] // config.block_px, self.grid.layers)
        capacity = most_candidates(self.shape, config.tiles_px)
        chooser = BlockChoice(self.device, blocks, grid, capacity, config.sweeps, self.labels_px, block_costs(config))
        add_first_choice(chain, chooser, arrays.links, self.shape, config=config)
        unfinished = chain.array("unfinished", 1, np.uint32)
        for again in range(config.rounds - 1):
            rounds = room.later_joins if again else room.joins
            add_joining(chain, chooser, unfinished, rounds=rounds, config=config)
            chain.dispatches += chooser.chain.dispatches
        last, edges = self.last, EdgeGrid(*self.shape, config.block_px)
        most = min(room.planes, capacity)
        planes = add_planes_of_pixels(last, chooser.planes, chooser.count, unfinished, block=config.block_px, most=most)
        heard = None
        if self.textures is not None:
            lines = line_arrays(last, self.textures)
            add_colours(chain, chain.arrays["image"], self.shape, lines.shared)
            heard = HeardLines(lines, min(room.lines, 2 * edges.shape[0] * edges.shape[1]), unfinished)
        links = last.array("edge_links", 2 * edges.shape[0] * edges.shape[1])
        choice = add_placed_edges(
            last, chooser.choice, planes, links, heard, edges, reach_px=config.edge_band_px, apart=BORDER_APART_LABELS
        )
        there, first = add_agreement(last, arrays, choice, planes.of_pixels, self.grid)
        add_sigma(last, arrays, self.grid)
        if self.judges:
            add_judged(
                last, arrays, blocks, OfPlanes(most, planes.number, choice, there, first), self.grid,
                block=config.block_px, apart=BORDER_APART_LABELS, bias=BIAS_OF_PLANES,
                known_within=sigma_of_range(self.labels_px) / self.step_px,
            )  # fmt: skip
        else:
            add_results(last, arrays, self.grid, reach_px=EDGE_REACH_PX)
        last.arrays |= {array.name: array for array in (chooser.count, planes.of_pixels, unfinished, arrays.label)}

    def _add_evidence(self, chain: Chain, likelihood: Array) -> None:
        image, usable = (chain.array(name, n * self.grid.pixels) for name, n in (("image", 3), ("usable", 1)))
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
            add_views_evidence(chain, source, self.shape, (image, usable, likelihood), layers_px, self.labels_px)

    @property
    def step_px(self) -> float:
        """Distance of two labels, px."""
        return float(self.labels_px[1] - self.labels_px[0])

    @property
    def judges(self) -> bool:
        """Whether the device finds the error bar of a surface of planes: the learned one."""
        return self.method.config.surface.learned_error_bar

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

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3), as `AccurateMethod.match`."""
        method = self.method
        views = filtered_views(image, method.space, config=method.config.views)
        image, usable = clipped_filled(image, views.mask)
        inputs = self._inputs(image, usable, views.guide)
        got = self._run(inputs, image, views.guide)
        while "unfinished" in got and got["unfinished"][0]:
            self.room = self.room.doubled()
            self._compose()
            got = self._run(inputs, image, views.guide)
        if self.uses_planes and not got["plane_count"][0]:  # what found no plane is judged as if none were looked for
            alone = Chain(self.device)
            add_results(alone, self.arrays, self.grid, reach_px=EDGE_REACH_PX)
            self.first.start({}, [])
            got = alone.run({}, ["results"])
        surface = self._judged(got) if "judged" in got else self._judged_on_cpu(got)
        return method.of_labels(surface, image, usable, self.labels_px)

    def _inputs(self, image: np.ndarray, usable: np.ndarray, guide: np.ndarray) -> dict[str, np.ndarray]:
        method = self.method
        inputs = {"image": image, "usable": usable, "guide": guide}
        if self.plan is not None:
            pairs = self.plan.source
            inputs["image"] = np.where(np.isfinite(image), image, np.float32(0))
            inputs["noise"] = np.zeros((len(self.plan.nodes.places), 3))
            if pairs.noise.is_known:
                margin = pairs.config.noise_margin
                inputs["noise"] = self.plan.nodes.noise_powers(pairs.noise.variance(image), noise_margin=margin)
            own = method.evidence.own_detail(image) if isinstance(method.evidence, SpectralEvidence) else None
            inputs["counted"] = usable if own is None else usable * own
        if isinstance(method.evidence, SpectralEvidence) and self.uses_windows:
            grid = self.windows
            inputs["window_noise"] = method.evidence.noise_of_windows(image, grid.rows, grid.columns)
        if self.uses_planes:
            inputs["unfinished"] = np.zeros(1, np.uint32)
        return inputs

    def _run(self, inputs: dict[str, np.ndarray], image: np.ndarray, guide: np.ndarray) -> dict[str, np.ndarray]:
        """Run both chains: the device has begun the first one while the CPU prepares the last."""
        self.first.start(inputs, [])
        if not self.uses_planes:
            return self.last.run({}, ["results"])
        config, edges = self.method.config.planes, self.method.edges
        further = {"edge_links": np.zeros(self.last.arrays["edge_links"].size, np.float32)}
        if config.edge_band_px > 0:  # else edges stay where blocks have them
            further["edge_links"] = edge_links(guide, config.edge_band_px)
        if self.textures is not None and edges is not None:
            further |= inputs_of(edges.photograph(image))
        found = ["judged"] if self.judges else ["results", "plane_of_pixel", "label", "planes"]
        return self.last.run(further, [*found, "plane_count", "unfinished"])

    def _judged(self, got: dict[str, np.ndarray]) -> Surface:
        """Return what `add_judged` has left."""
        judged_px = got["judged"].reshape(*self.shape, 4)
        known = judged_px[..., 3] > 0
        label = (self.labels_px[0] + self.step_px * judged_px[..., 0].astype(float)).astype(np.float32)
        return Surface(np.where(known, label, np.float32(np.nan)), self.step_px * judged_px[..., 1], judged_px[..., 2])

    def _judged_on_cpu(self, got: dict[str, np.ndarray]) -> Surface:
        """Judge a surface without planes, or with the error bar that is not the learned one."""
        step, results = self.step_px, got["results"].reshape(*self.shape, 4)
        disparity, sigma, extent = self.labels_px[0] + step * results[..., 0], step * results[..., 1], results[..., 2]
        planes, first_px = None, disparity
        if "planes" in got:
            found = planes_of(got["planes"], got["plane_count"], self.labels_px)
            planes = Planes(found, got["plane_of_pixel"].reshape(self.shape).astype(np.intp))
            there = planes.label_px
            # The plane to the bit: `judged` asks where the surface is it.
            disparity = np.where(np.abs(disparity - there) < _ALIKE * step, there, disparity)
            first_px = self.labels_px[0] + step * got["label"].reshape(self.shape)
        return judged(
            Surface(disparity, sigma, results[..., 3]), step * extent, self.labels_px, first_px=first_px,
            explained_by=planes, learned=self.method.config.surface.learned_error_bar,
            known_within_px=sigma_of_range(self.labels_px),
        )  # fmt: skip


@dataclass
class AccurateOnDevice:
    """A method whose chains are made at the first photograph and kept; for one thread at a time, safe from several.

    Attributes
    ----------
    method : AccurateMethod
    device : Device
    """

    method: AccurateMethod
    device: Device
    _chain: AccurateChain | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3); raises DeviceError, OutOfMemoryError besides InputError."""
        with self._lock:
            shape = image.shape[0], image.shape[1]
            pairs = pairs_of(self.method)
            if pairs is not None:
                pairs.check_size(image)
            try:
                if self._chain is None or self._chain.shape != shape:
                    self._chain = None  # gives its memory back before the next takes its own
                    self._chain = AccurateChain(self.method, self.device, shape)
                return self._chain.match(image)
            except (DeviceError, OutOfMemoryError):
                self._chain = None  # gives its memory back
                raise

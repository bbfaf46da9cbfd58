"""Quality "accurate" on a device.

The photograph goes up once and one array of maps comes down at the end. In between, where planes explain the surface,
sums of blocks of the volume, the planes that were found and the first choice of blocks come down, then a choice after
every joining of planes; lines across borders go up. The volume itself never leaves the device.
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
from chromaperture.disparity.edge_likelihood import GRID_PX, Photograph
from chromaperture.disparity.error_bar import sigma_of_range
from chromaperture.disparity.gpu.agreement_stages import add_agreement
from chromaperture.disparity.gpu.candidate_stages import (
    add_candidates,
    add_first_choice,
    most_candidates,
)
from chromaperture.disparity.gpu.device import Array, Chain, Device, DeviceError
from chromaperture.disparity.gpu.edge_stages import (
    SHADES,
    EdgeGrid,
    add_placed_edges,
    add_shades,
    lines_heard,
    products_of,
)
from chromaperture.disparity.gpu.evidence_plan import EvidencePlan, plan_evidence
from chromaperture.disparity.gpu.evidence_stages import add_evidence
from chromaperture.disparity.gpu.joining_stages import add_joining
from chromaperture.disparity.gpu.judging_stages import OfPlanes, add_judged
from chromaperture.disparity.gpu.label_stages import WindowsEarned, add_labels, add_views_evidence
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
from chromaperture.disparity.planar import BORDER_APART_LABELS, Planes, block_costs, planes_of_pixels
from chromaperture.disparity.plane_edges import edge_links
from chromaperture.disparity.result import Disparity
from chromaperture.disparity.spectral_evidence import SpectralEvidence
from chromaperture.disparity.views import filtered_views
from chromaperture.disparity.winner import Surface
from chromaperture.errors import OutOfMemoryError

_ALIKE = 1e-4  # labels: rounding of a plane's label in single precision


class PlanesFound(NamedTuple):
    """Planes before their edges are placed, where the CPU judges the surface before them, and the planes of blocks."""

    planes: Planes
    first_px: np.ndarray | None
    of_blocks: Array


class Prepared(NamedTuple):
    """What the CPU makes of a photograph while the device begins: links of edges, samples of lines."""

    of_edges: np.ndarray
    photograph: Photograph | None


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
    plan : EvidencePlan or None
        None where the blur is not known: evidence is that of shifted views.
    grid : Grid
    labels_px : (N,) float64, px
    """

    method: AccurateMethod
    device: Device
    shape: tuple[int, int]
    joins: int = 40
    plan: EvidencePlan | None = field(init=False)
    grid: Grid = field(init=False)
    labels_px: np.ndarray = field(init=False)
    first: Chain = field(init=False)
    arrays: SurfaceArrays = field(init=False)
    last: Chain | None = field(default=None, init=False)  # of the photograph before, whose memory the next one takes
    blocks: Array | None = field(init=False)
    chooser: BlockChoice | None = field(init=False)

    def __post_init__(self) -> None:
        config = self.method.config
        self.labels_px = with_halves(config.layers.values_px)
        self.grid = Grid(*self.shape, len(self.labels_px))
        pairs = pairs_of(self.method)
        self.plan = None if pairs is None else plan_evidence(pairs, config.layers.values_px)
        self.first = chain = Chain(self.device)
        self.arrays = arrays = surface_arrays(chain, self.grid, config.surface)
        self._add_evidence(chain, arrays.likelihood)
        add_paths(chain, arrays.likelihood, arrays.guide, arrays.cost, self.grid, self.labels_px, config=config.surface)
        add_start(chain, arrays, self.grid, config=config.surface)
        add_variation(chain, arrays, self.grid, self.labels_px, config=config.surface)
        add_posterior(chain, arrays, self.grid, config=config.surface)
        self.blocks = self.chooser = None
        if self.uses_planes:
            self.blocks = add_block_sums(chain, arrays, self.grid, config.planes.block_px)
            add_candidates(
                chain, arrays.label, arrays.sigma, arrays.likelihood, self.grid,
                tiles_px=config.planes.tiles_px, slope_penalty=config.planes.slope_penalty,
            )  # fmt: skip
            size = config.planes.block_px
            self.chooser = BlockChoice(
                self.device, self.blocks, Grid(self.shape[0] // size, self.shape[1] // size, self.grid.layers),
                most_candidates(self.shape, config.planes.tiles_px), config.planes.sweeps, self.labels_px,
                block_costs(config.planes),
            )  # fmt: skip
            add_first_choice(chain, self.chooser, arrays.links, self.shape, config=config.planes)
            unfinished = chain.array("unfinished", 1, np.uint32)
            for _ in range(config.planes.rounds - 1):
                add_joining(chain, self.chooser, unfinished, rounds=self.joins, config=config.planes)
                chain.dispatches += self.chooser.chain.dispatches
            for array in (self.chooser.planes, self.chooser.count, self.chooser.choice):
                chain.arrays[array.name] = array
            if self.hears_lines:
                add_shades(chain, chain.arrays["image"], self.shape)

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

    def _last_chain(self, found: PlanesFound | None, prepared: Prepared | None) -> Chain:
        """Compose what follows the joining of planes, or the first chain where there are none."""
        chain, arrays = Chain(self.device, self.last), self.arrays
        if found is not None and prepared is not None:
            config, step = self.method.config.planes, self.step_px
            planes = found.planes.planes / step - (0, 0, self.labels_px[0] / step)
            in_layers = chain.constant("planes", np.concatenate([planes, np.zeros((len(planes), 1))], axis=1))
            heard, grid = None, EdgeGrid(*self.shape, config.block_px)
            if prepared.photograph is not None and self.method.edges is not None:
                lines = lines_heard(
                    found.planes.choice[::GRID_PX, ::GRID_PX], found.planes.planes * (GRID_PX, GRID_PX, 1),
                    BORDER_APART_LABELS * step, self.method.edges, prepared.photograph,
                )  # fmt: skip
                heard = None if lines is None else (lines, prepared.photograph.colours)
            choice = add_placed_edges(
                chain, found.of_blocks, planes, prepared.of_edges, heard, grid,
                reach_px=config.edge_band_px, apart=BORDER_APART_LABELS,
            )  # fmt: skip
            there, first = add_agreement(chain, arrays, choice, in_layers, self.grid)
            add_sigma(chain, arrays, self.grid)
            if self.judges and self.blocks is not None:
                add_judged(
                    chain, arrays, self.blocks, OfPlanes(len(planes), choice, there, first), self.grid,
                    block=config.block_px, apart=BORDER_APART_LABELS, bias=BIAS_OF_PLANES,
                    known_within=sigma_of_range(self.labels_px) / step,
                )  # fmt: skip
                return chain
        add_results(chain, arrays, self.grid, reach_px=EDGE_REACH_PX)
        return chain

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3), as `AccurateMethod.match`."""
        method = self.method
        views = filtered_views(image, method.space, config=method.config.views)
        image, usable = clipped_filled(image, views.mask)
        inputs = {"image": image, "usable": usable, "guide": views.guide}
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
        found, prepared = self._planes(inputs, image, views.guide)
        step = self.step_px
        self.last = last = self._last_chain(found, prepared)
        if "judged" in last.arrays:
            return method.of_labels(self._judged(last), image, usable, self.labels_px)
        got = last.run({}, ["results"] if found is None else ["results", "plane_of_pixel"])
        results = got["results"].reshape(*usable.shape, 4)
        disparity, sigma, extent = self.labels_px[0] + step * results[..., 0], step * results[..., 1], results[..., 2]
        planes = None
        if found is not None:
            planes = found.planes._replace(choice=got["plane_of_pixel"].reshape(usable.shape).astype(np.intp))
            there = planes.label_px
            # The plane to the bit: `judged` asks where the surface is it.
            disparity = np.where(np.abs(disparity - there) < _ALIKE * step, there, disparity)
        surface = judged(
            Surface(disparity, sigma, results[..., 3]), step * extent, self.labels_px,
            first_px=disparity if found is None or found.first_px is None else found.first_px,
            explained_by=planes,
            learned=method.config.surface.learned_error_bar, known_within_px=sigma_of_range(self.labels_px),
        )  # fmt: skip
        return method.of_labels(surface, image, usable, self.labels_px)

    def _judged(self, last: Chain) -> Surface:
        """Run a chain whose end is `add_judged`."""
        judged_px = last.run({}, ["judged"])["judged"].reshape(*self.shape, 4)
        known = judged_px[..., 3] > 0
        label = (self.labels_px[0] + self.step_px * judged_px[..., 0].astype(float)).astype(np.float32)
        return Surface(np.where(known, label, np.float32(np.nan)), self.step_px * judged_px[..., 1], judged_px[..., 2])

    def _planes(
        self, inputs: dict[str, np.ndarray], image: np.ndarray, guide: np.ndarray
    ) -> tuple[PlanesFound | None, Prepared | None]:
        """Run the first chain, and explain its surface by planes, as `planes_of_surface` does before edges."""
        config = self.method.config.planes
        if self.chooser is None:
            self.first.run(inputs, ["round"])
            return None, None
        chooser = self.chooser
        names = [array.name for array in (chooser.planes, chooser.count, chooser.choice)]
        begun = self.first.start(
            inputs | {"unfinished": np.zeros(1, np.uint32)},
            [*names, "unfinished", *([SHADES] if self.hears_lines else []), *([] if self.judges else ["label"])],
        )
        prepared = self._prepared(image, guide)
        got = self.first.finish(begun)
        assert not got["unfinished"][0]
        planes, choice = planes_of(*(got[name] for name in names[:2]), self.labels_px), got["choice"].reshape(chooser.shape)
        if prepared.photograph is not None:
            prepared.photograph.shade_products = products_of(got[SHADES])
        if not len(planes):
            return None, None
        fitting = planes_of_pixels(planes, choice, self.shape, config.block_px)
        first = None if self.judges else self.labels_px[0] + self.step_px * got["label"].reshape(self.shape)
        return PlanesFound(fitting, first, chooser.choice), prepared

    def _prepared(self, image: np.ndarray, guide: np.ndarray) -> Prepared:
        config, edges = self.method.config.planes, self.method.edges
        photograph = edges.photograph(image) if edges is not None and self.hears_lines else None
        if photograph is not None:
            photograph.prepare()
        if config.edge_band_px == 0:  # edges stay where blocks have them
            return Prepared(np.zeros((2, *EdgeGrid(*self.shape, config.block_px).shape), np.float32), photograph)
        return Prepared(edge_links(guide, config.edge_band_px), photograph)


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

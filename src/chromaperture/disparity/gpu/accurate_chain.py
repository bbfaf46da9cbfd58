"""Quality "accurate" on a device.

The photograph goes up once and three maps come down at the end. In between, where planes explain the surface, the first
surface, its error bar and the sums of blocks of the volume come down, and the labels that planes and surface agree on
go up; see ``plane_stages.py`` for what the CPU does with them. The volume itself never leaves the device.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from chromaperture.disparity.accurate import EDGE_REACH_PX, AccurateMethod, judged, with_halves
from chromaperture.disparity.blur_evidence import BlurEvidence
from chromaperture.disparity.clipped_areas import clipped_filled
from chromaperture.disparity.correlation_evidence import CorrelationEvidence
from chromaperture.disparity.error_bar import sigma_of_range
from chromaperture.disparity.gpu.device import Array, Chain, Device, DeviceError
from chromaperture.disparity.gpu.evidence_plan import EvidencePlan, plan_evidence
from chromaperture.disparity.gpu.evidence_stages import add_evidence
from chromaperture.disparity.gpu.label_stages import WindowsEarned, add_labels, add_views_evidence
from chromaperture.disparity.gpu.plane_stages import BlockChoice, PlaneChoice, refined_planes
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
    add_taken_planes,
    add_variation,
    surface_arrays,
)
from chromaperture.disparity.planar import Planes, block_costs, fitting_planes, links_of_blocks
from chromaperture.disparity.plane_agreement import where_they_agree
from chromaperture.disparity.plane_edges import LineCosts
from chromaperture.disparity.plane_fit import Volume, distinct_of, proposals
from chromaperture.disparity.result import Disparity
from chromaperture.disparity.spectral_evidence import SpectralEvidence
from chromaperture.disparity.views import filtered_views
from chromaperture.disparity.winner import Surface
from chromaperture.errors import OutOfMemoryError


class PlanesFound(NamedTuple):
    """Planes, the surface before them, and the labels that are taken of both; (H, W) px each."""

    planes: Planes
    first_px: np.ndarray
    taken_px: np.ndarray


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
    plan: EvidencePlan | None = field(init=False)
    grid: Grid = field(init=False)
    labels_px: np.ndarray = field(init=False)
    first: Chain = field(init=False)
    last: dict[bool, Chain] = field(init=False)  # by whether planes explain the surface
    blocks: Array | None = field(init=False)

    def __post_init__(self) -> None:
        config = self.method.config
        self.labels_px = with_halves(config.layers.values_px)
        self.grid = Grid(*self.shape, len(self.labels_px))
        pairs = pairs_of(self.method)
        self.plan = None if pairs is None else plan_evidence(pairs, config.layers.values_px)
        self.first = chain = Chain(self.device)
        arrays = surface_arrays(chain, self.grid, config.surface)
        self._add_evidence(chain, arrays.likelihood)
        add_paths(chain, arrays.likelihood, arrays.guide, arrays.cost, self.grid, self.labels_px, config=config.surface)
        add_start(chain, arrays, self.grid, config=config.surface)
        add_variation(chain, arrays, self.grid, self.labels_px, config=config.surface)
        add_posterior(chain, arrays, self.grid, config=config.surface)
        self.blocks = add_block_sums(chain, arrays, self.grid, config.planes.block_px) if self.uses_planes else None
        self.last = {of_planes: self._last_chain(arrays, of_planes) for of_planes in (False, True)}

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

    def _last_chain(self, arrays: SurfaceArrays, of_planes: bool) -> Chain:
        chain = Chain(self.device)
        if of_planes:
            add_taken_planes(chain, arrays, self.grid)
            add_sigma(chain, arrays, self.grid)
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
        found = self._planes(inputs, views.guide, method.line_costs(image))
        of_planes = found is not None
        step = float(self.labels_px[1] - self.labels_px[0])
        more = {} if found is None else {"taken_labels": (found.taken_px - self.labels_px[0]) / step}
        results = self.last[of_planes].run(more, ["results"])["results"].reshape(*usable.shape, 4)
        disparity, sigma, extent = self.labels_px[0] + step * results[..., 0], step * results[..., 1], results[..., 2]
        disparity = disparity if found is None else found.taken_px  # what went up, without the rounding of its way back
        surface = judged(
            Surface(disparity, sigma, results[..., 3]), step * extent, self.labels_px,
            first_px=disparity if found is None else found.first_px,
            explained_by=None if found is None else found.planes,
            learned=method.config.surface.learned_error_bar, known_within_px=sigma_of_range(self.labels_px),
        )  # fmt: skip
        return method.of_labels(surface, image, usable, self.labels_px)

    def _planes(
        self, inputs: dict[str, np.ndarray], guide: np.ndarray, line_costs: LineCosts | None
    ) -> PlanesFound | None:
        """Run the first chain, and explain its surface by planes where they agree, as `optimised_surface`."""
        config, step = self.method.config.planes, float(self.labels_px[1] - self.labels_px[0])
        if self.blocks is None:
            self.first.run(inputs, ["round"])
            return None
        got = self.first.run(inputs, ["label", "sigma", "blocks"])
        shape = self.grid.height, self.grid.width
        label = self.labels_px[0] + step * got["label"].reshape(shape)
        sigma = step * got["sigma"].reshape(shape)
        found = proposals(label, sigma, step, config.tiles_px, run=self.method.run)
        likelihood = self.first.arrays["likelihood"]
        planes = refined_planes(
            self.device, likelihood, self.grid, found, self.labels_px, slope_penalty=config.slope_penalty
        )
        planes = distinct_of(found, list(planes), step)
        if not len(planes):
            return None
        blocks = Grid(shape[0] // config.block_px, shape[1] // config.block_px, self.grid.layers)
        sums = got["blocks"].reshape(blocks)
        costs = block_costs(config)
        links = links_of_blocks(guide, config=config, surface=self.method.config.surface)
        chooser = BlockChoice(self.device, self.blocks, blocks, len(planes), config.sweeps, self.labels_px, costs)

        def choices(cost: np.ndarray, links: np.ndarray, *, sweeps: int) -> np.ndarray:
            return PlaneChoice(self.device, cost.shape[:2], cost.shape[2], sweeps).choices_of(cost, links)

        volume = Volume(sums, self.labels_px, costs, self.method.run)
        fitting = fitting_planes(
            planes, volume, guide, lambda some: chooser.choose(some, links), config=config, choices=choices,
            line_costs=line_costs,
        )  # fmt: skip
        return PlanesFound(fitting, label, where_they_agree(fitting, label, np.hypot(sigma, step)))


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

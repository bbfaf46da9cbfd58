"""Quality "accurate" on a device: evidence and paths, `AccurateMethod.path_surface`; all else is `AccurateMethod`.

The photograph goes up once. What comes down are the paths' surface, mean and variance of its labels, and the evidence,
all of blocks. While the device works, the CPU finds depth edges.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from operator import call

import numpy as np

from chromaperture.matching.accurate import AccurateMethod, PathSurface, Prepared
from chromaperture.matching.blocks import BLOCK_PX, block_means
from chromaperture.matching.device.device import Array, Chain, Device
from chromaperture.matching.device.evidence_stages import EvidencePlan, add_evidence, plan_evidence
from chromaperture.matching.device.label_stages import (
    WindowEvidence,
    WindowGrid,
    add_labels,
    add_views_evidence,
    add_windows,
)
from chromaperture.matching.device.measured import OnDevice
from chromaperture.matching.device.surface_stages import Grid, add_path_surface
from chromaperture.matching.evidence.blur import BlurEvidence
from chromaperture.matching.evidence.correlation import CorrelationEvidence
from chromaperture.matching.evidence.spectral import SpectralEvidence
from chromaperture.matching.readable.paths import Posterior
from chromaperture.matching.result import NO_EXTRAS, Extras, Measured, Pending
from chromaperture.system.threads import parallel_map

DOWN = ("label", "posterior", "likelihood")


def pairs_of(method: AccurateMethod) -> BlurEvidence | None:
    """Return the evidence of pairs of channels; None where the blur is not known."""
    evidence = method.evidence
    if isinstance(evidence, SpectralEvidence):
        return evidence.pairs
    return evidence if isinstance(evidence, BlurEvidence) else None


@dataclass
class AccurateChain:
    """The chain of one camera, from a photograph to `DOWN`."""

    method: AccurateMethod
    device: Device
    shape: tuple[int, int]  # height and width of its photographs
    plan: EvidencePlan | None = field(init=False)  # None where the blur is not known: evidence is that of views
    grid: Grid = field(init=False)  # of blocks
    chain: Chain = field(init=False)

    def __post_init__(self) -> None:
        config, labels_px = self.method.config, self.method.labels_px
        self.grid = Grid(self.shape[0] // BLOCK_PX, self.shape[1] // BLOCK_PX, len(labels_px))
        pairs = pairs_of(self.method)
        self.plan = None if pairs is None else plan_evidence(pairs, config.layers.values_px)
        self.chain = chain = Chain(self.device)
        image, likelihood = chain.array("image", 3 * math.prod(self.shape)), chain.array("likelihood", self.grid.size)
        usable, guide = (chain.array(name, self.grid.pixels) for name in ("usable", "guide"))
        self._add_evidence(image, usable, likelihood)
        add_path_surface(chain, likelihood, guide, self.grid, labels_px, config=config.surface)

    def start(self, prepared: Prepared) -> Pending[PathSurface]:
        """Send a photograph to the device; at most two are under way, to be awaited in turn."""
        pending = self.chain.start(self._inputs(prepared), list(DOWN))
        return Pending(lambda: self._found(pending.result()))

    def _found(self, got: dict[str, np.ndarray]) -> PathSurface:
        """Return what came down, in px."""
        labels_px, (height, width, _) = self.method.labels_px, self.grid
        first, step = float(labels_px[0]), float(labels_px[1] - labels_px[0])
        mean, variance = np.moveaxis(got["posterior"].reshape(height, width, 2), 2, 0)
        return PathSurface(
            np.asarray(first + step * got["label"].reshape(height, width), np.float32),
            Posterior(np.asarray(first + step * mean, np.float32), np.asarray(step**2 * variance, np.float32)),
            got["likelihood"].reshape(self.grid),
        )

    def _add_evidence(self, image: Array, usable: Array, likelihood: Array) -> None:
        chain, config, labels_px = self.chain, self.method.config, self.method.labels_px
        layers_px = config.layers.values_px
        if self.plan is not None:
            noise = chain.array("noise", 3 * len(self.plan.nodes.places))
            unexplained = add_evidence(chain, self.plan, image, noise)
            # What counts of the pairs' evidence: nothing where the picture is not usable, else what is a pixel's own.
            counted = chain.array("counted", self.grid.pixels)
            windows = self._windows(usable) if self.windows is not None else None
            add_labels(chain, self.plan, unexplained, counted, likelihood, labels_px, windows=windows)
        else:
            source = self.method.evidence
            assert isinstance(source, CorrelationEvidence)
            add_views_evidence(chain, source, self.shape, (image, usable, likelihood), layers_px, labels_px)

    def _windows(self, usable: Array) -> WindowEvidence:
        evidence, grid, chain = self.method.evidence, self.windows, self.chain
        assert isinstance(evidence, SpectralEvidence)
        assert grid is not None
        noise = chain.array("window_noise", 3 * grid.count)
        earned = add_windows(
            chain, evidence, grid, (chain.arrays["image"], chain.arrays["shading"], noise),
            self.method.config.layers.values_px, self.method.labels_px,
        )  # fmt: skip
        return WindowEvidence(earned, usable, grid)

    @property
    def windows(self) -> WindowGrid | None:
        """Where windows of all channels are; None where they are no evidence."""
        evidence = self.method.evidence
        if not isinstance(evidence, SpectralEvidence) or not evidence.is_used(self.method.config.layers.values_px):
            return None
        return WindowGrid(*self.shape, evidence.config.stride_px)

    def _inputs(self, prepared: Prepared) -> dict[str, np.ndarray]:
        image, usable, guide, variance = prepared
        usable = block_means(usable)
        inputs = {"image": image, "usable": usable, "guide": guide}
        of_noise: dict[str, Callable[[], np.ndarray]] = {}
        if self.plan is not None:
            if not np.isfinite(image).all():
                inputs["image"] = np.where(np.isfinite(image), image, np.float32(0))
            of_noise["noise"] = lambda: self._noise_of_tiles(variance)
            of_noise["counted"] = lambda: self._counted(image, usable, variance)
        evidence, grid = self.method.evidence, self.windows
        if isinstance(evidence, SpectralEvidence) and grid is not None:
            of_noise["window_noise"] = lambda: evidence.noise_of_windows(variance, grid.rows, grid.columns)
        return inputs | dict(zip(of_noise, parallel_map(call, of_noise.values()), strict=True))

    def _noise_of_tiles(self, variance: np.ndarray) -> np.ndarray:
        """Return the power of noise in every tile, (tiles, 3); 0 where it is not known."""
        assert self.plan is not None
        pairs, nodes = self.plan.source, self.plan.nodes
        if not pairs.noise.is_known:
            return np.zeros((len(nodes.places), 3))
        return nodes.noise_powers(variance, noise_margin=pairs.config.noise_margin)

    def _counted(self, image: np.ndarray, usable: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """Return how much of the evidence of pairs counts in every block; (h, w)."""
        evidence = self.method.evidence
        own = evidence.own_detail(image, variance) if isinstance(evidence, SpectralEvidence) else None
        return usable if own is None else usable * own


@dataclass
class AccurateOnDevice(OnDevice):
    """Quality "accurate" on a device; its chain is made at the first photograph of a size, and kept."""

    method: AccurateMethod
    device: Device
    _chain: AccurateChain | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def start(self, image: np.ndarray, extras: Extras = NO_EXTRAS) -> Pending[Measured]:
        """Send an image (H, W, 3) to the device, which begins; at most two are under way, to be awaited in turn."""
        pairs = pairs_of(self.method)
        if pairs is not None:
            pairs.check_size(image)
        with self._lock, self._freed_on_failure():
            shape = image.shape[0], image.shape[1]
            if self._chain is None or self._chain.shape != shape:
                self._chain = None  # gives its memory back before the next takes its own
                self._chain = AccurateChain(self.method, self.device, shape)
            pending = self.method.begin(image, self._chain.start)

        def result() -> Measured:
            with self._lock, self._freed_on_failure():
                return Measured(pending.result())

        return Pending(result)

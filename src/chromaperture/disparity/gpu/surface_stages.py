"""Stages of quality "accurate" from a volume of log-likelihoods to a surface, appended to a chain.

Paths, the place between the layers, variation coupled to the volume, posterior, range about a pixel: the files of
``stages/`` explain each. Disparities count in layers here. Volumes are (h, w, count), the layers of a pixel next to
each other.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np

from chromaperture.disparity.gpu.device import Array, Chain, DeviceError
from chromaperture.disparity.gpu.workgroups import GROUP, groups_for
from chromaperture.disparity.stages.between_layers import TANGENTS
from chromaperture.disparity.stages.paths import LEAST_UNEXPLAINED, LINES, penalties_of
from chromaperture.disparity.stages.variation import OPERATOR_NORM_SQUARED
from chromaperture.stage_config import SurfaceConfig

AT_ONCE = 8  # neighbours that an invocation of a filter has: what they read overlaps
LANES = 16  # invocations of a path; 8, 16, 32: 10, 8, 10 ms for 143 layers of 720x480 on an H200 (docs/gpu.md)
LANES_IN_SOFTWARE = 4  # the fewer, the less they tell each other; 2 and 1 have too many layers each for its registers
# Steps of a path that are read before they are needed, and the most layers that an invocation reads ahead; by hand.
# On an H200 a step took 5 us without, and 1.3 us with it and 16 lanes (docs/gpu.md).
AHEAD, LAYERS_AHEAD = 4, 72
MOST_LAYERS = 512  # of a path: 32 in the registers of each of 16 invocations
STEPS_SIDE = 64  # px that a workgroup of `coupling_steps.wgsl` loads along either axis
_MOST_STEPS = 5  # iterations in shared memory: of 64 x 64 px loaded 54 x 54 are stored


class Grid(NamedTuple):
    """Size of a volume."""

    height: int
    width: int
    layers: int

    @property
    def pixels(self) -> int:
        """Pixels of a map."""
        return self.height * self.width

    @property
    def size(self) -> int:
        """Entries of the volume."""
        return self.height * self.width * self.layers


def per_pixel(chain: Chain, stage: str, arrays: list[Array], grid: Grid, **constants: Any) -> None:
    """Append a stage with one invocation for every pixel."""
    chain.add(
        stage, arrays, groups=groups_for(grid.pixels), uses=("indexing",),
        height=grid.height, width=grid.width, **constants,
    )  # fmt: skip


def add_paths(
    chain: Chain,
    likelihood: Array,
    guide: Array,
    total: Array,
    grid: Grid,
    layers_px: np.ndarray,
    *,
    config: SurfaceConfig,
    lanes: int | None = None,
    ahead: int | None = None,
) -> None:
    """Append `stages.aggregate_paths`: a dispatch for every direction.

    Parameters
    ----------
    chain : Chain
    likelihood, guide, total : Array
        Volume, map, volume; the last is written.
    grid : Grid
    layers_px : (count,) float, px
    config : SurfaceConfig
    lanes : int
        Invocations that share a path; 1, 2, 4, ... 64. By default as many as suit the device.
    ahead : int
        Steps of a path that are read before they are needed; by default as suits the device.

    Raises
    ------
    DeviceError
        More than `MOST_LAYERS` layers.
    """
    if grid.layers > MOST_LAYERS:
        raise DeviceError(f"{grid.layers} labels are too many for the GPU, at most {MOST_LAYERS}; use --device cpu")
    penalties = penalties_of(config, layers_px)
    lanes = lanes or (LANES_IN_SOFTWARE if chain.device.info.is_software else LANES)
    own_layers = math.ceil(grid.layers / lanes)
    if ahead is None:
        ahead = 1 if chain.device.info.is_software else max(1, min(AHEAD, LAYERS_AHEAD // own_layers))
    # Layers within which a change costs less than a jump: nothing comes from further away.
    reach = math.ceil(penalties.jump / penalties.slope_per_layer / own_layers)
    for i, (dx, dy) in enumerate((sign * x, sign * y) for x, y in LINES[: config.paths // 2] for sign in (1, -1)):
        lines = grid.height if dy == 0 else grid.width if dx == 0 else grid.height + grid.width - 1
        chain.add(
            "volume_paths", [likelihood, guide, total], groups=(lines / (GROUP // lanes),),
            height=grid.height, width=grid.width, count=grid.layers, lines=lines,
            lanes=lanes, own_layers=own_layers, ahead=ahead, reach=min(lanes - 1, reach), dx=float(dx), dy=float(dy),
            own=float(config.paths - 1), starts_total=i == 0,
            slope=penalties.slope_per_layer, jump=penalties.jump,
            edge_range=penalties.edge_range, edge_floor=penalties.edge_floor,
        )  # fmt: skip


def add_gaussian(
    chain: Chain,
    values: Array,
    between: Array,
    shape: tuple[int, int],
    taps: np.ndarray,
    *,
    parts: int,
    planes: int = 1,
    source: Array | None = None,
    every: int = 1,
) -> None:
    """Append a filter along both axes: (planes, h, w, parts), mirrored at the borders.

    Parameters
    ----------
    chain : Chain
    values, between : Array
        What is filtered, in place, and as much room.
    shape : (int, int)
    taps : (2 r + 1,) float
    parts, planes : int
    source : Array, optional
        What is filtered instead; ``values`` is only written.
    every : int
        Only every so many-th pixel along either axis is computed; more than 1 needs ``source``.
    """
    height, width = shape
    # A constant array that is indexed by a variable is copied for every invocation: half the time of a software device.
    filter_taps = chain.constant(f"taps_of_{values.name}", np.concatenate([taps, np.zeros((AT_ONCE - 1) * every)]))
    for before, after, along_x in ((source or values, between, True), (between, values, False)):
        lines, across = (height, width) if along_x else (width, height)
        chain.add(
            "gaussian_line", [before, filter_taps, after],
            groups=groups_for(planes * lines * -(-across // (AT_ONCE * every)) * parts), uses=("indexing",),
            height=height, width=width, planes=planes, parts=parts, reach=len(taps) // 2, along_x=along_x, every=every,
        )  # fmt: skip
        width = -(-width // every)


def gaussian_taps(sigma: float) -> np.ndarray:
    """Return the taps of OpenCV's ``GaussianBlur`` of float pictures when it chooses the window itself."""
    size = round(sigma * 8 + 1) | 1  # OpenCV's own rule: four sigmas to either side
    return np.asarray(cv2.getGaussianKernel(size, sigma, cv2.CV_32F)[:, 0])


class SurfaceArrays(NamedTuple):
    """What the stages between the volume and the surface work on."""

    likelihood: Array  # (h, w, count)
    guide: Array  # (h, w)
    cost: Array  # (h, w, count)
    winner: Array  # (h, w, 4)
    offset: Array  # (h, w)
    tangents: Array  # (h, w, 2)
    averages: Array  # (h, w, 2)
    links: Array  # (h, w, 2)
    goal: Array  # (h, w)
    surface: Array  # (h, w, 4): layer, extrapolated, dual
    other: Array  # (h, w, 4): the iterations go to and fro
    posterior: Array  # (h, w, 2): mean and variance
    sigma: Array  # (h, w)
    label: Array  # (h, w): layer
    couplings: Array  # (rounds,)
    round: Array  # (1,)


def surface_arrays(chain: Chain, grid: Grid, config: SurfaceConfig) -> SurfaceArrays:
    """Make the arrays; raises OutOfMemoryError."""
    pixels = grid.pixels
    sizes = dict(
        likelihood=grid.size, guide=pixels, cost=grid.size, winner=4 * pixels, offset=pixels, tangents=2 * pixels,
        averages=2 * pixels, links=2 * pixels, goal=pixels, surface=4 * pixels, other=4 * pixels,
        posterior=2 * pixels, sigma=pixels, label=pixels,
    )  # fmt: skip
    made = {name: chain.array(name, size) for name, size in sizes.items()}
    rounds = np.geomspace(*config.coupling_layers2, max(1, config.coupling_rounds))
    couplings = chain.constant("couplings", rounds)
    return SurfaceArrays(**made, couplings=couplings, round=chain.array("round", 1, np.uint32))


def add_start(chain: Chain, a: SurfaceArrays, grid: Grid, *, config: SurfaceConfig) -> None:
    """Append the best layers by cost and `between_layers`, which starts the variation."""
    per_pixel(chain, "volume_winner", [a.cost, a.likelihood, a.winner], grid, count=grid.layers)
    taps = gaussian_taps(config.interpolation_sigma_px)
    for i in range(TANGENTS):
        per_pixel(
            chain, "layer_tangents", [a.winner, a.offset, a.tangents], grid,
            is_first=i == 0, least_unexplained=LEAST_UNEXPLAINED,
        )  # fmt: skip
        add_gaussian(chain, a.tangents, a.averages, (grid.height, grid.width), taps, parts=2)
        per_pixel(chain, "layer_offsets", [a.winner, a.tangents, a.offset, a.surface], grid)


def add_variation(chain: Chain, a: SurfaceArrays, grid: Grid, layers_px: np.ndarray, *, config: SurfaceConfig) -> None:
    """Append `stages.coupled_variation`; the result is in ``surface``."""
    step = float(layers_px[1] - layers_px[0])
    chain.add("count_up", [a.round], groups=(1,), to_zero=True)
    per_pixel(
        chain, "link_weights", [a.guide, a.links], grid, edge_range=config.edge_range, edge_floor=config.edge_floor
    )
    primal_step = OPERATOR_NORM_SQUARED**-0.5
    # An even number of dispatches a round: it ends in the array in which it began.
    parts = _even_parts(config.variation_iterations)
    for _ in range(config.coupling_rounds):
        per_pixel(
            chain, "coupling_target", [a.surface, a.likelihood, a.winner, a.couplings, a.round, a.goal], grid,
            count=grid.layers, fidelity=1 / (config.slope_penalty * step),
        )  # fmt: skip
        for i, steps in enumerate(parts):
            before, after = (a.surface, a.other) if i % 2 == 0 else (a.other, a.surface)
            chain.add(
                "coupling_steps", [before, after, a.goal, a.links, a.couplings, a.round],
                groups=tuple(side / (STEPS_SIDE - 2 * steps) for side in (grid.width, grid.height)),
                height=grid.height, width=grid.width, steps=steps, is_fresh=i == 0,
                primal_step=primal_step, dual_step=1 / (OPERATOR_NORM_SQUARED * primal_step),
                huber=float(config.huber_layers), highest=float(grid.layers - 1),
            )  # fmt: skip
        chain.add("count_up", [a.round], groups=(1,), to_zero=False)


def _even_parts(iterations: int) -> list[int]:
    """Cut iterations into an even number of nearly equal parts; 0 does nothing but copy."""
    dispatches = 2 * math.ceil(iterations / _MOST_STEPS / 2)
    return [iterations // dispatches + (i < iterations % dispatches) for i in range(dispatches)]


def add_posterior(chain: Chain, a: SurfaceArrays, grid: Grid, *, config: SurfaceConfig) -> None:
    """Append `stages.posterior`, in layers, and the error bar of the surface."""
    per_pixel(
        chain, "volume_posterior", [a.cost, a.posterior], grid,
        count=grid.layers, temperature=config.temperature * config.paths,
    )  # fmt: skip
    add_sigma(chain, a, grid)


def add_sigma(chain: Chain, a: SurfaceArrays, grid: Grid) -> None:
    """Append the error bar that the posterior gives the surface, `Posterior.sigma_px`."""
    per_pixel(chain, "surface_sigma", [a.surface, a.posterior, a.sigma, a.label], grid)


def add_block_sums(chain: Chain, a: SurfaceArrays, grid: Grid, size: int) -> Array:
    """Append sums of the volume over squares of pixels, as `planar.block_sums`."""
    entries = (grid.height // size) * (grid.width // size) * grid.layers
    blocks = chain.array("blocks", entries)
    chain.add(
        "block_sums", [a.likelihood, blocks], groups=groups_for(entries), uses=("indexing",),
        height=grid.height, width=grid.width, count=grid.layers, size=size,
    )  # fmt: skip
    return blocks

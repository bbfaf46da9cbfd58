"""Stages of quality "accurate" from a volume of log-likelihoods to a surface, appended to a chain.

Paths, the place between the layers and the posterior: the files of ``readable/`` explain each. Disparities count in
layers here. Volumes are (h, w, count), layers of a block adjacent.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np

from chromaperture.matching.blocks import BLOCK_PX
from chromaperture.matching.device.device import GROUP, Array, Chain, DeviceError
from chromaperture.matching.readable.between_layers import TANGENTS
from chromaperture.matching.readable.paths import LEAST_UNEXPLAINED, LINES, path_temperature, penalties_of
from chromaperture.settings.stages import SurfaceConfig

AT_ONCE = 8  # neighbours that an invocation of a filter has: what they read overlaps
LANES = 16  # invocations of a path; 8, 16, 32: 10, 8, 10 ms for 143 layers of 720x480 on an H200 (docs/gpu.md)
# Steps of a path that are read before they are needed, and the most layers that an invocation reads ahead; by hand.
# On an H200 a step took 5 us without, and 1.3 us with it and 16 lanes (docs/gpu.md).
AHEAD, LAYERS_AHEAD = 4, 72
MOST_LAYERS = 512  # of a path: 32 in the registers of each of 16 invocations


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
        stage, arrays, grid.pixels, height=grid.height, width=grid.width, **constants,
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
    lanes: int = LANES,
    ahead: int | None = None,
) -> None:
    """Append `readable.aggregate_paths`: a dispatch for every direction; raises DeviceError for too many layers.

    ``likelihood``, ``guide``, ``total``: volume, map, volume; the last is written. ``lanes`` invocations share a path:
    1, 2, 4, ... 64; ``ahead`` of its steps are read before they are needed, by default as many as registers hold.
    """
    if grid.layers > MOST_LAYERS:
        raise DeviceError(f"{grid.layers} labels are too many for the GPU, at most {MOST_LAYERS}; use --device cpu")
    penalties = penalties_of(config, layers_px)
    own_layers = math.ceil(grid.layers / lanes)
    if ahead is None:
        ahead = max(1, min(AHEAD, LAYERS_AHEAD // own_layers))
    # Layers within which a change costs less than a jump: nothing comes from further away.
    reach = math.ceil(penalties.jump / penalties.slope_per_layer / own_layers)
    for i, (dx, dy) in enumerate((sign * x, sign * y) for x, y in LINES[: config.paths // 2] for sign in (1, -1)):
        lines = grid.height if dy == 0 else grid.width if dx == 0 else grid.height + grid.width - 1
        chain.add(
            "volume_paths", [likelihood, guide, total], groups=(lines / (GROUP // lanes),), height=grid.height,
            width=grid.width, count=grid.layers, lines=lines, lanes=lanes, own_layers=own_layers, ahead=ahead,
            reach=min(lanes - 1, reach), dx=float(dx), dy=float(dy), own=float(config.paths - 1), starts_total=i == 0,
            slope=penalties.slope_per_layer, jump=penalties.jump, edge_range=penalties.edge_range,
            edge_floor=penalties.edge_floor,
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
) -> None:
    """Append a filter along both axes: (planes, h, w, parts), mirrored at the borders.

    ``values`` is filtered in place, ``between`` is as much room; where ``source`` is given, it is filtered instead.
    """
    height, width = shape
    # An array: a shader's constant that is indexed by a variable is copied for every invocation.
    filter_taps = chain.constant(f"taps_of_{values.name}", np.concatenate([taps, np.zeros(AT_ONCE - 1)]))
    for before, after, along_x in ((source or values, between, True), (between, values, False)):
        lines, across = (height, width) if along_x else (width, height)
        chain.add(
            "gaussian_line", [before, filter_taps, after], planes * lines * -(-across // AT_ONCE) * parts,
            height=height, width=width, planes=planes, parts=parts, reach=len(taps) // 2, along_x=along_x,
        )  # fmt: skip


def gaussian_taps(sigma: float) -> np.ndarray:
    """Return the taps of OpenCV's ``GaussianBlur`` of float pictures when it chooses the window itself."""
    size = round(sigma * 8 + 1) | 1  # OpenCV's own rule: four sigmas to either side
    return np.asarray(cv2.getGaussianKernel(size, sigma, cv2.CV_32F)[:, 0])


def add_path_surface(
    chain: Chain, likelihood: Array, guide: Array, grid: Grid, labels_px: np.ndarray, *, config: SurfaceConfig
) -> None:
    """Append the paths, the surface of least cost between the labels, and the posterior of the labels.

    Makes the arrays ``label``, (h, w), and ``posterior``, (h, w, 2): mean and variance; labels from 0 on.
    """
    pixels = grid.pixels
    sizes = dict(
        cost=grid.size, winner=4 * pixels, offset=pixels, tangents=2 * pixels, averages=2 * pixels, label=pixels,
        posterior=2 * pixels,
    )  # fmt: skip
    cost, winner, offset, tangents, averages, label, posterior = (chain.array(*size) for size in sizes.items())
    add_paths(chain, likelihood, guide, cost, grid, labels_px, config=config)
    per_pixel(chain, "volume_winner", [cost, likelihood, winner], grid, count=grid.layers)
    taps = gaussian_taps(config.interpolation_sigma_px / BLOCK_PX)
    for i in range(TANGENTS):
        per_pixel(
            chain, "layer_tangents", [winner, offset, tangents], grid, is_first=i == 0,
            least_unexplained=LEAST_UNEXPLAINED,
        )  # fmt: skip
        add_gaussian(chain, tangents, averages, (grid.height, grid.width), taps, parts=2)
        per_pixel(chain, "layer_offsets", [winner, tangents, offset, label], grid)
    per_pixel(
        chain, "volume_posterior", [cost, posterior], grid, count=grid.layers,
        temperature=path_temperature(config),
    )  # fmt: skip


def add_block_means(chain: Chain, of_pixels: Array, usable: Array, likelihood: Array, grid: Grid, size: int) -> None:
    """Append means of a volume over squares of pixels, `blocks.block_means`, times how far these are usable."""
    chain.add(
        "block_means", [of_pixels, usable, likelihood], (grid.height // size) * (grid.width // size) * grid.layers,
        height=grid.height, width=grid.width, count=grid.layers, size=size,
    )  # fmt: skip

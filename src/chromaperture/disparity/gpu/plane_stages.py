"""Blocks choose planes on a device: costs of planes, belief propagation over them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from chromaperture.disparity.gpu.device import Array, Chain, Device
from chromaperture.disparity.gpu.surface_stages import AHEAD, Grid
from chromaperture.disparity.gpu.workgroups import GROUP, groups_for
from chromaperture.disparity.stages.planes import PlaneCosts

_PARTS = 256  # of the messages that are set to 0, as many workgroups: chosen by hand


def add_potts(
    chain: Chain, beliefs: Array, count: Array, links: Array, shape: tuple[int, int], capacity: int, sweeps: int
) -> Array:
    """Append `stages.potts_beliefs` and the choices of least cost, which are returned.

    Parameters
    ----------
    chain : Chain
    beliefs : Array
        (h, w, planes): the costs before, the beliefs behind.
    count : Array
        How many planes there are.
    links : Array
        (2, h, w).
    shape : (int, int)
    capacity : int
        The most planes.
    sweeps : int
    """
    pixels, single = shape[0] * shape[1], chain.device.info.is_software
    held: dict[str, Any] = {} if single else {"held": math.ceil(capacity / GROUP), "ahead": AHEAD}
    sent = [chain.array(f"sent_{side}", pixels * capacity) for side in ("right", "left", "down", "up")]
    chain.add("messages_zero", [count, *sent], groups=(_PARTS,), pixels=pixels, parts=_PARTS)
    for _ in range(sweeps):
        for along_x, (ahead, back) in ((True, sent[:2]), (False, sent[2:])):
            lines = shape[0] if along_x else shape[1]
            chain.add(
                "potts_lines_single" if single else "potts_lines", [beliefs, ahead, back, links, count],
                groups=(lines / (GROUP if single else 1),), height=shape[0], width=shape[1], along_x=along_x, **held,
            )  # fmt: skip
    choice = chain.array("choice", pixels, np.uint32)
    chain.add(
        "least_choice", [beliefs, count, choice], groups=groups_for(pixels), uses=("indexing",), pixels=pixels,
    )  # fmt: skip
    return choice


class PlaneChoice:
    """Blocks or pixels that choose planes together, on a device.

    Parameters
    ----------
    device : Device
    shape : (int, int)
    capacity : int
        The most planes.
    sweeps : int
    """

    def __init__(self, device: Device, shape: tuple[int, int], capacity: int, sweeps: int) -> None:
        self.shape, self.capacity = shape, capacity
        self.chain = chain = Chain(device)
        pixels = shape[0] * shape[1]
        self.beliefs = chain.array("beliefs", pixels * capacity)
        self.count = chain.array("plane_count", 1, np.uint32)
        self.links = chain.array("plane_links", 2 * pixels)
        self.choice = add_potts(chain, self.beliefs, self.count, self.links, shape, capacity, sweeps)

    def beliefs_of(self, cost: np.ndarray, links: np.ndarray) -> np.ndarray:
        """Return `stages.potts_beliefs` of a cost (h, w, K)."""
        return self._run(cost, links, "beliefs")[: cost.size].reshape(cost.shape)

    def _run(self, cost: np.ndarray, links: np.ndarray, output: str) -> np.ndarray:
        filled = np.zeros(self.beliefs.size, np.float32)
        filled[: cost.size] = cost.ravel()
        number = np.array([cost.shape[2]], np.uint32)
        return self.chain.run({"beliefs": filled, "plane_count": number, "plane_links": links}, [output])[output]


class BlockChoice(PlaneChoice):
    """Blocks of a volume that choose planes; their sums stay on the device.

    Parameters
    ----------
    device, capacity, sweeps
        As `PlaneChoice`.
    blocks : Array
        (h, w, layers), sums of blocks.
    grid : Grid
        Of the blocks.
    labels_px : (layers,) float, px
    costs : PlaneCosts
        Of a block.
    """

    def __init__(
        self,
        device: Device,
        blocks: Array,
        grid: Grid,
        capacity: int,
        sweeps: int,
        labels_px: np.ndarray,
        costs: PlaneCosts,
    ) -> None:
        super().__init__(device, (grid.height, grid.width), capacity, sweeps)
        self.blocks, self.labels_px, self.costs = blocks, labels_px, costs
        following = self.chain.dispatches[:]
        self.chain.dispatches.clear()
        self.planes = planes = self.chain.array("block_planes", 4 * capacity)
        self.chain.add(
            "plane_costs", [blocks, planes, self.count, self.beliefs], groups=groups_for(grid.pixels, 1),
            height=grid.height, width=grid.width, count=grid.layers, outside=float(costs.outside),
        )  # fmt: skip
        self.chain.dispatches += following

    def inputs_of(self, planes: np.ndarray) -> dict[str, np.ndarray]:
        """Return what goes up of planes (K, 3) of blocks, px, from which to choose."""
        step = float(self.labels_px[1] - self.labels_px[0])
        filled = np.zeros((self.capacity, 4), np.float32)
        filled[: len(planes), :3] = planes / step
        filled[: len(planes), 2] -= self.labels_px[0] / step
        filled[: len(planes), 3] = self.costs.slope / 2 * (filled[: len(planes), :2] ** 2).sum(axis=1)
        return {self.planes.name: filled, self.count.name: np.array([len(planes)], np.uint32)}

    def choose(self, planes: np.ndarray) -> np.ndarray:
        """Return the plane of every block, (h, w) int, of planes (K, 3) of blocks; ``links`` are on the device."""
        return self.chain.run(self.inputs_of(planes), ["choice"])["choice"].reshape(self.shape).astype(np.intp)

"""Planes on a device: refining candidates, costs of planes, belief propagation over them.

What stays on the CPU, and why: the consensus of random samples in every tile and the joining of planes are decisions
one after the other over a few thousand numbers, and an edge's reach is a distance transform for every plane. They need
maps and block sums of the volume, a sixteenth of it; the volume itself stays on the device.
"""

from __future__ import annotations

import numpy as np

from chromaperture.disparity.gpu.device import Array, Chain, Device
from chromaperture.disparity.gpu.surface_stages import Grid
from chromaperture.disparity.gpu.workgroups import GROUP, groups_for
from chromaperture.disparity.plane_fit import NEWTON_STEPS, Proposal
from chromaperture.disparity.stages.plane_refining import CONDITION, GAINED, REACH
from chromaperture.disparity.stages.planes import PlaneCosts


def refined_planes(
    device: Device, likelihood: Array, grid: Grid, found: list[Proposal], labels_px: np.ndarray, *, slope_penalty: float
) -> np.ndarray:
    """Move planes to the most likely place near them, as `stages.best_planes`; (K, 3) float64.

    Parameters
    ----------
    device : Device
    likelihood : Array
        (h, w, layers), nats a pixel.
    grid : Grid
    found : list of Proposal
    labels_px : (layers,) float, px
    slope_penalty : float
        `PlaneCosts.slope`.
    """
    if not found:
        return np.empty((0, 3))
    step = float(labels_px[1] - labels_px[0])
    counts = np.array([len(part.x) for part in found])
    middles = np.array([(part.x.mean(), part.y.mean()) for part in found])
    planes = np.array([part.plane for part in found])
    in_layers = planes / step
    in_layers[:, 2] += (in_layers[:, :2] * middles).sum(axis=1) - labels_px[0] / step
    chain = Chain(device)
    points = np.concatenate([part.x | part.y << 16 for part in found]).astype(np.uint32)
    parts = np.zeros((len(found), 4), np.uint32)
    parts[:, 0], parts[:, 1] = np.cumsum(counts) - counts, counts
    result = chain.constant("planes", np.concatenate([in_layers, np.zeros((len(found), 1))], axis=1))
    chain.add(
        "plane_refining",
        [
            likelihood, chain.constant("points", points), chain.constant("parts", parts),
            chain.constant("middles", middles), result,
        ],
        groups=(len(found),), width=grid.width, count=grid.layers, reach=REACH, slope_penalty=slope_penalty,
        newton_steps=NEWTON_STEPS, condition=CONDITION, gained=GAINED,
    )  # fmt: skip
    moved = chain.run({}, ["planes"])["planes"].reshape(-1, 4)[:, :3].astype(float)
    moved[:, 2] += labels_px[0] / step - (moved[:, :2] * middles).sum(axis=1)
    return moved * step


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
        links = chain.array("plane_links", 2 * pixels)
        sent = [chain.array(f"sent_{side}", pixels * capacity) for side in ("right", "left", "down", "up")]
        for messages in sent:
            chain.add("fill_zero", [messages], groups=groups_for(messages.size), uses=("indexing",), size=messages.size)
        for _ in range(sweeps):
            for along_x, (ahead, back) in ((True, sent[:2]), (False, sent[2:])):
                lines, single = shape[0] if along_x else shape[1], device.info.is_software
                chain.add(
                    "potts_lines", [self.beliefs, ahead, back, links, self.count],
                    groups=(lines / (GROUP if single else 1),),
                    uses=("choices_single" if single else "choices_shared",),
                    height=shape[0], width=shape[1], along_x=along_x,
                )  # fmt: skip

        choice = chain.array("choice", pixels, np.uint32)
        chain.add(
            "least_choice", [self.beliefs, self.count, choice], groups=groups_for(pixels), uses=("indexing",),
            pixels=pixels,
        )  # fmt: skip

    def beliefs_of(self, cost: np.ndarray, links: np.ndarray) -> np.ndarray:
        """Return `stages.potts_beliefs` of a cost (h, w, K)."""
        return self._run(cost, links, "beliefs")[: cost.size].reshape(cost.shape)

    def choices_of(self, cost: np.ndarray, links: np.ndarray) -> np.ndarray:
        """Return the choices of least cost, (h, w) int: beliefs stay on the device."""
        return self._run(cost, links, "choice").reshape(self.shape).astype(np.intp)

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
        self.labels_px, self.costs = labels_px, costs
        following = self.chain.dispatches[:]
        self.chain.dispatches.clear()
        planes = self.chain.array("block_planes", 4 * capacity)
        self.chain.add(
            "plane_costs", [blocks, planes, self.count, self.beliefs], groups=groups_for(grid.pixels, 1),
            height=grid.height, width=grid.width, count=grid.layers, outside=float(costs.outside),
        )  # fmt: skip
        self.chain.dispatches += following

    def choose(self, planes: np.ndarray, links: np.ndarray) -> np.ndarray:
        """Return the plane of every block, (h, w) int, of planes (K, 3) of blocks."""
        step = float(self.labels_px[1] - self.labels_px[0])
        filled = np.zeros((self.capacity, 4))
        filled[: len(planes), :3] = planes / step
        filled[: len(planes), 2] -= self.labels_px[0] / step
        filled[: len(planes), 3] = self.costs.slope / 2 * (filled[: len(planes), :2] ** 2).sum(axis=1)
        number = np.array([len(planes)], np.uint32)
        inputs: dict[str, np.ndarray] = {"block_planes": filled, "plane_count": number, "plane_links": links}
        return self.chain.run(inputs, ["choice"])["choice"].reshape(self.shape).astype(np.intp)

"""Refocusing on the device: the composite of ``effects/refocusing.py``, in WGSL.

The picture, what near surfaces hide, and the new blur radii go up once, the new picture comes down once. All layers
share their shaders: what differs is in a small array of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from chromaperture.matching.device.device import Array, Chain, Device

LEAST_COVER = 1e-3  # below it a pixel stays darker, in place of a division by nothing
_NOWHERE = np.float32(3e38)  # px, a blur radius beyond all layers: nothing is hidden there


class RefocusLayer(NamedTuple):
    """Part of a picture that is blurred as one."""

    # New blur radii, px: of the layer before, its own, of the layer behind. Weights fall linearly to its neighbours.
    nodes: tuple[float, float, float]
    box: tuple[int, int, int, int]  # top, left, bottom and right of what it reaches
    scale: int  # cells of so many px a side are blurred
    kernel: np.ndarray  # (s, s) float32: the pupil in cells, of sum 1, s odd
    joined: tuple[int, ...]  # numbers of the layers that hide this one, and did not hide those before

    @property
    def cells(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        top, left, bottom, right = self.box
        return -(-(bottom - top) // self.scale), -(-(right - left) // self.scale)

    def packed(self) -> np.ndarray:
        """Return what `refocus_layer` names; (11,) uint32."""
        top, left, bottom, right = self.box
        whole = (top, left, bottom - top, right - left, self.scale, *self.cells, len(self.kernel))
        return np.concatenate([np.array(self.nodes, np.float32).view(np.uint32), np.array(whole, np.uint32)])


def inputs_of(
    pictures: tuple[np.ndarray, np.ndarray], radii: tuple[np.ndarray, np.ndarray], hidden: np.ndarray
) -> dict[str, np.ndarray]:
    """Return what goes up of what `RefocusChain.composite` takes."""
    behind_radius = np.where(hidden, radii[1], _NOWHERE)
    return {"color": pictures[0], "behind": pictures[1], "radius": radii[0], "behind_radius": behind_radius}


class RefocusChain:
    """Arrays on a device for pictures of one size, (H, W)."""

    def __init__(self, device: Device, size: tuple[int, int]) -> None:
        self.size = size
        self.chain = chain = Chain(device)
        self.pixels = size[0] * size[1]
        for name in ("color", "behind", "refocused"):
            chain.array(name, 3 * self.pixels)
        for name in ("radius", "behind_radius", "before"):
            chain.array(name, self.pixels)
        chain.array("total", 4 * self.pixels)

    def composite(
        self,
        pictures: tuple[np.ndarray, np.ndarray],
        radii: tuple[np.ndarray, np.ndarray],
        hidden: np.ndarray,
        layers: Sequence[RefocusLayer],
    ) -> np.ndarray:
        """Return the picture (H, W, 3) of a lens with another focus.

        ``pictures``: what is seen, and what is hidden behind it, (H, W, 3) float32; ``radii``: new blur of both, (H, W)
        float32, px; ``hidden``: (H, W) bool, where there is anything hidden; ``layers``: near to far.
        """
        self._compose(layers)
        inputs = inputs_of(pictures, radii, hidden)
        return self.chain.run(inputs, ["refocused"])["refocused"].reshape(*self.size, 3)

    def _compose(self, layers: Sequence[RefocusLayer]) -> None:
        """Put the dispatches of these layers in the place of the last ones."""
        chain, arrays = self.chain, self.chain.arrays
        chain.dispatches.clear()
        in_picture: dict[str, Any] = {"width": self.size[1]}
        for name in ("before", "total"):
            chain.add("fill_zero", [arrays[name]], arrays[name].size, size=arrays[name].size)
        most = max((int(np.prod(layer.cells)) for layer in layers), default=1)
        cells, blurred = (self._array(name, 4 * most) for name in ("cells", "blurred"))
        facts: list[Array] = []
        covers: dict[int, str] = {}  # of layers that hide nothing yet
        free: list[str] = []
        for number, layer in enumerate(layers):
            for joined in layer.joined:
                self._over_box(
                    "cover_joined", layers[joined], [arrays[covers[joined]], facts[joined], arrays["before"]]
                )
                free.append(covers.pop(joined))
            name = free.pop() if free else f"cover{len(covers)}"
            covers[number] = name
            cover = self._array(name, self.pixels)
            facts.append(chain.constant(f"layer{number}", layer.packed()))
            kernel = chain.constant(f"kernel{number}", layer.kernel)
            count = int(np.prod(layer.cells))
            seen = [arrays[each] for each in ("color", "behind", "radius", "behind_radius")]
            chain.add("layer_reduced", [*seen, facts[-1], cells], count, **in_picture)
            chain.add("layer_blurred", [cells, kernel, facts[-1], blurred], count)
            self._over_box("layer_added", layer, [blurred, arrays["before"], facts[-1], arrays["total"], cover])
        chain.add(
            "light_over_cover", [arrays["total"], arrays["refocused"]], self.pixels, pixels=self.pixels,
            least_cover=LEAST_COVER,
        )  # fmt: skip

    def _over_box(self, stage: str, layer: RefocusLayer, arrays: list[Array]) -> None:
        top, left, bottom, right = layer.box
        self.chain.add(stage, arrays, (bottom - top) * (right - left), width=self.size[1])

    def _array(self, name: str, size: int) -> Array:
        """Return an array of at least so many numbers."""
        known = self.chain.arrays.get(name)
        return known if known is not None and known.size >= size else self.chain.array(name, size)

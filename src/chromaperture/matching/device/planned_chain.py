"""A chain that is written down instead of run: for a browser, which runs the same shaders over the same arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from chromaperture.matching.device.device import AdapterInfo, Array, Chain, Device, Dispatch
from chromaperture.matching.device.shader_text import shader
from chromaperture.matching.device.workgroups import dispatch_size

# How the invocations that share a path exchange their least cost, by what a device can do; see `real_time_chain.py`.
Exchange = Literal["quad", "shared"]


_LARGEST_BYTES = 128 * 2**20  # of an array: what every device with WebGPU takes, its default limit


class PlannedChain(Chain):
    """A chain of a device that is elsewhere; `Chain.run` and `Chain.start` do not work.

    Parameters
    ----------
    exchange : {"quad", "shared"}
        ``quad``: the device has subgroups; ``shared``: it has none.

    Attributes
    ----------
    values : dict
        Of the constant arrays, flat, by name.
    """

    def __init__(self, exchange: Exchange) -> None:
        info = AdapterInfo(
            "a browser's device", "Unknown", "WebGPU", "", _LARGEST_BYTES // 1_000_000, exchange == "quad"
        )
        super().__init__(Device(info, None, exchange == "quad", False, _LARGEST_BYTES))
        self.values: dict[str, np.ndarray] = {}

    def array(self, name: str, size: int, dtype: type = np.float32) -> Array:
        """Name an array of so many 32-bit numbers."""
        self.arrays[name] = Array(name, None, int(size), np.dtype(dtype))
        return self.arrays[name]

    def write(self, array: Array, values: np.ndarray) -> None:
        """Keep the values of a constant."""
        self.values[array.name] = np.ascontiguousarray(values, array.dtype).ravel()

    def add(
        self,
        stage: str,
        arrays: Sequence[Array],
        *,
        groups: Sequence[float],
        entry: str = "main",
        uses: Sequence[str] = (),
        **constants: Any,
    ) -> None:
        """Append a stage, as `Chain.add`; its entry point must be ``main``."""
        if entry != "main":
            raise ValueError(f"stage {stage}: a plan has no entry point but main")
        size = dispatch_size(stage, len(arrays), groups)
        source = shader(stage, uses, constants)
        self.dispatches.append(Dispatch(stage, source, size, tuple(arrays), constants))

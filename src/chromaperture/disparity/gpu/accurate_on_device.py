"""Quality "accurate" as a method: its chains are made at the first photograph of a size, and kept."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from chromaperture.disparity.accurate import AccurateMethod
from chromaperture.disparity.gpu.accurate_chain import AccurateChain, Started, pairs_of
from chromaperture.disparity.gpu.device import Device
from chromaperture.disparity.gpu.measured import NOTHING, Further, Measured, OnDevice, is_same
from chromaperture.disparity.gpu.working_stages import Reduction


class Begun(NamedTuple):
    """A photograph that a method has begun, and the chains that compute it."""

    chain: AccurateChain
    started: Started


@dataclass
class AccurateOnDevice(OnDevice):
    """Quality "accurate" on a device.

    Attributes
    ----------
    method : AccurateMethod
    device : Device
    reduction : Reduction or None
        Where reduced pictures are matched; the method is then that of their camera.
    """

    method: AccurateMethod
    device: Device
    reduction: Reduction | None = None
    _chain: AccurateChain | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def start(self, image: np.ndarray, further: Further = NOTHING) -> Begun:
        """Send an image (H, W, 3) to the device, which begins; at most two are under way, `finish` them in turn."""
        pairs = pairs_of(self.method)
        if pairs is not None and self.reduction is None:
            pairs.check_size(image)
        with self._lock, self._freed_on_failure():
            chain = self._composed((image.shape[0], image.shape[1]), further)
            return Begun(chain, chain.start(image))

    def finish(self, begun: Begun) -> Measured:
        """Wait for what `start` has begun."""
        with self._lock, self._freed_on_failure():
            return begun.chain.finish(begun.started)

    def _composed(self, shape: tuple[int, int], further: Further) -> AccurateChain:
        chain = self._chain
        if chain is None or chain.shape != shape or not is_same(chain.further, further):
            self._chain = None  # gives its memory back before the next takes its own
            chain = AccurateChain(self.method, self.device, shape, reduction=self.reduction, further=further)
            self._chain = chain
        return chain

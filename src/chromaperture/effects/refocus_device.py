"""Refocusing on a camera's device."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.matching.device.device import DeviceError
from chromaperture.matching.device.gpu_method import DeviceMethod, device_method
from chromaperture.matching.device.refocus_stages import RefocusChain, RefocusLayer
from chromaperture.system.errors import OutOfMemoryError

_NUMBERS = 4  # of a pixel, in the largest array


@dataclass
class DeviceCompositor:
    """The compositor of `refocus` on a device as long as that works; safe from several threads."""

    behind: DeviceMethod  # whose device it is; where that fails the CPU takes over in both
    _chain: RefocusChain | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __call__(
        self,
        pictures: tuple[np.ndarray, np.ndarray],
        radii: tuple[np.ndarray, np.ndarray],
        hidden: np.ndarray,
        layers: Sequence[RefocusLayer],
    ) -> np.ndarray | None:
        """Return the picture, see `RefocusChain.composite`; None where the CPU has to do it.

        Raises DeviceError, OutOfMemoryError where the device was asked for by name.
        """
        device, size = self.behind.on_gpu.device, (hidden.shape[0], hidden.shape[1])
        if self.behind.has_failed or 4 * _NUMBERS * hidden.size > device.largest_bytes:
            return None
        try:
            with self._lock:
                if self._chain is None or self._chain.size != size:
                    self._chain = None  # gives its memory back before the next takes its own
                    self._chain = RefocusChain(device, size)
                return self._chain.composite(pictures, radii, hidden, layers)
        except (DeviceError, OutOfMemoryError) as error:
            self._chain = None
            self.behind.fall_back(error)
        return None


def compositor_of(camera: CodedApertureCamera) -> DeviceCompositor | None:
    """Return what refocuses on the device of a camera; None where it has none."""
    behind = device_method(camera.method)
    return None if behind is None else DeviceCompositor(behind)

"""What a device makes of a disparity that came back to the CPU: depth in millimetres and aligned colours.

For methods that go to the device and back in parts, and for working scales that the CPU reduces to. The photograph and
two maps go up, the results come down once.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np

from chromaperture.disparity.gpu.alignment_stage import add_alignment
from chromaperture.disparity.gpu.conversion_stage import add_conversion
from chromaperture.disparity.gpu.device import Chain, Device, DeviceError
from chromaperture.disparity.gpu.gpu_method import DeviceMethod, Further, GpuMethod, Measured, device_method, same
from chromaperture.disparity.result import Method
from chromaperture.errors import OutOfMemoryError


@dataclass
class FurtherMaps:
    """One chain, made for the first photograph of a size and kept; safe from several threads.

    Attributes
    ----------
    behind : DeviceMethod
        Whose device it is; where that fails the CPU takes over in both.
    """

    behind: DeviceMethod
    _chain: Chain | None = None
    _size: tuple[int, int] = (0, 0)
    _further: Further = field(default_factory=Further)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def added(self, measured: Measured, image: np.ndarray, further: Further) -> Measured:
        """Return a measurement with what is asked for besides, where the device can make it.

        Raises
        ------
        DeviceError, OutOfMemoryError
            The device was asked for by name.
        """
        device = self.behind.on_gpu.device
        if self.behind.has_failed or further == Further() or image.nbytes > device.largest_bytes:
            return measured
        try:
            with self._lock:
                return self._run(device, measured, image, further)
        except (DeviceError, OutOfMemoryError) as error:
            self._chain = None  # gives its memory back
            self.behind.fall_back(error)
        return measured

    def _run(self, device: Device, measured: Measured, image: np.ndarray, further: Further) -> Measured:
        size = image.shape[0], image.shape[1]
        if self._chain is None or self._size != size or not same(self._further, further):
            self._chain = None  # gives its memory back before the next takes its own
            self._chain, self._size, self._further = composed(device, size, further), size, further
        inputs = {"disparity": measured.disparity.value_px}
        outputs = []
        if further.conversion is not None:
            inputs["sigma"] = measured.disparity.sigma_px
            outputs += ["depth_mm", "sigma_mm"]
        if further.alignment is not None:
            inputs["image"] = image
            outputs.append("color")
        found = self._chain.run(inputs, outputs)
        depth_mm, sigma_mm = (found[name].reshape(size) if name in found else None for name in ("depth_mm", "sigma_mm"))
        color = found["color"].reshape(*size, 3) if "color" in found else None
        return measured._replace(depth_mm=depth_mm, sigma_mm=sigma_mm, color=color)


def composed(device: Device, size: tuple[int, int], further: Further) -> Chain:
    """Return a chain from ``disparity``, ``sigma`` and ``image`` of (H, W) to what is asked for."""
    chain = Chain(device)
    pixels = size[0] * size[1]
    disparity = chain.array("disparity", pixels)
    if further.conversion is not None:
        add_conversion(chain, disparity, chain.array("sigma", pixels), further.conversion)
    if further.alignment is not None:
        add_alignment(chain, chain.array("image", 3 * pixels), disparity, size, further.alignment)
    return chain


def further_maps(method: Method) -> FurtherMaps | None:
    """Return what completes a method's measurements on its device; None where there is none, or it does so itself."""
    behind = device_method(method)
    does_so_itself = behind is method and behind is not None and isinstance(behind.on_gpu, GpuMethod)
    return None if behind is None or does_so_itself else FurtherMaps(behind)

"""A method on a device: chains for the sizes of picture it has seen, and the way back to the CPU."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from chromaperture.matching.accurate import AccurateMethod
from chromaperture.matching.device.accurate_chain import AccurateOnDevice
from chromaperture.matching.device.device import Array, Chain, Device, DeviceError, adapters, open_device
from chromaperture.matching.device.measured import OnDevice, add_extras, is_same, measured_from, outputs_of
from chromaperture.matching.device.paper_chain import add_paper, runs_on_device
from chromaperture.matching.device.real_time_chain import add_real_time
from chromaperture.matching.device.view_stages import Reduction, add_reduced, add_upsampled, check_stats
from chromaperture.matching.paper import PaperMethod
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.matching.result import NO_EXTRAS, Disparity, Extras, Measured, Method, Pending
from chromaperture.matching.views import guide_weights
from chromaperture.matching.working_scale import ScaledMethod
from chromaperture.system.errors import CaptureWarning, ChromapertureError, InputError, OutOfMemoryError


@dataclass
class GpuMethod(OnDevice):
    """Qualities "real-time" and "paper" on a device."""

    method: RealTimeMethod | PaperMethod
    device: Device
    reduction: Reduction | None = None  # of larger pictures, to those that the method is of
    _chain: Chain | None = None
    _size: tuple[int, int] = (0, 0)
    _extras: Extras = NO_EXTRAS
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def start(self, image: np.ndarray, extras: Extras = NO_EXTRAS) -> Pending[Measured]:
        """Send an image (H, W, 3) to the device, which begins; at most two are under way, to be awaited in turn."""
        size = (image.shape[0], image.shape[1])
        with self._lock, self._freed_on_failure():
            pending = self._composed(size, extras).start({"image": image}, [*outputs_of(extras), "stats"])

        def result() -> Measured:
            with self._lock, self._freed_on_failure():
                found = pending.result()
            check_stats(found["stats"], len(self.method.space.rows))
            return measured_from(found, size)

        return Pending(result)

    @property
    def makes_extras(self) -> bool:
        """Whether `start` makes what is asked for besides the disparity."""
        return True

    def _composed(self, size: tuple[int, int], extras: Extras) -> Chain:
        """Return the chain for a size, kept until another is needed."""
        if self._chain is None or self._size != size or not is_same(self._extras, extras):
            self._chain = None
            chain = Chain(self.device)
            image = chain.array("image", 3 * size[0] * size[1])
            if self.reduction is None:
                self._add_matching(chain, image, size)
            else:
                small = add_reduced(chain, image, size, self.reduction)
                self._add_matching(chain, small, self.reduction.size_px[::-1])
                add_upsampled(chain, image, small, size, self.reduction, self.method.config.views.guide_range)
            add_extras(chain, image, size, extras)
            self._chain, self._size, self._extras = chain, size, extras
        return self._chain

    def _add_matching(self, chain: Chain, image: Array, size: tuple[int, int]) -> None:
        if isinstance(self.method, RealTimeMethod):
            add_real_time(chain, image, size, self.method)
        else:
            add_paper(chain, image, size, self.method)


@dataclass
class DeviceMethod(Method):
    """A method on a device as long as that works, else on the CPU."""

    on_gpu: OnDevice
    on_cpu: Method
    may_fall_back: bool  # nobody asked for the device by name: its errors are not the caller's concern
    has_failed: bool = False

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3)."""
        return self.start(image).result().disparity

    def start(self, image: np.ndarray, extras: Extras = NO_EXTRAS) -> Pending[Measured]:
        """Send an image (H, W, 3) to the device, which computes it while another is read back.

        At most two are under way, to be awaited in turn. The CPU begins when it is waited for.
        """
        pending: Pending[Measured] | None = None
        if not self.has_failed:
            try:
                pending = self.on_gpu.start(image, extras)
            except (DeviceError, OutOfMemoryError) as error:
                self.fall_back(error)

        def result() -> Measured:
            if pending is not None:
                try:
                    return pending.result()
                except (DeviceError, OutOfMemoryError) as error:
                    self.fall_back(error)
            return Measured(self.on_cpu.match(image))

        return Pending(result)

    @property
    def can_pipeline(self) -> bool:
        """Whether `start` computes a photograph while the one before is read back."""
        return True

    @property
    def makes_extras(self) -> bool:
        """Whether `start` makes what is asked for besides the disparity."""
        return self.on_gpu.makes_extras and not self.has_failed

    def fall_back(self, error: ChromapertureError) -> None:
        """Go on with the CPU, which is said once, or raise the error."""
        if not self.may_fall_back:
            raise error
        if not self.has_failed:
            warnings.warn(f"{error}; measuring on the CPU from here on", CaptureWarning, stacklevel=4)
        self.has_failed = True


def chosen_device(choice: str) -> Device | None:
    """Return the device of ``auto``, ``cpu``, ``gpu`` or ``gpu:NAME``; None is the CPU.

    ``auto`` takes a real device where there is one, never a rasteriser in software. Raises DeviceError and
    MissingDependencyError for the last two only.
    """
    if choice == "cpu":
        return None
    if choice == "gpu" or choice.startswith("gpu:"):
        return open_device(choice)
    if choice != "auto":
        raise InputError(
            f"unknown device {choice!r}: choose auto, cpu, gpu or gpu:NAME, see 'chromaperture info --devices'"
        )
    found = adapters()
    if not found or found[0].is_software:
        return None
    try:
        return open_device("gpu")
    except DeviceError as error:
        warnings.warn(f"{error}; measuring on the CPU", CaptureWarning, stacklevel=3)
        return None


def on_device(method: Method, choice: str, note: Callable[[str], None], *, pixels: int = 0) -> Method:
    """Return a method on the device of a choice, where the device can run it.

    ``note`` is called with one line where a device was asked for and the CPU is taken, or where it is software. Where
    the device has no array for a photograph's ``pixels``, the CPU reduces it to the working scale.
    """
    if isinstance(method, ScaledMethod):
        matching = on_device(method.method, choice, note)
        if not isinstance(matching, DeviceMethod):
            return method
        too_large = 12 * pixels > matching.on_gpu.device.largest_bytes  # three floats a pixel
        if too_large or not isinstance(matching.on_gpu, GpuMethod):
            return replace(method, method=matching)
        on_gpu = replace(matching.on_gpu, reduction=Reduction(method.size_px, guide_weights(method.aperture)))
        return DeviceMethod(on_gpu, method, matching.may_fall_back)
    asked_for = choice not in ("auto", "cpu")
    opened: Callable[[Device], OnDevice]
    if isinstance(method, RealTimeMethod) or (isinstance(method, PaperMethod) and runs_on_device(method.config)):
        opened = partial(GpuMethod, method)
    elif isinstance(method, AccurateMethod) and not method.config.spectral.dual_pixel:
        opened = partial(AccurateOnDevice, method)
    else:
        if asked_for:
            chosen_device(choice)  # a device that does not exist is refused all the same
            note("scores debiased or weighted by texture, and half pixels, run on the CPU: the GPU has no such stages")
        return method
    device = chosen_device(choice)
    if device is None:
        return method
    if device.info.is_software:
        note(f"{device.info.name} is software: slower than --device cpu")
    return DeviceMethod(opened(device), method, not asked_for)


def device_method(method: Method) -> DeviceMethod | None:
    """Return the part of a method that works on a device; None where there is none."""
    inner = method.method if isinstance(method, ScaledMethod) else method
    return inner if isinstance(inner, DeviceMethod) else None

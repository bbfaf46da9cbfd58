"""A method on a device: chains for the sizes of picture it has seen, and the way back to the CPU."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from chromaperture.config import MatcherConfig, PaperConfig, RealTimeConfig
from chromaperture.disparity.accurate import AccurateMethod
from chromaperture.disparity.gpu.accurate_chain import AccurateOnDevice
from chromaperture.disparity.gpu.alignment_stage import Alignment, add_alignment
from chromaperture.disparity.gpu.conversion_stage import Conversion, add_conversion
from chromaperture.disparity.gpu.device import Array, Chain, Device, DeviceError, Ticket, adapters, open_device
from chromaperture.disparity.gpu.paper_chain import add_paper, runs_on_device
from chromaperture.disparity.gpu.real_time_chain import add_real_time
from chromaperture.disparity.gpu.view_stages import check_stats
from chromaperture.disparity.gpu.working_stages import Reduction, add_reduced, add_upsampled
from chromaperture.disparity.labels import IDENTITY, LabelMap
from chromaperture.disparity.paper import PaperMethod
from chromaperture.disparity.real_time import RealTimeMethod
from chromaperture.disparity.result import Disparity, Method
from chromaperture.disparity.views import ViewSpace, guide_weights
from chromaperture.disparity.working_scale import ScaledMethod
from chromaperture.errors import CaptureWarning, ChromapertureError, InputError, OutOfMemoryError

_MAPS = ("disparity", "sigma", "confidence")
_MILLIMETRES = ("depth_mm", "sigma_mm")
_COLOR = "color"


class Further(NamedTuple):
    """What a device makes of a disparity where it is asked to."""

    conversion: Conversion | None = None
    alignment: Alignment | None = None


class Measured(NamedTuple):
    """Disparity, and what was asked for besides.

    Attributes
    ----------
    disparity : Disparity
    depth_mm, sigma_mm : (H, W) float32, mm, or None
    color : (H, W, 3) float32, or None
        Aligned and white balanced.
    """

    disparity: Disparity
    depth_mm: np.ndarray | None = None
    sigma_mm: np.ndarray | None = None
    color: np.ndarray | None = None


_NOTHING = Further()


class Started(NamedTuple):
    """A photograph under way: what computes it, and its (H, W)."""

    chain: Chain
    ticket: Ticket
    size: tuple[int, int]


@dataclass
class GpuMethod:
    """A method whose stages run on a device; not for two threads at a time but safe from them.

    Attributes
    ----------
    config : MatcherConfig
        `RealTimeConfig` or `PaperConfig`.
    space : ViewSpace
    label_map : LabelMap
    device : Device
    reduction : Reduction or None
        Where reduced pictures are matched; the other attributes are then those of their camera.
    """

    config: MatcherConfig
    space: ViewSpace
    label_map: LabelMap
    device: Device
    reduction: Reduction | None = None
    _chain: Chain | None = None
    _key: tuple[object, ...] = ()
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3); raises DeviceError, OutOfMemoryError besides InputError."""
        return self.measure(image).disparity

    def measure(self, image: np.ndarray, further: Further = _NOTHING) -> Measured:
        """Return the disparity, and what else is asked for, of an image (H, W, 3)."""
        with self._lock:
            return self._finished(self._started(image, further))

    def start(self, image: np.ndarray, further: Further = _NOTHING) -> Started:
        """Send an image (H, W, 3) to the device, which begins; at most two are under way, `finish` them in turn."""
        with self._lock:
            return self._started(image, further)

    def finish(self, started: Started) -> Measured:
        """Return what `measure` would have returned."""
        with self._lock:
            return self._finished(started)

    def _started(self, image: np.ndarray, further: Further) -> Started:
        size = (image.shape[0], image.shape[1])
        outputs = [*_MAPS, "stats", *(_MILLIMETRES if further.conversion is not None else ())]
        outputs += [] if further.alignment is None else [_COLOR]
        with self._freed_on_failure():
            chain = self._composed(size, further)
            return Started(chain, chain.start({"image": image}, outputs), size)

    def _finished(self, started: Started) -> Measured:
        with self._freed_on_failure():
            found = started.chain.finish(started.ticket)
        check_stats(found["stats"], len(self.space.rows))
        color = found.pop(_COLOR).reshape(*started.size, 3) if _COLOR in found else None
        maps = {name: values.reshape(started.size) for name, values in found.items() if name != "stats"}
        disparity = Disparity(*(maps[name] for name in _MAPS))
        depth_mm, sigma_mm = (maps.get(name) for name in _MILLIMETRES)
        return Measured(disparity, depth_mm, sigma_mm, color)

    @contextmanager
    def _freed_on_failure(self) -> Iterator[None]:
        try:
            yield
        except (DeviceError, OutOfMemoryError):
            self._chain = None  # gives its memory back
            raise

    def _composed(self, size: tuple[int, int], further: Further) -> Chain:
        """Return the chain for a size, kept until another is needed."""
        key = (size, *further)
        if self._chain is None or self._key[0] != size or not same(self._key[1:], further):
            self._chain = None
            chain = Chain(self.device)
            image = chain.array("image", 3 * size[0] * size[1])
            if self.reduction is None:
                self._add_matching(chain, image, size)
            else:
                small = add_reduced(chain, image, size, self.reduction)
                self._add_matching(chain, small, self.reduction.size_px[::-1])
                add_upsampled(chain, image, small, size, self.reduction, self.config.views.guide_range)
            if further.conversion is not None:
                add_conversion(chain, chain.arrays["disparity"], chain.arrays["sigma"], further.conversion)
            if further.alignment is not None:
                add_alignment(chain, image, chain.arrays["disparity"], size, further.alignment)
            self._chain, self._key = chain, key
        return self._chain

    def _add_matching(self, chain: Chain, image: Array, size: tuple[int, int]) -> None:
        if isinstance(self.config, RealTimeConfig):
            add_real_time(chain, image, size, self.config, self.space, self.label_map)
        elif isinstance(self.config, PaperConfig):
            add_paper(chain, image, size, self.config, self.space)
        else:
            raise TypeError(type(self.config).__name__)


def same(one: tuple[object, ...], other: tuple[object, ...]) -> bool:
    """Whether two tuples hold the same objects."""
    return all(a is b for a, b in zip(one, other, strict=True))


class Waiting(NamedTuple):
    """A photograph that is to be measured, and where the device has begun what it is doing."""

    image: np.ndarray
    started: Started | None = None


@dataclass
class DeviceMethod:
    """A method on a device as long as that works, else on the CPU.

    Attributes
    ----------
    on_gpu : GpuMethod or AccurateOnDevice
    on_cpu : Method
        Takes over, with one warning, where ``may_fall_back``.
    may_fall_back : bool
        Whether nobody asked for the device by name: then an error of the device is not the caller's concern.
    """

    on_gpu: GpuMethod | AccurateOnDevice
    on_cpu: Method
    may_fall_back: bool
    has_failed: bool = False

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3)."""
        return self.measure(image).disparity

    def measure(self, image: np.ndarray, further: Further = _NOTHING) -> Measured:
        """Return the disparity of an image, and its depth where the device made it."""
        return self.finish(self.start(image, further))

    def start(self, image: np.ndarray, further: Further = _NOTHING) -> Waiting:
        """Send an image (H, W, 3) to the device where it can compute while another is read back.

        At most two are under way; `finish` them in turn. What runs on the CPU, or goes to the device and back in parts,
        begins when it is finished.
        """
        if self.has_failed or isinstance(self.on_gpu, AccurateOnDevice):
            return Waiting(image)
        try:
            return Waiting(image, self.on_gpu.start(image, further))
        except (DeviceError, OutOfMemoryError) as error:
            self.fall_back(error)
            return Waiting(image)

    def finish(self, waiting: Waiting) -> Measured:
        """Return what `measure` would have returned."""
        try:
            if waiting.started is not None and isinstance(self.on_gpu, GpuMethod):
                return self.on_gpu.finish(waiting.started)
            if not self.has_failed and isinstance(self.on_gpu, AccurateOnDevice):  # the rest: `further_maps.py`
                return Measured(self.on_gpu.match(waiting.image))
        except (DeviceError, OutOfMemoryError) as error:
            self.fall_back(error)
        return Measured(self.on_cpu.match(waiting.image))

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

    Parameters
    ----------
    method : Method
        For the CPU.
    choice : str
        As `chosen_device`.
    note : callable
        Called with one line where a device was asked for and the CPU is taken, or the device is software.
    pixels : int
        Of a photograph. Where the device has no array for it the CPU reduces it to the working scale.
    """
    if isinstance(method, ScaledMethod):
        matching = on_device(method.method, choice, note)
        if not isinstance(matching, DeviceMethod):
            return method
        on_gpu = matching.on_gpu
        if isinstance(on_gpu, AccurateOnDevice) or 12 * pixels > on_gpu.device.largest_bytes:  # three floats a pixel
            return replace(method, method=matching)
        on_gpu = replace(on_gpu, reduction=Reduction(method.size_px, guide_weights(method.aperture)))
        return DeviceMethod(on_gpu, method, matching.may_fall_back)
    asked_for = choice not in ("auto", "cpu")
    opened: Callable[[Device], GpuMethod | AccurateOnDevice]
    if isinstance(method, PaperMethod) and runs_on_device(method.config):
        opened = partial(GpuMethod, method.config, method.space, IDENTITY)
    elif isinstance(method, RealTimeMethod):
        opened = partial(GpuMethod, method.config, method.space, method.label_map)
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
        note(f"{device.info.name} is software: slower than --device cpu, with the same results")
    return DeviceMethod(opened(device), method, not asked_for)


def device_method(method: Method) -> DeviceMethod | None:
    """Return the part of a method that works on a device; None where there is none."""
    inner = method.method if isinstance(method, ScaledMethod) else method
    return inner if isinstance(inner, DeviceMethod) else None

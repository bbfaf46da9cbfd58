"""One device and the chains of stages that run on it: the only module that speaks to ``wgpu``.

How a stage is dispatched: a `Chain` is a list of dispatches over named arrays of 32-bit numbers on the device. It is
composed once for a size of picture and then run for every frame::

    chain = Chain(open_device("gpu"))
    image = chain.array("image", height * width * 3)           # float32 unless told otherwise; kept from frame to frame
    field = chain.constant("field", values)                    # goes up once, here
    depth = chain.array("depth", height * width)
    chain.add("enlarge", [image, field, depth], width * height, width=width, height=height, jump=1.0)
    maps = chain.run({"image": picture}, ["depth"])             # up, all dispatches as one submission, down

The section ``enlarge`` of a ``.wgsl`` file has the stage, see ``shader_text.py``. Its source is preceded by ``const
width = 960u;`` for every keyword (int becomes u32, float f32, a sequence of floats an array); the arrays are its
bindings 0, 1, 2 ... of group 0, in order. A stage may bind eight arrays, use 16 KB of shared memory and 256 invocations
a workgroup, because every implementation has these. Dispatches run in the order in which they were added, each sees
what those before it wrote, and nothing returns to the CPU in between: what depends on the picture (means, percentiles)
stays in arrays.
"""

from __future__ import annotations

import importlib.util
import logging
import math
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np

from chromaperture.matching.device.shader_text import shader
from chromaperture.matching.result import Pending
from chromaperture.system.errors import InputError, MissingDependencyError, OutOfMemoryError
from chromaperture.system.threads import submit

GROUP = 64  # invocations of a workgroup of the stages that have one for every pixel
MOST_GROUPS = 65_535  # workgroups along an axis of a dispatch: WebGPU's default limit
MOST_BINDINGS = 8  # arrays of a stage: WebGPU's default limit
# Real devices first; within a kind those that wgpu names first. A rasteriser in software is the last choice.
_KINDS = {"DiscreteGPU": 0, "IntegratedGPU": 1, "VirtualGPU": 2, "Unknown": 3, "CPU": 4}
_RAISED = ("max-storage-buffer-binding-size", "max-buffer-size")  # to all that the adapter has: default 128 MB
_SLOTS = 2  # frames under way: one is computed while another is read back
_LARGEST_BYTES = 128 * 2**20  # of an array in a browser: the default limit of WebGPU
Exchange = Literal["quad", "shared"]  # see `PlannedChain`


def groups_for(invocations: int, size: int = GROUP) -> tuple[int, int]:
    """Return workgroups along x and y for so many invocations, as `indexing` in ``common.wgsl`` numbers those of 64."""
    groups = max(1, -(-invocations // size))
    across = min(groups, MOST_GROUPS)
    return across, -(-groups // across)


def dispatch_size(stage: str, array_count: int, groups: Sequence[float]) -> tuple[int, int, int]:
    """Return workgroups along x, y, z, rounded up; raises InputError where WebGPU's limits do not allow a stage."""
    x, y, z = (max(1, math.ceil(g)) for g in (*groups, 1, 1)[:3])
    if max(x, y, z) > MOST_GROUPS or array_count > MOST_BINDINGS:
        raise InputError(f"stage {stage}: {(x, y, z)} workgroups, {array_count} arrays; the picture is too large")
    return x, y, z


class DeviceError(InputError):
    """There is no such device, or it failed while it worked; the same can be computed by the CPU."""


class AdapterInfo(NamedTuple):
    """What ``info --devices`` shows of an adapter."""

    name: str
    kind: str  # DiscreteGPU, IntegratedGPU, VirtualGPU, CPU, Unknown
    backend: str  # Vulkan, Metal, D3D12
    driver: str
    largest_array_mb: int
    subgroups: bool

    @property
    def is_software(self) -> bool:
        """Whether it is the CPU in disguise."""
        return self.kind == "CPU"


class Array(NamedTuple):
    """An array of 32-bit numbers on a device."""

    name: str
    buffer: Any
    size: int
    dtype: np.dtype
    is_constant: bool = False


@dataclass(frozen=True, eq=False)
class Dispatch:
    """A stage over its arrays."""

    stage: str
    source: str
    groups: tuple[int, int, int]
    arrays: tuple[Array, ...]
    constants: Mapping[str, Any]
    device: Device
    pipeline: Callable[[], Any] | None  # waits for the compiled shader; None: nothing is compiled here

    @cached_property
    def bound(self) -> tuple[Any, Any]:
        """The pipeline and its arrays, for the device."""
        assert self.pipeline is not None
        entries = [
            {"binding": i, "resource": {"buffer": a.buffer, "offset": 0, "size": a.buffer.size}}
            for i, a in enumerate(self.arrays)
        ]
        with device_errors(self.device.info.name):
            pipeline = self.pipeline()
            layout = pipeline.get_bind_group_layout(0)
            return pipeline, self.device.handle.create_bind_group(layout=layout, entries=entries)


@dataclass
class Device:
    """An adapter in use, with the pipelines made for it."""

    info: AdapterInfo
    handle: Any  # wgpu.GPUDevice; None: elsewhere, in a browser
    subgroups: bool  # whether stages may use operations of subgroups
    timestamps: bool  # whether they can be timed
    largest_bytes: int  # of one array
    pipelines: dict[str, Callable[[], Any]] = field(default_factory=dict)

    def pipeline(self, source: str) -> Callable[[], Any]:
        """Begin to compile a shader, each once; what is returned waits for it, and raises DeviceError."""

        def made() -> Any:
            with device_errors(self.info.name):
                module = self.handle.create_shader_module(code=source)
                compute = {"module": module, "entry_point": "main"}
                return self.handle.create_compute_pipeline(layout="auto", compute=compute)

        if source not in self.pipelines:
            self.pipelines[source] = submit(made)  # a driver took 5 s for 122: docs/gpu.md
        return self.pipelines[source]


class Chain:
    """Arrays on a device and the stages that run over them."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.arrays: dict[str, Array] = {}
        self.dispatches: list[Dispatch] = []
        self._readback: list[tuple[Any, int]] = [(None, 0)] * _SLOTS
        self._next = 0

    def array(self, name: str, size: int, dtype: type = np.float32) -> Array:
        """Make an array of so many 32-bit numbers, zero at first; raises OutOfMemoryError."""
        bytes_ = 4 * max(int(size), 4)
        if bytes_ > self.device.largest_bytes:
            raise OutOfMemoryError(
                f"{self.device.info.name}: array {name!r} of {bytes_ / 1e6:.0f} MB is larger than the device's "
                f"{self.device.largest_bytes / 1e6:.0f} MB; use --device cpu, or --scale 1/2"
            )
        wgpu = _wgpu()
        usage = wgpu.BufferUsage.STORAGE | wgpu.BufferUsage.COPY_DST | wgpu.BufferUsage.COPY_SRC
        with device_errors(self.device.info.name):
            buffer = self.device.handle.create_buffer(label=name, size=bytes_, usage=usage)
        self.arrays[name] = Array(name, buffer, int(size), np.dtype(dtype))
        return self.arrays[name]

    def constant(self, name: str, values: np.ndarray) -> Array:
        """Make an array with values, which go up once; float32, int32 or uint32 as given, else float32."""
        values = np.asarray(values)
        dtype = values.dtype if values.dtype in (np.int32, np.uint32) else np.dtype(np.float32)
        values = np.ascontiguousarray(values, dtype)
        made = self.array(name, values.size, dtype.type)._replace(is_constant=True)
        self.arrays[name] = made
        self.write(made, values)
        return made

    def write(self, array: Array, values: np.ndarray) -> None:
        """Send values to an array; raises InputError when they do not fit."""
        values = np.ascontiguousarray(values, array.dtype)
        if values.size != array.size:
            raise InputError(f"{array.name}: {values.size} values for an array of {array.size}")
        with device_errors(self.device.info.name):
            self.device.handle.queue.write_buffer(array.buffer, 0, values)

    def add(
        self,
        stage: str,
        arrays: Sequence[Array],
        invocations: int = 0,
        *,
        groups: Sequence[float] | None = None,
        uses: Sequence[str] = (),
        **constants: Any,
    ) -> None:
        """Append a stage.

        ``stage``: a section of a ``.wgsl`` file; ``arrays``: bindings 0, 1, 2 ... of group 0; each once;
        ``invocations``: at least so many, in workgroups of 64; ``groups``: workgroups along x, y, z, rounded up, where
        they are others; ``uses``: sections besides those that the stage's names; ``constants``: named constants of the
        shader.
        """
        count = dispatch_size(stage, len(arrays), groups or groups_for(invocations))
        source = shader(stage, uses, constants)
        pipeline = self.device.pipeline(source) if self.device.handle is not None else None
        self.dispatches.append(Dispatch(stage, source, count, tuple(arrays), constants, self.device, pipeline))

    def run(self, inputs: Mapping[str, np.ndarray], outputs: Sequence[str]) -> dict[str, np.ndarray]:
        """Send the inputs, run all stages and return the outputs, flat; raises DeviceError, OutOfMemoryError."""
        return self.start(inputs, outputs).result()

    def start(self, inputs: Mapping[str, np.ndarray], outputs: Sequence[str]) -> Pending[dict[str, np.ndarray]]:
        """Begin a frame, whose outputs are read back in one copy: at most two are under way, to be awaited in turn."""
        for name, values in inputs.items():
            self.write(self.arrays[name], values)
        down = [self.arrays[name] for name in outputs]
        slot, self._next = self._next, (self._next + 1) % _SLOTS
        with device_errors(self.device.info.name):
            encoder = self.device.handle.create_command_encoder()
            one_pass = encoder.begin_compute_pass()
            for dispatch in self.dispatches:
                encode(one_pass, dispatch)
            one_pass.end()
            staging, offset = self._staging(slot, down), 0
            for array in down:
                encoder.copy_buffer_to_buffer(array.buffer, 0, staging, offset, 4 * array.size)
                offset += 4 * array.size
            self.device.handle.queue.submit([encoder.finish()])
        return Pending(lambda: self._read(staging, down))

    def _read(self, staging: Any, down: Sequence[Array]) -> dict[str, np.ndarray]:
        """Wait for a frame and return its outputs, flat."""
        wgpu = _wgpu()
        found, offset = {}, 0
        with device_errors(self.device.info.name):
            staging.map_sync(wgpu.MapMode.READ)
            try:
                mapped = staging.read_mapped(0, staging.size, copy=False)
                for array in down:
                    # A copy: the memory goes back to the device.
                    found[array.name] = np.frombuffer(mapped, array.dtype, array.size, offset).copy()
                    offset += 4 * array.size
                del mapped
            finally:
                staging.unmap()
        return found

    @property
    def device_bytes(self) -> int:
        """Memory of all arrays."""
        return sum(array.buffer.size for array in self.arrays.values())

    def _staging(self, slot: int, down: Sequence[Array]) -> Any:
        wgpu, size = _wgpu(), 4 * sum(array.size for array in down)
        if self._readback[slot][1] != size:
            usage = wgpu.BufferUsage.MAP_READ | wgpu.BufferUsage.COPY_DST
            self._readback[slot] = self.device.handle.create_buffer(size=size, usage=usage), size
        return self._readback[slot][0]


def encode(one_pass: Any, dispatch: Dispatch) -> None:
    """Append a stage to a pass."""
    pipeline, bindings = dispatch.bound
    one_pass.set_pipeline(pipeline)
    one_pass.set_bind_group(0, bindings)
    one_pass.dispatch_workgroups(*dispatch.groups)


def has_extra() -> bool:
    """Whether the extra ``gpu`` is installed."""
    return importlib.util.find_spec("wgpu") is not None


def adapters() -> list[AdapterInfo]:
    """Return all adapters, real devices first; empty without the extra or without a driver."""
    return [info for info, _ in _found_adapters()]


@lru_cache(maxsize=4)
def open_device(choice: str = "gpu") -> Device:
    """Open a device, once in a process; raises MissingDependencyError, DeviceError.

    ``gpu`` takes the first real device, else a rasteriser in software; ``gpu:NAME`` the first whose name contains NAME,
    upper or lower case.
    """
    _wgpu()
    found = _found_adapters()
    if not found:
        raise DeviceError(
            "no GPU found: install a Vulkan driver (Debian: mesa-vulkan-drivers has those of AMD, Intel and software), "
            "or use --device cpu"
        )
    wanted = choice.partition(":")[2].strip().lower()
    fitting = [pair for pair in found if wanted in pair[0].name.lower()]
    if not fitting:
        names = ", ".join(info.name for info, _ in found)
        raise DeviceError(f"no GPU named {wanted!r}: this machine has {names}; see 'chromaperture info --devices'")
    return _opened(*fitting[0])


def _opened(info: AdapterInfo, adapter: Any) -> Device:
    features = [name for name in ("subgroup", "timestamp-query") if name in adapter.features]
    limits = {name: adapter.limits[name] for name in _RAISED}
    with device_errors(info.name):
        handle = adapter.request_device_sync(required_features=features, required_limits=limits)
    largest = min(limits.values())
    return Device(info, handle, "subgroup" in features, "timestamp-query" in features, int(largest))


@lru_cache(maxsize=1)
def _found_adapters() -> list[tuple[AdapterInfo, Any]]:
    try:
        wgpu = _wgpu()
        # A Linux driver that looks for a display complains to standard error where this is not set.
        os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())
        with ExitStack() as after:  # without wgpu's message about every driver that it cannot load
            after.callback(wgpu.logger.setLevel, wgpu.logger.level)
            wgpu.logger.setLevel(logging.CRITICAL)
            found = list(wgpu.gpu.enumerate_adapters_sync())
    except (MissingDependencyError, RuntimeError, OSError):
        return []
    known = [(_info(adapter), adapter) for adapter in found if adapter.info["backend_type"] != "OpenGL"]
    return sorted(known, key=lambda pair: _KINDS.get(pair[0].kind, 3))  # sorted() keeps the order within a kind


def _info(adapter: Any) -> AdapterInfo:
    about, limits = adapter.info, adapter.limits
    return AdapterInfo(
        about["device"] or about["description"] or "unnamed",
        about["adapter_type"],
        about["backend_type"],
        about["description"],
        min(limits[name] for name in _RAISED) // 1_000_000,
        "subgroup" in adapter.features,
    )


@lru_cache(maxsize=1)
def _wgpu() -> Any:
    try:
        import wgpu
        from wgpu.backends.wgpu_native.extras import set_instance_extras
    except ImportError as error:
        raise MissingDependencyError(f"a GPU needs the extra: pip install 'chromaperture[gpu]' ({error})") from None
    # Not OpenGL: it lacks storage that compute shaders need, and looking for it writes to standard error.
    with suppress(RuntimeError):  # somebody else in this process was first
        set_instance_extras(backends=["Vulkan", "Metal", "DX12"])
    return wgpu


@contextmanager
def device_errors(name: str) -> Iterator[None]:
    """Turn errors of ``wgpu`` into one line: memory, a lost device, or what it says."""
    try:
        yield
    except Exception as error:
        kind, said = type(error).__name__, " ".join(str(error).split())
        if not kind.startswith("GPU") and not isinstance(error, RuntimeError):
            raise
        if "out of memory" in said.lower() or kind == "GPUOutOfMemoryError":
            raise OutOfMemoryError(f"{name}: not enough device memory; use --device cpu, or --scale 1/2") from error
        if "lost" in said.lower():
            raise DeviceError(f"{name} was lost while it worked; use --device cpu, or start again") from error
        raise DeviceError(f"{name} failed: {said[:300]}") from error


class PlannedChain(Chain):
    """A chain that is written down instead of run, for a browser: `Chain.run` and `Chain.start` do not work.

    ``exchange`` {"quad", "shared"}: whether the device has subgroups: how invocations that share a path exchange their
    least cost.
    """

    def __init__(self, exchange: Exchange) -> None:
        info = AdapterInfo(
            "a browser's device", "Unknown", "WebGPU", "", _LARGEST_BYTES // 1_000_000, exchange == "quad"
        )
        super().__init__(Device(info, None, exchange == "quad", False, _LARGEST_BYTES))
        self.values: dict[str, np.ndarray] = {}  # of the constant arrays, flat, by name

    def array(self, name: str, size: int, dtype: type = np.float32) -> Array:
        """Name an array of so many 32-bit numbers."""
        self.arrays[name] = Array(name, None, int(size), np.dtype(dtype))
        return self.arrays[name]

    def write(self, array: Array, values: np.ndarray) -> None:
        """Keep the values of a constant."""
        self.values[array.name] = np.ascontiguousarray(values, array.dtype).ravel()


def stage_times_ms(chain: Chain, inputs: Mapping[str, np.ndarray]) -> list[tuple[str, float]]:
    """Run all stages of a chain, each timed by the device; raises DeviceError where it keeps no time."""
    times = pass_times_ms(chain, inputs, [[one] for one in chain.dispatches])
    return [(one.stage, ms) for one, ms in zip(chain.dispatches, times, strict=True)]


def pass_times_ms(chain: Chain, inputs: Mapping[str, np.ndarray], passes: Sequence[Sequence[Dispatch]]) -> list[float]:
    """Run stages in passes, each timed by the device from its first stage to its last; raises DeviceError."""
    device = chain.device
    if not device.timestamps:
        raise DeviceError(f"{device.info.name} keeps no timestamps")
    import wgpu

    count = 2 * len(passes)
    for name, values in inputs.items():
        chain.write(chain.arrays[name], values)
    with device_errors(device.info.name):
        queries = device.handle.create_query_set(type=wgpu.QueryType.timestamp, count=count)
        usage = wgpu.BufferUsage.QUERY_RESOLVE | wgpu.BufferUsage.COPY_SRC
        resolved = device.handle.create_buffer(size=8 * count, usage=usage)
        encoder = device.handle.create_command_encoder()
        for i, dispatches in enumerate(passes):
            places = {"beginning_of_pass_write_index": 2 * i, "end_of_pass_write_index": 2 * i + 1}
            one_pass = encoder.begin_compute_pass(timestamp_writes={"query_set": queries, **places})
            for dispatch in dispatches:
                encode(one_pass, dispatch)
            one_pass.end()
        encoder.resolve_query_set(queries, 0, count, resolved, 0)
        device.handle.queue.submit([encoder.finish()])
        ticks = np.frombuffer(device.handle.queue.read_buffer(resolved), np.uint64).astype(float)
    return [float(ms) for ms in (ticks[1::2] - ticks[0::2]) / 1e6]

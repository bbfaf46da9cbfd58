"""Quality "accurate" on a device and by Numba, stage by stage: processor time of both in one run.

    LP_NUM_THREADS=1 python benchmarks/gpu_profile.py [--sample still_life_cy_open] [--size 360x240] [--shaders]

For rasterisers in software only, whose time is the processor's: of a real GPU it would count the waiting. The depths
are compared before anything is timed. Every dispatch is waited for alone, and functions of the CPU count without those
of the list that they call.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np

from chromaperture.matching.device.accurate_chain import AccurateOnDevice
from chromaperture.matching.device.device import Chain, Dispatch, open_device
from chromaperture.products.samples import open_sample
from chromaperture.system.threads import limited_threads

LEAST_AGREEING, DEPTH_TOLERANCE = 0.995, 1e-3


class Stage(NamedTuple):
    """Dispatches of the device, and MODULE:NAME or MODULE:CLASS.NAME of the CPU."""

    device: tuple[str, ...]
    cpu: tuple[str, ...]


STAGES = {
    "spectra of tiles": Stage(
        ("gaussian_line:shading", "tile_rows", "tile_columns", "tile_smoothing", "tile_signal"),
        ("stages.tiles:Nodes.spectra", "stages.tiles:without_shading"),
    ),
    "transfer functions": Stage(("point_rows", "point_columns"), ("cpu:point_transforms",)),
    "P and Q": Stage(
        ("pair_spectra", "cross_columns", "cross_rows", "tiles_joined"),
        ("cpu:cross_filter",),
    ),
    "bands and windows": Stage(
        ("bands_rows", "bands_columns", "band_products", "gaussian_line:products", "band_correlation"),
        ("cpu:band_correlation", "blur_evidence:BlurEvidence._correlate"),
    ),
    "labels": Stage(
        ("pair_evidence", "labels_of_samples", "labels_between"),
        (
            "cpu:read_at_labels", "blur_evidence:with_midpoints", "blur_evidence:_nats",
            "spectral_evidence:_add_enlarged",
        ),
    ),
    "likelihood of all channels": Stage(
        ("window_rows", "window_spectra", "spectral_likelihood", "slope_evidence", "slope_shares", "window_labels"),
        (
            "spectral_evidence:SpectralEvidence.at_windows", "spectral_evidence:_at_labels",
            "spectral_evidence:_tempered",
        ),
    ),
    "paths": Stage(("volume_paths",), ("cpu:aggregate_paths",)),
    "place between layers": Stage(
        ("volume_winner", "layer_tangents", "layer_offsets", "gaussian_line:tangents"),
        ("accurate:least_cost", "stages.between_layers:between_layers"),
    ),
    "posterior": Stage(("volume_posterior",), ("cpu:posterior",)),
    "sums of blocks": Stage(("block_sums",), ("block_surface:block_sums",)),
    "regions, plate and error bar, on the CPU in both": Stage((), ("accurate:explained_surface",)),
}  # fmt: skip


class Clock:
    """Processor time of functions without that of the functions inside."""

    def __init__(self) -> None:
        self.taken_ms: dict[str, float] = defaultdict(float)
        self.running: list[float] = []

    def timed(self, name: str, work: Callable[[], Any]) -> Any:
        self.running.append(0.0)
        begin = time.process_time()
        result = work()
        taken = time.process_time() - begin
        self.taken_ms[name] += 1e3 * (taken - self.running.pop())
        if self.running:
            self.running[-1] += taken
        return result

    def watch(self, path: str, name: str) -> None:
        """Replace a function, wherever it was imported, by one that is timed."""
        module_name, _, attribute = path.partition(":")
        module = importlib.import_module(f"chromaperture.matching.{module_name}")
        *owners, attribute = attribute.split(".")
        owner = getattr(module, owners[0]) if owners else module
        original = getattr(owner, attribute)

        @functools.wraps(original)
        def replacement(*args: Any, **options: Any) -> Any:
            return self.timed(name, lambda: original(*args, **options))

        setattr(owner, attribute, replacement)
        for other in list(sys.modules.values()):
            ours = not owners and getattr(other, "__name__", "").startswith("chromaperture")
            if ours and getattr(other, attribute, None) is original:
                setattr(other, attribute, replacement)


def named(dispatch: Dispatch) -> str:
    """Name of a dispatch's stage; a filter's with what it filters."""
    if dispatch.stage != "gaussian_line":
        return dispatch.stage
    return f"gaussian_line:{dispatch.arrays[1].name.removeprefix('taps_of_')}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sample", default="still_life_cy_open")
    parser.add_argument("--size", default="360x240")
    parser.add_argument("--device", default="gpu")
    parser.add_argument("--shaders", action="store_true", help="each shader's time besides")
    arguments = parser.parse_args()
    width, height = (int(side) for side in arguments.size.split("x"))
    camera, image = open_sample(arguments.sample, quality="accurate", device="cpu")
    camera, image = camera.at_size(width, height), cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    on_gpu = AccurateOnDevice(camera.method, open_device(arguments.device))
    depths = [camera.millimetres(match(image))[0] for match in (on_gpu.match, camera.method.match)]
    known = np.isfinite(depths[1])
    close = np.where(known, np.abs(depths[0] - depths[1]) <= DEPTH_TOLERANCE * depths[1], np.isnan(depths[0])).mean()
    if close < LEAST_AGREEING:
        raise SystemExit(f"only {close:.2%} of the depths agree with the CPU: nothing is timed")
    on_cpu, on_device = Clock(), Clock()
    start = Chain.start

    def one_by_one(self: Chain, inputs: Any, outputs: Any) -> Any:
        for name, values in inputs.items():
            self.write(self.arrays[name], values)
        whole = self.dispatches[:]

        def alone(dispatch: Dispatch) -> None:
            self.dispatches[:] = [dispatch]
            start(self, {}, [])
            self.device.handle.queue.read_buffer(dispatch.arrays[-1].buffer, 0, 16)  # waits

        for dispatch in whole:
            on_device.timed(named(dispatch), functools.partial(alone, dispatch))
        self.dispatches.clear()
        pending = start(self, {}, outputs)
        self.dispatches[:] = whole
        return pending

    with limited_threads(1):
        cv2.setNumThreads(1)
        begin = time.process_time()
        on_gpu.match(image)
        whole_device = time.process_time() - begin
        begin = time.process_time()
        camera.method.match(image)
        whole_cpu = time.process_time() - begin
        for name, stage in STAGES.items():
            for path in stage.cpu:
                on_cpu.watch(path, name)
        camera.method.match(image)
        numba_ms = dict(on_cpu.taken_ms)
        on_cpu.taken_ms.clear()
        Chain.start = one_by_one  # type: ignore[method-assign]
        on_gpu.match(image)
    print(f"{arguments.sample} {arguments.size}, {on_gpu.device.info.name}, agreeing {close:.4f}")
    print(f"whole: device {1e3 * whole_device:.0f} ms, Numba {1e3 * whole_cpu:.0f} ms, {whole_device / whole_cpu:.1f}")
    if arguments.shaders:
        for name, taken_ms in sorted(on_device.taken_ms.items(), key=lambda item: -item[1]):
            print(f"{name:28s} {taken_ms:10.1f}")
    print(f"\n{'stage':48s} {'device ms':>10s} {'Numba ms':>10s} {'ratio':>6s}")
    for name, stage in STAGES.items():
        device_ms = sum(on_device.taken_ms.pop(part, 0.0) for part in stage.device) or on_cpu.taken_ms.get(name, 0.0)
        cpu_ms = numba_ms.get(name, 0.0)
        print(f"{name:48s} {device_ms:10.1f} {cpu_ms:10.1f} {device_ms / max(cpu_ms, 0.1):6.1f}")
    print(f"{'others':48s} {sum(on_device.taken_ms.values()):10.1f} {1e3 * whole_cpu - sum(numba_ms.values()):10.1f}")


if __name__ == "__main__":
    main()

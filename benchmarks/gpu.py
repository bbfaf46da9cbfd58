"""The matcher on a device (WGSL) against the compiled one (Numba), and what every stage moves and computes.

    python benchmarks/gpu.py [--device gpu] [--quality real-time] [--design cy_halves] [--size 1280x720] [--json]

Nothing is timed before its output has been compared with the CPU's: a dispatch that failed is fast. Times of stages
are the device's own timestamps. On a rasteriser in software both share the same cores: only the ratio says something.

``--device none`` counts what a GPU would be given and computes nothing.

Bytes are those of the arrays that a stage binds, each once: what it must move if no cache kept anything from one stage
to the next and nothing was read twice. Operations are additions, multiplications, comparisons and square roots of the
inner loops, counted in the sources. The larger of bytes over the memory's bandwidth and operations over the arithmetic
rate is the least time that a device of these could take; `--bandwidth` and `--rate` give them (an H200: 4800 GB/s,
60 TFLOP/s by its data sheet). Steps are those that one invocation takes one after the other where the next needs the
last. `sum with latency` adds `--dispatch-us` for every dispatch and `--step-ns` for every step, which are assumptions:
nobody measured them here.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from matcher import scene

from chromaperture.matching.device.device import AdapterInfo, Chain, Device, Dispatch, pass_times_ms, stage_times_ms
from chromaperture.matching.device.gpu_method import DeviceMethod, GpuMethod, on_device
from chromaperture.matching.device.measured import NO_EXTRAS
from chromaperture.matching.estimate import method_for
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.paper import PaperMethod
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.optics.aperture import design_named
from chromaperture.settings.methods import PaperConfig, RealTimeConfig
from chromaperture.system.threads import limited_threads, thread_count

# Chosen by hand, so that a benchmark takes seconds: whole calls, the fastest counts; runs with timestamps, the median.
ROUNDS, DEVICE_ROUNDS, STAGE_ROUNDS = 6, 30, 9
WARMING_S = 1.0
AGREEING_PX, LEAST_AGREEING = 0.02, 0.97  # Numba decides otherwise where two layers are as good


def capture(design: str, width: int, height: int) -> np.ndarray:
    """The scene of `matcher.py` as the sensor sees it, (H, W, 3)."""
    from chromaperture.color.unmixing import own_film_unmixing, view_directions

    aperture = design_named(design)
    views, _, _ = scene(view_directions(aperture), shape=(height, width))
    image = np.stack(views, -1) @ np.linalg.pinv(own_film_unmixing(aperture)).T
    return (0.9 / image.max() * image).astype(np.float32)


def counting_device() -> Device:
    """A device that makes nothing, as if it were a GPU: arrays and stages of any size can be composed on it."""
    pipeline = SimpleNamespace(get_bind_group_layout=lambda group: None)
    handle = SimpleNamespace(
        create_buffer=lambda *, size, **_: SimpleNamespace(size=size),
        create_shader_module=lambda **_: None,
        create_compute_pipeline=lambda **_: pipeline,
        create_bind_group=lambda **_: None,
        queue=SimpleNamespace(write_buffer=lambda *_: None),
    )
    return Device(AdapterInfo("counting", "DiscreteGPU", "none", "", 0, True), handle, True, False, 1 << 40)


def operations(dispatch: Dispatch) -> float:
    """Operations of a stage's inner loops."""
    c: Mapping[str, Any] = dispatch.constants
    invocations = 64.0 * dispatch.groups[0] * dispatch.groups[1]
    # Steps of a block's backward and forward recursions: they start beside it.
    back, ahead = ((c["block"] + n * c["reach"] if "block" in c else 1) for n in (1, 2))
    views = c.get("view_count", c.get("views", 0))
    pairs = 3 if views == 3 else 1
    per: dict[str, Callable[[], float]] = {
        "light": lambda: 8 * c["pixels"],
        "views": lambda: 24 * invocations,
        "halve_rows": lambda: (11 * 24 + 4 * 5 * 2 * (c["view_count"] + 2)) * invocations,
        "halve_columns": lambda: 40 * invocations,
        "blur": lambda: (
            0.0 if c["sparse"] else 8 * (2 * c["reach"] + 4) * c["plane_count"] * invocations
        ),  # next to nothing is unusable
        "variance": lambda: 3 * c["view_count"] * c["pixels"],
        "guide_scale": lambda: 4 * 4 * 3 * c["sparse_count"],
        "sample_y": lambda: 7 * c["each"] * invocations,
        "sample_x": lambda: 7 * c["each"] * invocations,
        "windows_x": lambda: (6 * ahead + 8 * back) * invocations,
        "windows_y": lambda: (8 * ahead + 8 * back) * invocations,
        "products_x": lambda: 4 * pairs * (3 * ahead + 5 * back) * invocations,
        "correlation": lambda: 4 * (pairs * (5 * ahead + 5 * back) + (8 * pairs + 6) * c["block"]) * invocations,
        # Sums of a row of two cells (three views are sampled there, 7 px by four taps), and the scores of both.
        "cell_scores": lambda: (
            ((2 * c["cells_each"] + 3) * (102 if views == 2 else 192 + 168) + 2 * c["cells_each"] * 60 * pairs)
            * invocations
        ),
        "own_sign": lambda: 2 * c["all_layers"] * invocations,
        "label_likelihood": lambda: 4 * 22 * invocations,
        "four_paths": lambda: 9 * c["width"] * c["height"] * c["pitch"],
        "path_winner": lambda: 17 * c["width"] * c["height"] * c["pitch"],
        "beside_nearer": lambda: 2 * (2 * c["nearer_reach"] + 1) ** 2 * invocations,
        "links": lambda: 10 * invocations,
        "smoothing": lambda: 12 * c["width"] * c["height"] * c["map_count"],
        "surface": lambda: (2 * c["reach"] + 4) * (5 + 16) * invocations,
        "surface_range": lambda: ((2 * c["reach"] + 4) * 16 + 4 * 30) * invocations,
        "cells_enlarged": lambda: 35 * invocations,
        "enlarge": lambda: 40 * invocations,
        "running_winner": lambda: 4 * c["pixels"] * c["layer_count"],
        "peak": lambda: 30 * invocations,
        "unlike_moments": lambda: 14 * c["cell"] ** 2 * views * invocations,
        "unlike_share": lambda: 16 * c["side"] ** 2 * invocations,
    }
    return per.get(dispatch.stage, lambda: 0.0)()


def steps(dispatch: Dispatch) -> float:
    """Steps of the longest walk in which every step needs the one before."""
    c: Mapping[str, Any] = dispatch.constants
    if dispatch.stage == "four_paths":
        return float(c["width"] if c["direction"] < 2 else c["height"])
    if dispatch.stage == "smoothing":  # 32 segments of a line, each walked three times, and their sums twice
        return 3 * math.ceil((c["width"] if c["along_x"] else c["height"]) / 32) + 2 * 31
    return float(2 * c["block"] + 3 * c["reach"]) if "block" in c else 0.0  # there and back


def stages_of(chain: Chain, image: np.ndarray, *, bandwidth: float, rate: float) -> dict[str, dict[str, float]]:
    """Dispatches, bytes, operations, the model's time and the measured one of every stage."""
    times = median_times_ms(chain, {"image": image})
    found: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for dispatch, (_, ms) in zip(chain.dispatches, times, strict=True):
        count(found[dispatch.stage], dispatch, operations(dispatch), bandwidth=bandwidth, rate=rate)
        found[dispatch.stage]["steps"] += steps(dispatch)
        found[dispatch.stage]["ms"] += ms
    return found


def median_times_ms(chain: Chain, inputs: Mapping[str, np.ndarray]) -> list[tuple[str, float]]:
    """Time of every dispatch by the device's timestamps, median of several runs; 0 where it keeps none."""
    if not chain.device.timestamps:
        return [(dispatch.stage, 0.0) for dispatch in chain.dispatches]
    runs = [stage_times_ms(chain, inputs) for _ in range(1 if chain.device.info.is_software else STAGE_ROUNDS)]
    return [(runs[0][i][0], statistics.median(run[i][1] for run in runs)) for i in range(len(runs[0]))]


def warmed(work: Callable[[], object]) -> None:
    """Repeat work for a second: a GPU that idles has a low clock, and takes its time to raise it."""
    end = time.perf_counter() + WARMING_S
    while time.perf_counter() < end:
        work()


def median_time_ms(chain: Chain, inputs: Mapping[str, np.ndarray]) -> float:
    """Time from the first stage to the last by the device's timestamps, median of several runs."""
    rounds = 1 if chain.device.info.is_software else STAGE_ROUNDS
    if rounds > 1:
        warmed(lambda: pass_times_ms(chain, inputs, [chain.dispatches]))
    return statistics.median(pass_times_ms(chain, inputs, [chain.dispatches])[0] for _ in range(rounds))


def count(row: dict[str, float], dispatch: Any, computed: float, *, bandwidth: float, rate: float) -> None:
    """Add a dispatch to the figures of its stage: each array is moved once, and the slower of two limits counts."""
    moved = 4 * sum(array.size for array in {a.name: a for a in dispatch.arrays}.values())
    row["dispatches"] += 1
    row["mbytes"] += moved / 1e6
    row["mops"] += computed / 1e6
    row["model_ms"] += 1e3 * max(moved / bandwidth, computed / rate)
    row["bandwidth_ms"] += 1e3 * moved / bandwidth


def benchmark(device: str, quality: str, design: str, size: tuple[int, int], bandwidth: float, rate: float) -> dict:
    width, height = size
    image = capture(design, width, height)
    on_cpu = method_for(PaperConfig() if quality == "paper" else RealTimeConfig(), aperture=design)
    if device == "none":
        assert isinstance(on_cpu, PaperMethod | RealTimeMethod)
        label_map = on_cpu.label_map if isinstance(on_cpu, RealTimeMethod) else IDENTITY
        counted = GpuMethod(on_cpu.config, on_cpu.space, label_map, counting_device())
        chain = counted._composed((height, width), NO_EXTRAS)
        stages = stages_of(chain, image, bandwidth=bandwidth, rate=rate)
        facts = {"quality": quality, "design": design, "size": f"{width}x{height}"}
        return {**facts, "device_mbytes": round(chain.device_bytes / 1e6, 1), "stages": stages}
    both = on_device(on_cpu, device, lambda note: None)
    if not isinstance(both, DeviceMethod):
        raise SystemExit(f"--device {device} is the CPU here: see 'chromaperture info --devices'")
    found, expected = both.on_gpu.match(image).value_px, on_cpu.match(image).value_px
    unknown = np.isnan(found) & np.isnan(expected)
    agreeing = float(((np.abs(found - expected) < AGREEING_PX) | unknown).mean())
    if agreeing < LEAST_AGREEING:
        raise SystemExit(f"only {agreeing:.1%} of the pixels agree with the CPU: nothing is timed")
    best: dict[str, float] = {}
    info = both.on_gpu.device.info
    rounds = {"numba": ROUNDS, "device": ROUNDS if info.is_software else DEVICE_ROUNDS}
    with limited_threads(thread_count()):
        for name, work in (("numba", on_cpu.match), ("device", both.on_gpu.match)):
            if name == "device" and not info.is_software:
                warmed(lambda: both.on_gpu.match(image))
            for _ in range(rounds[name]):
                wall, cpu = time.perf_counter(), time.process_time()
                work(image)
                for kind, taken in (("wall", time.perf_counter() - wall), ("cpu", time.process_time() - cpu)):
                    key = f"{name}_{kind}_ms"
                    best[key] = min(best.get(key, float("inf")), 1e3 * taken)
    chain = both.on_gpu._chain
    assert chain is not None
    stages = stages_of(chain, image, bandwidth=bandwidth, rate=rate)
    if chain.device.timestamps:
        best["device_timestamps_ms"] = median_time_ms(chain, {"image": image})
    return {
        "device": info.name, "software": info.is_software,
        "quality": quality, "design": design, "size": f"{width}x{height}",
        "share_within_0.02_px_of_numba": round(agreeing, 4),
        "ratio_to_numba_wall": round(best["device_wall_ms"] / best["numba_wall_ms"], 2),
        "ratio_to_numba_cpu": round(best["device_cpu_ms"] / best["numba_cpu_ms"], 2),
        **{name: round(ms, 2) for name, ms in best.items()},
        "mbytes_up": round(image.nbytes / 1e6, 1), "mbytes_down": round(3 * found.nbytes / 1e6, 1),
        "device_mbytes": round(chain.device_bytes / 1e6, 1), "dispatches": len(chain.dispatches),
        "stages": {name: {k: round(v, 6) for k, v in row.items()} for name, row in stages.items()},
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="gpu")
    parser.add_argument("--quality", default="real-time", choices=("real-time", "paper"))
    parser.add_argument("--design", default="cy_halves")
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--bandwidth", type=float, default=4800.0, help="of the model's memory, GB/s")
    parser.add_argument("--rate", type=float, default=60.0, help="of the model's arithmetic, TFLOP/s")
    parser.add_argument("--dispatch-us", type=float, default=5.0, help="between two dispatches, an assumption")
    parser.add_argument("--step-ns", type=float, default=100.0, help="of a dependent step, an assumption")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    width, height = (int(side) for side in arguments.size.split("x"))
    result = benchmark(
        arguments.device, arguments.quality, arguments.design, (width, height),
        1e9 * arguments.bandwidth, 1e12 * arguments.rate,
    )  # fmt: skip
    if arguments.json:
        print(json.dumps(result, indent=2))
        return
    stages = result.pop("stages")
    print("\n".join(f"{name:32s} {value}" for name, value in result.items()))
    print(
        f"\n{'stage':16s} {'dispatches':>10s} {'MB':>9s} {'Mop':>9s} {'steps':>6s} {'model ms':>9s} "
        f"{'of which memory':>16s} {'measured ms':>12s}"
    )
    total: dict[str, float] = defaultdict(float)
    for name, row in [*stages.items(), ("sum", total)]:
        share = row["bandwidth_ms"] / row["model_ms"] if row["model_ms"] else 0.0
        print(
            f"{name:16s} {row['dispatches']:10.0f} {row['mbytes']:9.1f} {row['mops']:9.1f} {row['steps']:6.0f} "
            f"{row['model_ms']:9.4f} {share:16.0%} {row['ms']:12.2f}"
        )
        for key, value in row.items():
            total[key] += value if name != "sum" else 0
    latency = 1e-3 * arguments.dispatch_us * total["dispatches"] + 1e-6 * arguments.step_ns * total["steps"]
    print(f"sum with latency {total['model_ms'] + latency:.3f} ms")


if __name__ == "__main__":
    main()

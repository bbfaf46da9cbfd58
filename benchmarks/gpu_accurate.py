"""Quality "accurate" on a device: what every stage moves and computes, and, where there is a device, how long it takes.

    python benchmarks/gpu_accurate.py [--sample still_life_cy_halves] [--size 720x480] [--device gpu] [--json]

Without ``--device`` nothing is computed: the chain is composed for the size and its dispatches counted, as
`benchmarks/gpu.py` counts them (bytes: arrays that a stage binds, each once; operations: those of the inner loops, at
most). The larger of bytes over bandwidth and operations over the arithmetic rate is the least time that a device of
these could take; it leaves out that a path is as many steps one after the other as it has pixels. With ``--device`` the
depth is compared with the CPU's before anything is timed.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import time
import warnings
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from gpu import count, counting_device, median_time_ms, median_times_ms, warmed

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.matching.accurate import AccurateMethod
from chromaperture.matching.device.accurate_chain import DOWN, AccurateChain
from chromaperture.matching.device.device import Chain, Device, Dispatch
from chromaperture.matching.working_scale import ScaledMethod
from chromaperture.products.samples import open_sample
from chromaperture.system.errors import CaptureWarning

LEAST_AGREEING, DEPTH_TOLERANCE = 0.995, 1e-3
ROUNDS = 5  # on a device that is not software


def operations(dispatch: Dispatch) -> float:
    """Operations of a stage's inner loops."""
    c: dict[str, Any] = dict(dispatch.constants)
    pixels = c.get("width", 0) * c.get("height", 0)
    entries = pixels * c.get("count", 0)

    def transforms() -> float:
        return 10.0 * c["lines"] * c["span"] * math.log2(c["span"])  # two numbers go side by side

    def taps() -> float:
        return 2.0 * c["reach"] + 1

    per = {
        "gaussian_line": lambda: 2 * taps() * pixels * c["planes"] * c["parts"],
        "tile_rows": transforms,
        "tile_columns": transforms,
        "tile_smoothing": lambda: 2 * taps() * c["pictures"] * c["size"] * (c["size"] // 2 + 1),
        "point_rows": lambda: (
            c["pictures"] * c["layers_of_round"] * (6.0 * c["side"] ** 2 * c["kept"] + 40 * c["points"])
        ),
        "point_columns": lambda: 8.0 * c["pictures"] * c["layers_of_round"] * c["side"] * c["kept"] ** 2,
        "pair_spectra": lambda: 7.0 * c["tiles"] * c["pair_count"] * c["span"] ** 2 / 2,
        "cross_columns": lambda: transforms() + 30.0 * c["lines"] * c["span"],
        "cross_rows": transforms,
        "tiles_joined": lambda: 20.0 * pixels * c["layers_of_round"] * c["pair_count"],
        "bands_rows": lambda: 4.0 * (taps() + 3) * pixels * c["pictures"] * c["smooths"],
        "bands_columns": lambda: (4.0 * (taps() + 3) * c["smooths"] + 2 * c["bands"]) * pixels * c["pictures"],
        "band_products": lambda: 30 * 6.0 * pixels / 4 * c["planes"],
        "band_correlation": lambda: 4.0 * pixels * c["bands"] * c["layers_of_round"] * c["pair_count"],
        "pair_evidence": lambda: 16.0 * c["samples"] * c["count"] * c["pairs"] * c["bands"],
        "labels_read": lambda: pixels * (6.0 * c["layers"] + 45 * c["count"]),
        "window_rows": lambda: 10.0 * c["side"] * 3 * c["width"] * c["window_rows"] * c["pairs"],
        "window_spectra": lambda: 27.0 * c["side"] * c["window_rows"] * c["window_columns"] * c["frequencies"],
        # 250 of a round of a frequency, without those that the last one leaves out
        "spectral_likelihood": lambda: (
            250.0
            * c["windows"]
            * c["slopes"]
            * c["frequencies"]
            * (c["layers"] * (c["rounds"] + 1) + c["first_rounds"])
        ),
        "slope_evidence": lambda: 6.0 * c["windows"] * c["slopes"] * c["layers"],
        "slope_shares": lambda: 12.0 * c["windows"] * c["slopes"] * c["rounds"],
        "window_labels": lambda: c["windows"] * (8.0 * c["slopes"] * c["layers"] + 50.0 * c["count"]),
        "labels_of_samples": lambda: c["sample_height"] * c["sample_width"] * (2.0 * c["layers"] + 45 * c["count"]),
        "labels_between": lambda: entries * (14.0 + 9 * ("stride" in c)),
        "volume_paths": lambda: 15.0 * entries,
        "volume_winner": lambda: 3.0 * entries,
        "layer_tangents": lambda: 8.0 * pixels,
        "layer_offsets": lambda: 6.0 * pixels,
        "volume_posterior": lambda: 10.0 * entries,
        "block_sums": lambda: 1.0 * entries,
    }
    return float(per.get(dispatch.stage, lambda: 0.0)())


def counted(chain: Chain, *, bandwidth: float, rate: float) -> dict[str, dict[str, float]]:
    """Dispatches, bytes, operations and the model's time of every stage."""
    found: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for dispatch in chain.dispatches:
        count(found[dispatch.stage], dispatch, operations(dispatch), bandwidth=bandwidth, rate=rate)
    return found


def composed(camera: CodedApertureCamera, device: Device) -> AccurateChain:
    """Compose the chain of a camera."""
    method, sensor = camera.method, camera.calibration.sensor
    shape = sensor.height_px, sensor.width_px
    if isinstance(method, ScaledMethod):
        shape, method = method.size_px[::-1], method.method
    assert isinstance(method, AccurateMethod)
    return AccurateChain(method, device, shape)


def chain_of(camera: CodedApertureCamera) -> Chain:
    """The chain that a camera's device has composed."""
    assert camera.device_method is not None
    accurate = camera.device_method.on_gpu._chain
    assert isinstance(accurate, AccurateChain)
    return accurate.chain


def timed(camera: CodedApertureCamera, image: np.ndarray, device: str) -> tuple[dict[str, Any], dict[str, float]]:
    """Disparity, and whole calls with depth and colours, beside Numba's, after the depth has been compared.

    Returns the figures, and the time of every stage by the device's timestamps in ms, empty where it keeps none.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CaptureWarning)  # the device is software
        on_gpu = CodedApertureCamera(camera.calibration, camera.config, device=device)
    if on_gpu.device_method is None:
        raise SystemExit(f"--device {device} is the CPU here: see 'chromaperture info --devices'")
    depths = [each.measure(image).depth_mm for each in (on_gpu, camera)]
    known = np.isfinite(depths[1])
    close = np.where(known, np.abs(depths[0] - depths[1]) <= DEPTH_TOLERANCE * depths[1], np.isnan(depths[0]))
    if close.mean() < LEAST_AGREEING:
        raise SystemExit(f"only {close.mean():.2%} of the depths agree with the CPU: nothing is timed")
    info = on_gpu.device_method.on_gpu.device.info
    found: dict[str, Any] = {"device": info.name, "software": info.is_software}
    found["share_within_0.1_percent"] = round(float(close.mean()), 5)
    works: dict[str, Callable[[np.ndarray], object]] = {
        "device": on_gpu.method.match, "numba": camera.method.match,
        "device_whole": on_gpu.measure, "numba_whole": camera.measure,
    }  # fmt: skip
    for name, work in works.items():
        if name.startswith("device") and not info.is_software:
            warmed(functools.partial(work, image))
        walls, cpus = [], []
        for _ in range(ROUNDS if name.startswith("device") and not info.is_software else 1):
            wall, cpu = time.perf_counter(), time.process_time()
            work(image)
            walls.append(1e3 * (time.perf_counter() - wall))
            cpus.append(1e3 * (time.process_time() - cpu))
        found[f"{name}_wall_ms"], found[f"{name}_cpu_ms"] = round(min(walls), 1), round(min(cpus), 1)
    for kind in ("", "_whole"):
        found[f"ratio{kind}_to_numba_cpu"] = round(found[f"device{kind}_cpu_ms"] / found[f"numba{kind}_cpu_ms"], 2)
    stages: dict[str, float] = defaultdict(float)
    chain = chain_of(on_gpu)
    if chain.device.timestamps:
        found["timestamps_ms"] = round(median_time_ms(chain, {}), 3)
        for stage, ms in median_times_ms(chain, {}):
            stages[stage] += ms
    return found, stages


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sample", default="still_life_cy_halves")
    parser.add_argument("--size", default="720x480")
    parser.add_argument(
        "--scale", type=int, help="match pictures reduced to 1 / scale; else the camera's working scale"
    )
    parser.add_argument("--device", help="run there, too")
    parser.add_argument("--bandwidth", type=float, default=4800.0, help="of the model's memory, GB/s")
    parser.add_argument("--rate", type=float, default=60.0, help="of the model's arithmetic, TFLOP/s")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    width, height = (int(side) for side in arguments.size.split("x"))
    camera, image = open_sample(arguments.sample, quality="accurate", device="cpu")
    if (width, height) != image.shape[1::-1]:
        camera, image = camera.at_size(width, height), cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    if arguments.scale:
        config = default_config(camera.calibration, "accurate", scale=arguments.scale)
        camera = CodedApertureCamera(camera.calibration, config)
    chain = composed(camera, counting_device())
    stages = counted(chain.chain, bandwidth=1e9 * arguments.bandwidth, rate=1e12 * arguments.rate)
    arrays = chain.chain.arrays.values()
    largest = max(arrays, key=lambda array: array.size)

    def mbytes(*names: str) -> float:
        return round(sum(4 * array.size for array in arrays if array.name in names) / 1e6, 1)

    result: dict[str, Any] = {
        "sample": arguments.sample, "size": arguments.size, "scale": camera.config.scale,
        "matched": f"{chain.grid.width}x{chain.grid.height}", "labels": chain.grid.layers,
        "dispatches": len(chain.chain.dispatches), "device_mbytes": round(chain.chain.device_bytes / 1e6),
        "largest_array": f"{largest.name}: {4 * largest.size / 1e6:.0f} MB",
        "mbytes_up": mbytes("image", "usable", "guide", "counted", "noise", "window_noise"),
        "mbytes_down": mbytes(*DOWN),
    }  # fmt: skip
    if chain.plan is not None:
        result |= {
            "layers_computed": len(chain.plan.computed_px), "tiles": len(chain.plan.nodes.places),
            "tile_samples": chain.plan.nodes.size, "pairs": len(chain.plan.source.all_pairs),
        }  # fmt: skip
    if arguments.device:
        figures, times = timed(camera, image, arguments.device)
        result |= figures
        for name, ms in times.items():
            stages[name]["ms"] = ms
    if arguments.json:
        print(json.dumps(result | {"stages": stages}, indent=2))
        return
    print("\n".join(f"{name:26s} {value}" for name, value in result.items()))
    print(f"\n{'stage':18s} {'dispatches':>10s} {'MB':>10s} {'Mop':>10s} {'model ms':>9s} {'measured ms':>12s}")
    total: dict[str, float] = defaultdict(float)
    for name, row in sorted(stages.items(), key=lambda item: -item[1]["model_ms"]):
        print(
            f"{name:18s} {row['dispatches']:10.0f} {row['mbytes']:10.1f} {row['mops']:10.1f} {row['model_ms']:9.3f} "
            f"{row['ms']:12.3f}"
        )
        for key, value in row.items():
            total[key] += value
    sums = (total["dispatches"], total["mbytes"], total["mops"], total["model_ms"], total["ms"])
    print("{:18s} {:10.0f} {:10.1f} {:10.1f} {:9.3f} {:12.3f}".format("sum", *sums))


if __name__ == "__main__":
    main()

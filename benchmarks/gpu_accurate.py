"""Quality "accurate" on a device: what every stage moves and computes, and, where there is a device, how long it takes.

    python benchmarks/gpu_accurate.py [--sample still_life_cy_halves] [--size 720x480] [--device gpu] [--json]

Without ``--device`` nothing is computed: the chains are composed for the size and their dispatches counted, as
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
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from gpu import count, counting_device, median_time_ms, median_times_ms, warmed

from chromaperture.camera import CodedApertureCamera
from chromaperture.camera_matching import default_config
from chromaperture.config import AccurateConfig
from chromaperture.disparity.gpu.accurate_chain import AccurateChain
from chromaperture.disparity.gpu.device import Chain, Device, Dispatch
from chromaperture.disparity.gpu.measured import Further
from chromaperture.disparity.gpu.regions_between import DOWN
from chromaperture.disparity.gpu.working_stages import Reduction
from chromaperture.disparity.views import guide_weights
from chromaperture.disparity.working_scale import ScaledMethod
from chromaperture.errors import CaptureWarning
from chromaperture.products.samples import open_sample

LEAST_AGREEING, DEPTH_TOLERANCE = 0.995, 1e-3
ROUNDS = 5  # on a device that is not software
SUMS = 6  # over the points of a plane, from each start
LINES, PARTS = 2000, 200  # across borders of a photograph of 720x480, and groups of them


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
        "gaussian_line": lambda: 2 * taps() * pixels / c["every"] * c["planes"] * c["parts"],
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
        "coupling_target": lambda: 60.0 * pixels,  # some six layers a pixel
        "coupling_steps": lambda: 28.0 * c["steps"] * pixels * 64**2 / (64 - 2 * c["steps"]) ** 2,
        "volume_posterior": lambda: 10.0 * entries,
        "surface_sigma": lambda: 4.0 * pixels,
        "block_sums": lambda: 1.0 * entries,
        "agreed_planes": lambda: (7.0 * c["trials"] + 30 * c["fits"]) * c["rounds"] * c["point_count"],
        # a sixth of the points of all tiles, three trials in each of some four steps
        "plane_refining": lambda: 500.0 * 12 * dispatch.arrays[1].size / 6,
        "plane_costs": lambda: 8.0 * pixels * dispatch.arrays[1].size / 4,
        "potts_lines": lambda: 8.0 * dispatch.arrays[0].size,
        # some 32 pairs behind a choice and 4 behind a join, from two starts
        "pair_joins": lambda: 60.0 * 2 * SUMS * c["most_points"] * c["side_by_side"] / 8,
        "part_planes": lambda: 60.0 * 2 * SUMS * dispatch.arrays[1].size,
        "part_counts": lambda: 4.0 * (2 * c["border"] + 1) ** 2 * pixels,
        "line_sides": lambda: 8.0 * (2 * c["reach"] + 1) ** 2 * LINES,
        "line_powers": lambda: 5.0 * LINES**2,
        "line_parts": lambda: 6.0 * LINES**2,
        # 54 x 54 numbers composed, and eliminated with 16 lines
        "line_costs": lambda: PARTS * dispatch.groups[1] * (54 * 54 / 2 * 60 + 54**3 / 3 + 54**2 * 16),
        "edge_possible": lambda: 12.0 * (2 * c["around"] + 1) ** 2 * pixels,
        "planes_allowed": lambda: 12.0 * pixels * (2 * c["reach"] + 1) ** 2 / 8,  # beside other planes only
        "plane_sums": lambda: 2.0 * pixels * dispatch.groups[0],
        "learned_bar": lambda: 90.0 * pixels,
        "range_line": lambda: 2 * taps() * pixels,
        "label_maps": lambda: 20.0 * pixels,
        "conversion": lambda: 60.0 * dispatch.arrays[0].size,
        # 8 x 8 samples of three channels by their weights
        "channels_shifted": lambda: 3.0 * 64 * 3 * pixels,
        "hidden_filled": lambda: 20.0 * pixels,
        "upsample": lambda: 100.0 * c["full_width"] * c["full_height"],
        "reduce": lambda: 8.0 * c["full_width"] * c["full_height"],
    }
    return float(per.get(dispatch.stage, lambda: 0.0)())


def counted(chains: dict[str, Chain], *, bandwidth: float, rate: float) -> dict[str, dict[str, float]]:
    """Dispatches, bytes, operations and the model's time of every stage."""
    found: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for chain in chains.values():
        for dispatch in chain.dispatches:
            count(found[dispatch.stage], dispatch, operations(dispatch), bandwidth=bandwidth, rate=rate)
    return found


def composed(camera: CodedApertureCamera, device: Device) -> tuple[AccurateChain, dict[str, Chain]]:
    """Compose the chains of a camera with depth and colours; planes and lines have room for all that may be found."""
    method, reduction = camera.method, None
    sensor = camera.calibration.sensor
    if isinstance(method, ScaledMethod):
        reduction = Reduction(method.size_px, guide_weights(method.aperture))
        method = method.method
    further = Further(camera.conversion, camera.device_alignment)
    shape = (sensor.height_px, sensor.width_px)
    chain = AccurateChain(method, device, shape, reduction=reduction, further=further)
    return chain, {"first": chain.first, "last": chain.last}


def chain_of(camera: CodedApertureCamera) -> AccurateChain:
    """The chains that a camera's device has composed last."""
    assert camera.device_method is not None
    chain = camera.device_method.on_gpu._chain
    assert isinstance(chain, AccurateChain)
    return chain


def down_between(chain: AccurateChain) -> float:
    """MB that come down between the submissions."""
    if not chain.uses_depth_edges:
        return 0.0
    return round(sum(4 * chain.first.arrays[name].size for name in DOWN) / 1e6, 1)


def timed(
    camera: CodedApertureCamera, image: np.ndarray, device: str
) -> tuple[dict[str, Any], dict[str, float]]:
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
    on_gpu.method.match(image)  # composes the chains without depth and colours
    works: dict[str, Callable[[np.ndarray], object]] = {
        "device": on_gpu.method.match, "numba": camera.method.match,
        "device_whole": on_gpu.measure, "numba_whole": camera.measure,
    }  # fmt: skip
    for name, work in works.items():
        if name == "device_whole":
            on_gpu.measure(image)
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
    if chain.first.device.timestamps:
        for name, part in (("first", chain.first), ("last", chain.last)):
            found[f"{name}_timestamps_ms"] = round(median_time_ms(part, {}), 3)
            for stage, ms in median_times_ms(part, {}):
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
    parser.add_argument(
        "--planes-on-device", action="store_true", help="the guide leads borders: nothing returns to the CPU in between"
    )
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
    if arguments.planes_on_device:
        assert isinstance(camera.config.matcher, AccurateConfig)
        config = replace(camera.config, matcher=camera.config.matcher.with_guided_borders())
        camera = CodedApertureCamera(camera.calibration, config)
    chain, chains = composed(camera, counting_device())
    stages = counted(chains, bandwidth=1e9 * arguments.bandwidth, rate=1e12 * arguments.rate)
    arrays = {id(array.buffer): array for part in chains.values() for array in part.arrays.values()}
    largest = max(arrays.values(), key=lambda array: array.size)

    def mbytes(*names: str) -> float:
        return round(sum(4 * array.size for array in arrays.values() if array.name in names) / 1e6, 1)

    result: dict[str, Any] = {
        "sample": arguments.sample, "size": arguments.size, "scale": camera.config.scale,
        "matched": f"{chain.grid.width}x{chain.grid.height}", "labels": chain.grid.layers,
        "layers_computed": len(chain.plan.computed_px), "tiles": len(chain.plan.nodes.places),
        "tile_samples": chain.plan.nodes.size, "pairs": len(chain.plan.source.all_pairs),
        "planes": chain.uses_planes, "dispatches": sum(len(part.dispatches) for part in chains.values()),
        "device_mbytes": round(sum(4 * array.size for array in arrays.values()) / 1e6),
        "largest_array": f"{largest.name}: {4 * largest.size / 1e6:.0f} MB",
        "mbytes_up": mbytes("image", "usable", "guide", "counted", "noise", "window_noise", "photograph"),
        "mbytes_down_between": down_between(chain),
        "mbytes_up_between": mbytes(
            "edge_links", "line_light", "line_noise_at", "voted_planes", "voted_choice", "planes_trusted"
        ),
        "mbytes_down": mbytes("disparity", "sigma", "confidence", "depth_mm", "sigma_mm", "color"),
    }  # fmt: skip
    if chain.textures is not None:
        textures = chain.textures.covariances, chain.textures.shares, chain.textures.facts
        result["mbytes_of_textures"] = round(sum(part.nbytes for part in textures) / 1e6, 1)
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

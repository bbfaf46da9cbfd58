"""A device (WGSL) against the compiled code of the CPU: python benchmarks/gpu.py agree PHOTO CAMERA [PHOTO CAMERA ...]

``agree`` compares the depth by WGSL, Numba and the readable NumPy. ``speed`` compares the depth of a sample, then times
whole calls beside Numba in the same process, and every stage by the device's timestamps. On a rasteriser in software
both share the same cores: only the ratio says something. ``count`` says what a GPU would be given of `accurate`, and
needs none.
"""

from __future__ import annotations

import argparse
import functools
import json
import statistics
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np

from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.camera.method import default_config
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.matching.accurate import AccurateMethod
from chromaperture.matching.device import accurate_chain
from chromaperture.matching.device.accurate_chain import AccurateChain
from chromaperture.matching.device.device import Chain, PlannedChain, pass_times_ms, stage_times_ms
from chromaperture.matching.device.gpu_method import device_method
from chromaperture.products.samples import open_sample
from chromaperture.system.errors import CaptureWarning
from chromaperture.system.threads import limited_threads, thread_count

QUALITIES = ("real-time", "paper", "accurate")
TOLERANCE, MIN_AGREEING = 1e-3, {"real-time": 0.97, "paper": 0.97, "accurate": 0.995}  # equal scores decide by rounding
ROUNDS = {"real-time": 30, "paper": 30, "accurate": 5}  # on a device that is not software; the fastest counts
STAGE_ROUNDS = 9
WARMING_S = 1.0


def on_device(camera: CodedApertureCamera, device: str) -> CodedApertureCamera:
    """The same camera on a device; raises SystemExit where that is the CPU."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CaptureWarning)  # the device is software
        found = CodedApertureCamera(camera.calibration, camera.config, device=device)
    if device_method(found.method) is None:
        raise SystemExit(f"--device {device} is the CPU here: see 'chromaperture info --devices'")
    return found


def agreeing(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels whose depths differ by less than `TOLERANCE`, or are unknown in both."""
    known = np.isfinite(one) & np.isfinite(other)
    near = np.zeros(known.shape, bool)
    near[known] = np.abs(one[known] / other[known] - 1) < TOLERANCE
    return float((near | (np.isnan(one) & np.isnan(other))).mean())


def apart_sigma(one: DepthFrame, other: DepthFrame) -> float:
    """99th percentile of the difference, in standard deviations."""
    return float(np.nanpercentile(np.abs(one.depth_mm - other.depth_mm) / other.sigma_mm, 99))


def agree(args: argparse.Namespace) -> None:
    """Print the share of agreeing pixels of each pair of executions, photographs at their own resolution."""
    print("camera               quality    WGSL:NumPy Numba:NumPy WGSL:Numba apart, sigma")
    for photo, file in zip(args.pairs[::2], args.pairs[1::2], strict=True):
        for quality in args.quality:
            compiled = load_camera(file, quality=quality, scale=1, device="cpu")
            readable = CodedApertureCamera(compiled.calibration, compiled.config, execution="numpy")
            image = compiled.read(photo)
            wgsl, numba, numpy = (c.measure(image) for c in (on_device(compiled, args.device), compiled, readable))
            pairs = ((wgsl, numpy), (numba, numpy), (wgsl, numba))
            shares = [agreeing(one.depth_mm, other.depth_mm) for one, other in pairs]
            columns = f"{shares[0]:10.4f} {shares[1]:11.4f} {shares[2]:10.4f} {apart_sigma(wgsl, numba):12.4f}"
            print(f"{file.stem:20s} {quality:10s} {columns}", flush=True)


def warmed(work: Callable[[], object]) -> None:
    """Repeat work for a second: a GPU that idles has a low clock, and takes its time to raise it."""
    end = time.perf_counter() + WARMING_S
    while time.perf_counter() < end:
        work()


def chain_of(camera: CodedApertureCamera) -> Chain:
    """The chain that a camera's device has composed."""
    method = device_method(camera.method)
    assert method is not None
    composed = method.on_gpu._chain
    chain = composed.chain if isinstance(composed, AccurateChain) else composed
    assert chain is not None
    return chain


def stages_of(chain: Chain, inputs: Mapping[str, np.ndarray]) -> dict[str, dict[str, float]]:
    """Dispatches of every stage, bytes of the arrays it binds (each once), and its time (median of several runs)."""
    rounds = 0 if not chain.device.timestamps else 1 if chain.device.info.is_software else STAGE_ROUNDS
    runs = [stage_times_ms(chain, inputs) for _ in range(rounds)]
    found: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for i, dispatch in enumerate(chain.dispatches):
        row = found[dispatch.stage]
        row["dispatches"] += 1
        row["mbytes"] += 4e-6 * sum(array.size for array in {a.name: a for a in dispatch.arrays}.values())
        row["ms"] += statistics.median(run[i][1] for run in runs) if runs else 0.0
    return found


def times_ms(work: Callable[[], object], rounds: int) -> tuple[float, float]:
    """Fastest of several runs on the clock and of processor time."""
    walls, cpus = [], []
    for _ in range(rounds):
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        walls.append(1e3 * (time.perf_counter() - wall))
        cpus.append(1e3 * (time.process_time() - cpu))
    return min(walls), min(cpus)


def timed(camera: CodedApertureCamera, image: np.ndarray, quality: str, device: str) -> dict[str, Any]:
    """Disparity, and whole calls with depth and colours, beside Numba's, after the depth has been compared."""
    on_gpu = on_device(camera, device)
    share = agreeing(on_gpu.measure(image).depth_mm, camera.measure(image).depth_mm)
    if share < MIN_AGREEING[quality]:
        raise SystemExit(f"only {share:.2%} of the depths agree with the CPU: nothing is timed")
    chain = chain_of(on_gpu)
    info = chain.device.info
    found: dict[str, Any] = {"device": info.name, "software": info.is_software, "agreeing": round(share, 5)}
    with limited_threads(thread_count()):
        for kind, ours, peer in (
            ("match", on_gpu.method.match, camera.method.match), ("measure", on_gpu.measure, camera.measure)
        ):  # fmt: skip
            once = functools.partial(ours, image)
            if not info.is_software:
                warmed(once)
            times = times_ms(once, 2 if info.is_software else ROUNDS[quality])
            peers = times_ms(functools.partial(peer, image), 2)
            for clock, taken, of_peer in zip(("wall", "cpu"), times, peers, strict=True):
                found[f"{kind}_{clock}_ms"] = round(taken, 2)
                found[f"{kind}_{clock}_over_numba"] = round(taken / of_peer, 2)
    inputs = {"image": image} if quality != "accurate" else {}
    if chain.device.timestamps:
        rounds = 1 if info.is_software else STAGE_ROUNDS
        passes = [pass_times_ms(chain, inputs, [chain.dispatches])[0] for _ in range(rounds)]
        found["timestamps_ms"] = round(statistics.median(passes), 3)
    return found | {"device_mbytes": round(chain.device_bytes / 1e6, 1), "stages": stages_of(chain, inputs)}


def speed(args: argparse.Namespace) -> None:
    """Time a sample, reduced or enlarged to a size."""
    width, height = (int(side) for side in args.size.split("x"))
    for quality in args.quality:
        camera, image = open_sample(args.sample, quality=quality, device="cpu")
        if (width, height) != image.shape[1::-1]:
            camera = camera.at_size(width, height)
            image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        config = default_config(camera.calibration, quality, scale=args.scale or "auto")
        figures = timed(CodedApertureCamera(camera.calibration, config), image, quality, args.device)
        result = {"sample": args.sample, "size": args.size, "quality": quality, **figures}
        if args.json:
            print(json.dumps(result), flush=True)
            continue
        stages = result.pop("stages")
        print("\n".join(f"{name:26s} {value}" for name, value in result.items()))
        print(f"\n{'stage':20s} {'dispatches':>10s} {'MB':>10s} {'ms':>10s}")
        for name, row in sorted(stages.items(), key=lambda item: -item[1]["ms"]):
            print(f"{name:20s} {row['dispatches']:10.0f} {row['mbytes']:10.1f} {row['ms']:10.3f}", flush=True)


def count(args: argparse.Namespace) -> None:
    """Print dispatches, memory and bytes of the arrays that dispatches bind, each once, of `accurate`."""
    width, height = (int(side) for side in args.size.split("x"))
    camera, _ = open_sample(args.sample, quality="accurate", device="cpu")
    calibration = camera.at_size(width, height).calibration
    config = default_config(calibration, "accurate", scale=args.scale or "auto")
    method = CodedApertureCamera(calibration, config).method
    assert isinstance(method, AccurateMethod)
    with mock.patch.object(accurate_chain, "Chain", return_value=PlannedChain("quad")):
        chain = AccurateChain(method, PlannedChain("quad").device, (height, width)).chain
    bound = (array.size for dispatch in chain.dispatches for array in {a.name: a for a in dispatch.arrays}.values())
    memory = 4e-6 * sum(array.size for array in chain.arrays.values())
    moved = 4e-9 * sum(bound)
    print(f"{len(method.labels_px)} labels, {len(chain.dispatches)} dispatches, {memory:.0f} MB, {moved:.2f} GB moved")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("agree")
    one.add_argument("pairs", nargs="+", type=Path, metavar="PHOTO CAMERA")
    one.set_defaults(run=agree)
    other = commands.add_parser("speed")
    other.add_argument("--sample", default="still_life_cy_halves")
    other.add_argument("--size", default="720x480")
    other.add_argument("--scale", type=int, help="match pictures reduced to 1 / scale; else the camera's own")
    other.add_argument("--json", action="store_true")
    other.set_defaults(run=speed)
    counting = commands.add_parser("count")
    counting.add_argument("--sample", default="still_life_cy_halves")
    counting.add_argument("--size", default="720x480")
    counting.add_argument("--scale", type=int)
    counting.set_defaults(run=count)
    for each in (one, other):
        each.add_argument("--device", default="gpu")
        each.add_argument("--quality", nargs="+", choices=QUALITIES, default=["real-time", "paper"])
    args = parser.parse_args()
    if args.run is agree and len(args.pairs) % 2:
        parser.error("every photograph needs its camera file behind it")
    args.run(args)


if __name__ == "__main__":
    main()

"""The app's page measuring on its own device, in Chromium, beside the CPU's path, one frame of each in turn.

    python benchmarks/page.py [--size 640x480] [--frames 5] [--json]

The maps are compared before anything is timed. Chromium has no graphics card here but a rasteriser in software
(SwiftShader), which shares the cores with everything else: the figures say that the page's part works, and what a
frame costs in software; nothing follows from them for a phone. Times on the clock are of a machine that may be busy;
CPU time is that of all processes of the browser, from the system's accounting.

Needs the extras ``serve`` and ``browser``, and Chromium.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import sys
import tempfile
import time
import warnings
from pathlib import Path

import cv2
import numpy as np

from chromaperture.app.device_plan import light_of_counts
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.model.camera_file import Calibration
from chromaperture.products.samples import open_sample, sample_camera

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from apps import WEBGPU, chromium, served

NAME = "still_life_cy_halves"
LEAST_AGREEING = 0.99  # of the pixels within 0.1 % of the readable stages; docs/gpu.md has 0.997 and more
_TICK_S = 1 / os.sysconf("SC_CLK_TCK")

PREPARE = """async ({ width, height, png }) => {
    const { openDevice, DeviceMeasurer } = await import("./webgpu.js");
    const { planFor } = await import("./plan.js");
    const bytes = Uint8Array.from(atob(png), (c) => c.charCodeAt(0));
    const gpu = await openDevice(), plan = await planFor("benchmark", width, height, gpu.exchange);
    const began = performance.now();
    window.measurer = await new DeviceMeasurer(gpu, plan).prepare();
    window.picture = await createImageBitmap(new Blob([bytes]), { colorSpaceConversion: "none" });
    window.shown = document.createElement("canvas").getContext("2d");
    const prepared = performance.now() - began, { depth } = await (await measurer.measure(picture)).maps();
    let text = "";
    const all = new Uint8Array(depth.buffer);
    for (let i = 0; i < all.length; i += 32768) text += String.fromCharCode(...all.subarray(i, i + 32768));
    return { prepared, depth: btoa(text), adapter: (await navigator.gpu.requestAdapter()).info.architecture };
}"""
FRAME = """async () => {
    const began = performance.now(), frame = await measurer.measure(picture);
    frame.draw(shown, "depth");
    await measurer.device.queue.onSubmittedWorkDone();
    return performance.now() - began;
}"""


def cpu_seconds(root: int) -> float:
    """CPU time of a process and of all that it started."""
    children: dict[int, list[int]] = {}
    used: dict[int, float] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue  # it has ended
            children.setdefault(int(fields[1]), []).append(int(entry.name))
            used[int(entry.name)] = (int(fields[11]) + int(fields[12])) * _TICK_S
    total, waiting = 0.0, [root]
    while waiting:
        process = waiting.pop()
        total += used.get(process, 0.0)
        waiting += children.get(process, [])
    return total


def measure(size: tuple[int, int], frames: int) -> dict[str, float | str]:
    """Run the comparison; raises SystemExit where the maps do not agree."""
    width, height = size
    calibration = Calibration.load(sample_camera(NAME))
    _, image = open_sample(NAME)
    if size != (calibration.sensor.width_px, calibration.sensor.height_px):
        calibration, image = reshaped(calibration, image, size)
    picture = linear_to_srgb_bytes(image)
    light, _ = light_of_counts(calibration)
    image = light[picture]
    config = default_config(calibration, scale=1)
    camera = CodedApertureCamera(calibration, config)
    readable = CodedApertureCamera(calibration, config, execution="numpy").measure(image).depth_mm
    png = base64.b64encode(cv2.imencode(".png", picture[..., ::-1])[1].tobytes()).decode()
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        calibration.save(folder / "benchmark.asdf")
        with (
            served(folder / "app", camera=folder / "benchmark.asdf") as app,
            sync_playwright() as driver,
            chromium(driver, flags=WEBGPU) as browser,
        ):
            page = browser.new_page()
            page.set_default_timeout(600_000)
            page.goto(app.url)
            page.wait_for_selector("#camera option[value=benchmark]", state="attached")
            found = page.evaluate(PREPARE, {"width": width, "height": height, "png": png})
            depth = np.frombuffer(base64.b64decode(found["depth"]), np.float32).reshape(height, width)
            both = np.isfinite(depth) & np.isfinite(readable)
            agreeing = float((np.abs(depth - readable)[both] < 1e-3 * readable[both]).mean())
            if agreeing < LEAST_AGREEING:
                sys.exit(f"the page agrees in {agreeing:.4f} of the pixels only: no time is worth anything")
            root = browser_process()
            camera.measure(image)
            rows = []
            for _ in range(frames):  # in turn, so that what else runs slows both
                before, began = time.process_time(), time.perf_counter()
                camera.measure(image)
                cpu = time.process_time() - before, time.perf_counter() - began
                before = cpu_seconds(root)
                wall = page.evaluate(FRAME) / 1000
                rows.append((*cpu, cpu_seconds(root) - before, wall))
    cpu_s, cpu_wall_s, page_s, page_wall_s = np.median(rows, axis=0)
    return {
        "size": f"{width}x{height}", "adapter": found["adapter"], "agreeing": round(agreeing, 4),
        "prepare_s": round(found["prepared"] / 1000, 2),
        "page_frames_a_second": round(1 / page_wall_s, 3), "cpu_frames_a_second": round(1 / cpu_wall_s, 3),
        "page_cpu_seconds": round(page_s, 3), "cpu_path_cpu_seconds": round(cpu_s, 3),
        "ratio_of_cpu_time": round(page_s / cpu_s, 2), "ratio_on_the_clock": round(page_wall_s / cpu_wall_s, 2),
    }  # fmt: skip


def reshaped(calibration: Calibration, image: np.ndarray, size: tuple[int, int]) -> tuple[Calibration, np.ndarray]:
    """The middle of the sample's frame in another size: for times, not for distances."""
    from dataclasses import replace

    width, height = size
    scale = max(width / image.shape[1], height / image.shape[0])
    large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    top, left = (large.shape[0] - height) // 2, (large.shape[1] - width) // 2
    part = np.ascontiguousarray(large[top : top + height, left : left + width]).clip(0, 1)
    return replace(calibration, sensor=replace(calibration.sensor, width_px=width, height_px=height)), part


def browser_process() -> int:
    """The Chromium that this process started last, by way of Playwright's driver."""
    found = [
        int(entry.name)
        for entry in Path("/proc").iterdir()
        if entry.name.isdigit() and _is_ours(entry) and b"--type=" not in _command(entry)
    ]
    return max(found)


def _command(entry: Path) -> bytes:
    try:
        return (entry / "cmdline").read_bytes()
    except OSError:
        return b"--type="


def _is_ours(entry: Path) -> bool:
    """Whether a process is a Chromium below this one."""
    if b"--use-webgpu-adapter" not in _command(entry):
        return False
    process = int(entry.name)
    while process > 1:
        if process == os.getpid():
            return True
        try:
            process = int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            return False
    return False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    width, height = (int(part) for part in asked.size.split("x"))
    warnings.simplefilter("ignore")
    found = measure((width, height), asked.frames)
    print(json.dumps(found) if asked.json else "\n".join(f"{name:24} {value}" for name, value in found.items()))


if __name__ == "__main__":
    main()

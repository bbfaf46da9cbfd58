"""How time and memory grow with pixels, layers, blur and photographs: python benchmarks/growth.py matcher|measuring

``matcher``: the real-time matcher's time against a straight line with a fixed part, which linear growth is.
``measuring``: processor time and peak memory of whole measurements of the sample, each in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from speed import CONFIG, directions_of, matching, scene
from timing import fastest_ms, used

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.matching.accurate import AccurateMethod
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.optics.aperture import design_named
from chromaperture.products.samples import open_sample
from chromaperture.settings.stages import LayersConfig
from chromaperture.system.threads import thread_count

SIZES = ((240, 320), (360, 640), (480, 960), (720, 1280))
LAYERS = (16, 24, 32, 48, 64)
QUALITIES = ("real-time", "accurate")
VALUES = {
    "pixels": (240, 480, 960, 1440, 3000, 6000),  # along the width
    "layers": (0.5, 0.75, 1.0, 1.5, 2.0),  # of those of the camera, in the same range
    "blur": (0.5, 0.75, 1.0, 1.25, 1.5),  # of the range of the camera, in as many layers
    "photographs": (1, 2, 4, 8),
}
LABELS = {
    "pixels": "megapixels",
    "layers": "layers",
    "blur": "widest blur, px at the pupil's edge",
    "photographs": "photographs of 0.35 megapixels",
}


def part_matching(height: int, width: int, layers: int) -> Callable[[], object]:
    """One match of a cut from the scene of `speed.py`, as a function without arguments."""
    aperture = design_named("cy_halves")
    views, guide, _ = scene(directions_of(aperture))
    views, guide = [view[:height, :width].copy() for view in views], guide[:height, :width].copy()
    return matching(aperture, views, guide, CONFIG.with_range(-layers / 4, layers / 4 - 0.5))


def line(sizes: Sequence[float], times: dict[str, float]) -> dict[str, float]:
    """Fixed part and slope of a straight line, and the largest relative distance from it."""
    values = np.array(list(times.values()))
    slope, fixed = np.polyfit(sizes, values, 1, w=1 / values)
    off = float(np.max(np.abs(fixed + slope * np.array(sizes) - values) / values))
    rounded = {name: round(ms, 1) for name, ms in times.items()}
    return rounded | {"fixed_ms": round(float(fixed), 1), "per_unit_ms": round(float(slope), 2), "off": round(off, 3)}


def matcher() -> None:
    threads = min(2, thread_count())
    pixels = fastest_ms({f"{h}x{w}": part_matching(h, w, 32) for h, w in SIZES}, threads=threads)
    print(json.dumps({"ms_by_megapixels": line([h * w / 1e6 for h, w in SIZES], pixels)}), flush=True)
    layers = fastest_ms({str(n): part_matching(720, 1280, n) for n in LAYERS}, threads=threads)
    print(json.dumps({"ms_by_layers": line(LAYERS, layers)}), flush=True)


def with_layers(camera: CodedApertureCamera, own: LayersConfig, axis: str, factor: float) -> tuple[LayersConfig, float]:
    """More layers in the same range, or as many in a wider one; and the place on the axis."""
    if axis == "layers":
        wanted = round(factor * len(own.values_px))
        layers = replace(own, step_px=(own.values_px[-1] - own.min_px) / (wanted - 1))
        return layers, len(layers.values_px)
    layers = LayersConfig(*(factor * end for end in (own.min_px, own.max_px, own.step_px)))
    return layers, float(np.abs(layers.values_px).max() / camera.alignment.lens_shift.blur.reach)


def case(quality: str, axis: str, value: float) -> dict:
    """Measure in this process, after one measurement that is not counted."""
    camera, image = open_sample(quality=quality, device="cpu")
    repeats, place = 1, value
    if axis == "pixels":
        size = int(value), int(value) * 2 // 3
        image = cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)
        camera, place = camera.at_size(*size), size[0] * size[1] / 1e6
    if axis == "photographs":
        repeats = int(value)
    measure: Callable[[], object] = partial(camera.measure, image)
    if axis in ("layers", "blur"):
        method = camera.method
        assert isinstance(method, RealTimeMethod | AccurateMethod)
        layers, place = with_layers(camera, method.config.layers, axis, value)
        measure = partial(replace(method, config=replace(method.config, layers=layers)).match, image)
    measure()
    begin = time.process_time()
    for _ in range(repeats):
        measure()
    seconds = time.process_time() - begin
    return {"quality": quality, "axis": axis, "place": place, "cpu_s": seconds, "peak_gb": used()["peak_gb"]}


def measuring(axes: Sequence[str], out: Path | None) -> None:
    rows: list[dict] = []
    for axis in axes:
        for quality in QUALITIES:
            for value in VALUES[axis]:
                command = [sys.executable, __file__, "measuring", "--case", quality, axis, str(value)]
                run = subprocess.run(command, capture_output=True, text=True, check=True)
                rows.append(json.loads(run.stdout.splitlines()[-1]))
                print(json.dumps(rows[-1]), flush=True)
    if out is not None:
        draw(rows, axes, out)


def draw(rows: Sequence[dict], axes: Sequence[str], out: Path) -> None:
    """Draw processor time and memory against every axis."""
    figure, places = plt.subplots(2, len(axes), figsize=(3.25 * len(axes), 5.6), squeeze=False, layout="constrained")
    for (top, bottom), axis in zip(places.T, axes, strict=True):
        for quality, marker in zip(QUALITIES, "os", strict=True):
            own = [row for row in rows if (row["axis"], row["quality"]) == (axis, quality)]
            for place, key in ((top, "cpu_s"), (bottom, "peak_gb")):
                place.plot([row["place"] for row in own], [row[key] for row in own], marker=marker, label=quality)
                place.set_xlabel(LABELS[axis])
                place.grid(alpha=0.3)
                place.set_xscale("log" if axis == "pixels" else "linear")
        top.set_yscale("log")
        bottom.set_ylim(bottom=0)
    places[0, 0].set_ylabel("processor time, s")
    places[1, 0].set_ylabel("peak memory, GB")
    places[0, 0].legend()
    figure.savefig(out, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=["matcher", "measuring"])
    parser.add_argument("--axes", nargs="+", choices=VALUES, default=list(VALUES), help="of measuring")
    parser.add_argument("--out", type=Path, help="picture of measuring, as PNG")
    parser.add_argument("--case", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.case:
        print(json.dumps(case(args.case[0], args.case[1], float(args.case[2]))))
    elif args.part == "matcher":
        matcher()
    else:
        measuring(args.axes, args.out)


if __name__ == "__main__":
    main()

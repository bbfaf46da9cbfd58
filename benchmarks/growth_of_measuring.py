"""How processor time and memory of a measurement grow with pixels, layers, blur and photographs.

    python benchmarks/growth_of_measuring.py --out DIR

The sample of 720x480 px is measured as it is, enlarged and reduced; with more and fewer layers in the same range; with
as many layers in a wider and a narrower range, which is blur; and several times one after the other. Every point is a
process of its own that measures once before it counts. Writes DIR/growth.json and DIR/growth.png.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.matching.accurate import AccurateMethod
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.products.samples import open_sample
from chromaperture.settings.stages import LayersConfig

QUALITIES = ("real-time", "accurate")
VALUES = {
    "pixels": (240, 480, 960, 1440, 3000, 6000),  # along the width
    "layers": (0.5, 0.75, 1.0, 1.5, 2.0),  # of those of the camera
    "blur": (0.5, 0.75, 1.0, 1.25, 1.5),  # of the range of the camera
    "photographs": (1, 2, 4, 8),
}
UNITS = {
    "pixels": "megapixels", "layers": "layers", "blur": "widest blur, px at the pupil's edge",
    "photographs": "photographs of 0.35 megapixels",
}  # fmt: skip


def with_layers(camera: CodedApertureCamera, own: LayersConfig, axis: str, factor: float) -> tuple[LayersConfig, float]:
    """More layers in the same range, or as many in a wider one; and the place on the axis."""
    count = len(own.values_px)
    if axis == "layers":
        wanted = round(factor * count)
        layers = replace(own, step_px=(own.values_px[-1] - own.min_px) / (wanted - 1))
        return layers, len(layers.values_px)
    layers = LayersConfig(*(factor * end for end in (own.min_px, own.max_px, own.step_px)))
    blur = camera.alignment.lens_shift.blur
    return layers, float(np.abs(layers.values_px).max() / blur.reach)


def case(quality: str, axis: str, value: float) -> dict:
    """Measure in this process."""
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
    # Not `ru_maxrss`, which a process inherits from the one that started it.
    status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    peak = next(line for line in status if line.startswith("VmHWM")).split()[1]
    return {"quality": quality, "axis": axis, "place": place, "cpu_s": seconds, "peak_gb": int(peak) / 1e6}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--case", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.case:
        print(json.dumps(case(args.case[0], args.case[1], float(args.case[2]))))
        return
    if args.out is None:
        parser.error("give --out DIR")
    args.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for axis, values in VALUES.items():
        for quality in QUALITIES:
            for value in values:
                command = [sys.executable, __file__, "--case", quality, axis, str(value)]
                run = subprocess.run(command, capture_output=True, text=True, check=True)
                rows.append(json.loads(run.stdout.splitlines()[-1]))
                print(json.dumps(rows[-1]), flush=True)
    (args.out / "growth.json").write_text(json.dumps(rows, indent=1))
    plot(rows, args.out / "growth.png")


def plot(rows: list[dict], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    _, axes = pyplot.subplots(2, 4, figsize=(13, 5.6), layout="constrained")
    for column, axis in enumerate(VALUES):
        for quality, mark in zip(QUALITIES, "os", strict=True):
            of = [row for row in rows if row["axis"] == axis and row["quality"] == quality]
            for line, key in enumerate(("cpu_s", "peak_gb")):
                place, figures = [row["place"] for row in of], [row[key] for row in of]
                axes[line, column].plot(place, figures, mark + "-", label=quality)
        for panel, label in zip(axes[:, column], ("processor time, s", "peak memory, GB"), strict=True):
            panel.set(xlabel=UNITS[axis], ylabel=label if column == 0 else None)
            panel.set(xscale="log") if axis == "pixels" else panel.set(xlim=(0, None))
            panel.set(yscale="log") if panel is axes[0, column] else panel.set(ylim=(0, None))
            panel.grid(alpha=0.3)
    axes[0, 0].legend()
    pyplot.savefig(path, dpi=100)


if __name__ == "__main__":
    main()

"""How the real-time matcher's time grows with pixels and with layers: a line through the origin is linear growth.

    python benchmarks/run.py growth [--json]
    python benchmarks/growth.py --out growth.png      # the same as a picture

``exponent`` is the slope of log time over log size by least squares: 1 is linear.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numba
import numpy as np
from matcher import CONFIG, NOISE, scene
from timing import fastest_ms

from chromaperture.color.unmixing import view_directions
from chromaperture.disparity import coarse_kernels
from chromaperture.disparity.inputs import prepare_views
from chromaperture.optics.aperture import design_named

SIZES = ((240, 320), (360, 640), (480, 960), (720, 1280))
LAYERS = (16, 24, 32, 48, 64)


def matching(height: int, width: int, layers: int):
    """One match of a cut from the benchmark's scene, as a function without arguments."""
    directions = view_directions(design_named("cy_halves"))
    views, guide, _ = scene(directions)
    views, guide = [view[:height, :width].copy() for view in views], guide[:height, :width].copy()
    config = CONFIG.with_range(-layers / 4, layers / 4 - 0.5)
    even = np.broadcast_to(np.float32(NOISE**2), (height, width, 2))
    noise = {"noise_variance": even, "noise_covariance": even[..., :1]}
    mask = np.ones((height, width), bool)

    def match() -> None:
        inputs = prepare_views(views, guide, mask, directions=directions, config=config, **noise)
        coarse_kernels.match(inputs, config)

    return match


def benchmark() -> dict:
    threads = min(2, numba.config.NUMBA_NUM_THREADS)
    pixels = fastest_ms({f"{h}x{w}": matching(h, w, 32) for h, w in SIZES}, threads=threads)
    layers = fastest_ms({str(n): matching(720, 1280, n) for n in LAYERS}, threads=threads)
    return {
        "growth": {
            "pixels_ms": {**rounded(pixels), "exponent": exponent([h * w for h, w in SIZES], pixels)},
            "layers_ms": {**rounded(layers), "exponent": exponent(LAYERS, layers)},
        }
    }


def rounded(times: dict[str, float]) -> dict[str, float]:
    return {name: round(time, 1) for name, time in times.items()}


def exponent(sizes, times: dict[str, float]) -> float:
    return round(float(np.polyfit(np.log(sizes), np.log(list(times.values())), 1)[0]), 2)


def main() -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("growth.png"))
    out = parser.parse_args().out
    result = benchmark()["growth"]
    _, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for axis, name, sizes, label in (
        (left, "pixels_ms", [h * w / 1e6 for h, w in SIZES], "megapixels (32 layers)"),
        (right, "layers_ms", LAYERS, "layers (1280 x 720)"),
    ):
        times = [time for key, time in result[name].items() if key != "exponent"]
        axis.plot(sizes, times, "o-")
        axis.set(xlabel=label, ylabel="ms", xlim=(0, None), ylim=(0, None))
        axis.set_title(f"exponent {result[name]['exponent']}")
    pyplot.savefig(out, dpi=110)
    print(result, out)


if __name__ == "__main__":
    main()

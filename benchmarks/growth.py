"""How the real-time matcher's time grows with pixels and with layers: a straight line, with a fixed part, is linear.

    python benchmarks/run.py growth [--json]
    python benchmarks/growth.py --out growth.png      # the same as a picture

``fixed_ms`` and ``per_unit_ms`` are those of the straight line; ``off_line`` is the largest distance from it, relative.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matcher import CONFIG, matching, scene
from timing import fastest_ms

from chromaperture.matching.views import view_spaces
from chromaperture.optics.aperture import design_named
from chromaperture.system.threads import thread_count

SIZES = ((240, 320), (360, 640), (480, 960), (720, 1280))
LAYERS = (16, 24, 32, 48, 64)


def part_matching(height: int, width: int, layers: int):
    """One match of a cut from the benchmark's scene, as a function without arguments."""
    aperture = design_named("cy_halves")
    views, guide, _ = scene(view_spaces(aperture, None, CONFIG.space)[0].directions)
    views, guide = [view[:height, :width].copy() for view in views], guide[:height, :width].copy()
    return matching(aperture, views, guide, CONFIG.with_range(-layers / 4, layers / 4 - 0.5))


def benchmark() -> dict:
    threads = min(2, thread_count())
    pixels = fastest_ms({f"{h}x{w}": part_matching(h, w, 32) for h, w in SIZES}, threads=threads)
    layers = fastest_ms({str(n): part_matching(720, 1280, n) for n in LAYERS}, threads=threads)
    return {
        "growth": {
            "pixels_ms": {**rounded(pixels), **line([h * w / 1e6 for h, w in SIZES], pixels)},
            "layers_ms": {**rounded(layers), **line(LAYERS, layers)},
        }
    }


def rounded(times: dict[str, float]) -> dict[str, float]:
    return {name: round(time, 1) for name, time in times.items()}


def line(sizes, times: dict[str, float]) -> dict[str, float]:
    """Fit a straight line, in relative errors."""
    values = np.array(list(times.values()))
    slope, fixed = np.polyfit(sizes, values, 1, w=1 / values)
    off = float(np.max(np.abs(fixed + slope * np.array(sizes) - values) / values))
    return {"fixed_ms": round(float(fixed), 1), "per_unit_ms": round(float(slope), 2), "off_line": round(off, 3)}


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
        found = result[name]
        times = [time for key, time in found.items() if key[0].isdigit()]
        axis.plot(sizes, times, "o")
        ends = np.array([0, max(sizes)])
        axis.plot(ends, found["fixed_ms"] + found["per_unit_ms"] * ends, "-", color="grey")
        axis.set(xlabel=label, ylabel="ms", xlim=(0, None), ylim=(0, None))
        axis.set_title(f"{found['fixed_ms']} + {found['per_unit_ms']} ms each, off by {found['off_line']:.1%}")
    pyplot.savefig(out, dpi=110)
    print(result, out)


if __name__ == "__main__":
    main()

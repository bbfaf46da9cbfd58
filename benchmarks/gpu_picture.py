"""Draw the data's way through the device, of docs/gpu.md: gpu.svg of quality real-time, gpu_accurate.svg of accurate.

python benchmarks/gpu_picture.py [--out docs/images]
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

REAL_TIME = (
    ("photograph", "light, mixing,\nhalving, fill, blur", "samples at every\nsub-pixel phase", "windows,\ncovariances",
     "correlation"),
    ("best layer,\nplace between", "four paths", "log-likelihood\nat the labels"),
    ("smoothing along\nthe surface", "surface, range,\nerror bar", "enlarge,\nconfidence", "conversion to\nmillimetres",
     "maps"),
)  # fmt: skip
ACCURATE = (
    ("photograph,\nguide, noise", "tiles, spectra,\nrays", "correlations,\nwindows", "log-likelihood\nat the labels",
     "paths, place,\nposterior"),
    ("thin plate", "regions choose\nplanes and join", "sums of\nblocks"),
    ("labels of pixels", "known pixels,\nlearned error bar", "conversion to\nmillimetres", "aligned colours", "maps"),
)  # fmt: skip
CPU = {"photograph", "maps"}
CPU_OF_ACCURATE = {ACCURATE[0][0], *ACCURATE[1][:2], *ACCURATE[2]}
WIDTH, HEIGHT, GAP_X, GAP_Y = 1.5, 0.62, 0.42, 0.42
ON_CPU, ON_DEVICE = "#f3e3c3", "#d7e6f5"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    out = parser.parse_args().out
    draw(REAL_TIME, "up: 12 bytes a pixel", "down: 20 bytes a pixel", out / "gpu.svg")
    ends = "up: 24 bytes a pixel", "down: 12 bytes a pixel, and 1/4 a label"
    meanwhile = "depth edges, while\nthe device works"
    draw(ACCURATE, *ends, out / "gpu_accurate.svg", on_cpu=CPU_OF_ACCURATE, down_row=1, meanwhile=meanwhile)


def draw(
    rows: tuple[tuple[str, ...], ...],
    up: str,
    down: str,
    out: Path,
    *,
    on_cpu: set[str] = CPU,
    down_row: int = 2,
    meanwhile: str = "",
) -> None:
    """Draw boxes of three rows, of which the second runs back; ``meanwhile`` stands before the second."""
    figure, axes = plt.subplots(figsize=(9.6, 3.3))
    places = []
    for row, names in enumerate(rows):
        # The second row runs back, from the right.
        columns = (4, 3, 2)[::-1] if row == 1 else range(5)
        places.append([(column * (WIDTH + GAP_X), -row * (HEIGHT + GAP_Y)) for column in columns])
        for name, (x, y) in zip(names, places[-1], strict=True):
            color = ON_CPU if name in on_cpu else ON_DEVICE
            axes.add_patch(FancyBboxPatch((x, y), WIDTH, HEIGHT, boxstyle="round,pad=0.03", fc=color, ec="#555555"))
            axes.text(x + WIDTH / 2, y + HEIGHT / 2, name, ha="center", va="center", fontsize=8)
    first, second, third = places
    way = [*first, *second[::-1], *third]
    for (x, y), (to_x, to_y) in pairwise(way):
        if y == to_y:
            ahead = to_x > x
            ends = (x + WIDTH * ahead, y + HEIGHT / 2), (to_x + WIDTH * (not ahead), to_y + HEIGHT / 2)
        else:
            ends = (x + WIDTH / 2, y), (to_x + WIDTH / 2, to_y + HEIGHT)
        style = {"arrowstyle": "-|>", "mutation_scale": 10, "color": "#555555", "shrinkA": 3, "shrinkB": 3}
        axes.add_patch(FancyArrowPatch(*ends, **style))
    axes.text(WIDTH + GAP_X / 2, first[0][1] + HEIGHT + 0.1, up, ha="center", fontsize=8)
    axes.text(4 * (WIDTH + GAP_X) - GAP_X / 2, places[down_row][0][1] - 0.22, down, ha="center", fontsize=8)
    axes.text(WIDTH / 2, second[0][1] + HEIGHT / 2, meanwhile, ha="center", va="center", fontsize=8)
    axes.set_xlim(-0.1, 5 * (WIDTH + GAP_X))
    axes.set_ylim(third[0][1] - 0.3, HEIGHT + 0.3)
    axes.set_aspect("equal")
    axes.axis("off")
    figure.savefig(out, bbox_inches="tight", metadata={"Date": None})


if __name__ == "__main__":
    main()

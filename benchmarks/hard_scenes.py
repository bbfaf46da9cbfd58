"""Bad input: what the sample camera (halves, V) answers, and whether its error bar says how wrong it is.

    python benchmarks/hard_scenes.py --out FOLDER [--case WORD ...] [--json]

Ray-traced photographs of ``hard_cases.py``. Each is measured by `accurate` and `real-time`; printed are, in the
affected area and of all pixels with known truth, the fraction that is answered, the fraction within 5 % of the truth
(an unknown depth counts as wrong), the fractions of the answers' errors within 2 and beyond 3 error bars, and the
median of error bar / depth. In a mirror its surface and the mirrored scene are right, in the strip that a moving card
covers for a part of the exposure the card and what is behind. FOLDER gets ``hard_scenes.png`` and ``hard_scenes.json``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib as mpl
import numpy as np
from hard_cases import Shot, shots

from chromaperture.color.color_maps import DIFFERENCE, DISTANCE
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.products.samples import open_sample

QUALITIES = ("accurate", "real-time")
COLUMNS = ("answered", "within_5", "within_2_bars", "beyond_3_bars", "bar_over_depth")


def errors(frame: DepthFrame, shot: Shot) -> np.ndarray:
    """Error of every pixel, mm, by the nearest of the answers that are right; NaN where there is none or no truth."""
    error = frame.depth_mm - shot.depth_mm
    if shot.also_right_mm is not None:
        other = frame.depth_mm - shot.also_right_mm
        error = np.where(np.abs(other) < np.abs(error), other, error)
    return error


def figures(frame: DepthFrame, shot: Shot, area: np.ndarray) -> dict[str, float]:
    known = area & np.isfinite(shot.depth_mm)
    answered = known & np.isfinite(frame.depth_mm)
    error = np.abs(errors(frame, shot))
    right_mm = np.abs(frame.depth_mm - errors(frame, shot))
    bars = error[answered] / frame.sigma_mm[answered]
    rows = (
        answered.sum() / known.sum(),
        (error[answered] < 0.05 * right_mm[answered]).sum() / known.sum(),
        (bars < 2).mean() if bars.size else np.nan,
        (bars > 3).mean() if bars.size else np.nan,
        np.median(frame.sigma_mm[answered] / frame.depth_mm[answered]) if bars.size else np.nan,
    )
    return {name: round(float(value), 3) for name, value in zip(COLUMNS, rows, strict=True)}


def picture(rows: list[tuple[str, Shot, dict[str, DepthFrame]]], path: Path) -> None:
    """Draw a row a case: photograph with the affected area, truth, depth, error over error bar."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    heads = ["photograph", "truth"]
    heads += [f"{q}: {what}" for q in QUALITIES for what in ("depth", "error / error bar")]
    fig, axes = plt.subplots(len(rows), len(heads), figsize=(12, 1.3 * len(rows) + 0.35), squeeze=False)
    for line, (name, shot, frames) in zip(axes, rows, strict=True):
        low, high = (float(np.nanpercentile(shot.depth_mm, p)) for p in (0.5, 99.5))
        margin = 0.1 * (high - low) + 50
        limits = {"vmin": low - margin, "vmax": high + margin, "cmap": DISTANCE}
        shown = np.clip(shot.image, 0, 1) ** (1 / 2.2)
        line[0].imshow(shown[::2, ::2])
        if not shot.affected.all():
            line[0].contour(shot.affected[::2, ::2], [0.5], colors="white", linewidths=0.5)
        line[0].set_ylabel(name.replace(", ", ",\n").replace(": ", ":\n").replace(" with ", "\nwith "), fontsize=6.5)
        drawn = [line[1].imshow(shot.depth_mm[::2, ::2], **limits)]
        for i, quality in enumerate(QUALITIES):
            frame = frames[quality]
            ratio = errors(frame, shot) / frame.sigma_mm
            drawn.append(line[2 + 2 * i].imshow(frame.depth_mm[::2, ::2], **limits))
            drawn.append(line[3 + 2 * i].imshow(ratio[::2, ::2], vmin=-4, vmax=4, cmap=DIFFERENCE))
        for axis, image in zip(line[1:], drawn, strict=True):
            axis.set_facecolor("black")
            bar = fig.colorbar(image, ax=axis, fraction=0.032, pad=0.02)
            bar.ax.tick_params(labelsize=5, length=1.5, pad=1)
        line[1].text(1.0, 1.02, "mm", transform=line[1].transAxes, fontsize=5, ha="left")
        for axis in line:
            axis.set(xticks=[], yticks=[])
    for axis, head in zip(axes[0], heads, strict=True):
        axis.set_title(head, fontsize=7)
    top = 1 - 0.3 / fig.get_figheight()
    fig.subplots_adjust(left=0.045, right=0.98, bottom=0.005, top=top, hspace=0.04, wspace=0.16)
    fig.savefig(path, dpi=100)
    plt.close(fig)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--case", nargs="+", default=[], help="words of the cases' names; all without")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    cameras = {quality: open_sample(quality=quality)[0] for quality in QUALITIES}
    report: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    rows = []
    for name, shot in shots(args.case):
        frames = {quality: camera.measure(shot.image) for quality, camera in cameras.items()}
        rows.append((name, shot, frames))
        areas = {"affected": shot.affected, "all": np.ones_like(shot.affected)}
        report[name] = {q: {a: figures(f, shot, area) for a, area in areas.items()} for q, f in frames.items()}
        if not args.json:
            for quality, parts in report[name].items():
                cells = (" ".join(f"{v:6.3f}" for v in part.values()) for part in parts.values())
                print(f"{name:32s} {quality:10s} " + "  |  ".join(cells), flush=True)
    picture(rows, args.out / "hard_scenes.png")
    (args.out / "hard_scenes.json").write_text(json.dumps(report, indent=1))
    if args.json:
        print(json.dumps(report))


if __name__ == "__main__":
    main()

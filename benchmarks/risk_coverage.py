"""Does the error bar rank, and is it honest? By captures with known truth, all designs and qualities.

    python benchmarks/risk_coverage.py --data FOLDER --cameras FOLDER --out curves.png --tenths tenths.png

FOLDER of ``--data`` is that of ``bench50.py``; the cameras' holds one camera file a design, DESIGN.asdf. Pixels are
ordered by the error bar's share of the depth. The risk at a coverage c is the share of errors above 2 % among the first
c of all pixels with known truth; an unknown depth comes last and is wrong. The oracle orders them by their true error.
``excess`` is the area between the two curves: 0 for a perfect order; the error bar's order is of use if the area under
its curve is below the risk of all pixels, which is that of a random order.

Honest is an error bar if it holds as many errors as it promises wherever it is short and wherever it is long. The
pixels of a scene with a depth, in the same order, are cut into ten equal parts; of each part it is counted how many
errors lie within one and two error bars. Figures are means over the scenes. Of Gaussian errors .68 and .95 would.
``right`` counts the tenths of which both shares are as asked, ``possible`` those that some factor on their bars, one
for each tenth by the truth, would make right: what is missing then is not the length of the bars but their order.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from chromaperture.camera.camera import load_camera

WRONG = 0.02  # of the depth
WITHIN = "within_1_sigma", "within_2_sigma"
ASKED = (0.55, 0.80), (0.88, 0.99)  # of every tenth, within one and two error bars
FACTORS = np.geomspace(0.05, 20, 400)  # on the bars of a tenth


def order_of_trust(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the pixels with known truth, the most trusted first, and ordered by themselves; (N,) each."""
    known = np.isfinite(truth)
    error = np.where(np.isfinite(depth), np.abs(depth - truth) / truth, np.inf)[known]
    trust = np.where(np.isfinite(depth) & np.isfinite(sigma), sigma / depth, np.inf)[known]
    return error[np.argsort(trust, kind="stable")], np.sort(error)


def risk(error: np.ndarray) -> np.ndarray:
    """Share of wrong depths among the first 1, 2, ... N pixels."""
    return np.cumsum(error > WRONG) / np.arange(1, len(error) + 1)


def tenths(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> list[np.ndarray]:
    """Errors in error bars, sorted, by tenth of the pixels, the most trusted first."""
    answered = np.isfinite(truth) & np.isfinite(depth) & np.isfinite(sigma)
    bars = (np.abs(depth - truth) / sigma)[answered][np.argsort((sigma / depth)[answered], kind="stable")]
    return [np.sort(part) for part in np.array_split(bars, 10)]


def shares_of(parts: list[np.ndarray], factor: float) -> np.ndarray:
    """Share of the errors within 1 and 2 error bars, both times a factor, mean over scenes; (2,)."""
    return np.mean([np.searchsorted(part, [factor, 2 * factor]) / len(part) for part in parts], axis=0)


def as_asked(shares: np.ndarray) -> bool:
    """Whether both shares lie in the ranges that are asked for."""
    return all(low <= share <= high for share, (low, high) in zip(shares, ASKED, strict=True))


def draw_tenths(axis: Axes, shares: np.ndarray) -> None:
    """Draw the (10, 2) shares of every tenth over the ranges that are asked for."""
    tenth = np.arange(1, 11)
    for column, (low, high), color in zip(shares.T, ASKED, ("tab:blue", "tab:orange"), strict=True):
        axis.axhspan(low, high, color=color, alpha=0.15, linewidth=0)
        axis.plot(tenth, column, "o-", color=color, markersize=3)
    axis.set(xlim=(0.5, 10.5), ylim=(0, 1.02))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--cameras", type=Path, required=True)
    parser.add_argument("--designs", nargs="+", default=["cy_halves", "rgb_squares", "cmy_circles", "cy_open"])
    parser.add_argument("--scenes", nargs="+", default=["steps", "room", "desk"])
    parser.add_argument("--quality", nargs="+", default=["paper", "real-time", "accurate"])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tenths", type=Path, help="draw the share of errors within 1 and 2 error bars, by tenth")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = []
    (figure, axes), (second, bar_axes) = (
        plt.subplots(
            len(args.quality), len(args.designs), figsize=(3.2 * len(args.designs), 2.9 * len(args.quality)),
            sharex=True, sharey=True, squeeze=False, layout="constrained",
        )
        for _ in range(2)
    )  # fmt: skip
    coverage = np.linspace(0.01, 1, 100)
    for row, bar_row, quality in zip(axes, bar_axes, args.quality, strict=True):
        for axis, bar_axis, design in zip(row, bar_row, args.designs, strict=True):
            camera = load_camera(args.cameras / f"{design}.asdf", quality=quality)
            trusted, best, bars = [], [], []
            for scene in args.scenes:
                depth = camera.measure(args.data / design / "scene" / f"{scene}.png")
                truth = cv2.imread(str(args.data / "truth" / f"{scene}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED) / 10.0
                maps = depth.depth_mm, depth.sigma_mm, np.where(truth > 0, truth, np.nan)
                errors = order_of_trust(*maps)
                bars.append(tenths(*maps))
                for curves, error in zip((trusted, best), errors, strict=True):
                    curve = risk(error)
                    curves.append(curve[np.ceil(coverage * len(curve)).astype(int) - 1])
            found, oracle = (np.mean(part, axis=0) for part in (trusted, best))
            of_tenth = list(zip(*bars, strict=True))
            shares = np.array([shares_of(parts, 1.0) for parts in of_tenth])
            rows.append(
                {
                    "design": design, "quality": quality,
                    "area": round(float(found.mean()), 3), "oracle": round(float(oracle.mean()), 3),
                    "excess": round(float((found - oracle).mean()), 3), "risk_of_all": round(float(found[-1]), 3),
                    "risk_of_half": round(float(found[49]), 3),
                    "right": sum(map(as_asked, shares)),
                    "possible": sum(any(as_asked(shares_of(parts, f)) for f in FACTORS) for parts in of_tenth),
                    "within_1_sigma": shares[:, 0].round(3).tolist(), "within_2_sigma": shares[:, 1].round(3).tolist(),
                }
            )  # fmt: skip
            axis.plot(coverage, found, color="tab:blue", label="by the error bar")
            axis.plot(coverage, oracle, color="0.6", label="by the true error")
            axis.axhline(found[-1], color="0.6", linestyle=":", label="random order")
            draw_tenths(bar_axis, shares)
            for each in (axis, bar_axis):
                each.set_title(f"{design}, {quality}", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("coverage")
    for axis in axes[:, 0]:
        axis.set_ylabel("share with error > 2 %")
    axes[0, 0].set(xlim=(0, 1), ylim=(0, 1))
    axes[0, 0].legend(fontsize=7)
    figure.savefig(args.out, dpi=110)
    for axis in bar_axes[-1]:
        axis.set_xlabel("tenth of the pixels, shortest bars first")
    for axis in bar_axes[:, 0]:
        axis.set_ylabel("within 1 / 2 bars")
    if args.tenths:
        second.savefig(args.tenths, dpi=110)
    if args.json:
        print(json.dumps(rows, indent=2))
        return
    print("design        quality     area   oracle  excess  of all  of half   within 1 bar: mean, tenths   within 2"
          "               right  possible")
    for r in rows:
        one, two = (f"{np.mean(r[k]):.2f}, {min(r[k]):.2f} to {max(r[k]):.2f}" for k in WITHIN)
        print(f"{r['design']:13} {r['quality']:10} {r['area']:5.3f}  {r['oracle']:6.3f}  {r['excess']:6.3f}  "
              f"{r['risk_of_all']:6.3f}  {r['risk_of_half']:7.3f}   {one:26}   {two:20}   "
              f"{r['right']:3}   {r['possible']:3}")  # fmt: skip


if __name__ == "__main__":
    main()

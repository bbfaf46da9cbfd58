"""Does the error bar rank? Share of wrong depths among the pixels that it trusts most, of captures with known truth.

    python benchmarks/risk_coverage.py --data FOLDER --cameras FOLDER --out curves.png

FOLDER of ``--data`` is that of ``bench50.py``; the cameras' holds one camera file a design, DESIGN.asdf. Pixels are
ordered by the error bar's share of the depth. The risk at a coverage c is the share of errors above 2 % among the first
c of all pixels with known truth; an unknown depth comes last and is wrong. The oracle orders them by their true error.
``excess`` is the area between the two curves: 0 for a perfect order; the error bar's order is of use if the area under
its curve is below the risk of all pixels, which is that of a random order.
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

from chromaperture.camera import load_camera

WRONG = 0.02  # of the depth


def order_of_trust(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the pixels with known truth, the most trusted first, and ordered by themselves; (N,) each."""
    known = np.isfinite(truth)
    error = np.where(np.isfinite(depth), np.abs(depth - truth) / truth, np.inf)[known]
    trust = np.where(np.isfinite(depth) & np.isfinite(sigma), sigma / depth, np.inf)[known]
    return error[np.argsort(trust, kind="stable")], np.sort(error)


def risk(error: np.ndarray) -> np.ndarray:
    """Share of wrong depths among the first 1, 2, ... N pixels."""
    return np.cumsum(error > WRONG) / np.arange(1, len(error) + 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--cameras", type=Path, required=True)
    parser.add_argument("--designs", nargs="+", default=["cy_halves", "rgb_squares", "cmy_circles", "cy_open"])
    parser.add_argument("--scenes", nargs="+", default=["steps", "room", "desk"])
    parser.add_argument("--quality", nargs="+", default=["real-time", "accurate"])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = []
    figure, axes = plt.subplots(
        len(args.quality), len(args.designs), figsize=(3.2 * len(args.designs), 2.9 * len(args.quality)),
        sharex=True, sharey=True, squeeze=False, layout="constrained",
    )  # fmt: skip
    coverage = np.linspace(0.01, 1, 100)
    for row, quality in zip(axes, args.quality, strict=True):
        for axis, design in zip(row, args.designs, strict=True):
            camera = load_camera(args.cameras / f"{design}.asdf", quality=quality)
            trusted, best = [], []
            for scene in args.scenes:
                depth = camera.measure(args.data / design / "scene" / f"{scene}.png")
                truth = cv2.imread(str(args.data / "truth" / f"{scene}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED) / 10.0
                errors = order_of_trust(depth.depth_mm, depth.sigma_mm, np.where(truth > 0, truth, np.nan))
                for curves, error in zip((trusted, best), errors, strict=True):
                    curve = risk(error)
                    curves.append(curve[np.ceil(coverage * len(curve)).astype(int) - 1])
            found, oracle = np.mean(trusted, axis=0), np.mean(best, axis=0)
            rows.append(
                {
                    "design": design, "quality": quality,
                    "area": round(float(found.mean()), 3), "oracle": round(float(oracle.mean()), 3),
                    "excess": round(float((found - oracle).mean()), 3), "risk_of_all": round(float(found[-1]), 3),
                    "risk_of_half": round(float(found[49]), 3),
                }
            )  # fmt: skip
            axis.plot(coverage, found, color="tab:blue", label="by the error bar")
            axis.plot(coverage, oracle, color="0.6", label="by the true error")
            axis.axhline(found[-1], color="0.6", linestyle=":", label="random order")
            axis.set_title(f"{design}, {quality}", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("coverage")
    for axis in axes[:, 0]:
        axis.set_ylabel("share with error > 2 %")
    axes[0, 0].set(xlim=(0, 1), ylim=(0, 1))
    axes[0, 0].legend(fontsize=7)
    figure.savefig(args.out, dpi=110)
    if args.json:
        print(json.dumps(rows, indent=2))
        return
    print("design        quality     area   oracle  excess  risk of all  of the most trusted half")
    for r in rows:
        print(f"{r['design']:13} {r['quality']:10} {r['area']:5.3f}  {r['oracle']:6.3f}  {r['excess']:6.3f}  "
              f"{r['risk_of_all']:11.3f}  {r['risk_of_half']:5.3f}")  # fmt: skip


if __name__ == "__main__":
    main()

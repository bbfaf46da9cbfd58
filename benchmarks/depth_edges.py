"""How wide is the wrong band beside a depth edge, and how good is the rest? By captures with known truth.

    python benchmarks/depth_edges.py --data FOLDER --cameras FOLDER --quality accurate --picture edges.png

FOLDER of ``--data`` is that of ``bench50.py``; the cameras' holds one camera file a design, DESIGN.asdf. A depth edge
is a step of the true distance by more than 5 % between two neighbours in a row or in a column. From it the wrong pixels
(error above 5 %) on either side are counted until the first right one, at most up to the next edge and up to 40 px: the
width of the wrong band is the sum of both sides. Blur is that of the nearer or the farther side, whichever is larger.
An edge lies between right surfaces if most of the pixels that would be counted are right on either side: there a band
is an edge in the wrong place, elsewhere it is a surface in the wrong place.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from chromaperture.camera.camera import load_camera
from chromaperture.model.camera_file import Calibration

STEP = 0.05  # of the distance
WRONG = 0.05
MOST_PX = 40  # of either side
APART_PX = 10  # from an edge: pixels beyond are counted apart
BLUR_PX = (0, 5, 10, 20, 40)


def edges_along_rows(truth: np.ndarray) -> np.ndarray:
    """Whether an edge lies between a pixel and the next of its row; (H, W - 1)."""
    log = np.log(truth)
    return np.abs(np.diff(log, axis=1)) > np.log1p(STEP)


def bands_of_line(wrong: np.ndarray, edges: np.ndarray) -> list[tuple[int, int, bool]]:
    """Place of every edge of a line, its wrong band, whether surfaces are right; of (W,) and (W - 1,) bool."""
    places = np.flatnonzero(edges)
    limits = np.concatenate([[-1], places, [len(edges)]])
    found = []
    for i, place in enumerate(places, start=1):
        before = wrong[max(limits[i - 1] + 1, place - MOST_PX + 1) : place + 1][::-1]
        behind = wrong[place + 1 : min(limits[i + 1], place + MOST_PX) + 1]
        width = sum(int(np.argmin(np.append(side, False))) for side in (before, behind))
        found.append((int(place), width, before.mean() < 0.5 and behind.mean() < 0.5))
    return found


def wrong_bands(depth: np.ndarray, truth: np.ndarray, blur_px: np.ndarray) -> np.ndarray:
    """Wrong band, px, blur, px, and whether surfaces are right, of edges along rows and columns; (N, 3)."""
    error = np.where(np.isfinite(depth), np.abs(depth - truth) / truth, np.inf)
    wrong = error > WRONG
    found = []
    for bad, true, blur in ((wrong, truth, blur_px), (wrong.T, truth.T, blur_px.T)):
        edges = edges_along_rows(true)
        for y in np.flatnonzero(edges.any(axis=1)):
            for place, width, right in bands_of_line(bad[y], edges[y]):
                found.append((width, max(blur[y, place], blur[y, place + 1]), right))
    return np.array(found, float).reshape(-1, 3)


def from_edges_px(truth: np.ndarray) -> np.ndarray:
    """Distance of every pixel from the nearest edge; (H, W), px."""
    edges = np.zeros(truth.shape, bool)
    edges[:, 1:] |= edges_along_rows(truth)
    edges[1:] |= edges_along_rows(truth.T).T
    return np.asarray(cv2.distanceTransform((~edges).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE))


def blur_of(truth: np.ndarray, calibration: Calibration) -> np.ndarray:
    """Diameter of the blur at the true distances, in the middle of the frame; px."""
    blur = calibration.field_blur()
    if blur is None:
        return np.full(truth.shape, np.nan)
    at_infinity, scale = blur.reference
    pupil_mm = truth - calibration.depth["accurate"].sensor_to_pupil_mm
    return np.asarray(2 * np.abs(at_infinity - scale / pupil_mm) / blur.reach)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--cameras", type=Path, required=True)
    parser.add_argument("--designs", nargs="+", default=["cy_halves", "rgb_squares", "cmy_circles", "cy_open"])
    parser.add_argument("--scenes", nargs="+", default=["steps", "room", "desk"])
    parser.add_argument("--quality", default="accurate")
    parser.add_argument("--picture", type=Path, help="draw the distribution of the widths")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    table = []
    for design in args.designs:
        camera = load_camera(args.cameras / f"{design}.asdf", quality=args.quality)
        bands, near, far = [], [], []
        for scene in args.scenes:
            stored = cv2.imread(str(args.data / "truth" / f"{scene}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED)
            truth = np.where(stored > 0, stored / 10.0, np.nan)
            depth = camera.measure(args.data / design / "scene" / f"{scene}.png").depth_mm
            bands.append(wrong_bands(depth, truth, blur_of(truth, camera.calibration)))
            right = np.where(np.isfinite(depth), np.abs(depth - truth) / truth, np.inf) < WRONG
            beyond = from_edges_px(truth) > APART_PX
            near.append(right[~beyond & np.isfinite(truth)].mean())
            far.append(right[beyond & np.isfinite(truth)].mean())
        widths, blurs, right = np.concatenate(bands).T
        median_between = float(np.median(widths[right > 0])) if right.any() else None
        by_blur = {
            f"{a}-{b}": [float(np.median(part)), len(part)]
            for a, b in itertools.pairwise(BLUR_PX)
            if len(part := widths[(blurs >= a) & (blurs < b)])
        }
        table.append(
            {
                "design": design, "quality": args.quality, "median_px": float(np.median(widths)),
                "mean_px": float(widths.mean()), "by_blur_px": by_blur,
                "between_right_surfaces": float(right.mean()),
                "median_px_between_right_surfaces": median_between,
                f"within_5_percent_up_to_{APART_PX}_px": float(np.mean(near)),
                f"within_5_percent_beyond_{APART_PX}_px": float(np.mean(far)),
            }
        )  # fmt: skip
        if not args.json:
            parts = ", ".join(f"blur {k} px: {v:.0f} ({n} edges)" for k, (v, n) in by_blur.items())
            print(f"{design:12} {args.quality}: wrong band median {np.median(widths):.1f}, mean {widths.mean():.1f} px "
                  f"({parts}); {right.mean():.2f} of the edges lie between right surfaces, median there "
                  f"{median_between} px; "
                  f"within 5 %: {np.mean(near):.3f} up to {APART_PX} px from an edge, {np.mean(far):.3f} beyond",
                  flush=True)  # fmt: skip
        axis.plot(np.sort(widths), np.linspace(0, 1, len(widths)), label=design)
    axis.set(xlabel="wrong band beside a depth edge, px", ylabel="share of the edges", xlim=(0, 2 * MOST_PX))
    axis.legend()
    if args.picture:
        figure.savefig(args.picture, dpi=110)
    if args.json:
        print(json.dumps(table, indent=2))


if __name__ == "__main__":
    main()

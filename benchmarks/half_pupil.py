"""Score the matcher on real photographs through the left and the right half of a pupil, against measured defocus.

    python benchmarks/half_pupil.py --data FOLDER [--quality paper real-time accurate] [--out DIR] [--json]

FOLDER holds NNN_left.png, NNN_right.png, NNN_gt_defocus.png (0 = unknown, the middle two thirds of the frame) and
calibration/white_sheet_*.png. Red is the right half, blue the left one, green their mean: optics and noise are real,
the colours put together, at half the resolution. With this order disparity grows with distance, as for film, which
`accurate` counts on where a near surface hides a far one. Spearman's correlation needs no calibration.
Coverage is the fraction of the pixels with truth that is scored: those of the shortest error bars.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import spearmanr

from chromaperture.camera import CodedApertureCamera
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import default_config
from chromaperture.color.color_maps import DISTANCE, color_map
from chromaperture.config import Quality

BLACK = 1024.0
COVERAGES = (0.5, 0.7, 0.8, 0.9, 1.0)
CROP = np.s_[126:630, 168:840]


def half_size(picture: np.ndarray) -> np.ndarray:
    return cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def read(path: Path) -> np.ndarray:
    return half_size(cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float32))


def capture(folder: Path, scene: str) -> np.ndarray:
    """Photograph of a cyan/yellow pupil; (756, 1008, 3) float32."""
    sides = []
    for side in ("left", "right"):
        sheet = cv2.GaussianBlur(read(folder / "calibration" / f"white_sheet_{side}.png") - BLACK, (0, 0), 12)
        sides.append((read(folder / f"{scene}_{side}.png") - BLACK) / sheet)
    image = np.dstack([sides[1], (sides[0] + sides[1]) / 2, sides[0]]).astype(np.float32)
    return image * np.float32(0.8 / np.percentile(image, 99.5))


def score(disparity: np.ndarray, sigma: np.ndarray, defocus: np.ndarray) -> dict[str, float]:
    """Spearman's correlation over the most trusted of the pixels with truth; the unknown are trusted last."""
    known = defocus > 0
    value, doubt, truth = disparity[known], sigma[known], defocus[known].astype(float)
    doubt = np.where(np.isfinite(value) & np.isfinite(doubt), doubt, np.inf)
    order = np.argsort(doubt, kind="stable")
    found = {"fill": float(np.isfinite(doubt).mean())}
    for share in COVERAGES:
        best = order[: round(share * len(order))]
        best = best[np.isfinite(doubt[best])]
        found[f"at_{share:g}"] = float(spearmanr(value[best], truth[best]).statistic)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--quality", nargs="+", default=["paper", "real-time", "accurate"])
    parser.add_argument("--range-px", nargs=2, type=float, default=(-8.0, 8.0))
    parser.add_argument("--out", type=Path, help="folder for pictures")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = []
    for path in sorted(args.data.glob("*_gt_defocus.png")):
        scene = path.name.split("_")[0]
        image, defocus = capture(args.data, scene), cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::2, ::2]
        for quality in args.quality:
            rows.append({"scene": scene, "quality": quality, **measure(image, defocus, quality, args, scene)})
            if not args.json:
                print(" ".join(f"{k} {v:.3f}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items()))
    means = {
        quality: {
            name: float(np.mean([row[name] for row in rows if row["quality"] == quality]))
            for name in ("fill", *(f"at_{share:g}" for share in COVERAGES))
        }
        for quality in args.quality
    }
    print(json.dumps({"rows": rows, "means": means}, indent=1) if args.json else f"means: {means}")


def measure(
    image: np.ndarray, defocus: np.ndarray, quality: Quality, args: argparse.Namespace, scene: str
) -> dict[str, float]:
    camera = Calibration.uncalibrated("cy_halves", width_px=image.shape[1], height_px=image.shape[0])
    config = default_config(camera, quality)
    config = replace(config, matcher=config.matcher.with_range(*args.range_px))
    frame = CodedApertureCamera(camera, config).measure(image)
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        low, high = np.nanpercentile(frame.disparity_px, (1, 99))
        name, colors = f"{scene}_{quality}.png", color_map(DISTANCE)
        plt.imsave(args.out / name, frame.disparity_px, vmin=low, vmax=high, cmap=colors)
    return score(frame.disparity_px[CROP], frame.disparity_sigma_px[CROP], defocus)


if __name__ == "__main__":
    main()

"""Score depth of real photographs by a dual-pixel sensor: python benchmarks/dual_pixel.py --data FOLDER [--quality Q].

FOLDER holds NAME_left.png and NAME_right.png (what the two halves of the pupil saw, 8-bit RGB), NAME_depth_mm.png
(16 bit, 0 unknown), and a flat board at two distances, flat_DDDD_f4_left.png and so on. Red is the left half's green,
blue the right one's, green their mean: a cyan/yellow pupil whose optics and noise are real. The camera is calibrated by
the two boards alone: d = A(x, y) - B(x, y) / z, A and B quadratic over the frame. Shares are of ALL pixels of known
truth; sigma is that of the disparity through this line. Depths are distances from the sensor, as the boards' are.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from chromaperture.camera import CodedApertureCamera
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import default_config
from chromaperture.color.srgb import srgb_to_linear
from chromaperture.robust import huber_weights

RANGE_PX = (-1.75, 1.0)  # half disparities from 0.35 m to infinity, and a layer at either end
BOARDS_MM = (600.0, 1500.0)
LEAST_SIGMA_PX = 0.02  # so that no single pixel of a board decides; chosen by hand
ROUNDS = 20  # of reweighting; chosen by hand


def capture(folder: Path, name: str) -> np.ndarray:
    """Photograph of a cyan/yellow pupil, linear if the files follow the sRGB curve; (H, W, 3) float32."""
    left, right = (cv2.imread(str(folder / f"{name}_{side}.png"))[..., 1] for side in ("left", "right"))
    sides = [srgb_to_linear(side.astype(np.float32) / 255) for side in (left, right)]
    return np.dstack([sides[0], (sides[0] + sides[1]) / 2, sides[1]]).astype(np.float32)


def camera(shape: tuple[int, int], quality: str) -> CodedApertureCamera:
    calibration = Calibration.uncalibrated("cy_halves", width_px=shape[1], height_px=shape[0])
    config = default_config(calibration, quality)
    return CodedApertureCamera(calibration, replace(config, matcher=config.matcher.with_range(*RANGE_PX)))


def smooth(values: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Quadratic over the frame, fitted robustly to a map with holes; a map."""
    y, x = np.mgrid[-1 : 1 : values.shape[0] * 1j, -1 : 1 : values.shape[1] * 1j]
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    known = np.isfinite(values)
    design, target, weight = terms[known], values[known], 1 / np.maximum(sigma[known], LEAST_SIGMA_PX)
    gain = np.ones_like(target)
    for _ in range(ROUNDS):
        root = np.sqrt(gain) * weight
        fit = np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0]
        gain = huber_weights((target - design @ fit) * weight)
    return terms @ fit


def score(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    known = truth > 0
    answered = known & np.isfinite(depth)
    relative = np.where(answered, np.abs(depth - truth) / np.where(known, truth, 1), np.inf)[known]
    ratio = np.full(truth.shape, np.inf)
    np.maximum(depth / np.where(known, truth, np.nan), truth / depth, out=ratio, where=answered)
    ratio = ratio[known]
    z = (np.abs(depth - truth) / sigma)[answered]
    return {
        "fill": float(answered.sum() / known.sum()),
        "abs_rel": float(relative[np.isfinite(relative)].mean()),
        "ratio_below_1.25": float((ratio < 1.25).mean()),
        **{f"within_{p}_percent": float((relative < p / 100).mean()) for p in (2, 5, 10)},
        "within_1_sigma": float((z < 1).mean()),
        "within_2_sigma": float((z < 2).mean()),
    }


def figures(data: Path, quality: str, *, spoil: Callable[[np.ndarray], np.ndarray] = lambda image: image) -> list[dict]:
    """Score every scene; ``spoil`` changes the photographs."""
    rows = []
    boards = [capture(data, f"flat_{mm:04.0f}_f4") for mm in BOARDS_MM]
    eye = camera(boards[0].shape[:2], quality)
    near, far = (smooth(f.disparity_px, f.disparity_sigma_px) for f in (eye.measure(spoil(b)) for b in boards))
    scale = (far - near) / (1 / BOARDS_MM[0] - 1 / BOARDS_MM[1])  # B, px mm; negative where left and right swap
    infinity = near + scale / BOARDS_MM[0]  # A, px
    for path in sorted(data.glob("*_depth_mm.png")):
        name = path.name.removesuffix("_depth_mm.png")
        frame = eye.measure(spoil(capture(data, name)))
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = scale / (infinity - frame.disparity_px)
        depth[~((depth > 0) & (depth < eye.config.depth.max_depth_mm))] = np.nan
        sigma = depth**2 / np.abs(scale) * frame.disparity_sigma_px
        truth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(float)
        rows.append({"quality": quality, "scene": name, **score(depth, sigma, truth)})
    return rows


def averages(rows: list[dict]) -> list[dict]:
    groups = defaultdict(list)
    for row in rows:
        groups[row["quality"], "boxes" if row["scene"].startswith("box") else "casual"].append(row)
    return [
        {"quality": quality, "scenes": kind, **{k: float(np.mean([r[k] for r in found])) for k in list(found[0])[2:]}}
        for (quality, kind), found in groups.items()
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--quality", nargs="+", default=["paper", "real-time", "accurate"])
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = [row for quality in args.quality for row in figures(args.data, quality)]
    for row in [] if args.json else rows:
        print(" ".join(f"{k} {v:.3f}" if isinstance(v, float) else str(v) for k, v in row.items()))
    means = averages(rows)
    if args.json:
        print(json.dumps({"rows": rows, "means": means}, indent=1))
    for mean in [] if args.json else means:
        print("mean", " ".join(f"{k} {v:.3f}" if isinstance(v, float) else str(v) for k, v in mean.items()))


if __name__ == "__main__":
    main()

"""Real photographs through halves of a pupil against measured defocus: python benchmarks/half_pupil.py --data FOLDER

FOLDER holds NNN_left.png, NNN_right.png, NNN_gt_defocus.png and calibration/; methods are the qualities of a camera
that is not calibrated, and ``kernels``, `accurate` with the blur that the measured kernels tell. Printed are Spearman's
correlations over the shortest error bars, their ``ceiling`` and ``on_line``, the pixels of one line for all scenes.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import scipy.optimize
from scipy.stats import spearmanr

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.noise import estimate_noise_variance
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.kernel_blur import KernelBlur, blur_from_kernels
from chromaperture.settings.methods import AccurateConfig, Quality

BLACK = 1024.0
COVERAGES = (0.5, 0.7, 0.8, 0.9, 1.0)
CROP = np.s_[126:630, 168:840]
KERNELS = (6, 8)  # rows and columns
RANGE_PX = (-8.0, 8.0)  # half disparities that cameras which are not calibrated search
# The set does not say where its kernels were measured. It was beyond the focus: with the distances exchanged near and
# far change places in both scenes. Layers are the same for any two distances.
FOCUS_MM, MEASURED_MM = 1.0, 1.5
REACH = 2.0  # of the range that is searched with kernels, over the half disparity that they have
ON_LINE = 255 / 20  # levels of the truth


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


def kernel_blur(folder: Path, width_px: int, height_px: int) -> KernelBlur:
    """Blur of photographs of half the size, by kernels that were measured at the full one."""
    left, right = (
        np.load(folder / "calibration" / f"blur_kernels_{side}.npy").reshape(*KERNELS, 61, 61)
        for side in ("left", "right")
    )
    kernels = np.stack([right, (left + right) / 2, left], axis=2)
    return blur_from_kernels(
        kernels, width_px=width_px, height_px=height_px, spacing_px=0.5, focus_mm=FOCUS_MM, measured_mm=MEASURED_MM
    )


class Found(NamedTuple):
    """Half disparity and its error bar where there may be truth, px; the truth, levels, 0 unknown."""

    disparity_px: np.ndarray
    sigma_px: np.ndarray
    defocus: np.ndarray


def by_kernels(image: np.ndarray, blur: KernelBlur) -> tuple[np.ndarray, np.ndarray]:
    """Half disparity and its error bar, with the settings of half pixels."""
    config = AccurateConfig.for_blur(blur.reach, one_pair=True).with_half_pixels()
    farthest = REACH * abs(blur.reach * blur.edge_px)
    found = estimate_disparity(
        image, aperture="cy_halves", config=config.with_range(-farthest, farthest), blur=blur,
        noise_variance=np.broadcast_to(estimate_noise_variance(image), image.shape),
    )  # fmt: skip
    return found.value_px, found.sigma_px


def by_quality(image: np.ndarray, quality: Quality, range_px: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Half disparity and its error bar by a camera that is not calibrated."""
    camera = Calibration.uncalibrated("cy_halves", width_px=image.shape[1], height_px=image.shape[0])
    config = default_config(camera, quality)
    config = replace(config, matcher=config.matcher.with_range(*range_px))
    frame = CodedApertureCamera(camera, config).measure(image)
    return frame.disparity_px, frame.disparity_sigma_px


def measure(scene: str, method: str, data: Path, range_px: tuple[float, float]) -> Found:
    image = capture(data, scene)
    defocus = cv2.imread(str(data / f"{scene}_gt_defocus.png"), cv2.IMREAD_UNCHANGED)[::2, ::2]
    if method == "kernels":
        disparity, sigma = by_kernels(image, kernel_blur(data, image.shape[1], image.shape[0]))
    else:
        disparity, sigma = by_quality(image, method, range_px)
    return Found(disparity[CROP], sigma[CROP], defocus)


def ceiling(defocus: np.ndarray) -> float:
    """Spearman's correlation of the truth with itself under even noise of a level, which tells no two areas wrong."""
    truth = defocus[defocus > 0].astype(float)
    return float(spearmanr(truth, truth + np.random.default_rng(0).uniform(-0.5, 0.5, truth.size)).statistic)


def on_line(scenes: list[Found]) -> float:
    """Share of the pixels of truth of all scenes that lie on one line, see above; the unknown do not."""
    truth = np.concatenate([found.defocus[found.defocus > 0] for found in scenes]).astype(float)
    value = np.concatenate([found.disparity_px[found.defocus > 0] for found in scenes]).astype(float)
    known = np.isfinite(value)
    start = np.polyfit(truth[known], value[known], 1)

    def misfit(line: np.ndarray) -> np.ndarray:
        return (value[known] - np.polyval(line, truth[known])) / (start[0] * ON_LINE)

    slope, offset = scipy.optimize.least_squares(misfit, start, loss="cauchy", x_scale=np.abs(start) + 1e-3).x
    return float(np.mean(np.abs(np.where(known, value, np.inf) - slope * truth - offset) <= abs(slope) * ON_LINE))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--method", nargs="+", default=["paper", "real-time", "accurate", "kernels"])
    parser.add_argument("--range-px", nargs=2, type=float, default=RANGE_PX, help="of the qualities")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    scenes = sorted(path.name.split("_")[0] for path in args.data.glob("*_gt_defocus.png"))
    if not scenes:
        parser.error(f"{args.data} holds no NNN_gt_defocus.png")
    rows, means = [], {}
    for method in args.method:
        found = [measure(scene, method, args.data, tuple(args.range_px)) for scene in scenes]
        of_method = [score(*part) | {"ceiling": ceiling(part.defocus)} for part in found]
        for scene, row in zip(scenes, of_method, strict=True):
            rows.append({"scene": scene, "method": method, **row})
            if not args.json:
                print(" ".join(f"{k} {v:.3f}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items()))
        mean = {name: float(np.mean([row[name] for row in of_method])) for name in of_method[0]}
        means[method] = mean | {"on_line": on_line(found)}
        if not args.json:
            print("mean", method, " ".join(f"{k} {v:.3f}" for k, v in means[method].items()), flush=True)
    if args.json:
        print(json.dumps({"rows": rows, "means": means}, indent=1))


if __name__ == "__main__":
    main()

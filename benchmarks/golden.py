"""Known distances of real and rendered photographs against the figures kept: python benchmarks/golden.py --data FOLDER

FOLDER holds bench50/cy_halves, real/cmu_dual_pixel and real/rf50_dual_pixel; quality real-time. Exit code 1 when a
figure got worse by more than four times its scatter over fresh noise; ``--keep`` writes figures and scatter to
golden.json. tests/project/test_golden.py does the same with the samples.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from dual_pixel import figures
from half_pupil import CROP, RANGE_PX, by_quality, capture, score

from chromaperture.camera.camera import load_camera
from chromaperture.products.samples import sample_camera
from chromaperture_paper.dual_pixel import means

KEPT = Path(__file__).parent / "golden.json"
QUALITY = "real-time"
FULL_WELL_ELECTRONS = 10_000  # of the added noise; chosen by hand, a small sensor has as many
SEEDS, ALLOWED = 4, 4.0  # scatter from four is known to a third; false alarms are rare all the same
LEAST_SCATTER = 0.002  # four runs may agree by chance; chosen by hand
Spoil = Callable[[np.ndarray], np.ndarray]


def boards(data: Path, spoil: Spoil) -> dict[str, float]:
    """Fractions of the frames of flat boards that are within 2 % of the ruler; the ruler errs by up to 3 mm."""
    camera = load_camera(sample_camera("still_life_cy_halves"), quality=QUALITY)
    folder = data / "bench50" / "cy_halves"
    near, bias = [], []
    with open(folder / "distances.csv", newline="") as file:
        for name, ruler_mm, *_ in [row for row in csv.reader(file) if row[0].endswith(".png")]:
            frame = camera.measure(spoil(camera.read(folder / "board" / Path(name).name)))
            relative = np.nan_to_num(frame.depth_mm / float(ruler_mm) - 1, nan=np.inf)
            near.append(float((np.abs(relative) < 0.02).mean()))
            bias.append(abs(float(np.median(relative))))
    return {
        "boards_mean_within_2_percent": float(np.mean(near)),
        "boards_least_within_2_percent": min(near),
        "boards_unbiased": 1 - max(bias),  # larger is better, as of every figure here
    }


def half_pupils(data: Path, spoil: Spoil) -> dict[str, float]:
    found, folder = [], data / "real" / "cmu_dual_pixel"
    for path in sorted(folder.glob("*_gt_defocus.png")):
        image = capture(folder, path.name.split("_")[0])
        disparity, sigma = by_quality(spoil(image), QUALITY, RANGE_PX)
        defocus = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::2, ::2]
        found.append(score(disparity[CROP], sigma[CROP], defocus)["at_0.9"])
    return {"half_pupils_spearman": float(np.mean(found))}


def dual_pixels(data: Path, spoil: Spoil) -> dict[str, float]:
    found = means(figures(data / "real" / "rf50_dual_pixel", QUALITY, spoil=spoil))
    names = ("ratio_below_1.25", "within_5_percent")
    return {f"rf50_{kind}_{name}": mean[name] for (_, _, kind), mean in found.items() for name in names}


def measure(data: Path, spoil: Spoil = lambda image: image) -> dict[str, float]:
    return boards(data, spoil) | half_pupils(data, spoil) | dual_pixels(data, spoil)


def noisy(seed: int) -> Spoil:
    rng = np.random.default_rng(seed)

    def spoil(image: np.ndarray) -> np.ndarray:
        noise = np.sqrt(np.maximum(image, 0) / FULL_WELL_ELECTRONS) * rng.normal(size=image.shape)
        return (image + noise).astype(np.float32)

    return spoil


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--keep", action="store_true", help="write the figures found as those to compare with")
    args = parser.parse_args()
    found = measure(args.data)
    if args.keep:
        others = [measure(args.data, noisy(seed)) for seed in range(SEEDS)]
        scatter = {name: float(np.std([other[name] for other in others], ddof=1)) for name in found}
        kept = {name: (round(found[name], 4), round(max(scatter[name], LEAST_SCATTER), 4)) for name in found}
        KEPT.write_text(json.dumps(kept, indent=1) + "\n")
    worse = False
    for name, (before, scatter_before) in json.loads(KEPT.read_text()).items():
        bad = found[name] < before - ALLOWED * scatter_before
        worse |= bad
        print(f"{name:32} {found[name]:.4f}  kept {before:.4f} +- {scatter_before:.4f}{'  WORSE' if bad else ''}")
    sys.exit(int(worse))


if __name__ == "__main__":
    main()

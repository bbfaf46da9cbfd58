"""Score depth maps of ray-traced captures with known truth: python benchmarks/bench50.py --data FOLDER [--quality Q].

FOLDER holds one session folder a design (as docs/calibration-session.md shows, with scene/*.png), white/, and
truth/SCENE.depth_0.1mm.png. The camera is calibrated from the session's boards, then every scene is measured.
Shares are of ALL pixels with known truth.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.model.camera_file import Calibration


def score(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    known = np.isfinite(truth)
    answered = known & np.isfinite(depth)
    error = np.where(answered, np.abs(depth - truth) / truth, np.inf)[known]
    z = np.abs(depth - truth)[answered] / sigma[answered]
    trusted = np.argsort(sigma[answered])[: answered.sum() // 2]
    return {
        "fill": float(answered.sum() / known.sum()),
        **{f"within_{p}_percent": float((error < p / 100).mean()) for p in (1, 2, 5, 10)},
        "within_1_sigma": float((z < 1).mean()),
        "within_2_sigma": float((z < 2).mean()),
        "most_trusted_half_within_2_percent": float(
            ((np.abs(depth - truth) / truth)[answered][trusted] < 0.02).mean()
        ),
    }


def deciles(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Fraction of the errors within one and two error bars, by decile of the error bar's share of the distance."""
    answered = np.isfinite(truth) & np.isfinite(depth)
    z = (np.abs(depth - truth) / sigma)[answered][np.argsort((sigma / depth)[answered])]
    parts = list(enumerate(np.array_split(z, 10), start=1))
    return {f"decile_{i}_within_{n}_sigma": float((part < n).mean()) for i, part in parts for n in (1, 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--designs", nargs="+", default=["cy_halves", "cy_open"])
    parser.add_argument("--scenes", nargs="+", default=["steps", "room", "desk"])
    parser.add_argument("--quality", nargs="+", default=["paper", "real-time"])
    parser.add_argument("--camera", type=Path, help="use this camera file instead of calibrating (one design)")
    parser.add_argument("--deciles", action="store_true", help="error bars by decile of sigma, least first")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    lens: Calibration | None = None
    table = []
    for design in args.designs:
        if args.camera:
            calibration = Calibration.load(args.camera)
        else:
            calibration = calibrate_session(args.data / design, lens_from=lens).calibration
        lens = lens or calibration  # designs without tilted boards share the first one's lens
        for quality in args.quality:
            camera = CodedApertureCamera(calibration, default_config(calibration, quality))
            for scene in args.scenes:
                frame = camera.measure(camera.read(args.data / design / "scene" / f"{scene}.png"))
                stored = cv2.imread(str(args.data / "truth" / f"{scene}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED)
                truth = np.where(stored > 0, stored / 10.0, np.nan)
                maps = frame.depth_mm.astype(float), frame.sigma_mm.astype(float), truth
                figures = score(*maps) | (deciles(*maps) if args.deciles else {})
                table.append({"design": design, "quality": quality, "scene": scene, **figures})
                if not args.json:
                    words = " ".join(f"{k} {v:.3f}" for k, v in figures.items())
                    print(f"{design:11} {quality:9} {scene:6} {words}", flush=True)
    if args.json:
        print(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()

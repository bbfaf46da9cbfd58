"""What each ingredient of quality real-time costs and gains: python benchmarks/ablation.py --data FOLDER.

FOLDER as for bench50.py. The camera is calibrated anew for every variant, because the depth curve belongs to the
matcher's settings. Times are of the whole measurement, the fastest of five, beside StereoSGBM 3WAY on an
equally large picture.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
from bench50 import score
from matcher import peers
from timing import fastest_ms

from chromaperture import calibrate
from chromaperture.camera import CodedApertureCamera, default_config
from chromaperture.config import CoarseConfig, MatcherConfig
from chromaperture.pipeline import read_capture

REAL_TIME = MatcherConfig.preset("real-time")
VARIANTS: dict[str, MatcherConfig] = {
    "everything": REAL_TIME,
    "no field over the frame": REAL_TIME,
    "unmixed views": dataclasses.replace(REAL_TIME, views="unmixed"),
    "no average between layers": dataclasses.replace(REAL_TIME, bilateral_sigma_px=0.0),
    "penalties not led by the guide": dataclasses.replace(REAL_TIME, coarse=CoarseConfig(edge_floor=1.0)),
    "penalties a tenth": dataclasses.replace(REAL_TIME, coarse=CoarseConfig(slope_penalty=1.0, jump_penalty=2.0)),
    "window of .70": dataclasses.replace(REAL_TIME, window_decay=0.7),
    "full resolution, best layer of a bilateral filter": MatcherConfig(),
}


def measure(name: str, data: Path, design: str, scenes: list[str]) -> dict:
    preset, matcher = MatcherConfig.preset, VARIANTS[name]
    MatcherConfig.preset = lambda quality: matcher if quality == "real-time" else preset(quality)  # type: ignore
    try:
        camera_file = calibrate.calibrate_session(data / design).calibration
        camera = CodedApertureCamera(camera_file, default_config(camera_file))
    finally:
        MatcherConfig.preset = preset  # type: ignore
    if name == "no field over the frame":
        camera.fields = None
    figures = []
    for scene in scenes:
        image = read_capture(data / design / "scene" / f"{scene}.png", camera)
        frame = camera.measure(image)
        stored = cv2.imread(str(data / "truth" / f"{scene}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED)
        truth = np.where(stored > 0, stored / 10.0, np.nan)
        figures.append(score(frame.depth_mm.astype(float), frame.sigma_mm.astype(float), truth))
    mean = {key: round(float(np.mean([f[key] for f in figures])), 3) for key in figures[0]}
    pair = [np.ascontiguousarray(image[..., channel]) for channel in (0, 2)]
    work = {"measure": lambda: camera.measure(image), "sgbm": peers(pair)["sgbm_3way"]}
    best = fastest_ms(work, threads=2, rounds=5)
    return {**mean, "ms": round(best["measure"], 1), "ratio_to_sgbm_3way": round(best["measure"] / best["sgbm"], 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--design", default="cy_halves")
    parser.add_argument("--scenes", nargs="+", default=["steps", "room", "desk"])
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    args = parser.parse_args()
    for name in args.variants:
        print(json.dumps({name: measure(name, args.data, args.design, args.scenes)}), flush=True)


if __name__ == "__main__":
    main()

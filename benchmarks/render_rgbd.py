"""Render RGB-D pictures through an aperture: frames a second of the layered renderer, and the pictures.

python benchmarks/render_rgbd.py --data DATA/real [--out DIR]
"""

import argparse
import json
import time
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from chromaperture.color.srgb import linear_to_srgb_bytes, srgb_to_linear
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.simulator.layer_renderer import render_layers

SENSOR_TO_PUPIL_MM = 50.0
SEVEN_SCENES_PX = 585.0  # focal length
# Middlebury 2014: depth = focal length * baseline / (disparity + offset of the principal points).
MOTORCYCLE_PX, MOTORCYCLE_BASELINE_MM, MOTORCYCLE_OFFSET_PX = 994.978, 193.001, 31.086


def linear(path):
    return srgb_to_linear(cv2.imread(str(path))[..., ::-1].astype(np.float32) / 255)


def seven_scenes(folder):
    for path in sorted(folder.glob("*.color.jpg")):
        depth = cv2.imread(str(path).replace("color.jpg", "depth.png"), cv2.IMREAD_UNCHANGED).astype(np.float32)
        depth[(depth == 0) | (depth == 65535)] = np.nan
        yield path.name.split(".")[0], linear(path), depth + SENSOR_TO_PUPIL_MM, SEVEN_SCENES_PX, 2000.0


def motorcycle(folder):
    stored = np.load(folder / "motorcycle_disp.npz")
    disparity = stored[stored.files[0]].astype(np.float32)
    seen = np.isfinite(disparity) & (disparity > 0)
    depth = np.where(seen, MOTORCYCLE_PX * MOTORCYCLE_BASELINE_MM / (disparity + MOTORCYCLE_OFFSET_PX), np.nan)
    depth = (depth + SENSOR_TO_PUPIL_MM).astype(np.float32)
    yield "motorcycle", linear(folder / "motorcycle_left.png"), depth, MOTORCYCLE_PX, 3000.0


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--design", default="cy_halves")
    parser.add_argument("--pupil-radius-mm", type=float, default=20.0)
    parser.add_argument("--pitch-px", type=float, default=0.5)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    aperture = made_of(DESIGNS[args.design], "real")
    rows = []
    scenes = seven_scenes(args.data / "seven_scenes")
    frames = [*islice(scenes, args.frames), *motorcycle(args.data / "motorcycle")]
    for name, color, depth, focal_px, focus_mm in frames:
        camera = PupilCamera(
            color.shape[1], color.shape[0], focal_px, args.pupil_radius_mm, focus_mm, SENSOR_TO_PUPIL_MM, 0.02
        )
        start = time.perf_counter()
        made = render_layers(color, depth, camera=camera, aperture=aperture, pitch_px=args.pitch_px)
        rows.append((name, time.perf_counter() - start, made.layer_count, color.shape[0] * color.shape[1]))
        if args.out:
            args.out.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(args.out / f"{name}.png"), linear_to_srgb_bytes(np.hstack([color, made.image]))[..., ::-1])
    video = [row for row in rows[1:] if row[0] != "motorcycle"]  # the first frame builds the transfer functions
    report = {
        "design": args.design,
        "frames": len(video) + 1,
        "median_fps": round(1 / float(np.median([row[1] for row in video])), 2) if video else None,
        "median_layers": int(np.median([row[2] for row in video])) if video else None,
        "million_pixel_layers_per_s": round(
            sum(row[2] * row[3] for row in video) / max(sum(row[1] for row in video), 1e-9) / 1e6, 1
        ),
        "motorcycle_s": round(rows[-1][1], 2),
        "motorcycle_layers": rows[-1][2],
        "motorcycle_pixels": rows[-1][3],
    }
    print(json.dumps(report, indent=None if args.json else 1))


if __name__ == "__main__":
    main()

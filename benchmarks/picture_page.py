"""A page of restored pictures at their own size: for edges, thin structures and highlights.

    python benchmarks/picture_page.py --data DATA --camera CAMERA.asdf [--camera ...] --out DIR

DATA holds bench50/; the cameras are calibrated from its sessions. Every row shows the same crop of the capture, of the
aligned picture, of everything in focus, refocused on the nearest surface, and of the open aperture's own capture.
"""

from __future__ import annotations

import argparse
import html
from pathlib import Path

import cv2
import numpy as np
from colour_data import LEVELS, SCENES

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.capture.files import read_image
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.color.transparency_map import compensate_vignetting, flat_field
from chromaperture.effects.refocusing import Focus, refocus
from chromaperture.effects.restore import restore, white_gains
from chromaperture.model.camera_file import Calibration

CROPS = {"middle": (160, 300), "corner": (0, 0)}  # top, left, px
SIZE = (240, 300)  # height, width, px


def pictures(data: Path, camera: CodedApertureCamera, scene: str) -> dict[str, np.ndarray]:
    design = camera.calibration.design
    image = read_image(data / design / "scene" / f"{scene}.png", **LEVELS)
    frame = camera.measure(image)
    known = {"disparity_px": frame.disparity_px, "camera": camera, "sigma_px": frame.disparity_sigma_px}
    flat, bare = (flat_field(read_image(data / "white" / f"{d}.png", **LEVELS)) for d in (design, "open"))
    aligned, sharp = (restore(image, sharpness=s, **known) for s in ("aligned", "full"))
    near = Focus(float(np.percentile(sharp.radius_px, 5)), 1.0)
    coded = {
        "capture": image * white_gains(camera.calibration),
        "aligned": aligned.color,
        "all in focus": sharp.color,
        "focused near": refocus(sharp.color, sharp.radius_px, near),
    }
    made = {name: compensate_vignetting(p, flat) for name, p in coded.items()}
    made["open aperture"] = compensate_vignetting(read_image(data / "open" / "scene" / f"{scene}.png", **LEVELS), bare)
    return {name: 0.9 * p / np.percentile(p, 99.5) for name, p in made.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--camera", type=Path, action="append", required=True)
    parser.add_argument("--scene", action="append", choices=SCENES, help="all when absent")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows = ["<!doctype html><title>Restored pictures</title><style>img{image-rendering:pixelated}</style>"]
    for path in args.camera:
        calibration = Calibration.load(path)
        camera = CodedApertureCamera(calibration, default_config(calibration, "accurate"))
        for scene in args.scene or SCENES:
            if not (args.data / "bench50" / calibration.design / "scene" / f"{scene}.png").exists():
                continue
            made = pictures(args.data / "bench50", camera, scene)
            rows.append(f"<h2>{html.escape(calibration.design)}, {scene}: {', '.join(made)}</h2>")
            for crop, (top, left) in CROPS.items():
                cut = np.s_[top : top + SIZE[0], left : left + SIZE[1]]
                tiles = [np.rint(255 * linear_to_srgb(np.maximum(p[cut], 0))).astype(np.uint8) for p in made.values()]
                name = f"{calibration.design}_{scene}_{crop}.png"
                cv2.imwrite(str(args.out / name), np.hstack(tiles)[..., ::-1])
                rows.append(f'<p><img src="{name}" alt="{crop}"></p>')
    (args.out / "index.html").write_text("\n".join(rows), encoding="utf-8")


if __name__ == "__main__":
    main()

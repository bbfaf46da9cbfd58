"""Thin things before the rooms of `error_bar_scenes.py`: wires, poles, gratings and plants, and what they gain.

    python benchmarks/thin_scenes.py draw CAMERA.asdf --lens double_gauss_50 --focus-mm 2200 --out pictures
    python benchmarks/thin_scenes.py score CAMERA.asdf [...] --pictures pictures [--quality accurate]

``draw`` renders scenes through the camera's lens and design into NAME_SEED.npz: the photograph, its truth, and where
thin things are seen. ``score`` measures them and prints, in the mean of a camera's scenes, the share of thin things'
pixels within 5 % of the truth, of pixels up to `AROUND_PX` beside them, and of all others.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from error_bar_scenes import few_surfaces, texture
from error_bar_training import EXPOSURES
from numpy.random import Generator

from chromaperture.camera import load_camera
from chromaperture.camera_file import Calibration
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.paraxial import focused_at
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays
from chromaperture.optics.render import render, render_depth
from chromaperture.optics.scene import Plane, plane
from chromaperture.optics.sensor import SensorModel, develop, expose

NEAREST_MM, FARTHEST_MM = 1000.0, 2100.0  # of thin things; the walls behind them are at 2300 mm or farther
TEXELS_A_PX = 3
AROUND_PX = 10


def covered(rng: Generator, cover: np.ndarray) -> np.ndarray:
    """Give a cover (h, w) a random texture in a random light; (h, w, 4)."""
    size = max(cover.shape)
    light = rng.choice([0.3, 0.7, 1.3])
    picture = np.clip(light * texture(rng, size)[: cover.shape[0], : cover.shape[1]], 0.005, 1)
    return np.dstack([picture, cover])


def wire(rng: Generator) -> np.ndarray:
    """A straight wire of 2 to 6 px."""
    return np.ones((int(rng.uniform(120, 420)) * TEXELS_A_PX, round(rng.uniform(2, 6) * TEXELS_A_PX)), np.float32)


def pole(rng: Generator) -> np.ndarray:
    """A pole of 8 to 16 px."""
    return np.ones((int(rng.uniform(150, 420)) * TEXELS_A_PX, round(rng.uniform(8, 16) * TEXELS_A_PX)), np.float32)


def grating(rng: Generator) -> np.ndarray:
    """Bars of 3 to 8 px with gaps of 20 to 50 px, across which one sees what is behind."""
    bar, gap = (round(v * TEXELS_A_PX) for v in (rng.uniform(3, 8), rng.uniform(20, 50)))
    bars = int(rng.integers(3, 6))
    cover = np.zeros((int(rng.uniform(100, 250)) * TEXELS_A_PX, bars * (bar + gap)), np.float32)
    for i in range(bars):
        cover[:, i * (bar + gap) : i * (bar + gap) + bar] = 1
    cover[:bar] = cover[-bar:] = 1
    return cover


def plant(rng: Generator) -> np.ndarray:
    """A stem of 3 px with leaves of 6 to 14 px, up to 60 px long."""
    height, width = 240 * TEXELS_A_PX, 180 * TEXELS_A_PX
    cover = np.zeros((height, width), np.float32)
    cv2.line(cover, (width // 2, height - 1), (width // 2, height // 6), 1.0, 3 * TEXELS_A_PX)
    for _ in range(int(rng.integers(8, 24))):
        y, side = int(rng.integers(height // 6, height)), rng.choice((-1, 1))
        length, turn = rng.uniform(20, 60) * TEXELS_A_PX / 2, rng.uniform(15, 60)
        middle = width / 2 + side * length * np.cos(np.radians(turn)), y - length * np.sin(np.radians(turn))
        cv2.ellipse(cover, (middle, (2 * length, rng.uniform(6, 14) * TEXELS_A_PX), -side * turn), 1.0, -1)
    return cover


def thin_things(seed: int, half_field: tuple[float, float], focal_px: float) -> list[Plane]:
    """Draw two to five thin things in view; ``focal_px`` is the image distance in pixels."""
    rng, out = np.random.default_rng(seed + 5000), []
    for _ in range(rng.integers(2, 6)):
        z = 1 / rng.uniform(1 / FARTHEST_MM, 1 / NEAREST_MM)
        x, y = (rng.uniform(-0.75, 0.75) * half * z for half in half_field)
        kinds = wire, pole, grating, plant
        picture = covered(rng, kinds[rng.choice(4, p=(0.4, 0.2, 0.15, 0.25))](rng))
        width = picture.shape[1] / TEXELS_A_PX * z / focal_px
        turn = 0, 0, rng.choice([rng.uniform(-30, 30), rng.uniform(-90, 90)])
        out.append(plane(picture, center_mm=(x, y, z), width_mm=width, tilt_deg=turn))
    return out


def draw(args: argparse.Namespace) -> None:
    """Render scenes and keep them with their truth and where thin things are."""
    calibration = Calibration.load(args.camera)
    sensor = calibration.sensor
    size = {"width_px": sensor.width_px, "height_px": sensor.height_px, "pixel_pitch_mm": sensor.pixel_pitch_mm}
    design = made_of(DESIGNS[args.design or calibration.aperture.name], "real")
    table = lens_rays(focused_at(load_lens(args.lens), args.focus_mm), design, cells=12, **size)
    wide, high = sensor.pixel_pitch_mm * np.array([sensor.width_px, sensor.height_px]) / 2 / table.z_mm
    args.out.mkdir(parents=True, exist_ok=True)
    for seed in range(args.first, args.first + args.scenes):
        behind = few_surfaces(seed, (wide, high))
        planes = behind + thin_things(seed, (wide, high), table.z_mm / sensor.pixel_pitch_mm)
        rng = np.random.default_rng(seed + 77)
        light, truth = render(table, planes, seed=seed), render_depth(table, planes)
        exposure = rng.choice(EXPOSURES) / np.percentile(light.max(axis=2), 99.5)
        image = np.minimum(develop(expose(light, SensorModel(), seed=seed, exposure=exposure), SensorModel()), 1)
        thin = np.nan_to_num(truth) != np.nan_to_num(render_depth(table, behind))
        np.savez(args.out / f"{args.camera.stem}_{seed}.npz", image=image.astype(np.float32),
                 truth_mm=truth.astype(np.float32), thin=thin)  # fmt: skip


def shares(relative: np.ndarray, thin: np.ndarray) -> tuple[float, float, float]:
    """Share within 5 % of thin things, of what is beside them, and of all else."""
    side = 2 * AROUND_PX + 1
    beside = cv2.dilate(thin.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))) > 0
    right = np.nan_to_num(relative, nan=np.inf) < 0.05
    of_thin, of_beside, of_else = (float(right[area].mean()) for area in (thin, beside & ~thin, ~beside))
    return of_thin, of_beside, of_else


def score(args: argparse.Namespace) -> None:
    """Measure pictures and print shares."""
    print(f"{'camera':<12}{'scenes':>7}{'thin':>8}{'beside':>8}{'else':>8}{'all':>8}")
    for file in args.cameras:
        camera = load_camera(file, quality=args.quality, scale=1, device="cpu")
        rows = []
        for path in sorted(args.pictures.glob(f"{file.stem}_*.npz")):
            with np.load(path) as z:
                relative = np.abs(camera.measure(z["image"]).depth_mm - z["truth_mm"]) / z["truth_mm"]
                rows.append((*shares(relative, z["thin"]), float((np.nan_to_num(relative, nan=1) < 0.05).mean())))
        print(f"{file.stem:<12}{len(rows):>7}" + "".join(f"{v:8.3f}" for v in np.mean(rows, axis=0)), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    drawing = commands.add_parser("draw")
    drawing.add_argument("camera", type=Path)
    drawing.add_argument("--lens", required=True)
    drawing.add_argument("--focus-mm", type=float, required=True)
    drawing.add_argument("--design", help="by default the camera's")
    drawing.add_argument("--first", type=int, default=300)
    drawing.add_argument("--scenes", type=int, default=12)
    drawing.add_argument("--out", type=Path, required=True)
    scoring = commands.add_parser("score")
    scoring.add_argument("cameras", type=Path, nargs="+")
    scoring.add_argument("--pictures", type=Path, required=True)
    scoring.add_argument("--quality", choices=("real-time", "accurate"), default="accurate")
    args = parser.parse_args()
    (draw if args.command == "draw" else score)(args)


if __name__ == "__main__":
    main()

"""Noise that the camera file does not know: another ISO, JPEG, an interpolated mosaic; what it costs `accurate`.

    python benchmarks/developed_files.py sheets
    python benchmarks/developed_files.py depth CAMERA.asdf --pictures FOLDER [--most N]

``sheets`` photographs white sheets with a sensor of 5000 electrons and prints, for linear files, JPEG and a Bayer
mosaic that is interpolated bilinearly, what noise is found in the pixels and in means of 2 x 2 and 4 x 4 px, in units
of the sensor's variance in the middle light, and what `photon_noise_of_sheets` answers. ``depth`` measures pictures of
``world_scenes.py draw``, KIND_NUMBER.npz, as they are and with the noise of 4 and 16 times the ISO, with the camera
as it is, without `noise_ratio`, and with the photograph's own noise in the camera file.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from chromaperture.camera import method as camera_matching
from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.color import noise
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear

FULL_WELL, READ = 5000.0, 4.0
COLOURS = ((0.05, 0.7, 0.8), (0.75, 0.7, 0.06), (0.9, 0.88, 0.85), (0.4, 0.35, 0.4))
SCALES_PX = (1, 2, 4)
TIMES = (1, 4, 16)  # of the ISO


def as_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    file = io.BytesIO()
    levels = np.rint(255 * linear_to_srgb(np.clip(image, 0, 1))).astype(np.uint8)
    Image.fromarray(levels).save(file, "JPEG", quality=quality, subsampling=0)
    return srgb_to_linear((np.asarray(Image.open(file)) / 255).astype(np.float32))


def as_mosaic(image: np.ndarray) -> np.ndarray:
    known = np.zeros(image.shape, np.float32)
    known[::2, ::2, 0] = known[1::2, 1::2, 2] = known[::2, 1::2, 1] = known[1::2, ::2, 1] = 1
    cross = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32)
    return cv2.filter2D(known * image, -1, cross) / cv2.filter2D(known, -1, cross)


FILES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "linear": lambda image: image,
    "JPEG 95": lambda image: as_jpeg(image, 95),
    "JPEG 90": lambda image: as_jpeg(image, 90),
    "JPEG 80": lambda image: as_jpeg(image, 80),
    "mosaic": as_mosaic,
}


def photographed(level: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    electrons = rng.poisson(level * FULL_WELL) + rng.normal(0, READ, level.shape)
    return (electrons / FULL_WELL).astype(np.float32)


def in_the_middle(found: tuple[float, float] | None) -> str:
    if found is None:
        return f"{'-':>8}"
    variance, expected = (0.5 / well + (read / well) ** 2 for well, read in (found, (FULL_WELL, READ)))
    return f"{variance / expected:8.2f}"


def sheets() -> None:
    rng = np.random.default_rng(1)
    shading = 1 - 0.3 * np.linspace(-1, 1, 720)[None, :, None] ** 2
    taken = [photographed(np.broadcast_to(np.array(c) * shading, (480, 720, 3)), rng) for c in COLOURS]
    print(f"{'files':<10}" + "".join(f"{s}x{s} px".rjust(8) for s in SCALES_PX) + f"{'answer':>8}")
    for name, developed in FILES.items():
        files = [developed(sheet) for sheet in taken]
        found = []
        for scale in SCALES_PX:
            samples = [noise.noise_samples(sheet, scale_px=scale) for sheet in files]
            found.append(noise.fit_photon_noise(*map(np.concatenate, zip(*samples, strict=True))))
        print(f"{name:<10}" + "".join(map(in_the_middle, [*found, noise.photon_noise_of_sheets(files)])))


def figures(camera: CodedApertureCamera, image: np.ndarray, truth_mm: np.ndarray) -> tuple[float, ...]:
    frame = camera.measure(image)
    error = np.abs(frame.depth_mm - truth_mm)
    known = np.isfinite(error)
    relative, bars = np.where(known, error / truth_mm, np.inf), (error / frame.sigma_mm)[known]
    return (relative < 0.02).mean(), (relative < 0.05).mean(), (bars < 1).mean(), (bars < 2).mean()


def depth(args: argparse.Namespace) -> None:
    camera = load_camera(args.camera, quality="accurate", scale=1, device="cpu")
    sensor = camera.calibration.sensor
    measured = camera_matching.noise_ratio
    paths = sorted(args.pictures.glob(f"{args.camera.stem}_*.npz"))[: args.most]
    print(f"{len(paths)} pictures{'':<26}{'2 %':>8}{'5 %':>8}{'1 bar':>8}{'2 bars':>8}")
    for times in TIMES:
        well, read = sensor.full_well_electrons / times, sensor.read_noise_electrons / np.sqrt(times)
        own = replace(camera.calibration, sensor=replace(sensor, full_well_electrons=well, read_noise_electrons=read))
        rows: dict[str, list[tuple[float, ...]]] = {}
        for k, path in enumerate(paths):
            with np.load(path) as z:
                image, truth_mm = z["image"], z["truth_mm"]
            more = (times - 1) * camera_matching.sensor_noise(image, camera.calibration)
            grain = np.random.default_rng(k).normal(size=image.shape) * np.sqrt(more)
            noisy = np.minimum(image + grain, 1).astype(np.float32)
            for name, with_camera, ratio in (
                ("as it is", camera, measured),
                ("without noise_ratio", camera, lambda image, variance: 1.0),
                ("own noise known", CodedApertureCamera(own, camera.config), measured),
            ):
                camera_matching.noise_ratio = ratio
                rows.setdefault(name, []).append(figures(with_camera, noisy, truth_mm))
        camera_matching.noise_ratio = measured
        for name, values in rows.items():
            print(f"ISO x {times:<4}{name:<26}" + "".join(f"{v:8.3f}" for v in np.mean(values, axis=0)), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("sheets")
    of_depth = commands.add_parser("depth")
    of_depth.add_argument("camera", type=Path)
    of_depth.add_argument("--pictures", type=Path, required=True)
    of_depth.add_argument("--most", type=int, default=12)
    args = parser.parse_args()
    sheets() if args.command == "sheets" else depth(args)


if __name__ == "__main__":
    main()

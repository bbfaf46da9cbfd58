"""Random rooms through the lens and half pixels of the real photographs: where is depth lost, and is the bar honest?

    python benchmarks/dual_pixel.py --data FOLDER --line prescription --camera-out rf50.asdf
    python benchmarks/half_pixel_rooms.py --data FOLDER --camera rf50.asdf --seeds 0 1 2 ... [--without-shared-noise]

Walls that hardly have texture, dark leather, prints, from .5 to 7.5 m, as 8-bit files with noise as photographs have it
(``matching/evidence/half_pixels.py``). ``--without-shared-noise`` measures as if every channel's noise were its own.
Printed are AbsRel, shares of all pixels with a ratio below 1.25 and within 5 and 10 %, of errors within one and two
error bars, and of pixels that are blank and off by a ratio of 1.25. Textures are those of ``error_bar_scenes.py``.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from error_bar_scenes import grain, texture
from numpy.random import Generator

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.paraxial import focused_at, paraxial
from chromaperture.optics.pinhole import pupil_camera
from chromaperture.optics.ray_table import RayTable, lens_rays
from chromaperture.optics.simulator.render import render, render_depth
from chromaperture.optics.simulator.scene import Plane, plane
from chromaperture.settings.methods import AccurateConfig
from chromaperture_paper.dual_pixel_camera import FULL_WELL_ELECTRONS, SENSOR_WIDTH_MM, lens_of_json
from chromaperture_paper.dual_pixel_noise import camera_for
from chromaperture_paper.half_pixels import HalfPixels, half_pixel_rays

WIDTH, HEIGHT = 768, 512
HALVES, FOCUS_MM = HalfPixels(slope=0.414, half_slope_px=336.0), 956.0  # by the two boards; from the pupil
# Noise variance in steps of rounding: of both halves, smoothed by .7 px, and of either. On walls of the photographs the
# first is 3.2 times the finest frequencies' power, the second 2.3 times.
COMMON, COMMON_SIGMA_PX, OWN = 3.9, 0.7, 1.4
LEAST_NOISE = 2e-4  # of the white level, on the toe of the sRGB curve
BLANK_CONTRAST = 0.012  # of detail in windows of 4 px; below it walls look even


def rays(data: Path) -> RayTable:
    """Trace the lens at its focus, with half pixels."""
    lens = lens_of_json(data / "rf50mm_prescription.json")
    size = {"width_px": WIDTH, "height_px": HEIGHT, "pixel_pitch_mm": SENSOR_WIDTH_MM / WIDTH}
    pupil_mm = paraxial(focused_at(lens, 1000.0)).sensor_to_entrance_pupil_mm
    optics = focused_at(lens, FOCUS_MM + pupil_mm)
    radius_mm = pupil_camera(optics, **size).pupil_radius_mm
    return half_pixel_rays(lens_rays(optics, DESIGNS["open"], cells=12, **size), HALVES, pupil_radius_mm=radius_mm)


def wall(rng: Generator, size: int) -> np.ndarray:
    """A wall with hardly any texture or none, in uneven light, and up to three lines."""
    contrast = rng.choice([0.0, 0.002, 0.005, 0.01, 0.03], p=[0.35, 0.25, 0.15, 0.15, 0.1])
    light = grain(rng, size, exponent=1.0) * 0 + 0.45
    if contrast:
        light = grain(rng, size, exponent=rng.uniform(0.9, 1.5), mean=0.45, contrast=contrast)
    shade = grain(rng, size, exponent=2.5, mean=1, contrast=0.15)
    for _ in range(rng.integers(0, 4)):
        line = slice(at := int(rng.integers(0, size - 8)), at + int(rng.integers(2, 8)))
        light[(slice(None), line) if rng.random() < 0.5 else line] *= rng.uniform(0.5, 0.95)
    return np.clip((light * shade)[..., None] * rng.uniform(0.5, 1.8, 3), 0.01, 1).astype(np.float32)


def leather(rng: Generator, size: int) -> np.ndarray:
    light = grain(rng, size, exponent=rng.uniform(0.8, 1.4), mean=0.45, contrast=rng.choice([0.02, 0.05, 0.1]))
    return np.clip(light[..., None] * rng.uniform(0.02, 0.12) * np.full(3, 2.0), 0.003, 1).astype(np.float32)


def surface(rng: Generator, size: int) -> np.ndarray:
    kind = rng.random()
    if kind < 0.25:
        return wall(rng, size)
    return leather(rng, size) if kind < 0.45 else texture(rng, size).astype(np.float32)


def room(seed: int, half_field: tuple[float, float]) -> list[Plane]:
    """Draw a wall, often a floor or a table, sometimes a side wall, and three to nine cards."""
    rng, wide = np.random.default_rng(seed + 31000), half_field[0]
    far = rng.uniform(2000, 7500)
    turn = 0, rng.choice([0, 0, rng.uniform(-35, 35)]), 0
    back = wall(rng, 1400) if rng.random() < 0.7 else texture(rng, 1400).astype(np.float32)
    planes = [grey(back, center_mm=(0, 0, far), width_mm=5 * wide * far, tilt_deg=turn)]
    if rng.random() < 0.8:
        picture = surface(rng, 1400)
        drop, tilt = rng.uniform(250, 1300), -rng.uniform(62, 88)
        middle = rng.uniform(700, min(far, 4000))
        place = 0, drop * middle / 2500 + 100, middle
        planes.append(
            grey(picture, center_mm=place, width_mm=max(middle, 600), tilt_deg=(max(tilt, -80), 0, 0))
            if middle / 2 < middle - 120
            else planes[0]
        )
    if rng.random() < 0.5:
        side = rng.choice([-1, 1])
        picture, place = surface(rng, 1000), (side * 0.68 * wide * far, 0, 0.8 * far)
        turn = 0, side * rng.uniform(45, 75), 0
        planes.append(grey(picture, center_mm=place, width_mm=0.6 * far, tilt_deg=turn))
    for _ in range(rng.integers(3, 10)):
        planes.append(card(rng, half_field, far))
    return planes


def card(rng: Generator, half_field: tuple[float, float], far: float) -> Plane:
    z = 1 / rng.uniform(1 / far, 1 / 550)
    x, y = (rng.uniform(-1, 1) * half * z for half in half_field)
    picture = surface(rng, int(rng.choice([300, 500, 800])))
    picture = picture[: int(len(picture) * rng.uniform(0.4, 1))]
    width = 2 * half_field[0] * z * rng.uniform(0.12, 0.55)
    lean = rng.uniform(-30, 30) if rng.random() < 0.2 else 0.0
    turn = rng.uniform(-45, 45) if rng.random() < 0.3 else 0.0
    tilt = lean, turn, rng.uniform(-15, 15)
    if rng.random() < 0.25:
        cover = np.zeros(picture.shape[:2], np.float32)
        middle = picture.shape[1] // 2, picture.shape[0] // 2
        cv2.ellipse(cover, middle, (middle[0] - 2, middle[1] - 2), 0, 0, 360, 1, -1)
        picture = np.dstack([picture, cover])
    return grey(picture, center_mm=(x, y, z), width_mm=width, tilt_deg=tilt)


def grey(picture: np.ndarray, **where) -> Plane:
    """A plane in the light of the green pixels alone."""
    picture = np.array(picture, np.float32)
    picture[..., 0] = picture[..., 2] = picture[..., 1]
    return plane(picture, **where)


def photograph(light: np.ndarray, seed: int) -> np.ndarray:
    """Write both halves as 8 bits, with their noise, and read them again."""
    rng = np.random.default_rng(seed + 5)
    light = light * rng.choice([0.35, 0.6, 0.9]) / np.percentile(light, 99.5)
    level = rng.uniform(0.6, 1.4)
    white = rng.standard_normal(light.shape[:2]).astype(np.float32)
    common = np.sqrt(COMMON * level) * cv2.GaussianBlur(white, (0, 0), COMMON_SIGMA_PX)
    halves = []
    for half in (light[..., 0], light[..., 2]):
        step = np.sqrt(np.maximum(half, 0) / FULL_WELL_ELECTRONS + LEAST_NOISE**2 / 12)
        noisy = half + step * (common + np.sqrt(OWN * level) * rng.standard_normal(half.shape))
        stored = np.rint(255 * linear_to_srgb(np.clip(noisy, 0, 1).astype(np.float32)))
        halves.append(srgb_to_linear((stored / 255).astype(np.float32)))
    right, left = halves
    return np.dstack([right, (left + right) / 2, left]).astype(np.float32)


def blank(image: np.ndarray) -> np.ndarray:
    green = image[..., 1]
    detail = cv2.GaussianBlur(green, (0, 0), 0.8) - cv2.GaussianBlur(green, (0, 0), 3.2)
    power, mean = (cv2.GaussianBlur(part, (0, 0), 4) for part in (detail * detail, green))
    return np.sqrt(power) / (mean + 1e-3) < BLANK_CONTRAST


def measured(image: np.ndarray, truth: np.ndarray, camera: CodedApertureCamera) -> dict[str, float]:
    frame = camera.measure(image)
    depth, sigma = np.asarray(frame.depth_mm, float), np.asarray(frame.sigma_mm, float)
    known, answered = np.isfinite(truth), np.isfinite(truth) & np.isfinite(depth)
    error, ratio = np.abs(depth - truth), np.maximum(depth / truth, truth / depth)
    relative, bars = (error / truth)[answered], (error / sigma)[answered]
    wrong = answered & blank(image) & (ratio > 1.25)
    return {
        "abs_rel": relative.mean(), "ratio_below_1.25": (ratio[answered] < 1.25).sum() / known.sum(),
        "within_5_percent": (relative < 0.05).sum() / known.sum(),
        "within_10_percent": (relative < 0.1).sum() / known.sum(),
        "within_1_sigma": (bars < 1).mean(), "within_2_sigma": (bars < 2).mean(),
        "blank_and_off": wrong.sum() / known.sum(),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--camera", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(20)))
    parser.add_argument("--without-shared-noise", action="store_true")
    args = parser.parse_args()
    calibration, table = Calibration.load(args.camera), rays(args.data)
    half_field = tuple(n * SENSOR_WIDTH_MM / WIDTH / 2 / table.z_mm for n in (WIDTH, HEIGHT))
    rows = []
    for seed in args.seeds:
        planes = room(seed, half_field)
        image, truth = photograph(2 * render(table, planes, seed=seed), seed), render_depth(table, planes)
        camera = camera_for(image, calibration, "accurate")
        matcher = camera.config.matcher
        if args.without_shared_noise and isinstance(matcher, AccurateConfig):
            matcher = replace(matcher, spectral=replace(matcher.spectral, dual_pixel=False))
            camera = CodedApertureCamera(camera.calibration, replace(camera.config, matcher=matcher))
        rows.append(measured(image, truth - table.z_mm, camera))
        print(seed, " ".join(f"{k} {v:.3f}" for k, v in rows[-1].items()), flush=True)
    print("mean", " ".join(f"{k} {np.mean([row[k] for row in rows]):.3f}" for k in rows[0]))


if __name__ == "__main__":
    main()

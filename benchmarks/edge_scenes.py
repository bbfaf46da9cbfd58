"""Random captures with known depth edges for `edge_training.py`: cards of any outline, through random cameras.

    python benchmarks/edge_scenes.py --out FOLDER [--cameras 60] [--scenes 10] [--first 0] [--rooms]

Every camera has another design, film, lens and focus. Kept are the photograph at half its resolution, linear light, and
between which blocks of 4 px the true distance jumps or bends. One camera of ten scenes takes 30 s on two cores.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.random import Generator
from rooms import NEAREST_MM, cover_of_card, few_surfaces, furnished_room, photographed, random_scene, texture

from chromaperture.matching.blocks import BLOCK_PX
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.pinhole import focused_at
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import RayTable, lens_rays
from chromaperture.optics.simulator.scene import Plane, plane

PITCH_MM = 0.03097
SIZES = ((720, 480), (720, 480), (360, 240))
EXPOSURES = (0.2, 0.5, 0.9, 0.9)  # of the white level
EXPOSURES_OF_ROOMS = (0.06, 0.2, 0.5, 0.9)
FILMS = ("ideal", "real", "leaky")
CUT_OUTS_MM = 2300.0  # the farthest; no wall is nearer
STEP = 0.015  # between neighbouring pixels, of the distance; the steepest surfaces of these scenes reach it
# Change of the slope of 1 / distance from one pixel to the next, of 1 / distance. In sixteen scenes the median of those
# above is .0015 to .0029, and 99 % of all pixels are below 5e-7.
FOLD = 5e-4


def outline(rng: Generator, height: int, width: int) -> np.ndarray:
    """Draw which part of a picture is there: an ellipse, a polygon, a blob, a few leaves; (height, width) float32."""
    cover = np.zeros((height, width), np.float32)
    middle = (width - 1) / 2, (height - 1) / 2

    def ring(turns: np.ndarray, radii: np.ndarray) -> None:
        points = np.stack([np.cos(turns) * middle[0], np.sin(turns) * middle[1]], axis=1) * radii[:, None]
        cv2.fillPoly(cover, [np.rint(points + middle).astype(np.int32)], 1.0)

    kind = rng.integers(4)
    if kind == 0:
        ring(np.linspace(0, 2 * np.pi, 90), np.full(90, 0.98))
    elif kind == 1:
        count = int(rng.integers(3, 9))
        ring(np.sort(rng.uniform(0, 2 * np.pi, count)), rng.uniform(0.6, 1, count))
    elif kind == 2:
        turns = np.linspace(0, 2 * np.pi, 180)
        waves = sum(rng.normal() / n * np.cos(n * turns + rng.uniform(0, 6.3)) for n in range(1, 9))
        ring(turns, np.clip(0.75 + 0.2 * waves, 0.15, 1))
    else:
        for _ in range(rng.integers(3, 12)):
            place = int(rng.uniform(0.2, 0.8) * width), int(rng.uniform(0.2, 0.8) * height)
            size = int(rng.uniform(0.1, 0.35) * width), int(rng.uniform(0.03, 0.12) * height) + 1
            cv2.ellipse(cover, place, size, rng.uniform(0, 180), 0, 360, 1.0, -1)
    return cover


def cut_out(
    rng: Generator, half_field: tuple[float, float], farthest_mm: float, cover: Callable[[Generator, int], np.ndarray]
) -> Plane:
    """Draw a card of any outline anywhere in view, evenly in 1 / distance."""
    z = min(NEAREST_MM / (1 - rng.random() * (1 - NEAREST_MM / farthest_mm)), farthest_mm)
    x, y = (rng.uniform(-1, 1) * half * z for half in half_field)
    picture = cover(rng, int(rng.choice([300, 500, 800])))
    picture = picture[: int(len(picture) * rng.uniform(0.4, 1))]
    tilt = (
        rng.uniform(-30, 30) * (rng.random() < 0.2),
        rng.uniform(-45, 45) * (rng.random() < 0.25),
        rng.uniform(0, 360),
    )
    shape = outline(rng, *picture.shape[:2])
    width = 2 * half_field[0] * z * rng.uniform(0.12, 0.6)
    return plane(np.dstack([picture, shape]), center_mm=(x, y, z), width_mm=width, tilt_deg=tilt)


def scene(seed: int, half_field: tuple[float, float], *, furnished: bool) -> list[Plane]:
    """Draw the rooms of `rooms.py`, two in three with things of other outlines in them."""
    rng = np.random.default_rng(seed + 50000)
    room = furnished_room if furnished else few_surfaces if seed % 2 else random_scene
    planes = room(seed, half_field)
    if seed % 3:
        cover = cover_of_card if furnished else texture
        planes = planes + [cut_out(rng, half_field, CUT_OUTS_MM, cover) for _ in range(rng.integers(1, 6))]
    return planes


def edges_of(depth_mm: np.ndarray) -> np.ndarray:
    """Find between which blocks the distance jumps or bends: of rows, then of columns; (2, H // 4, W // 4) bool.

    The entry of a block is about the block below it, and the one right of it.
    """
    near = 1 / depth_mm

    def along(values: np.ndarray) -> np.ndarray:
        """Look along the columns of an array, from the middle of a block to the next."""
        jump = np.abs(np.diff(values, axis=0)) > STEP * values[1:]
        bend = np.abs(np.diff(values, 2, axis=0)) > FOLD * values[1:-1]
        found = jump.copy()
        found[1:] |= bend
        count, across = values.shape[0] // BLOCK_PX, values.shape[1] // BLOCK_PX
        rows = found[BLOCK_PX // 2 : BLOCK_PX // 2 + (count - 1) * BLOCK_PX, : across * BLOCK_PX]
        of_columns = rows.reshape(count - 1, BLOCK_PX, -1).any(axis=1)
        out = np.zeros((count, across), bool)
        out[:-1] = of_columns.reshape(count - 1, across, BLOCK_PX).sum(axis=2) * 2 >= BLOCK_PX
        return out

    return np.stack([along(near), along(near.T).T])


def camera(seed: int) -> tuple[RayTable, tuple[float, float]]:
    """Draw a camera: its rays, and the tangents of half its field of view."""
    rng = np.random.default_rng(seed + 90000)
    width, height = SIZES[rng.integers(len(SIZES))]
    design = str(rng.choice([name for name in DESIGNS if name != "open"]))
    film = str(rng.choice(FILMS))
    lens = load_lens(str(rng.choice(["double_gauss_50", "double_gauss_50", "achromat_50"])))
    size = {"width_px": width, "height_px": height, "pixel_pitch_mm": PITCH_MM}
    table = lens_rays(
        focused_at(lens, float(rng.uniform(1400, 3200))), made_of(DESIGNS[design], film), cells=12, **size
    )
    half = PITCH_MM * np.array([width, height]) / 2 / table.z_mm
    return table, (float(half[0]), float(half[1]))


def captures(
    seed: int, scenes: int, keep: Callable[[int, np.ndarray, np.ndarray], None], *, furnished: bool
) -> None:
    """Photograph scenes through one camera."""
    table, half_field = camera(seed)
    exposures = EXPOSURES_OF_ROOMS if furnished else EXPOSURES
    for number in range(seed * 100, seed * 100 + scenes):
        planes = scene(number, half_field, furnished=furnished)
        keep(number, *photographed(table, planes, seed=number, exposures=exposures))


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--out", type=Path, required=True)
    arguments.add_argument("--cameras", type=int, default=60)
    arguments.add_argument("--scenes", type=int, default=10, help="of every camera")
    arguments.add_argument("--first", type=int, default=0, help="number of the first camera")
    arguments.add_argument("--rooms", action="store_true", help="furnished ones")
    args = arguments.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    def keep(number: int, image: np.ndarray, truth_mm: np.ndarray) -> None:
        half = cv2.resize(image.astype(np.float32), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        np.savez_compressed(args.out / f"{number}.npz", image=half.astype(np.float16), edges=edges_of(truth_mm))

    for seed in range(args.first, args.first + args.cameras):
        captures(seed, args.scenes, keep, furnished=args.rooms)
        print(f"camera {seed}", flush=True)


if __name__ == "__main__":
    main()

"""Random rooms as people photograph them: printed walls, floors of wood and tiles, books, boxes, posters, shelves.

    python benchmarks/furnished_rooms.py --out PICTURE.png [--first 0] [--bent]

draws twelve of them. The rooms of `error_bar_scenes.py` have walls of enlarged photographs, whose own blur looks like
that of a lens out of focus; here prints are sharp and photographs small. Sizes are millimetres.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from error_bar_scenes import NEAREST_MM, grain, photograph, photographed, side_of_box
from numpy.random import Generator

from chromaperture.color.color_maps import DISTANCE, draw_levels
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.paraxial import focused_at
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays
from chromaperture.optics.simulator.scene import Plane, plane

WORDS = (
    "depth", "light", "colour", "pupil", "lens", "field", "focus", "aperture", "film", "ray", "optics", "sensor",
    "blur", "print", "paper", "image",
)  # fmt: skip
FONTS = cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX, cv2.FONT_HERSHEY_COMPLEX
WALLS_MM = 2200.0, 3900.0
STRIPS = 18  # of what is bent: a can with a radius of 100 mm is .3 mm off between two joints
WALL_TEXELS, FLOOR_TEXELS = 1500, 1200


def hue(rng: Generator, *, saturation: float = 1.0) -> np.ndarray:
    """Draw a colour of paint or ink, linear; one in four is grey."""
    grey, own = rng.uniform(0.05, 0.85), rng.uniform(0.04, 0.9, 3)
    share = 0.0 if rng.random() < 0.25 else saturation * rng.uniform(0.2, 1)
    return np.asarray(grey * (1 - share) + own * share, np.float32)


def two_hues(rng: Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw two colours that differ."""
    one = hue(rng)
    while True:
        other = hue(rng)
        if np.abs(one - other).max() > rng.choice([0.06, 0.15, 0.3]):
            return one, other


def worn(rng: Generator, picture: np.ndarray) -> np.ndarray:
    """Add the grain of a material, and half of the time clouds of light and shade."""
    height, width = picture.shape[:2]
    side = max(height, width)
    fine = grain(rng, side, exponent=rng.uniform(0.3, 0.9), mean=0.5, contrast=rng.choice([0.01, 0.03, 0.08]))
    out = picture * (0.5 + fine[:height, :width, None])
    if rng.random() < 0.5:
        clouds = grain(rng, side, exponent=rng.uniform(1.3, 2), mean=0.5, contrast=rng.choice([0.05, 0.15]))
        out = out * (0.5 + clouds[:height, :width, None])
    return np.clip(out, 0.01, 0.98).astype(np.float32)


def wallpaper(rng: Generator, size: int) -> np.ndarray:
    """Diamonds, checks, stripes or dots of two colours."""
    one, other = two_hues(rng)
    y, x = np.mgrid[:size, :size].astype(np.float32)
    period, tall = rng.uniform(16, 90), rng.uniform(0.6, 2)
    u, v = x / period, y / (period * tall)
    kind = rng.integers(4)
    if kind == 0:
        inside = (np.floor(u + v) + np.floor(u - v)) % 2
    elif kind == 1:
        inside = (np.floor(u) + np.floor(v)) % 2
    elif kind == 2:
        inside = (u if rng.random() < 0.7 else v) % 1 < rng.uniform(0.1, 0.6)
    else:
        inside = np.hypot(u % 1 - 0.5, v % 1 - 0.5) < rng.uniform(0.15, 0.4)
    return worn(rng, np.where(inside[..., None] > 0, one, other))


def bricks(rng: Generator, size: int) -> np.ndarray:
    """Bricks or tiles with joints, each in its own tone."""
    tone, joint = hue(rng, saturation=0.6), hue(rng, saturation=0.2)
    height = int(rng.uniform(18, 70))
    width = int(height * rng.uniform(1, 3.5))
    shift = width // 2 if rng.random() < 0.6 else 0
    gap, own = int(rng.integers(2, 5)), rng.choice([0.03, 0.1, 0.25])
    picture = np.empty((size, size, 3), np.float32)
    picture[:] = joint
    for row, top in enumerate(range(0, size, height)):
        for left in range(-width, size, width):
            start = left + shift * (row % 2)
            color = tone * (1 + own * rng.normal()) + 0.3 * own * rng.normal(size=3)
            picture[top : top + height - gap, max(0, start) : max(0, start + width - gap)] = np.clip(color, 0.01, 1)
    return worn(rng, picture)


def wood(rng: Generator, size: int) -> np.ndarray:
    """Planks with a grain along them."""
    tone = np.array([0.45, 0.25, 0.12]) * rng.uniform(0.4, 1.6) * rng.uniform(0.8, 1.2, 3)
    along = cv2.resize(
        grain(rng, size, exponent=rng.uniform(0.5, 1), mean=0.5, contrast=rng.choice([0.06, 0.12, 0.2])),
        None, fx=1, fy=rng.uniform(5, 16), interpolation=cv2.INTER_LINEAR,
    )[:size]  # fmt: skip
    picture = np.clip(tone * (0.5 + along)[..., None], 0.01, 1)
    plank = int(rng.uniform(50, 160))
    for left in range(0, size, plank):
        picture[:, left : left + plank] *= 1 + 0.12 * rng.normal()
        picture[:, left : left + 2] *= 0.45
    picture = np.rot90(picture) if rng.random() < 0.5 else picture
    return np.clip(np.ascontiguousarray(picture), 0.01, 0.98).astype(np.float32)


def plaster(rng: Generator, size: int) -> np.ndarray:
    """A painted wall: its grain is fine and often faint."""
    fine = grain(rng, size, exponent=rng.uniform(0.3, 1), mean=0.5, contrast=rng.choice([0.01, 0.02, 0.05, 0.1]))
    clouds = grain(rng, size, exponent=1.8, mean=0.5, contrast=0.08)
    return np.clip(hue(rng, saturation=0.5) * (0.5 + fine)[..., None] * (0.5 + clouds)[..., None], 0.01, 0.98).astype(
        np.float32
    )


def cloth(rng: Generator, size: int) -> np.ndarray:
    """A carpet or a curtain: a weave of two colours in a pattern."""
    one, other = two_hues(rng)
    share = grain(rng, size, exponent=rng.uniform(0.8, 1.4), mean=0.5, contrast=0.25)
    weave = grain(rng, size, exponent=0.1, mean=0.5, contrast=rng.choice([0.05, 0.15]))
    return np.clip((one + (other - one) * share[..., None]) * (0.5 + weave)[..., None], 0.01, 0.98).astype(np.float32)


def inked(picture: np.ndarray, mask: np.ndarray, ink: np.ndarray) -> None:
    """Print what a mask of 8 bits says into a picture."""
    picture += (ink - picture) * (mask[..., None] / np.float32(255))


def lettering(rng: Generator, picture: np.ndarray, ink: np.ndarray, *, top: int, bottom: int, margin: int) -> None:
    """Write lines of words into a picture, from top to bottom."""
    mask = np.zeros(picture.shape[:2], np.uint8)
    height = int(rng.uniform(7, 26))
    scale, thickness = height / 22, max(1, round(height / rng.uniform(6, 14)))
    font = FONTS[rng.integers(len(FONTS))]
    right = picture.shape[1] - margin
    for base in range(top + height, bottom, int(height * rng.uniform(1.5, 2))):
        x = margin
        while x < right:
            word = str(rng.choice(WORDS))
            length = cv2.getTextSize(word, font, scale, thickness)[0][0]
            if x + length > right:
                break
            cv2.putText(mask, word, (x, base), font, scale, 255, thickness, cv2.LINE_AA)
            x += length + height // 2
    inked(picture, mask, ink)


def book(rng: Generator, size: int) -> np.ndarray:
    """A cover: frame, title, lines of text, discs and rings, sometimes a photograph."""
    ground, ink = two_hues(rng)
    tall = int(size * rng.uniform(0.6, 1.4))
    picture = np.empty((tall, size, 3), np.float32)
    picture[:] = ground
    picture *= 0.5 + grain(rng, max(tall, size), exponent=1.5, mean=0.5, contrast=rng.choice([0.02, 0.08, 0.15]))[
        :tall, :size, None
    ]
    margin = int(size * rng.uniform(0.04, 0.1))
    if rng.random() < 0.6:
        cv2.rectangle(
            picture, (margin // 2, margin // 2), (size - margin // 2, tall - margin // 2), ink.tolist(), margin // 5 + 1
        )
    title = str(rng.choice(WORDS)).upper()
    font = FONTS[rng.integers(len(FONTS))]
    scale = 0.75 * (size - 2 * margin) / cv2.getTextSize(title, font, 1, 2)[0][0] * rng.uniform(0.6, 1)
    base = margin + int(26 * scale)
    mask = np.zeros(picture.shape[:2], np.uint8)
    cv2.putText(mask, title, (margin, base), font, scale, 255, max(1, round(3 * scale)), cv2.LINE_AA)
    inked(picture, mask, ink)
    kind = rng.integers(3)
    if kind == 0:
        lettering(rng, picture, ink, top=base + 10, bottom=tall - margin, margin=margin)
    elif kind == 1 and tall - margin > base + 40:
        side = min(size - 2 * margin, tall - margin - base - 20)
        picture[base + 20 : base + 20 + side, margin : margin + side] = photograph(rng, side)
    for _ in range(rng.integers(0, 6)):
        place = int(rng.integers(0, size)), int(rng.integers(base, max(base + 1, tall)))
        color, full = hue(rng).tolist(), -1 if rng.random() < 0.5 else int(rng.integers(1, 5))
        cv2.circle(picture, place, int(size * rng.uniform(0.02, 0.15)), color, full, cv2.LINE_AA)
    return np.clip(picture, 0.01, 0.98).astype(np.float32)


def poster(rng: Generator, size: int) -> np.ndarray:
    """A photograph with a margin, and a line below it."""
    picture = np.empty((int(size * 1.15), size, 3), np.float32)
    picture[:] = hue(rng, saturation=0.3)
    margin = int(size * rng.uniform(0.02, 0.08))
    side = size - 2 * margin
    picture[margin : margin + side, margin : margin + side] = photograph(rng, side)
    lettering(rng, picture, hue(rng), top=margin + side + 4, bottom=len(picture) - 2, margin=margin)
    return np.clip(picture, 0.01, 0.98).astype(np.float32)


def page(rng: Generator, size: int) -> np.ndarray:
    """Text on paper, or a chart of letters."""
    picture = np.full((int(size * rng.uniform(0.4, 1.4)), size, 3), rng.uniform(0.6, 0.9), np.float32)
    margin = max(4, size // 12)
    lettering(rng, picture, np.full(3, 0.04), top=margin, bottom=len(picture) - margin, margin=margin)
    return worn(rng, picture)


def shelf(rng: Generator, size: int) -> np.ndarray:
    """Backs of books side by side, row over row."""
    picture = np.full((size, size, 3), 0.05, np.float32)
    high = int(size / rng.integers(3, 7))
    for top in range(0, size, high):
        left = 0
        while left < size:
            wide, low = int(rng.uniform(12, 60)), int(high * rng.uniform(0.02, 0.3))
            picture[top + low : top + high - 6, left : left + wide - 1] = hue(rng)
            for _ in range(rng.integers(0, 4)):
                at = top + low + int(rng.uniform(0, high - low))
                picture[at : at + int(rng.integers(2, 14)), left + 2 : left + wide - 3] = hue(rng)
            left += wide
    return worn(rng, picture)


def cover_of_card(rng: Generator, size: int) -> np.ndarray:
    kinds = book, poster, page, cloth, wallpaper, wood, plaster
    return kinds[rng.choice(len(kinds), p=[0.4, 0.15, 0.15, 0.08, 0.08, 0.07, 0.07])](rng, size)


def cover_of_wall(rng: Generator) -> np.ndarray:
    kinds = wallpaper, bricks, plaster, shelf, cloth, wood, poster
    kind = kinds[rng.choice(len(kinds), p=[0.25, 0.2, 0.2, 0.1, 0.08, 0.07, 0.1])]
    return kind(rng, WALL_TEXELS)[:WALL_TEXELS]


def furnished_room(seed: int, half_field: tuple[float, float]) -> list[Plane]:
    """Draw a wall, often a floor and a side wall, posters on the wall, and two to nine books, boxes and cards.

    Parameters
    ----------
    seed : int
    half_field : (float, float)
        Tangents of half the field of view, along x and y.
    """
    rng, (wide, high) = np.random.default_rng(seed + 31000), half_field
    far = rng.uniform(*WALLS_MM)
    turn = rng.choice([0, 0, 0, rng.uniform(-12, 12)]), rng.choice([0, 0, 0, rng.uniform(-25, 25)]), 0
    planes = [plane(cover_of_wall(rng), center_mm=(0, 0, far), width_mm=4.4 * wide * far, tilt_deg=turn)]
    if rng.random() < 0.6:
        tilt = -rng.uniform(68, 86), 0, 0
        kinds = wood, bricks, cloth, wallpaper
        floor = kinds[rng.choice(4, p=[0.45, 0.25, 0.2, 0.1])](rng, FLOOR_TEXELS)
        planes.append(plane(floor, center_mm=(0, rng.uniform(0.6, 0.9) * high * far, 0.72 * far), width_mm=1.2 * far,
                            tilt_deg=tilt))  # fmt: skip
    if rng.random() < 0.3:
        side, turned = rng.choice([-1, 1]), rng.uniform(50, 75)
        place = side * rng.uniform(0.75, 0.95) * wide * far, 0, 0.8 * far
        planes.append(plane(cover_of_wall(rng), center_mm=place, width_mm=0.6 * far, tilt_deg=(0, side * turned, 0)))
    if not any(turn):
        for _ in range(rng.integers(0, 4)):  # on the wall, or a little before it
            z = far - rng.choice([4.0, rng.uniform(20, 400)])
            place = rng.uniform(-1, 1) * wide * z, rng.uniform(-1, 0.6) * high * z, z
            planes.append(plane(cover_of_card(rng, 400), center_mm=place, width_mm=wide * z * rng.uniform(0.2, 0.8)))
    for _ in range(rng.integers(2, 8)):
        planes += thing(rng, half_field, 0.97 * far)
    return planes


def thing(rng: Generator, half_field: tuple[float, float], farthest_mm: float) -> list[Plane]:
    """Draw a book, a box or a card that stands upright or nearly so, evenly in 1 / distance."""
    z = NEAREST_MM / (1 - rng.random() * (1 - NEAREST_MM / farthest_mm))
    x, y = rng.uniform(-1, 1) * half_field[0] * z, rng.uniform(-0.5, 1) * half_field[1] * z
    width = 2 * half_field[0] * z * rng.uniform(0.12, 0.45)
    front = cover_of_card(rng, int(rng.choice([300, 450, 600])))
    height = width * front.shape[0] / front.shape[1]
    turned = rng.uniform(-40, 40) if rng.random() < 0.3 else 0.0
    tilt = (rng.uniform(-30, 20) if rng.random() < 0.2 else 0.0), turned, (rng.uniform(-8, 8) * (rng.random() < 0.5))
    found = [plane(front, center_mm=(x, y, z), width_mm=width, tilt_deg=tilt)]
    if rng.random() < 0.4 and not any(tilt):
        deep, turned = width * rng.uniform(0.15, 1), rng.uniform(50, 85)
        flank = plaster(rng, 300) if rng.random() < 0.5 else cover_of_card(rng, 300)
        flank = cv2.resize(flank, (300, max(2, min(900, int(300 * height / deep)))), interpolation=cv2.INTER_AREA)
        found.append(side_of_box(flank, front_mm=(x, y, z), width_mm=width, deep_mm=deep, turned_deg=turned))
    return found


def bent_things(seed: int, half_field: tuple[float, float]) -> list[Plane]:
    """Draw one to four cans, columns, curtains and bent pages for two rooms in three: what planes do not explain."""
    rng, (wide, high) = np.random.default_rng(seed + 63000), half_field
    found: list[Plane] = []
    for _ in range(rng.integers(1, 5) if rng.random() < 2 / 3 else 0):
        z = NEAREST_MM / (1 - rng.random() * (1 - NEAREST_MM / WALLS_MM[0]))
        x, y = rng.uniform(-1, 1) * wide * z, rng.uniform(-0.5, 0.8) * high * z
        width, kind = 2 * wide * z * rng.uniform(0.12, 0.5), rng.integers(4)
        along = np.linspace(-0.5, 0.5, STRIPS + 1)
        if kind < 2:  # a can or a column: the half of a cylinder that faces the lens
            turns = np.pi * 0.94 * along
            line = width / 2 * np.stack([np.sin(turns), -np.cos(turns)], axis=1)
        elif kind == 2:
            folds, deep = rng.uniform(1.5, 4), width * rng.uniform(0.03, 0.1)
            line = np.stack([width * along, deep * np.sin(2 * np.pi * folds * along + rng.uniform(0, 6.3))], axis=1)
        else:
            line = np.stack([width * along, width * rng.uniform(-1, 1) * along**2 + width * 0.5 * along], axis=1)
        found += bent_sheet(cover_of_card(rng, 600), line + np.array([x, z]), y_mm=y)
    return found


def bent_sheet(texture: np.ndarray, line_mm: np.ndarray, *, y_mm: float) -> list[Plane]:
    """Bend a picture along a line of (x, z), upright strip by strip."""
    steps = np.diff(line_mm, axis=0)
    lengths = np.hypot(*steps.T)
    texel_mm = lengths.sum() / texture.shape[1]
    ends = np.rint(np.concatenate([[0], np.cumsum(lengths)]) / texel_mm).astype(int)
    strips = []
    for (x, z), (right, deeper), length, first, last in zip(
        line_mm[:-1], steps, lengths, ends[:-1], np.maximum(ends[1:], ends[:-1] + 2), strict=True
    ):
        # Wider by a hundredth, so that no ray passes between two; as high as the whole picture.
        tall = max(2, round(len(texture) * texel_mm * (last - first) / length))
        part = cv2.resize(texture[:, first:last], (int(last - first), tall), interpolation=cv2.INTER_LINEAR)
        place = x + right / 2, y_mm, z + deeper / 2
        turned = -np.degrees(np.arctan2(deeper, right))
        strips.append(plane(part, center_mm=place, width_mm=1.01 * length, tilt_deg=(0, turned, 0)))
    return strips


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--out", type=Path, required=True)
    arguments.add_argument("--first", type=int, default=0)
    arguments.add_argument("--bent", action="store_true", help="cans and curtains, too")
    args = arguments.parse_args()
    size = {"width_px": 360, "height_px": 240, "pixel_pitch_mm": 0.06194}
    lens = focused_at(load_lens("double_gauss_50"), 2000.0)
    table = lens_rays(lens, made_of(DESIGNS["cy_halves"], "real"), cells=8, **size)
    half = 0.06194 * np.array([360, 240]) / 2 / table.z_mm
    pictures = []
    for seed in range(args.first, args.first + 12):
        half_field = float(half[0]), float(half[1])
        room = furnished_room(seed, half_field) + (bent_things(seed, half_field) if args.bent else [])
        image, depth_mm = photographed(table, room, seed=seed, exposures=(0.9,))
        levels = (1 / NEAREST_MM - 1 / depth_mm) / (1 / NEAREST_MM - 1 / WALLS_MM[1])
        near = draw_levels(levels, DISTANCE)[..., ::-1]
        pictures.append(np.vstack([np.uint8(255 * np.sqrt(np.clip(image, 0, 1)))[..., ::-1], near]))
    rows = [np.hstack(pictures[row : row + 4]) for row in range(0, 12, 4)]
    cv2.imwrite(str(args.out), np.vstack(rows))


if __name__ == "__main__":
    main()

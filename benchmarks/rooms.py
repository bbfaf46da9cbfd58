"""Random rooms of planes for `world_scenes.py` and `edge_scenes.py`: generated textures, photographs, prints.

Photographs are those that scikit-image brings (public domain or CC0): `pip install 'chromaperture[bench]'`. Rooms of
`random_scene` have walls of enlarged photographs, whose own blur looks like that of a lens out of focus; in a
`furnished_room` prints are sharp and photographs small. Sizes are millimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
from numpy.random import Generator
from skimage import data

from chromaperture.optics.ray_table import RayTable
from chromaperture.optics.simulator.render import render, render_depth
from chromaperture.optics.simulator.scene import Plane, plane
from chromaperture.optics.simulator.sensor import SensorModel, develop, expose
from chromaperture.optics.simulator.textures import noise, srgb_to_linear

PHOTOGRAPHS = ("astronaut", "coffee", "chelsea", "rocket", "immunohistochemistry", "hubble_deep_field")
NEAREST_MM, FARTHEST_MM = 1000.0, 3900.0
WALLS_MM = 2400.0, 3700.0
# Of the textures: their red askew by up to 1.2 of their pixels, 1 to 5 mm on a wall; printers keep to .1 mm. With
# 0.2 bars are half as long again, for errors of whole planes that no sign tells.
MISPRINTED = 0.02
WORDS = (
    "depth", "light", "colour", "pupil", "lens", "field", "focus", "aperture", "film", "ray", "optics", "sensor",
    "blur", "print", "paper", "image",
)  # fmt: skip
FONTS = cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX, cv2.FONT_HERSHEY_COMPLEX
FURNISHED_WALLS_MM = 2200.0, 3900.0
WALL_TEXELS, FLOOR_TEXELS = 1500, 1200


def grain(rng: Generator, size: int, **options: float) -> np.ndarray:
    """Noise with a power law of its own seed; (size, size)."""
    return noise((size, size), seed=int(rng.integers(1e9)), **options)


def leaves(rng: Generator, size: int) -> np.ndarray:
    """Discs and rectangles whose sizes follow a power law, as things in photographs do."""
    base, contrast = rng.uniform(0.15, 0.8, 3), rng.choice([0.12, 0.3, 0.6])
    hues = contrast * rng.choice([0.0, 0.15, 0.5])
    picture = np.full((size, size, 3), rng.uniform(0.2, 0.7), np.float32)
    radii = 3 / (1 - rng.random(int(rng.choice([400, 1200, 3000]))))
    for radius in np.minimum(np.sort(radii)[::-1], size / 3):
        color = np.clip(base * (1 + contrast * rng.normal()) + hues * rng.normal(size=3), 0.02, 0.95).tolist()
        x, y = (int(v) for v in rng.integers(0, size, 2))
        if rng.random() < 0.5:
            cv2.circle(picture, (x, y), int(radius), color, -1, cv2.LINE_AA)
        else:
            box = (x, y), (2 * radius, radius * rng.uniform(0.3, 2)), rng.uniform(0, 180)
            cv2.fillConvexPoly(picture, cv2.boxPoints(box).astype(np.int32), color, cv2.LINE_AA)
    return picture


def speckle(rng: Generator, size: int) -> np.ndarray:
    """Noise in a hue, with a share of its own in every channel."""
    exponent, contrast = rng.uniform(0.6, 1.3), rng.choice([0.02, 0.06, 0.12, 0.2])
    own = rng.choice([0, 0.05, 0.2, 0.4])
    common, *each = (grain(rng, size, exponent=exponent, mean=0.45, contrast=contrast) for _ in range(4))
    picture = common[..., None] + own * (np.stack(each, axis=-1) - 0.45)
    return np.asarray(np.clip(picture * rng.uniform(0.25, 1, 3), 0.01, 1))


def stripes(rng: Generator, size: int) -> np.ndarray:
    """Bars of one period in any direction, and a little noise."""
    turn, period = rng.uniform(0, np.pi), rng.uniform(10, 120)
    y, x = np.mgrid[:size, :size]
    bars = np.sign(np.sin(2 * np.pi * (x * np.cos(turn) + y * np.sin(turn)) / period))
    little = 0.02 * (grain(rng, size, exponent=0.8) - 0.45)
    light = 0.45 + rng.uniform(0.05, 0.35) * bars
    return np.asarray(np.clip(light[..., None] * rng.uniform(0.4, 1, 3) + little[..., None], 0.01, 1))


def blank(rng: Generator, size: int) -> np.ndarray:
    """A wall with hardly any texture, and up to five lines across it."""
    wall = grain(rng, size, exponent=rng.uniform(1, 1.6), mean=0.45, contrast=rng.choice([0.008, 0.02, 0.04]))
    for _ in range(rng.integers(0, 6)):
        line, light = slice(at := int(rng.integers(0, size - 8)), at + int(rng.integers(2, 8))), rng.uniform(0.5, 0.95)
        wall[(slice(None), line) if rng.random() < 0.5 else line] *= light
    return np.asarray(np.clip(wall[..., None] * rng.uniform(0.3, 1.2, 3), 0.01, 1))


@cache
def photograph_named(name: str) -> np.ndarray:
    return srgb_to_linear(getattr(data, name)()[..., :3].astype(np.float32) / 255)


def photograph(rng: Generator, size: int) -> np.ndarray:
    """A square of a photograph, turned, mirrored, its colours exchanged, in another light."""
    whole = photograph_named(str(rng.choice(PHOTOGRAPHS)))
    height, width = whole.shape[:2]
    side = int(min(height, width) * rng.uniform(0.4, 1))
    y, x = rng.integers(0, height - side + 1), rng.integers(0, width - side + 1)
    part = np.rot90(whole[y : y + side, x : x + side], int(rng.integers(4)))
    part = part[:, ::-1] if rng.random() < 0.5 else part
    part = part[..., rng.permutation(3)] if rng.random() < 0.3 else part
    how = cv2.INTER_AREA if size < side else cv2.INTER_CUBIC
    part = cv2.resize(np.ascontiguousarray(part), (size, size), interpolation=how)
    return np.asarray(np.clip(part * rng.uniform(0.7, 1.4) * rng.uniform(0.6, 1, 3), 0.005, 1))


def texture(rng: Generator, size: int) -> np.ndarray:
    """Any of them; few printed with their red askew, one in three in uneven light; (size, size, 3) float32."""
    kinds = leaves, speckle, stripes, blank, photograph
    picture = kinds[rng.choice(len(kinds), p=[0.25, 0.2, 0.04, 0.08, 0.43])](rng, size).astype(np.float32)
    if rng.random() < MISPRINTED:
        shift = np.array([[1, 0, rng.uniform(-1.2, 1.2)], [0, 1, rng.uniform(-1.2, 1.2)]], np.float32)
        picture[..., 0] = cv2.warpAffine(picture[..., 0], shift, (size, size), borderMode=cv2.BORDER_REFLECT)
    if rng.random() < 0.3:
        picture *= 0.6 + 0.4 * grain(rng, size, exponent=1.6, mean=0.5, contrast=0.2)[..., None]
    return picture


def random_scene(seed: int, half_field: tuple[float, float]) -> list[Plane]:
    """Draw a wall, sometimes a floor and a side wall, and four to ten cards, some slanted, round, or sides of boxes.

    Parameters
    ----------
    seed : int
    half_field : (float, float)
        Tangents of half the field of view, along x and y.
    """
    rng, (wide, high) = np.random.default_rng(seed), half_field
    far = rng.uniform(*WALLS_MM)
    turn = rng.choice([0, 0, 0, rng.uniform(-15, 15)]), rng.choice([0, 0, 0, rng.uniform(-25, 25)]), 0
    wall = texture(rng, int(rng.choice([700, 1000, 1400])))
    planes = [plane(wall, center_mm=(0, 0, far), width_mm=4.4 * wide * far, tilt_deg=turn)]
    if rng.random() < 0.5:
        tilt = -rng.uniform(65, 80), 0, 0
        place = 0, 0.75 * high * far, 0.75 * far
        planes.append(plane(texture(rng, 900), center_mm=place, width_mm=1.2 * far, tilt_deg=tilt))
    if rng.random() < 0.35:
        side = rng.choice([-1, 1])
        tilt = 0, side * rng.uniform(50, 72), 0
        place = side * 0.8 * wide * far, 0, 0.8 * far
        planes.append(plane(texture(rng, 900), center_mm=place, width_mm=0.5 * far, tilt_deg=tilt))
    for _ in range(rng.integers(4, 11)):
        planes += card(rng, half_field, 1.02 * far)
    return planes


def few_surfaces(seed: int, half_field: tuple[float, float]) -> list[Plane]:
    """Draw a wall, sometimes a floor, and two to five cards, half of the wide ones photographs; as `random_scene`."""
    rng, (wide, high) = np.random.default_rng(seed + 9000), half_field

    def surface(size: int) -> np.ndarray:
        return photograph(rng, size).astype(np.float32) if rng.random() < 0.5 else texture(rng, size)

    far = rng.uniform(2300, 3800)
    turn = rng.choice([0, 0, rng.uniform(-15, 15)]), rng.choice([0, 0, rng.uniform(-25, 25)]), 0
    wall = surface(int(rng.choice([700, 1000, 1400])))
    planes = [plane(wall, center_mm=(0, 0, far), width_mm=4.4 * wide * far, tilt_deg=turn)]
    if rng.random() < 0.5:
        tilt = -rng.uniform(65, 80), 0, 0
        place = 0, 0.75 * high * far, 0.75 * far
        planes.append(plane(surface(900), center_mm=place, width_mm=1.2 * far, tilt_deg=tilt))
    for _ in range(rng.integers(2, 6)):
        planes += card(rng, (0.8 * wide, 0.8 * high), far)
    return planes


def card(rng: Generator, half_field: tuple[float, float], farthest_mm: float) -> list[Plane]:
    """Draw a card anywhere in view, evenly in 1 / distance; one in four of the upright ones is the front of a box."""
    z = min(NEAREST_MM / (1 - rng.random() * (1 - NEAREST_MM / FARTHEST_MM)), farthest_mm)
    x, y = (rng.uniform(-1, 1) * half * z for half in half_field)
    width = 2 * half_field[0] * z * rng.uniform(0.12, 0.5)
    picture = texture(rng, int(rng.choice([300, 500, 800])))
    picture = picture[: int(len(picture) * rng.uniform(0.4, 1))]
    height = width * picture.shape[0] / picture.shape[1]
    tilt_x = rng.uniform(-30, 30) if rng.random() < 0.2 else 0.0
    tilt_y = rng.uniform(-45, 45) if rng.random() < 0.25 else 0.0
    tilt = tilt_x, tilt_y, rng.uniform(-15, 15)
    if rng.random() < 0.2:
        cover = np.zeros(picture.shape[:2], np.float32)
        middle = picture.shape[1] // 2, picture.shape[0] // 2
        cv2.ellipse(cover, middle, (middle[0] - 2, middle[1] - 2), 0, 0, 360, 1, -1)
        picture = np.dstack([picture, cover])
    found = [plane(picture, center_mm=(x, y, z), width_mm=width, tilt_deg=tilt)]
    if rng.random() < 0.25 and tilt_y == 0:
        deep, turn = width * rng.uniform(0.4, 1), rng.uniform(50, 80)
        part = texture(rng, 400)[: max(2, min(400, int(400 * height / deep)))]
        found.append(side_of_box(part, front_mm=(x, y, z), width_mm=width, deep_mm=deep, turned_deg=turn))
    return found


def side_of_box(
    picture: np.ndarray, *, front_mm: tuple[float, float, float], width_mm: float, deep_mm: float, turned_deg: float
) -> Plane:
    """Put a side that goes back to the front of a box, on the side that the lens sees.

    Parameters
    ----------
    picture : (h, w, 3) float
    front_mm : (float, float, float)
        Middle of the front.
    width_mm : float
        Of the front.
    deep_mm : float
        Width of the side.
    turned_deg : float
        By which it turns away from the front.
    """
    x, y, z = front_mm
    side, cosine, sine = -1 if x > 0 else 1, np.cos(np.radians(turned_deg)) / 2, np.sin(np.radians(turned_deg)) / 2
    place = x + side * (width_mm / 2 + deep_mm * cosine), y, z + deep_mm * sine
    return plane(picture, center_mm=place, width_mm=deep_mm, tilt_deg=(0, -side * turned_deg, 0))


def photographed(
    table: RayTable, planes: list[Plane], *, seed: int, exposures: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Photograph a scene, its brightest half percent at one of some shares of the white level.

    Returns
    -------
    image : (H, W, 3) float
        With noise, at most 1.
    truth_mm : (H, W) float
    """
    rng = np.random.default_rng(seed + 77)
    light, truth_mm = render(table, planes, seed=seed), render_depth(table, planes)
    exposure = rng.choice(exposures) / np.percentile(light.max(axis=2), 99.5)
    image = develop(expose(light, SensorModel(), seed=seed, exposure=exposure), SensorModel())
    return np.minimum(image, 1), truth_mm


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
    far = rng.uniform(*FURNISHED_WALLS_MM)
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

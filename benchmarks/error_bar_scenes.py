"""Random scenes for `world_scenes.py` and `edge_scenes.py`: a room of planes, generated textures and photographs.

Photographs are those that scikit-image brings (public domain or CC0): `pip install 'chromaperture[bench]'`.
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
# 0.2, as before, bars are half as long again, for errors of whole planes that no sign tells.
MISPRINTED = 0.02


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

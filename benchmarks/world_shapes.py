"""Textures and shapes for `world_scenes.py`: busts, vases, balls, boxes, curtains, crumpled sheets as grids."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.random import Generator
from rooms import cover_of_card, grain, photograph, plaster, texture

HUES = (
    ((0.80, 0.30, 0.05), (0.05, 0.15, 0.70)),  # orange, blue
    ((0.70, 0.06, 0.05), (0.06, 0.50, 0.10)),  # red, green
    ((0.80, 0.70, 0.06), (0.30, 0.05, 0.45)),  # yellow, purple
    ((0.05, 0.60, 0.70), (0.70, 0.08, 0.06)),  # cyan, red
    ((0.70, 0.06, 0.50), (0.06, 0.55, 0.12)),  # magenta, green
)


def two_hued(rng: Generator, size: int) -> np.ndarray:
    """Stripes, checks or blobs of two hues: one channel falls where another rises."""
    one, other = (np.array(hue) for hue in HUES[rng.integers(len(HUES))])
    grey, own = rng.choice([0.0, 0.0, 0.15, 0.4]), rng.uniform(0.7, 1.2)
    one, other = (own * ((1 - grey) * hue + grey * hue.mean()) for hue in (one, other))
    y, x = np.mgrid[:size, :size]
    turn, period = rng.choice([0, np.pi / 2, rng.uniform(0, np.pi)]), size / rng.uniform(4, 24)
    u, v = (x * np.cos(turn) + y * np.sin(turn)) / period, (y * np.cos(turn) - x * np.sin(turn)) / period
    kind = rng.integers(4)
    if kind < 2:
        wave = np.sin(2 * np.pi * u)
    elif kind == 2:
        wave = np.sin(2 * np.pi * u) * np.sin(2 * np.pi * v)
    else:
        wave = (grain(rng, size, exponent=rng.uniform(1.1, 1.6), mean=0.5, contrast=0.15) - 0.5) * 6
    share = np.clip(0.5 + wave * rng.choice([0.5, 3.0, 30.0]), 0, 1)[..., None]  # soft or sharp
    fine = 0.5 + grain(rng, size, exponent=0.6, mean=0.5, contrast=rng.choice([0.01, 0.04]))[..., None]
    return np.clip((one + (other - one) * share) * fine, 0.01, 0.98).astype(np.float32)


def skin(rng: Generator, size: int) -> np.ndarray:
    """Skin or clay: hardly any texture, some spots."""
    tone = rng.choice([[0.62, 0.38, 0.27], [0.35, 0.19, 0.12], [0.5, 0.48, 0.45], [0.5, 0.25, 0.16]])
    fine = grain(rng, size, exponent=rng.uniform(0.4, 1), mean=0.5, contrast=rng.choice([0.01, 0.025, 0.05]))
    clouds = grain(rng, size, exponent=1.6, mean=0.5, contrast=0.05)
    picture = np.asarray(tone) * (0.5 + fine)[..., None] * (0.5 + clouds)[..., None]
    for _ in range(rng.integers(0, 40)):
        x, y = (int(v) for v in rng.integers(0, size, 2))
        cv2.circle(picture, (x, y), int(rng.integers(1, 4)), (picture[y, x] * 0.6).tolist(), -1, cv2.LINE_AA)
    return np.clip(picture, 0.01, 0.98).astype(np.float32)


def one_of(rng: Generator, size: int, shares: dict[Callable, float]) -> np.ndarray:
    """Draw a texture of some kinds, not one that is nearly black."""
    while True:
        picture = list(shares)[rng.choice(len(shares), p=list(shares.values()))](rng, size)
        if np.median(picture) > 0.03:
            return np.ascontiguousarray(picture, np.float32)


def surface(rng: Generator, size: int = 700) -> np.ndarray:
    """Any texture: noise, leaves, prints, photographs, plaster, two hues."""
    shares = {texture: 0.35, cover_of_card: 0.25, photograph: 0.15, plaster: 0.1, skin: 0.1, two_hued: 0.05}
    return one_of(rng, size, shares)


def greens(rng: Generator) -> list[np.ndarray]:
    """Four pictures of leaves of one plant, with a midrib and veins along the rows."""
    tone = np.array([0.12, 0.3, 0.06]) * rng.uniform(0.6, 2, 3) * rng.uniform(0.6, 1.3)
    y, x = np.mgrid[:96, :64]
    veins = np.sin((y + 1.2 * np.abs(x - 32)) * rng.uniform(0.4, 1.2)) > 0.8
    light = 1 + 0.8 * (np.abs(x - 32) < 2) + rng.uniform(0, 0.5) * veins
    found = []
    for _ in range(4):
        fine = grain(rng, 96, exponent=0.8, mean=0.5, contrast=rng.choice([0.05, 0.12]))[:, :64]
        own = tone * (1 + 0.25 * rng.normal()) + rng.choice([0, 0, 0.1]) * np.array([1, 0.5, 0])
        found.append(np.clip(np.abs(own) * (light * (0.5 + fine))[..., None], 0.01, 0.95).astype(np.float32))
    return found


def put(points: np.ndarray, at: Sequence[float], *, turned_deg: float = 0.0, pitch_deg: float = 0.0) -> np.ndarray:
    """Turn points about their upright axis, lean the world by the camera's pitch, and move them."""
    a, b = np.radians(turned_deg), np.radians(pitch_deg)
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return points @ (about_x @ about_y).T + np.asarray(at)


def tube(line: np.ndarray, radius: np.ndarray | float, around: int = 8) -> np.ndarray:
    """Points around a line (n, 3)."""
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True) + 1e-9
    aside = np.cross(along, [0.12, 0.05, 1.0])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True) + 1e-9
    turn = np.linspace(0, 2 * np.pi, around + 1)[None, :, None]
    ring = aside[:, None] * np.cos(turn) + np.cross(along, aside)[:, None] * np.sin(turn)
    return line[:, None] + np.broadcast_to(radius, len(line))[:, None, None] * ring


def lathe(radii: np.ndarray, heights: np.ndarray, around: int = 64) -> np.ndarray:
    """Turn a profile about the upright axis; heights count upwards from the foot."""
    turn = np.linspace(-np.pi, np.pi, around + 1)
    return np.stack([
        radii[:, None] * np.sin(turn), np.repeat(-heights[:, None], around + 1, axis=1), -radii[:, None] * np.cos(turn)
    ], axis=-1)  # fmt: skip


def vase(rng: Generator, high_mm: float) -> np.ndarray:
    """Draw a vase, a cup or a bottle."""
    knots = rng.uniform(0.12, 0.42, 5) * high_mm
    radii = np.interp(np.linspace(0, 4, 60), np.arange(5), knots)
    radii = cv2.GaussianBlur(radii[None], (0, 0), 5, borderType=cv2.BORDER_REPLICATE)[0]
    return lathe(np.concatenate([[0], radii, radii[::-1] * 0.9]), high_mm * np.concatenate([
        [0], np.linspace(0, 1, 60), np.linspace(1, 0.3, 60)
    ]))  # fmt: skip


def can(rng: Generator, high_mm: float) -> np.ndarray:
    radius = high_mm * rng.uniform(0.25, 0.5)
    return lathe(radius * np.array([0, 1, 1, 0]), high_mm * np.array([0, 0, 1, 1.0]))


def sphere(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions over a sphere, (count, 2 count, 3), and how far each is from the upright axis and the front."""
    down, turn = np.meshgrid(np.linspace(0.001, np.pi - 0.001, count), np.linspace(-np.pi, np.pi, 2 * count + 1),
                             indexing="ij")  # fmt: skip
    unit = np.stack([np.sin(down) * np.sin(turn), -np.cos(down), -np.sin(down) * np.cos(turn)], axis=-1)
    return unit, np.stack([turn, down - np.pi / 2], axis=-1)


def bumps(rng: Generator, unit: np.ndarray, amount: float, fineness: float = 3.0) -> np.ndarray:
    """Sum waves through space in random directions: a rough surface without seams."""
    found = np.zeros(unit.shape[:2])
    for _ in range(14):
        wave = rng.normal(size=3) * fineness * rng.uniform(0.4, 2)
        found += np.sin(unit @ wave + rng.uniform(0, 6.3)) / (1 + np.linalg.norm(wave) / fineness)
    return 1 + amount * found


def ball(rng: Generator, high_mm: float) -> np.ndarray:
    """Draw a ball, an egg, a stone or crumpled paper that lies on the ground."""
    unit, _ = sphere(40)
    amount = rng.choice([0, 0, 0.02, 0.06])
    stretch = rng.uniform(0.8, 1.2, 3) if amount or rng.random() < 0.4 else np.ones(3)
    points = unit * high_mm / 2 * bumps(rng, unit, amount, rng.choice([2.0, 6.0]))[..., None] * stretch
    return points - np.array([0, points[..., 1].max(), 0])


def torus(rng: Generator, high_mm: float) -> np.ndarray:
    """Draw a ring that stands, leans or lies."""
    thick = high_mm * rng.uniform(0.08, 0.16)
    turn = np.linspace(0, 2 * np.pi, 72)
    ring = (high_mm / 2 - thick) * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    points = tube(ring, thick, 20)
    points = put(points, (0, 0, 0), pitch_deg=rng.choice([0, 90, rng.uniform(0, 90)]))
    return points - np.array([0, points[..., 1].max(), 0])


def bust(rng: Generator, high_mm: float) -> np.ndarray:
    """Draw a head with nose, eye sockets, brow, chin and neck on shoulders."""
    unit, angles = sphere(90)
    turn, low = angles[..., 0], angles[..., 1]

    def at(x: float, y: float, wide: float, tall: float) -> np.ndarray:
        return np.exp(-(((turn - x) / wide) ** 2) - ((low - y) / tall) ** 2)

    radius = bumps(rng, unit, rng.uniform(0.008, 0.02))
    radius += rng.uniform(0.16, 0.26) * at(0, 0.18, 0.16, 0.2) + 0.07 * at(0, -0.28, 0.7, 0.12)
    radius -= sum(rng.uniform(0.07, 0.12) * at(side, -0.06, 0.22, 0.15) for side in (-0.42, 0.42))
    radius += 0.05 * at(0, 0.52, 0.3, 0.07) - 0.04 * at(0, 0.42, 0.3, 0.05) + 0.1 * at(0, 0.95, 0.5, 0.2)
    radius += sum(0.22 * at(side, 0.0, 0.12, 0.22) for side in (-1.6, 1.6))
    head = unit * radius[..., None] * np.array([0.19, 0.27, 0.23]) * high_mm
    head[..., 1] -= 0.7 * high_mm
    heights = np.linspace(0.58, 0, 50)
    radii = np.interp(heights, [0, 0.02, 0.2, 0.3, 0.36, 0.42, 0.6], [0.3, 0.38, 0.34, 0.2, 0.11, 0.1, 0.09])
    body = lathe(radii * high_mm, heights * high_mm, around=180)
    body[..., 2] *= 0.6
    return np.concatenate([head[:78], body])


def sides_of_box(size_mm: Sequence[float]) -> list[np.ndarray]:
    """Front, left, right and top of a box that stands on the ground."""
    x, y, z = np.array(size_mm) / 2
    front = [[[-x, -2 * y, -z], [x, -2 * y, -z]], [[-x, 0, -z], [x, 0, -z]]]
    left = [[[-x, -2 * y, z], [-x, -2 * y, -z]], [[-x, 0, z], [-x, 0, -z]]]
    top = [[[-x, -2 * y, z], [x, -2 * y, z]], [[-x, -2 * y, -z], [x, -2 * y, -z]]]
    right = np.array(left)[:, ::-1] * [-1, 1, 1]
    return [np.array(front), np.array(left), right, np.array(top)]


def curtain(rng: Generator, width_mm: float, high_mm: float) -> np.ndarray:
    """Draw a hanging cloth in folds that drift and deepen downwards; it hangs from the origin."""
    v, u = np.mgrid[0:1:60j, -0.5:0.5:400j]
    folds, deep = width_mm / rng.uniform(60, 220), rng.uniform(10, 45)
    drift = 0.3 * np.sin(2 * np.pi * (rng.uniform(0.3, 1) * v + rng.random())) * rng.uniform(0, 1)
    phase = 2 * np.pi * folds * u + 2 * np.sin(2 * np.pi * rng.uniform(1, 3) * u + rng.uniform(0, 6)) + 3 * drift
    z = deep * (0.5 + 0.5 * v) * (np.sin(phase) + 0.3 * np.sin(2.1 * phase + 1))
    return np.stack([width_mm * u + 0.4 * deep * np.cos(phase), high_mm * v, z], axis=-1)


def crumpled(rng: Generator, width_mm: float, high_mm: float) -> np.ndarray:
    """Draw a crumpled cloth with folds about the origin; it faces the lens."""
    y, x = np.mgrid[-0.5:0.5:300j, -0.5:0.5:450j]
    rough, where = (
        cv2.GaussianBlur(grain(rng, 450, exponent=exponent, mean=0.5, contrast=0.16)[:300] - 0.5, (0, 0), 2.5)
        for exponent in (rng.uniform(1.3, 1.8), 1.8)
    )
    relief = rng.uniform(0.15, 0.4) * rough
    for _ in range(rng.integers(2, 5)):
        turn, count, sharp = rng.uniform(0, np.pi), rng.uniform(4, 14), rng.uniform(1, 3)
        wave = np.sin(2 * np.pi * count * (x * np.cos(turn) + 0.7 * y * np.sin(turn)) + rng.uniform(4, 12) * where)
        here = np.clip(0.5 + rng.uniform(2, 5) * np.roll(where, rng.integers(300), axis=0), 0, 1)
        relief = relief - rng.uniform(0.2, 0.4) / count * here * np.abs(wave) ** sharp
    relief = np.asarray(cv2.GaussianBlur(relief, (0, 0), 1.5), float)
    return np.stack([width_mm * x, high_mm * y, width_mm * (relief - relief.mean())], axis=-1)

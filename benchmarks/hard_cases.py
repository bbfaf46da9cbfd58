"""Scenes for `hard_scenes.py`, drawn ray by ray through the lens of the shipped sample camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import RayTable, lens_rays
from chromaperture.optics.simulator.render import render, render_depth
from chromaperture.optics.simulator.scene import Plane, plane
from chromaperture.optics.simulator.sensor import SensorModel, develop, expose
from chromaperture.optics.simulator.textures import noise

WIDTH, HEIGHT, PITCH_MM = 720, 480, 0.0309722  # of the sample camera
FOCAL_PX = 1660  # about: 51.4 mm of image distance; places textures, measures nothing
WALL_MM, MIRROR_MM = 3000, 2400
WHITE = 0.9  # of the white level: the 99.5th percentile of the brightest channel, as an exposure meter would set it
LAMPS_OVER = 30.0  # times as bright as white paper
TUNGSTEN = (1.0, 0.42, 0.12)  # light of a black body of 2400 K at 605, 540, 465 nm (Planck), red = 1
GREEN_FILTER = (0.03, 0.9, 0.06)  # transmission of a deep green gelatine, about Wratten 58
MOVED_PX, INSTANTS = 30, 7  # of the moving card, and how many instants make its exposure
AROUND_PX = 10  # of thin objects and lamps: a blur radius at 1.2 m


@dataclass(frozen=True)
class Shot:
    """A photograph, its true depth, and where it is hard."""

    image: np.ndarray  # (H, W, 3) float32, linear, 1.0 = white level
    depth_mm: np.ndarray  # (H, W), NaN unknown
    affected: np.ndarray  # (H, W) bool
    also_right_mm: np.ndarray | None = None  # (H, W), another answer that is right, NaN where there is none


@cache
def table() -> RayTable:
    """Rays of the sample camera's lens and film."""
    return lens_rays(
        load_lens("double_gauss_50"), made_of(DESIGNS["cy_halves"], "real"), cells=16, nodes=25,
        width_px=WIDTH, height_px=HEIGHT, pixel_pitch_mm=PITCH_MM,
    )  # fmt: skip


def speckle(seed: int, *, hue: Sequence[float] = (1, 1, 1), size: int = 600, grain: float = 0.8) -> np.ndarray:
    """Noise of amplitudes 1 / f^0.8 in a hue, with a fifth of it of its own in every channel; (h, w, 3)."""
    common = noise((size, size), exponent=grain, seed=seed, mean=0.45, contrast=0.16)
    own = [noise((size, size), exponent=grain, seed=1000 * (k + 1) + seed, mean=0, contrast=0.2) for k in range(3)]
    own = [0.2 * (each - each.mean()) for each in own]
    return np.clip((common[..., None] + np.stack(own, -1)) * np.asarray(hue), 0, 1).astype(np.float32)


def wall(distance_mm: float = WALL_MM, seed: int = 1) -> Plane:
    return plane(speckle(seed, hue=(0.9, 1, 0.8), size=1400), center_mm=(0, 0, distance_mm), width_mm=1600)


def room(hues: Sequence[Sequence[float]] = ((1, 0.8, 0.7), (0.6, 0.9, 1), (0.9, 1, 0.6))) -> list[Plane]:
    """Cards at several distances, one of them slanted, before a wall."""
    return [
        wall(),
        plane(speckle(2, hue=hues[0]), center_mm=(-230, -60, 2300), width_mm=300),
        plane(speckle(3, hue=hues[1]), center_mm=(210, 0, 2000), width_mm=330, tilt_deg=(0, 40, 0)),
        plane(speckle(4, hue=hues[2]), center_mm=(-40, 60, 1400), width_mm=170, tilt_deg=(0, 0, 8)),
    ]


def exposed(
    light: np.ndarray, *, seed: int, gain: Sequence[float] = (1, 1, 1), white: float | None = None
) -> np.ndarray:
    """Photograph light through the sample camera's sensor; ``white``: the light that is brought to `WHITE`."""
    light = light * np.asarray(gain)
    white = float(np.percentile(light.max(axis=2), 99.5)) if white is None else white
    sensor = SensorModel()
    return develop(expose(np.maximum(light, 0), sensor, seed=seed, exposure=WHITE / white), sensor)


def shot(planes: Sequence[Plane], marked: Sequence[Plane], *, seed: int, gain: Sequence[float] = (1, 1, 1)) -> Shot:
    """Photograph planes; affected is where the marked ones are seen."""
    image = exposed(render(table(), planes, seed=seed), seed=seed, gain=gain)
    return Shot(image, render_depth(table(), planes), where(planes, marked))


def where(planes: Sequence[Plane], marked: Sequence[Plane]) -> np.ndarray:
    """Pixels whose chief ray meets one of the marked planes first; (H, W) bool."""
    depth = render_depth(table(), planes)
    rest = [p for p in planes if not any(p is m for m in marked)]
    return depth != (render_depth(table(), rest) if rest else np.full_like(depth, np.nan))


def empty_channels() -> Shot:
    hues = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (0, 1, 1), (1, 0, 1)]  # red, green, blue, yellow, cyan, magenta
    cards = [
        plane(speckle(10 + i, hue=hue), center_mm=(210 * (i % 3 - 1), 190 * (i // 3) - 95, 1600), width_mm=160)
        for i, hue in enumerate(hues)
    ]
    return shot([wall(), *cards], cards, seed=1)


def tungsten() -> Shot:
    return lit(TUNGSTEN, seed=2)


def green_filter() -> Shot:
    return lit(GREEN_FILTER, seed=3)


def lit(gain: Sequence[float], *, seed: int) -> Shot:
    made = shot(room(), room(), seed=seed, gain=gain)
    return Shot(made.image, made.depth_mm, np.ones((HEIGHT, WIDTH), bool))


def repeating() -> Shot:
    """Stripes across the baseline, of 6, 9 and 14 px, on cards nearer than the focus and on one beyond it."""
    cards = []
    for i, (period_px, distance) in enumerate([(6, 1500), (9, 1700), (14, 1500), (9, 2700)]):
        width_mm, texels = 0.2 * distance * 0.9, 1200
        period = period_px * distance / FOCAL_PX / width_mm * texels
        bars = 0.45 + 0.35 * np.sign(np.sin(2 * np.pi * np.arange(texels) / period))
        texture = np.broadcast_to(bars[None, :, None], (texels, texels, 3)).astype(np.float32)
        x, y = 0.21 * distance * (i % 2 - 0.5), 0.14 * distance * (i // 2 - 0.5)
        cards.append(plane(texture[: texels * 6 // 10], center_mm=(x, y, distance), width_mm=width_mm))
    return shot([wall(), *cards], cards, seed=4)


def with_hole(texture: np.ndarray, width_mm: float, hole_mm: Sequence[float]) -> np.ndarray:
    """Cut (x0, y0, x1, y1), mm from the middle, out of a texture's coverage; (h, w, 4)."""
    height, width = texture.shape[:2]
    scale = width / width_mm
    x0, x1 = (round(width / 2 + scale * v) for v in hole_mm[::2])
    y0, y1 = (round(height / 2 + scale * v) for v in hole_mm[1::2])
    cover = np.ones((height, width, 1), np.float32)
    cover[y0:y1, x0:x1] = 0
    return np.concatenate([texture, cover], axis=2)


def mirror() -> Shot:
    """A flat mirror is an opening to the mirrored room: 1.2 m behind it, its wall and a card."""
    hole = (-330, -200, 80, 200)
    front = plane(with_hole(speckle(1, size=1400), 1300, hole), center_mm=(0, 0, MIRROR_MM), width_mm=1300)
    glass = plane(np.ones((4, 4, 3)), center_mm=(-125, 0, MIRROR_MM), width_mm=410)
    card = plane(speckle(4), center_mm=(250, 40, 1500), width_mm=130)
    behind = [wall(3900, seed=5), plane(speckle(6), center_mm=(-330, 40, 3100), width_mm=260)]
    made = shot([front, card, *behind], behind, seed=5)
    surface = np.where(made.affected, render_depth(table(), [front, glass, card]), made.depth_mm)
    return Shot(made.image, surface, made.affected, np.where(made.affected, made.depth_mm, np.nan))


def window() -> Shot:
    """A pane that lets 0.85 of a view through and mirrors a fifth of the room's light, at another distance."""
    hole = (-80, -200, 330, 200)
    texture = with_hole(speckle(1, size=1400), 1300, hole)
    front = plane(texture, center_mm=(0, 0, MIRROR_MM), width_mm=1300)
    black = plane(texture * (0, 0, 0, 1), center_mm=(0, 0, MIRROR_MM), width_mm=1300)
    card = plane(speckle(4), center_mm=(-250, 40, 1500), width_mm=130)
    dark = plane(np.zeros((4, 4, 3)), center_mm=(-250, 40, 1500), width_mm=130)
    view = [wall(3000, seed=5), plane(speckle(6), center_mm=(60, 50, 2700), width_mm=180)]
    reflected = wall(4200, seed=7)
    through = render(table(), [front, card, *view], seed=6)
    pane = render(table(), [black, dark, reflected], seed=7)
    open_view = render(table(), [black, dark, *view], seed=6)  # what comes through, without what is lit beside it
    light = through - 0.15 * open_view + 0.2 * pane
    planes = [front, card, *view]
    return Shot(exposed(light, seed=6), render_depth(table(), planes), where(planes, view))


def lamps() -> Shot:
    places = [(-60, -260, 2600, 60), (60, -200, 2200, 40), (-190, 110, 1390, 16), (110, 110, 1350, 30)]
    places.append((40, -100, 2900, 90))
    bulbs = []
    for x, y, z, size in places:
        disc = np.zeros((200, 200, 4), np.float32)
        cv2.circle(disc, (100, 100), 98, (1, 0.85, 0.6, 1), -1)
        bulbs.append(plane(disc * (LAMPS_OVER, LAMPS_OVER, LAMPS_OVER, 1), center_mm=(x, y, z), width_mm=size))
    planes = [*room(), *bulbs]
    plain = render(table(), room(), seed=8)
    white = float(np.percentile(plain.max(axis=2), 99.5))
    image = np.minimum(exposed(render(table(), planes, seed=8), seed=8, white=white), 1.0)
    clipped = (image.max(axis=2) >= 0.995).astype(np.uint8)
    return Shot(image, render_depth(table(), planes), grown(clipped, AROUND_PX))


def moving() -> Shot:
    """A card that moves across the wall while the shutter is open; its depth is that of the middle of the exposure."""
    light, covered = np.zeros((HEIGHT, WIDTH, 3)), np.zeros((HEIGHT, WIDTH), int)
    still = [*room()[:3]]
    for i in range(INSTANTS):
        x = -60 + (i / (INSTANTS - 1) - 0.5) * MOVED_PX * 1500 / FOCAL_PX
        card = plane(speckle(4), center_mm=(x, 60, 1500), width_mm=180)
        light += render(table(), [*still, card], seed=10 + i) / INSTANTS
        covered += where([*still, card], [card])
    background = render_depth(table(), still)
    card_mm = float(render_depth(table(), [plane(np.ones((4, 4, 3)), center_mm=(0, 0, 1500), width_mm=2000)]).mean())
    depth = np.where(2 * covered >= INSTANTS, card_mm, background)
    partly = (covered > 0) & (covered < INSTANTS)
    other = np.where(partly, np.where(depth == background, card_mm, background), np.nan)
    return Shot(exposed(light, seed=9), depth, covered > 0, other)


def thin() -> Shot:
    """Two wires of 2 and 5 px, and a plant of leaves 8 to 14 px wide, before a wall."""
    texel = 1500 / FOCAL_PX / 2  # half a pixel
    plant = np.zeros((620, 500, 4), np.float32)
    rng = np.random.default_rng(4)
    cv2.line(plant, (250, 619), (250, 120), (0.25, 0.3, 0.12, 1), 6)
    for _ in range(34):
        y, side = int(rng.integers(110, 520)), rng.choice((-1, 1))
        length, angle = int(rng.integers(45, 105)), float(rng.uniform(15, 60))
        middle = 250 + side * length * np.cos(np.radians(angle)), y - length * np.sin(np.radians(angle))
        green = np.array([0.25, 0.5, 0.12]) * rng.uniform(0.6, 1.5)
        box = ((middle[0], middle[1]), (2.0 * length, float(rng.integers(16, 28))), -side * angle)
        cv2.ellipse(plant, box, (*green.tolist(), 1), -1, cv2.LINE_8)
    plant[..., :3] *= (0.7 + 0.6 * speckle(8, size=620))[:620, :500]
    objects = [plane(plant, center_mm=(130, 20, 1500), width_mm=500 * texel)]
    for x, width_px, turn in [(-220, 2, 10), (-120, 5, -14)]:
        texture = speckle(20 + width_px, hue=(0.4, 0.4, 0.45), size=900)[:, : 4 * width_px]
        objects.append(
            plane(texture, center_mm=(x, 0, 1500), width_mm=width_px * 1500 / FOCAL_PX, tilt_deg=(0, 0, turn))
        )
    made = shot([wall(), *objects], objects, seed=11)
    return Shot(made.image, made.depth_mm, grown(made.affected.astype(np.uint8), AROUND_PX))


def grown(mask: np.ndarray, reach_px: int) -> np.ndarray:
    size = 2 * reach_px + 1
    return cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))) > 0


CASES: dict[str, Callable[[], Shot]] = {
    "easy: the room in white light": lambda: lit((1, 1, 1), seed=12),
    "colours with an empty channel": empty_channels,
    "tungsten light": tungsten,
    "green filter on the lens": green_filter,
    "repeating texture": repeating,
    "mirror": mirror,
    "window": window,
    "saturated lamps": lamps,
    "moving card, long exposure": moving,
    "wires and a plant": thin,
}


def shots(names: Sequence[str] = ()) -> Iterator[tuple[str, Shot]]:
    """Draw the cases whose name contains one of the words, all without any."""
    for name, make in CASES.items():
        if not names or any(word in name for word in names):
            yield name, make()

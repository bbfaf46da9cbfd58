"""Scenes of real geometry, curved, thin and cluttered, with known depth: a set to choose by and to test on.

    python benchmarks/world_scenes.py cameras --out CAMERAS
    python benchmarks/world_scenes.py draw --out PICTURES [--first 0] [--scenes 48] [--shared SHARED] [--camera NAME]
    python benchmarks/world_scenes.py score CAMERAS --pictures PICTURES [--quality accurate] [--json FILE]

``cameras`` simulates and calibrates the sessions of `CAMERAS`. ``draw`` renders the scenes of `PLAN`, triangle meshes
met by Open3D's rays (`pip install open3d scikit-image`), and keeps KIND_NUMBER.npz: image, truth_mm (of the chief rays,
from the sensor plane), kind, camera, part (even numbers are for choosing, odd ones for testing), slant. Scenes of the
kind rgbd need SHARED/data/real/seven_scenes and motorcycle. Lengths are millimetres, x right, y down, z forward.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from bench50 import score as score_of
from numpy.random import Generator
from rooms import (
    bricks,
    cloth,
    cover_of_card,
    cover_of_wall,
    few_surfaces,
    furnished_room,
    grain,
    photograph,
    photographed,
    plaster,
    texture,
    wallpaper,
    wood,
)
from scipy.ndimage import distance_transform_edt
from world_shapes import (
    ball,
    bust,
    can,
    crumpled,
    curtain,
    greens,
    lathe,
    one_of,
    put,
    sides_of_box,
    skin,
    sphere,
    surface,
    torus,
    tube,
    two_hued,
    vase,
)

from chromaperture.camera.camera import load_camera
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.pinhole import focused_at
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import RayTable, lens_rays
from chromaperture.optics.simulator.render import (
    _grid,
    _interpolate_row,
    _jitter,
    _pixel_slope,
    _random,
    _Rays,
    _texel,
    _World,
)
from chromaperture.optics.simulator.scene import Plane, plane
from chromaperture.optics.simulator.sensor import SensorModel, develop, expose
from chromaperture.optics.simulator.textures import srgb_to_linear
from chromaperture.system.compilation import compiled
from chromaperture.system.threads import in_parallel

WIDTH_PX, HEIGHT_PX, SENSOR_MM, LENS = 720, 480, 22.3, "double_gauss_50"
CAMERAS = {  # name: design, focus in mm
    "V": ("cy_halves", 2000.0),
    "IV": ("cmy_circles", 1800.0),
    "II": ("rgb_squares", 2400.0),
    "VII": ("cy_open", 2200.0),
}
PLAN = {  # camera: kinds of its scenes, in the order of their numbers
    "V": "head head head head plant plant plant plant clutter clutter clutter clutter cloth cloth cloth wires wires "
    "wires rgbd rgbd rgbd stripes stripes stripes slant slant slant room room room",
    "IV": "head wires clutter rgbd stripes slant",
    "II": "plant cloth head clutter room stripes",
    "VII": "wires plant rgbd cloth slant room",
}
EXPOSURES = (0.2, 0.5, 0.9, 0.9, 0.9)  # of the white level
CELLS = 10  # across the exit pupil: about 55 rays through the open stop, for each colour
BAND_ROWS = 16  # are rendered at a time
NAMES = ("within_2_percent", "within_5_percent", "within_1_sigma", "within_2_sigma", "fill")  # of the scores


class Sheet(NamedTuple):
    """A grid of points with a picture stretched over it."""

    points: np.ndarray  # (h, w, 3)
    picture: np.ndarray  # (a, b, 3) float32, linear reflectance
    kept: np.ndarray | None = None  # (h - 1, w - 1) bool, cells that are not cut out
    shaded: bool = True


class Mesh(NamedTuple):
    """All sheets of a scene, as triangles."""

    points: np.ndarray  # (N, 3) float32
    corners: np.ndarray  # (T, 3) uint32
    places: np.ndarray  # (T, 3, 2) float32, texel coordinates of the corners
    shades: np.ndarray  # (T, 3) float32
    owners: np.ndarray  # (T,) int64, number of the texture
    world: _World  # textures, as the renderer of planes reads them


# ------------------------------------------------------------------------------------------------------ the renderer


def shade_of(points: np.ndarray, light: np.ndarray, ambient: float) -> np.ndarray:
    """Lambert's law by smooth normals, both sides alike; (h, w)."""
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True) + 1e-12
    normal *= -np.sign((normal * points).sum(axis=2, keepdims=True))
    return ambient + (1 - ambient) * np.maximum(normal @ light, 0)


def meshed(sheets: Sequence[Sheet], light: np.ndarray, ambient: float) -> Mesh:
    """Cut sheets into triangles; pictures that several share are kept once."""
    pictures = {id(sheet.picture): sheet.picture for sheet in sheets}
    number = {name: i for i, name in enumerate(pictures)}
    points, corners, places, shades, owners, count = [], [], [], [], [], 0
    for sheet in sheets:
        height, width = sheet.points.shape[:2]
        index = np.arange(height * width).reshape(height, width)
        cell = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1)
        cell = cell.reshape(-1, 4) if sheet.kept is None else cell[sheet.kept]
        three = np.concatenate([cell[:, [0, 1, 2]], cell[:, [0, 2, 3]]])
        y, x = np.mgrid[: sheet.picture.shape[0] : height * 1j, : sheet.picture.shape[1] : width * 1j]
        shade = shade_of(sheet.points, light, ambient) if sheet.shaded else np.ones((height, width))
        points.append(sheet.points.reshape(-1, 3))
        corners.append(three + count)
        places.append(np.stack([x, y], axis=-1).reshape(-1, 2)[three])
        shades.append(shade.ravel()[three])
        owners.append(np.full(len(three), number[id(sheet.picture)]))
        count += height * width
    sizes = np.array([[picture.shape[0] * picture.shape[1], *picture.shape[:2]] for picture in pictures.values()])
    shapes = np.column_stack([np.cumsum(sizes[:, 0]) - sizes[:, 0], sizes[:, 1:]]).astype(np.int64)
    texels = np.ones((int(sizes[:, 0].sum()), 4), np.float32)
    texels[:, :3] = np.concatenate([picture.reshape(-1, 3) for picture in pictures.values()])
    kinds = np.float32, np.uint32, np.float32, np.float32, np.int64
    all_points, all_corners, all_places, all_shades, all_owners = (
        np.concatenate(part).astype(kind)
        for part, kind in zip((points, corners, places, shades, owners), kinds, strict=True)
    )
    world = _World(texels, shapes, np.zeros((len(shapes), 12), np.float32))
    return Mesh(all_points, all_corners, all_places, all_shades, all_owners, world)


@compiled(fastmath=True)
def _aim(lines, light, rays, jitter, seed, top, first_row, last_row):  # type: ignore[no-untyped-def]
    """Fill rays (rows, width, G, S, 6) and their light, as `chromaperture.optics.simulator.render` aims them."""
    _, width, sets, count = light.shape
    columns = rays.origin.shape[2]
    line = np.empty((sets, columns, count, 7), np.float32)
    for row in range(first_row, last_row):
        y = top + row
        _interpolate_row(rays, y, 1, line)
        state = np.uint32((seed * 7919 + y * 2654435761 + 12345) & 0xFFFFFFFF)
        for x in range(width):
            state, jx = _random(state)
            state, jy = _random(state)
            gx = (x - rays.grid[0]) / rays.grid[1]
            j = min(max(int(gx), 0), columns - 2)
            b = np.float32(gx - j)
            for g in range(sets):
                for s in range(count):
                    left, right = line[g, j, s], line[g, j + 1, s]
                    one = lines[row, x, g, s]
                    light[row, x, g, s] = (1 - b) * left[4] + b * right[4]
                    dx, dy = jitter[s, 0] + jx, jitter[s, 1] + jy
                    one[0], one[1] = (1 - b) * left[0] + b * right[0], (1 - b) * left[1] + b * right[1]
                    one[2] = rays.z_mm
                    one[3] = (1 - b) * left[2] + b * right[2] + (dx - (1.5 if dx >= 1 else 0.5)) * rays.pixel_slope
                    one[4] = (1 - b) * left[3] + b * right[3] + (dy - (1.5 if dy >= 1 else 0.5)) * rays.pixel_slope
                    one[5] = 1.0 if light[row, x, g, s] > 0 else -1.0  # dark rays go where nothing is


@compiled(fastmath=True)
def _gather(out, light, met, place, places, shades, owners, world, first_row, last_row):  # type: ignore[no-untyped-def]
    """Sum the light of the triangles that the rays meet."""
    _, width, sets, count = light.shape
    for row in range(first_row, last_row):
        for x in range(width):
            for g in range(sets):
                for s in range(count):
                    t = np.int64(met[row, x, g, s])
                    if t >= len(owners):
                        continue
                    b, c = place[row, x, g, s]
                    a = np.float32(1) - b - c
                    u = a * places[t, 0, 0] + b * places[t, 1, 0] + c * places[t, 2, 0]
                    v = a * places[t, 0, 1] + b * places[t, 1, 1] + c * places[t, 2, 1]
                    shade = a * shades[t, 0] + b * shades[t, 1] + c * shades[t, 2]
                    out[row, x, g] += light[row, x, g, s] * shade * _texel(world, owners[t], u, v, g)


def rendered(table: RayTable, mesh: Mesh, *, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Photograph a mesh through a traced lens; light (H, W, 3), depth (H, W) by the chief rays."""
    import open3d as o3d  # a large package, only for this

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(mesh.points), o3d.core.Tensor(mesh.corners))

    def cast(lines: np.ndarray) -> dict:
        return scene.cast_rays(o3d.core.Tensor.from_numpy(lines))

    rays = _Rays(_grid(table), np.float32(table.z_mm), table.origin, table.slope, table.weight, _pixel_slope(table))
    jitter = _jitter(table.origin.shape[3], seed)
    out = np.zeros((table.height_px, table.width_px, 3), np.float32)
    for top in range(0, table.height_px, BAND_ROWS):
        band = out[top : top + BAND_ROWS]
        light = np.empty((len(band), table.width_px, 3, len(jitter)), np.float32)
        lines = np.empty((*light.shape, 6), np.float32)
        aim = lines, light, rays, jitter, seed, top
        in_parallel(lambda _, first, last, aim=aim: _aim(*aim, first, last), len(band))  # type: ignore[misc]
        found = cast(lines)
        met, place = found["primitive_ids"].numpy(), found["primitive_uvs"].numpy()
        gather = band, light, met, place, mesh.places, mesh.shades, mesh.owners, mesh.world
        in_parallel(lambda _, first, last, gather=gather: _gather(*gather, first, last), len(band))  # type: ignore[misc]
    depth = cast(chief_lines(table))["t_hit"].numpy() + np.float32(table.z_mm)
    return out, np.where(np.isfinite(depth), depth, np.nan).astype(np.float32)


def chief_lines(table: RayTable) -> np.ndarray:
    """Interpolate the chief ray of every pixel; (H, W, 6) float32."""
    rows, columns = table.chief.shape[:2]
    y = np.linspace(0, rows - 1, table.height_px)[:, None]
    x = np.linspace(0, columns - 1, table.width_px)[None]
    i, j = np.minimum(y.astype(int), rows - 2), np.minimum(x.astype(int), columns - 2)
    a, b = (y - i)[..., None], (x - j)[..., None]
    upper = (1 - b) * table.chief[i, j] + b * table.chief[i, j + 1]
    chief = (1 - a) * upper + a * ((1 - b) * table.chief[i + 1, j] + b * table.chief[i + 1, j + 1])
    lines = np.ones((table.height_px, table.width_px, 6), np.float32)
    lines[..., :2], lines[..., 2], lines[..., 3:5] = chief[..., :2], table.z_mm, chief[..., 2:]
    return lines


def of_plane(one: Plane) -> Sheet:
    """Turn a plane of the planar renderer into a sheet."""
    height, width = one.texture.shape[:2]
    across, along = width * one.texel_mm / 2 * one.right, height * one.texel_mm / 2 * one.down
    points = np.array([[one.center_mm + a * across + b * along for a in (-1, 1)] for b in (-1, 1)])
    return Sheet(points, one.texture[..., :3])


class Ground(NamedTuple):
    """A table or floor, seen from above by the pitch."""

    pitch_deg: float
    pivot_mm: np.ndarray  # (3,)

    def stood(self, points: np.ndarray, x: float, s: float, turned_deg: float = 0.0) -> np.ndarray:
        """Stand points on it, x to the right and s away from the pivot."""
        return put(put(points, (x, 0, s), turned_deg=turned_deg), self.pivot_mm, pitch_deg=self.pitch_deg)

    def sheet(self, picture: np.ndarray, wide_mm: float, front_mm: float, back_mm: float) -> list[Sheet]:
        """Its top and its front edge."""
        top = np.array([[[x, 0, s] for x in (-wide_mm, wide_mm)] for s in (back_mm, front_mm)])
        edge = np.array([[[x, y, front_mm] for x in (-wide_mm, wide_mm)] for y in (0, 400.0)])
        thin = np.ascontiguousarray(picture[-max(8, len(picture) // 4) :])
        return [Sheet(self.stood(top, 0, 0), picture), Sheet(self.stood(edge, 0, 0), thin)]


Half = tuple[float, float]


def in_disparity(rng: Generator, near: float, far: float) -> float:
    """Draw a distance evenly in 1 / distance."""
    return 1 / rng.uniform(1 / far, 1 / near)


def backdrop(rng: Generator, half: Half, far: float, picture: np.ndarray | None = None) -> list[Sheet]:
    """A wall that faces the lens, turned a little, sometimes with a poster, or a curtain."""
    if picture is None:
        picture = cover_of_wall(rng) if rng.random() < 0.6 else surface(rng, 1400)
    wide = 2.8 * half[0] * far
    if rng.random() < 0.25:
        return [Sheet(put(curtain(rng, wide, 0.7 * wide), (0, -0.35 * wide, far - 60)), picture)]
    tilt = rng.choice([0, 0, rng.uniform(-8, 8)]), rng.choice([0, rng.uniform(-20, 20)]), 0
    side = min(picture.shape[:2])
    found = [of_plane(plane(picture[:side, :side], center_mm=(0, 0, far), width_mm=wide, tilt_deg=tilt))]
    if not any(tilt) and rng.random() < 0.5:
        place = rng.uniform(-0.8, 0.8) * half[0] * far, rng.uniform(-0.8, 0.1) * half[1] * far, far - 6
        poster = cover_of_card(rng, 500)
        found.append(of_plane(plane(poster, center_mm=place, width_mm=rng.uniform(0.3, 0.9) * half[0] * far)))
    return found


def spots(rng: Generator, count: int, x_mm: float, s_mm: tuple[float, float], apart_mm: float) -> np.ndarray:
    """Draw places on the ground that keep apart, as many as are found."""
    found: list[np.ndarray] = []
    for _ in range(60 * count):
        place = np.array([rng.uniform(-x_mm, x_mm), rng.uniform(*s_mm)])
        if all(np.hypot(*(place - other)) > apart_mm for other in found):
            found.append(place)
        if len(found) == count:
            break
    return np.array(found)


def some_thing(rng: Generator, high_mm: float) -> list[np.ndarray]:
    """Draw a body that stands on the ground, as one or several grids."""
    kind = rng.integers(6)
    if kind == 5:
        return sides_of_box(high_mm * rng.uniform([0.4, 0.5, 0.2], [1.2, 1, 0.9]))
    return [(vase, can, ball, ball, torus)[kind](rng, high_mm)]


def with_skin(rng: Generator, grids: Sequence[np.ndarray], kind: Callable = surface, size: int = 600) -> list[Sheet]:
    picture = kind(rng, size)
    return [Sheet(grid, picture) for grid in grids]


def head(rng: Generator, half: Half) -> list[Sheet]:
    """Busts, vases, balls and rings before a wall or a curtain."""
    far = rng.uniform(2200, 3800)
    z = rng.uniform(1350, min(2200, far - 600))
    ground = Ground(rng.uniform(3, 14), np.array([0, 0.8 * half[1] * z, z]))
    sheets = backdrop(rng, half, far)
    sheets += ground.sheet(surface(rng, 900), 2 * half[0] * z, -0.16 * z, min(0.25 * z, far - z - 150))
    high = rng.uniform(1.25, 1.7) * half[1] * z
    x = rng.uniform(-0.4, 0.4) * half[0] * z
    kind = skin if rng.random() < 0.6 else surface
    grid = ground.stood(bust(rng, high), x, rng.uniform(-0.05, 0.05) * z, rng.uniform(-50, 50))
    sheets += with_skin(rng, [grid], kind, 800)
    reach = -0.13 * z, min(0.22 * z, far - z - 200)
    for place in spots(rng, int(rng.integers(2, 6)), 0.95 * half[0] * z, reach, 0.12 * z):
        if abs(place[0] - x) > 0.05 * z:
            turned = rng.uniform(-40, 40)
            thing = some_thing(rng, rng.uniform(0.3, 0.9) * half[1] * z)
            grids = [ground.stood(grid, place[0], place[1], turned) for grid in thing]
            sheets += with_skin(rng, grids, skin if rng.random() < 0.25 else surface)
    return sheets


def cloth_cover(rng: Generator, size: int = 1200) -> np.ndarray:
    shares = {cloth: 0.3, wallpaper: 0.2, photograph: 0.2, texture: 0.15, plaster: 0.1, two_hued: 0.05}
    return one_of(rng, size, shares)


def drapery(rng: Generator, half: Half) -> list[Sheet]:
    """A crumpled cloth over the frame or a wall, curtains before it, and some things."""
    far = rng.uniform(1800, 3600)
    wide = 2.8 * half[0] * far
    if rng.random() < 0.85:
        points = put(crumpled(rng, wide, 0.75 * wide), (0, 0, far), turned_deg=rng.uniform(-15, 15))
        points[..., 2] = np.clip(points[..., 2], 1050, 3950)
        sheets = [Sheet(points, cloth_cover(rng))]
    else:
        sheets = backdrop(rng, half, far)
    for side in rng.permutation([-1, 1])[: rng.integers(0, 3)]:
        z = in_disparity(rng, max(1150, 0.5 * far), 0.8 * far)
        wide = rng.uniform(0.5, 1.0) * half[0] * z
        grid = curtain(rng, wide, 2.6 * half[1] * z)
        place = side * rng.uniform(0.6, 0.9) * half[0] * z, -1.3 * half[1] * z, z
        sheets.append(Sheet(put(grid, place), cloth_cover(rng)))
    for _ in range(rng.integers(0, 2)):  # a blanket that hangs over a rail: its fold faces the lens
        z = in_disparity(rng, max(1150, 0.5 * far), 0.85 * far)
        wide, radius = rng.uniform(0.4, 0.9) * half[0] * z, rng.uniform(15, 60)
        bend = np.linspace(0, np.pi, 24)
        back = np.stack([np.linspace(0.6, 0, 20) * half[1] * z, np.full(20, radius)], axis=1)
        over = np.stack([-radius * np.sin(bend), radius * np.cos(bend)], axis=1)
        front = np.stack([np.linspace(0, rng.uniform(0.6, 1.4), 40) * half[1] * z, np.full(40, -radius)], axis=1)
        line = np.concatenate([back, over[1:-1], front])
        across = np.linspace(-wide / 2, wide / 2, 80)[None]
        grid = np.stack(np.broadcast_arrays(across, line[:, :1], line[:, 1:]), axis=-1)
        sway = np.maximum(0, np.arange(len(line)) - 42)[:, None] / 40 * np.sin(grid[..., 0] / wide * rng.uniform(6, 25))
        grid = grid + np.stack([0 * sway, 0 * sway, 12 * sway], axis=-1)
        place = rng.uniform(-0.5, 0.5) * half[0] * z, rng.uniform(-0.6, 0.1) * half[1] * z, z
        sheets.append(Sheet(put(grid, place, turned_deg=rng.uniform(-30, 30)), cloth_cover(rng, 700)))
    return sheets


def leaf(rng: Generator, long_mm: float, wide_mm: float, start: np.ndarray, heading: float, rise: float) -> np.ndarray:
    """Points of a leaf that bends down under its weight, folded along its midrib; (9, 5, 3)."""
    t, across = np.linspace(0, 1, 9), np.linspace(-1, 1, 5)
    angle = rise - rng.uniform(0.3, 1.8) * t
    ahead = np.array([np.sin(heading), 0, -np.cos(heading)])
    steps = long_mm / 8 * (np.cos(angle)[:, None] * ahead + np.sin(angle)[:, None] * np.array([0, -1, 0]))
    middle = start + np.cumsum(steps, axis=0)
    aside = np.array([np.cos(heading), 0, np.sin(heading)]) + rng.normal(size=3) * 0.25
    shape = wide_mm / 2 * np.sin(np.pi * np.clip(t, 0.02, 0.98)) ** rng.uniform(0.6, 1)
    points = middle[:, None] + (shape[:, None] * across)[..., None] * aside / np.linalg.norm(aside)
    points[..., 1] -= rng.uniform(0, 0.5) * np.abs(across) * shape[:, None]
    return points


def one_plant(rng: Generator, high_mm: float, px_mm: float) -> list[Sheet]:
    """Draw a pot, stems and leaves of 5 to 40 px across, upright on the ground."""
    pot = high_mm * rng.uniform(0.1, 0.22)
    sheets = with_skin(rng, [lathe(pot * np.array([0, 0.6, 0.85, 0.75]), pot * np.array([0, 0, 1.3, 1.3]))])
    pictures, wide = greens(rng), px_mm * np.exp(rng.uniform(np.log(6), np.log(34)))
    stem = np.tile(np.array([[[0.15, 0.2, 0.06]]], np.float32) * rng.uniform(0.4, 1.2), (8, 8, 1))
    count = int(np.clip(600 / (wide / px_mm), 25, 120))
    for _ in range(rng.integers(2, 7)):
        t = np.linspace(0, 1, 30)[:, None]
        out, tall = rng.uniform(0, 2 * np.pi), high_mm * rng.uniform(0.6, 1)
        lean = rng.uniform(0.1, 0.5) * tall * t**1.6 * np.array([[np.sin(out), 0, -np.cos(out)]])
        line = np.array([0, -1.2 * pot, 0]) + lean + tall * t * np.array([[0, -1, 0]]) * (1 - 0.15 * t)
        line += 0.01 * tall * np.sin(9 * t + rng.uniform(0, 6, 3))
        sheets.append(Sheet(tube(line, px_mm * rng.uniform(1.2, 3) * (1.2 - t[:, 0]), 6), stem))
        for _ in range(max(4, count // 4)):
            long = wide * rng.uniform(1.5, 4)
            at = line[rng.integers(4, 30)]
            broad, heading, rise = wide * rng.uniform(0.6, 1.3), rng.uniform(0, 2 * np.pi), rng.uniform(-0.2, 1.2)
            points = leaf(rng, long, broad, at, heading, rise)
            sheets.append(Sheet(points, pictures[rng.integers(4)]))
    return sheets


def grass(rng: Generator, high_mm: float, px_mm: float, reach_mm: float) -> list[Sheet]:
    """Draw blades of 2 to 7 px over a patch."""
    pictures, sheets = greens(rng), []
    for _ in range(rng.integers(150, 500)):
        start = np.array([rng.uniform(-reach_mm, reach_mm), 0, rng.uniform(-0.2, 0.2) * reach_mm])
        long, rise = high_mm * rng.uniform(0.4, 1), rng.uniform(1.1, 1.9)
        points = leaf(rng, long, px_mm * rng.uniform(2, 7), start, rng.uniform(0, 2 * np.pi), rise)
        sheets.append(Sheet(points, pictures[rng.integers(4)]))
    return sheets


def plant(rng: Generator, half: Half) -> list[Sheet]:
    """Plants and grass, 0.3 to 2 m before a wall or cloth."""
    z = rng.uniform(1350, 2200)
    far = min(z + 0.25 * z + rng.uniform(100, 1700), 3850)
    px_mm = 2 * half[0] * z / WIDTH_PX
    ground = Ground(rng.uniform(4, 15), np.array([0, 0.95 * half[1] * z, z]))
    sheets = backdrop(rng, half, far)
    sheets += ground.sheet(surface(rng, 900), 2 * half[0] * z, -0.15 * z, 0.18 * z)
    for x, s in spots(rng, int(rng.integers(2, 5)), 0.85 * half[0] * z, (-0.1 * z, 0.14 * z), 0.16 * z):
        parts = one_plant(rng, rng.uniform(1, 1.9) * half[1] * z, px_mm)
        sheets += [part._replace(points=ground.stood(part.points, x, s, rng.uniform(0, 1))) for part in parts]
    if rng.random() < 0.6:
        blades = grass(rng, rng.uniform(0.4, 0.9) * half[1] * z, px_mm, rng.uniform(0.4, 1) * half[0] * z)
        x, s = rng.uniform(-0.5, 0.5) * half[0] * z, rng.uniform(-0.14, 0.1) * z
        sheets += [blade._replace(points=ground.stood(blade.points, x, s)) for blade in blades]
    return sheets


def wavy(rng: Generator, start: np.ndarray, end: np.ndarray, sway_mm: float, count: int = 40) -> np.ndarray:
    """Draw a smooth line between two points that sways aside; (count, 3)."""
    t = np.linspace(0, 1, count)[:, None]
    line = start + (end - start) * t
    for order in range(1, 4):
        line = line + sway_mm / order * np.sin(np.pi * order * t + rng.uniform(0, 6.3, 3)) * rng.normal(size=3)
    return line


def fence(rng: Generator, half: Half, z: float) -> list[np.ndarray]:
    """Wires of a chain-link fence, or bars that cross."""
    mesh, radius = rng.uniform(25, 80), rng.uniform(0.8, 3) * z / 1600
    wide, high, found = 1.15 * half[0] * z, 1.15 * half[1] * z, []
    steep = 1.0 if rng.random() < 0.6 else 0.0  # diagonals, or upright and level ones
    for at in np.arange(-wide - 2 * high * steep, wide + 2 * high * steep, mesh):
        y = np.linspace(-high, high, 120)
        weave = radius * np.sin(np.pi * y / mesh)
        found += [tube(np.stack([at + side * steep * y, y, z + side * weave], axis=1), radius, 6) for side in (-1, 1)]
    if not steep:
        found = found[::2]
        x = np.linspace(-wide, wide, 120)
        found += [tube(np.stack([x, 0 * x + at, 0 * x + z + radius], axis=1), radius, 6)
                  for at in np.arange(-high, high, mesh * rng.uniform(0.7, 2))]  # fmt: skip
    return found


def slats(rng: Generator, half: Half, z: float) -> list[np.ndarray]:
    """Boards side by side, upright or level, turned a little, with gaps."""
    board = rng.uniform(8, 45) * z / 1800
    pitch, turned = board * rng.uniform(1.4, 3), np.radians(rng.uniform(-50, 50))
    upright, found = rng.random() < 0.5, []
    across, along = (half if upright else half[::-1]) * np.array(1.2 * z)
    for at in np.arange(-across, across, pitch):
        x = at + np.array([-0.5, 0.5]) * board * np.cos(turned)
        depth = z + np.array([-0.5, 0.5]) * board * np.sin(turned)
        grid = np.stack(np.broadcast_arrays(x[None], np.array([[-along], [along]]), depth[None]), axis=-1)
        found.append(grid if upright else grid[..., [1, 0, 2]])
    return found


def wheel(rng: Generator, radius: float) -> list[np.ndarray]:
    """A rim, a hub and spokes about the origin."""
    turn = np.linspace(0, 2 * np.pi, 90)
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    found = [tube(radius * ring, radius * rng.uniform(0.02, 0.06), 10), tube(0.06 * radius * ring, 0.05 * radius, 8)]
    count, thin = int(rng.integers(10, 30)), rng.uniform(0.8, 2.2)
    for i in range(count):
        a, b = 2 * np.pi * i / count, 2 * np.pi * (i / count + rng.choice([0, 0.06]))
        ends = np.array([[0.08 * radius * np.cos(b), 0.08 * radius * np.sin(b), rng.choice([-8, 8])],
                         [radius * np.cos(a), radius * np.sin(a), 0]])  # fmt: skip
        found.append(tube(np.linspace(*ends, 12), thin, 6))
    return found


def hair(rng: Generator, half: Half, z: float) -> list[Sheet]:
    """A head of hair: hundreds of strands that hang over a ball, in a few tones."""
    radius, x = rng.uniform(0.35, 0.5) * half[1] * z, rng.uniform(-0.5, 0.5) * half[0] * z
    tone = np.array([[0.35, 0.2, 0.1], [0.06, 0.05, 0.04], [0.6, 0.45, 0.2], [0.5, 0.5, 0.5]])[rng.integers(4)]
    tones = [np.tile((tone * t).astype(np.float32), (8, 8, 1)) for t in rng.uniform(0.5, 1.5, 6)]
    unit, _ = sphere(40)
    top = np.array([x, -0.35 * half[1] * z, z])
    sheets = with_skin(rng, [put(unit * radius, (x, -0.3 * half[1] * z, z))], skin)
    curl = rng.uniform(4, 18)
    for _ in range(700):
        out, reach = rng.uniform(-np.pi, np.pi), rng.uniform(0.7, 1.25)
        side = np.array([np.sin(out), 0, -np.cos(out)])
        bend = np.linspace(0, np.pi / 2, 10)[:, None]
        over = top + radius * 1.05 * reach * (np.sin(bend) * side + np.cos(bend) * np.array([0, -1, 0]))
        fall = over[-1] + np.array([rng.normal() * 20, rng.uniform(0.4, 1.4) * half[1] * z, rng.normal() * 20])
        line = np.concatenate([over[:-1], wavy(rng, over[-1], fall, 0.3 * curl, 16)])
        line += curl * 0.15 * np.sin(np.linspace(0, rng.uniform(5, 20), len(line)))[:, None] * rng.normal(size=3)
        sheets.append(Sheet(tube(line, rng.uniform(0.4, 1.2) * z / 1600, 4), tones[rng.integers(6)]))
    return sheets


def wires(rng: Generator, half: Half) -> list[Sheet]:
    """A fence, slats, wheels or hair, and cables; the far wall and some things are seen through the gaps."""
    far = rng.uniform(2400, 3800)
    z = in_disparity(rng, 1150, 0.7 * far)
    sheets = backdrop(rng, half, far)
    kind = rng.choice(4, p=[0.3, 0.25, 0.2, 0.25])
    if kind == 3:
        sheets += hair(rng, half, z)
    elif kind == 2:
        for _ in range(rng.integers(2, 5)):
            place = *(rng.uniform(-0.8, 0.8) * side * z for side in half), z * rng.uniform(1, 1.2)
            pose = {"turned_deg": rng.uniform(-40, 40), "pitch_deg": rng.uniform(-20, 20)}
            grids = [put(grid, place, **pose) for grid in wheel(rng, rng.uniform(0.4, 0.9) * half[1] * z)]
            sheets += with_skin(rng, grids, plaster)
    else:
        grids = (fence, slats)[kind](rng, half, z)
        turned = rng.uniform(-25, 25)
        sheets += with_skin(rng, [put(grid - [0, 0, z], (0, 0, z), turned_deg=turned) for grid in grids],
                            wood if kind and rng.random() < 0.6 else plaster)  # fmt: skip
    for _ in range(rng.integers(1, 4)):
        middle = z + rng.uniform(0.15, 0.8) * (far - z)
        high, at = rng.uniform(0.4, 1) * half[1] * middle, [rng.uniform(-0.8, 0.8) * half[0] * middle, 0, middle]
        at[1] = rng.uniform(-0.2, 0.9) * half[1] * middle
        sheets += with_skin(rng, [put(grid, at, turned_deg=rng.uniform(-40, 40)) for grid in some_thing(rng, high)])
    for _ in range(rng.integers(1, 7)):
        near = in_disparity(rng, 1100, 0.9 * far)
        left, right = (rng.uniform(-1, 1) * half[1] * near for _ in range(2))
        wide, back = 1.2 * half[0] * near, near * rng.uniform(0.95, 1.1)
        ends = np.array([[-wide, left, near], [wide, right, back]])
        ends = ends if rng.random() < 0.6 else ends[:, [1, 0, 2]]
        line = wavy(rng, ends[0], ends[1], 40)
        sheets += with_skin(rng, [tube(line, rng.uniform(0.8, 5) * near / 1600, 8)], plaster, 64)
    return sheets


def clutter(rng: Generator, half: Half) -> list[Sheet]:
    """Many small things on a table, seen from above, before a wall."""
    z, pitch = rng.uniform(1450, 2200), rng.uniform(18, 42)
    ground = Ground(pitch, np.array([0, 0.25 * half[1] * z, z]))
    back = rng.uniform(0.22, 0.4) * z
    far = min(rng.uniform(1.1, 1.7) * (z + back), 3900)
    sheets = backdrop(rng, half, max(far, z + back + 120))
    cover = wood if rng.random() < 0.4 else cloth_cover
    sheets += ground.sheet(cover(rng, 1200), 1.5 * half[0] * (z + back), -0.26 * z, back)
    apart = rng.uniform(0.04, 0.065) * z
    for place in spots(rng, int(rng.integers(18, 36)), 1.05 * half[0] * z, (-0.22 * z, 0.92 * back), apart):
        high, turned = apart * rng.uniform(0.5, 1.7), rng.uniform(-60, 60)
        grids = some_thing(rng, high)
        if rng.random() < 0.2:
            ends = np.array([[-0.8 * apart, -4, 0], [0.8 * apart, -4, 0]])
            grids = [tube(np.linspace(*ends, 12), rng.uniform(2, 4.5), 8)]  # a pen
        sheets += with_skin(rng, [ground.stood(grid, place[0], place[1], turned) for grid in grids], surface, 300)
    return sheets


def stripes(rng: Generator, half: Half) -> list[Sheet]:
    """Things and walls, flat and curved, in two hues."""
    far = rng.uniform(2200, 3700)
    z = rng.uniform(1350, min(2200, far - 500))
    ground = Ground(rng.uniform(4, 16), np.array([0, 0.75 * half[1] * z, z]))
    sheets = backdrop(rng, half, far, two_hued(rng, 1400) if rng.random() < 0.6 else None)
    sheets += ground.sheet(two_hued(rng, 900), 2 * half[0] * z, -0.15 * z, min(0.3 * z, far - z - 100))
    for place in spots(rng, 6, 0.95 * half[0] * z, (-0.13 * z, min(0.25 * z, far - z - 150)), 0.11 * z):
        high, turned = rng.uniform(0.5, 1.4) * half[1] * z, rng.uniform(-40, 40)
        stood = [ground.stood(grid, place[0], place[1], turned) for grid in some_thing(rng, high)]
        sheets += with_skin(rng, stood, two_hued)
    near = in_disparity(rng, 1150, 0.8 * far)
    hung = put(curtain(rng, rng.uniform(0.4, 0.8) * half[0] * near, 2.6 * half[1] * near),
               (rng.choice([-1, 1]) * 0.75 * half[0] * near, -1.3 * half[1] * near, near))  # fmt: skip
    return [*sheets, Sheet(hung, two_hued(rng, 700))]


def slanted(rng: Generator, half: Half, slant: float) -> list[Sheet]:
    """One wall whose distance changes by a share of it over the frame's width, or two that meet in an edge."""
    far, turn = rng.uniform(1500, 3200), rng.choice([0, np.pi, rng.uniform(0, 2 * np.pi)])
    slope, wide = slant / (2 * half[0]), 1.45 * half[0] * far
    at = rng.uniform(-0.4, 0.4) * half[0] * far if rng.random() < 0.5 else wide
    slopes = slope * np.array([1, -1]) if at < wide else slope * np.array([np.cos(turn), 0])
    sheets, tilt = [], 0.0 if at < wide else slope * np.sin(turn)
    for slope, start, end in ((slopes[0], -wide, at), (slopes[1], at, wide)):
        if end - start > 1:
            shares = {plaster: 0.3, texture: 0.3, wallpaper: 0.2, bricks: 0.2}
            picture = one_of(rng, 1200, shares)
            part = np.ascontiguousarray(picture[:, : max(16, int(picture.shape[1] * (end - start) / (2 * wide)))])
            x, y = np.meshgrid([start, end], [-wide, wide])
            sheets.append(Sheet(np.stack([x, y, far + slope * (x - min(at, 0.5 * wide)) + tilt * y], axis=-1), part))
    return sheets


def seen(shared: Path, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Read a frame of a depth camera or of a stereo pair; colour (linear) and depth, NaN unknown."""
    if number % 3 == 0:
        stored = np.load(shared / "data" / "real" / "motorcycle" / "motorcycle_disp.npz")
        disparity = stored[stored.files[0]].astype(np.float32)
        known = np.isfinite(disparity) & (disparity > 0)
        depth = np.where(known, 994.978 * 193.001 / (np.where(known, disparity, 1) + 31.086), np.nan)  # its calibration
        path = shared / "data" / "real" / "motorcycle" / "motorcycle_left.png"
    else:
        paths = sorted((shared / "data" / "real" / "seven_scenes").glob("*.color.jpg"))
        path = paths[number * 17 % len(paths)]
        depth = cv2.imread(str(path).replace("color.jpg", "depth.png"), cv2.IMREAD_UNCHANGED).astype(np.float32)
        depth[(depth == 0) | (depth == 65535)] = np.nan
    return srgb_to_linear(cv2.imread(str(path))[..., ::-1].astype(np.float32) / 255), depth.astype(np.float32)


def rgbd(rng: Generator, half: Half, shared: Path, number: int) -> list[Sheet]:
    """A part of a photographed room as a surface cut at jumps of depth, with a far layer behind the cuts."""
    color, depth = seen(shared, number)
    width = int(depth.shape[1] * rng.uniform(0.7, 0.95))
    height = width * 2 // 3
    y, x = rng.integers(0, depth.shape[0] - height + 1), rng.integers(0, depth.shape[1] - width + 1)
    color, depth = color[y : y + height, x : x + width], depth[y : y + height, x : x + width]
    nearest = distance_transform_edt(np.isnan(depth), return_distances=False, return_indices=True)
    depth = cv2.medianBlur(depth[tuple(nearest)], 5)
    z = depth * (2000 / np.sqrt(np.percentile(depth, 1) * np.percentile(depth, 99)))
    inverse = 1000 / np.clip(z, 1050, 3900)
    for _ in range(4):  # steps of the sensor's counts are smoothed, jumps kept
        inverse = cv2.bilateralFilter(inverse, 9, 0.015, 4)
    z = 1000 / cv2.GaussianBlur(inverse, (0, 0), 0.7)
    farther = cv2.GaussianBlur(cv2.dilate(z, np.ones((25, 25))), (0, 0), 4)
    farther = np.maximum(farther, z) * 1.004
    corners = np.stack([z[:-1, :-1], z[:-1, 1:], z[1:, :-1], z[1:, 1:]])
    kept = corners.max(axis=0) < 1.025 * corners.min(axis=0)
    own = distance_transform_edt(z < 0.96 * farther, return_distances=False, return_indices=True)
    behind = cv2.GaussianBlur(color[tuple(own)], (0, 0), 1)
    u, v = np.meshgrid(np.linspace(-1, 1, width) * 1.06 * half[0], np.linspace(-1, 1, height) * 1.06 * half[1])
    fine = 0.5 + grain(rng, 2 * width, exponent=0.5, mean=0.5, contrast=0.03)[: 2 * height, :, None]

    def layer(z: np.ndarray, color: np.ndarray, kept: np.ndarray | None = None) -> Sheet:
        larger = cv2.resize(color, (2 * width, 2 * height), interpolation=cv2.INTER_CUBIC)
        return Sheet(np.stack([u * z, v * z, z], axis=-1), np.clip(larger, 0.005, 1) * fine, kept, shaded=False)

    return [layer(z, color, kept), layer(farther, behind)]


# ---------------------------------------------------------------------------------------------------------- commands


class Planned(NamedTuple):
    """One scene of the set."""

    number: int
    camera: str
    kind: str


def planned() -> list[Planned]:
    pairs = [(camera, kind) for camera, kinds in PLAN.items() for kind in kinds.split()]
    return [Planned(number, *pair) for number, pair in enumerate(pairs)]


@cache
def table_of(camera: str) -> RayTable:
    """Rays of a camera of `CAMERAS`."""
    design, focus_mm = CAMERAS[camera]
    size = {"width_px": WIDTH_PX, "height_px": HEIGHT_PX, "pixel_pitch_mm": SENSOR_MM / WIDTH_PX}
    return lens_rays(focused_at(load_lens(LENS), focus_mm), made_of(DESIGNS[design], "real"), cells=CELLS, **size)


def pictured(scene: Planned, shared: Path | None) -> dict[str, np.ndarray]:
    """Draw and photograph one scene of the plan."""
    table, seed = table_of(scene.camera), 7000 + scene.number
    half = SENSOR_MM / 2 / table.z_mm, SENSOR_MM / 2 / table.z_mm * HEIGHT_PX / WIDTH_PX
    rng, slant = np.random.default_rng(seed), 0.0
    if scene.kind == "room":
        planes = (few_surfaces if scene.number % 2 else furnished_room)(seed, half)
        image, truth = photographed(table, planes, seed=seed, exposures=EXPOSURES)
    else:
        if scene.kind == "slant":
            slant = (0.05, 0.0, 0.15, 0.2, 0.12)[scene.number % 7 % 5]
            sheets = slanted(rng, half, slant)
        elif scene.kind == "rgbd":
            sheets = rgbd(rng, half, shared, scene.number)
        else:
            kinds = {"head": head, "plant": plant, "clutter": clutter, "cloth": drapery, "wires": wires}
            sheets = (kinds | {"stripes": stripes})[scene.kind](rng, half)
        to_light = np.array([rng.uniform(-0.7, 0.7), rng.uniform(-0.9, -0.3), -0.7])
        mesh = meshed(sheets, to_light / np.linalg.norm(to_light), rng.uniform(0.4, 0.65))
        light, truth = rendered(table, mesh, seed=seed)
        exposure = rng.choice(EXPOSURES) / np.percentile(light.max(axis=2), 99.5)
        image = develop(expose(light, SensorModel(), seed=seed, exposure=exposure), SensorModel())
    part = "testing" if scene.number % 2 else "choosing"
    words = {"kind": scene.kind, "camera": scene.camera, "part": part, "slant": slant}
    maps = {"image": np.minimum(image, 1).astype(np.float32), "truth_mm": truth.astype(np.float32)}
    return maps | {name: np.array(value) for name, value in words.items()}


def draw(args: argparse.Namespace) -> None:
    """Render scenes of the plan, one by one."""
    args.out.mkdir(parents=True, exist_ok=True)
    for scene in planned()[args.first : args.first + args.scenes]:
        if (scene.kind == "rgbd" and args.shared is None) or args.camera not in (None, scene.camera):
            continue
        maps = pictured(scene, args.shared)
        np.savez(args.out / f"{scene.kind}_{scene.number:02}.npz", **maps)
        low, high = np.nanpercentile(maps["truth_mm"], (0, 100))
        known = np.isfinite(maps["truth_mm"]).mean()
        name = f"{scene.kind}_{scene.number:02} {scene.camera}"
        print(f"{name}: {low:.0f} to {high:.0f} mm, {known:.4f} known", flush=True)


def cameras(args: argparse.Namespace) -> None:
    """Simulate and calibrate the sessions."""
    program = sys.executable, "-m", "chromaperture"
    args.out.mkdir(parents=True, exist_ok=True)
    for name, (design, focus_mm) in CAMERAS.items():
        size = ["--width", str(WIDTH_PX), "--height", str(HEIGHT_PX), "--sensor-width-mm", str(SENSOR_MM)]
        camera = ["--design", design, "--film", "real", "--lens", LENS, "--focus-mm", str(focus_mm)]
        subprocess.run([*program, "simulate", args.out / name, *camera, *size, "--cells", "12"], check=True)
        subprocess.run([*program, "calibrate", args.out / name, "--out", args.out / f"{name}.asdf"], check=True)


def score(args: argparse.Namespace) -> None:
    """Measure pictures and print the shares by kind and part, in per cent."""
    only = None if args.cameras.is_dir() else args.cameras.stem
    folder = args.cameras if only is None else args.cameras.parent
    opened = cache(lambda name: load_camera(folder / f"{name}.asdf", quality=args.quality, scale=1, device="cpu"))
    rows = []
    for path in sorted(args.pictures.glob("*.npz")):
        with np.load(path) as stored:
            about = {name: str(stored[name]) for name in ("kind", "camera", "part")}
            if only not in (None, about["camera"]):
                continue
            frame = opened(about["camera"]).measure(stored["image"])
            figures = score_of(frame.depth_mm, frame.sigma_mm, stored["truth_mm"])
        found = {name: figures[name] for name in NAMES}
        rows.append({"scene": path.stem, **about, **found})
        print(path.stem, about["camera"], "  ".join(f"{name} {100 * value:.1f}" for name, value in found.items()))
    print(f"\n{'':22}scenes  " + "  ".join(f"{name:>16}" for name in NAMES))
    for column in ("kind", "part", "camera", None):
        for value in sorted({row[column] for row in rows}) if column else ["mean"]:
            these = np.array([[row[name] for name in NAMES] for row in rows if not column or row[column] == value])
            error = these.std(axis=0, ddof=1) / np.sqrt(len(these)) if len(these) > 1 else np.full(len(NAMES), np.nan)
            pairs = zip(100 * these.mean(axis=0), 100 * error, strict=True)
            words = "  ".join(f"{mean:9.1f} ± {more:4.1f}" for mean, more in pairs)
            print(f"{value:22}{len(these):6}  {words}")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("cameras")
    one.add_argument("--out", type=Path, required=True)
    one.set_defaults(run=cameras)
    one = commands.add_parser("draw")
    one.add_argument("--out", type=Path, required=True)
    one.add_argument("--first", type=int, default=0, help="number of the first scene")
    one.add_argument("--scenes", type=int, default=48)
    one.add_argument("--camera", choices=CAMERAS, help="only its scenes")
    one.add_argument("--shared", type=Path, help="folder with data/real/seven_scenes and data/real/motorcycle")
    one.set_defaults(run=draw)
    one = commands.add_parser("score")
    one.add_argument("cameras", type=Path, help="folder of camera files, or one of them: its scenes only")
    one.add_argument("--pictures", type=Path, required=True)
    one.add_argument("--quality", default="accurate")
    one.add_argument("--json", type=Path)
    one.set_defaults(run=score)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()

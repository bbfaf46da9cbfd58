"""The reference renderer: every ray of every pixel, through its own point of the pupil, to the nearest plane.

Exact for planes with hard edges: parallax, blur, colour errors, vignetting and occlusion need no model of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from chromaperture.optics.ray_table import RayTable
from chromaperture.optics.simulator.scene import Plane
from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.errors import InputError
from chromaperture.system.threads import in_parallel

ONE = np.float32(1)  # keeps the kernels in single precision
HALF = np.float32(0.5)

# Steps of the two-dimensional low-discrepancy sequence R2: 1 / p and 1 / p^2, p^3 = p + 1.
_R2 = (0.7548776662466927, 0.5698402909980532)


class _World(NamedTuple):
    """Planes as the kernels read them."""

    texels: np.ndarray  # (N, 4) float32: R, G, B reflectance and coverage, of all planes
    shapes: np.ndarray  # (P, 3) int64: first texel, height, width
    frames: np.ndarray  # (P, 12) float32: corner, texels per mm along right and down, normal


class _Rays(NamedTuple):
    """A ray table as the kernels read it."""

    grid: np.ndarray  # (4,) float64: first image point and spacing in x, then in y, px
    z_mm: np.float32
    origin: np.ndarray
    slope: np.ndarray
    weight: np.ndarray
    pixel_slope: np.float32  # change of a ray's slope per px


def render(table: RayTable, planes: Sequence[Plane], *, seed: int = 0) -> np.ndarray:
    """Photograph a scene of planes: white through the open pupil on the axis gives 1; no plane is dark."""
    world = _packed(planes, table.z_mm)
    rays = _Rays(_grid(table), np.float32(table.z_mm), table.origin, table.slope, table.weight, _pixel_slope(table))
    out = np.zeros((table.height_px, table.width_px, 3), np.float32)
    jitter = _jitter(table.origin.shape[3], seed)
    in_parallel(lambda _, first, last: _render(out, rays, world, jitter, seed, first, last), len(out))
    return out


def _jitter(count: int, seed: int) -> np.ndarray:
    """Place rays in a pixel: a low-discrepancy set, shuffled against the pupil; (count, 2) float32 in [0, 1)."""
    rng = np.random.default_rng(seed)
    places = np.stack([np.arange(count) * step % 1 for step in _R2], -1)
    turn = rng.random(2)
    return rng.permutation((places + turn) % 1).astype(np.float32)


def _grid(table: RayTable) -> np.ndarray:
    x, y = table.x_px, table.y_px
    return np.array([x[0], x[1] - x[0], y[0], y[1] - y[0]])


def _pixel_slope(table: RayTable) -> np.float32:
    """Compute the change of a ray's slope per px in the middle; within a pixel it is used everywhere."""
    rows, columns = table.chief.shape[:2]
    j = columns // 2
    change = table.chief[rows // 2, j, 2] - table.chief[rows // 2, j - 1, 2]
    return np.float32(change / (table.x_px[j] - table.x_px[j - 1]))


def render_depth(table: RayTable, planes: Sequence[Plane]) -> np.ndarray:
    """Compute the depth at each pixel's chief ray; (H, W) float32, mm from the sensor, NaN where it meets nothing."""
    return _render_sharp(table, planes)[1]


def render_sharp(table: RayTable, planes: Sequence[Plane]) -> np.ndarray:
    """Render with chief rays only, neither blurred nor filtered; (H, W, 3) float32."""
    return _render_sharp(table, planes)[0]


def _render_sharp(table: RayTable, planes: Sequence[Plane]) -> tuple[np.ndarray, np.ndarray]:
    world, grid, z = _packed(planes, table.z_mm), _grid(table), np.float32(table.z_mm)
    color = np.zeros((table.height_px, table.width_px, 3), np.float32)
    depth = np.full((table.height_px, table.width_px), np.nan, np.float32)
    in_parallel(
        lambda _, first, last: _render_chief(color, depth, grid, z, table.chief, world, first, last), len(depth)
    )
    return color, depth


def _packed(planes: Sequence[Plane], pupil_mm: float) -> _World:
    if not planes:
        raise InputError("nothing to render: the scene has no planes")
    shapes = np.zeros((len(planes), 3), np.int64)
    frames = np.zeros((len(planes), 12), np.float32)
    offset = 0
    for i, p in enumerate(planes):
        height, width = p.texture.shape[:2]
        half = (width * p.texel_mm / 2 * p.right, height * p.texel_mm / 2 * p.down)
        corners = [p.center_mm + a * half[0] + b * half[1] for a in (-1, 1) for b in (-1, 1)]
        if min(corner[2] for corner in corners) <= pupil_mm:
            raise InputError(
                f"plane {i + 1} of the scene reaches behind the camera: all of it must lie beyond the entrance "
                f"pupil, {pupil_mm:.0f} mm from the sensor"
            )
        shapes[i] = offset, height, width
        normal = np.cross(p.right, p.down)
        frames[i] = [*corners[0], *(p.right / p.texel_mm), *(p.down / p.texel_mm), *normal]
        offset += height * width
    texels = np.concatenate([p.texture.reshape(-1, 4) for p in planes]).astype(np.float32)
    return _World(texels, shapes, frames)


@inlined(inline="always", fastmath=True)
def _hit(ox, oy, oz, sx, sy, world):  # type: ignore[no-untyped-def]
    """Find the nearest plane on the ray (o + t s, oz + t): its number (-1 for none), t, and texel coordinates."""
    nearest, best, bu, bv = -1, np.float32(1e30), np.float32(0), np.float32(0)
    shapes = world.shapes
    for p in range(shapes.shape[0]):
        f = world.frames[p]
        across = f[9] * sx + f[10] * sy + f[11]
        if across == 0:
            continue
        t = (f[9] * (f[0] - ox) + f[10] * (f[1] - oy) + f[11] * (f[2] - oz)) / across
        if t <= 0 or t >= best:
            continue
        px, py, pz = ox + t * sx - f[0], oy + t * sy - f[1], oz + t - f[2]
        u = px * f[3] + py * f[4] + pz * f[5]
        v = px * f[6] + py * f[7] + pz * f[8]
        if u < 0 or v < 0 or u >= shapes[p, 2] or v >= shapes[p, 1]:
            continue
        if world.texels[shapes[p, 0] + int(v) * shapes[p, 2] + int(u), 3] < 0.5:
            continue
        nearest, best, bu, bv = p, t, u, v
    return nearest, best, bu, bv


@inlined(inline="always", fastmath=True)
def _texel(world, p, u, v, channel):  # type: ignore[no-untyped-def]
    """Interpolate one channel bilinearly between texel centres, with replicated borders."""
    texels, shapes = world.texels, world.shapes
    height, width = shapes[p, 1], shapes[p, 2]
    u = min(max(u - HALF, np.float32(0)), np.float32(width - 1))
    v = min(max(v - HALF, np.float32(0)), np.float32(height - 1))
    i, j = min(int(v), height - 2), min(int(u), width - 2)
    a, b = v - np.float32(i), u - np.float32(j)
    base = shapes[p, 0] + i * width + j
    top = (ONE - b) * texels[base, channel] + b * texels[base + 1, channel]
    bottom = (ONE - b) * texels[base + width, channel] + b * texels[base + width + 1, channel]
    return (ONE - a) * top + a * bottom


@inlined(fastmath=True)
def _interpolate_row(rays, y, colours, line):  # type: ignore[no-untyped-def]
    """Interpolate the table's rows at image row y: origin, slope and light of each ray, (G, Gx, S, 7)."""
    sets, rows, columns, count = rays.origin.shape[:4]
    gy = (y - rays.grid[2]) / rays.grid[3]
    i = min(max(int(gy), 0), rows - 2)
    a = np.float32(gy - i)
    for g in range(sets):
        for j in range(columns):
            for s in range(count):
                for c in range(2):
                    line[g, j, s, c] = (ONE - a) * rays.origin[g, i, j, s, c] + a * rays.origin[g, i + 1, j, s, c]
                    line[g, j, s, 2 + c] = (ONE - a) * rays.slope[g, i, j, s, c] + a * rays.slope[g, i + 1, j, s, c]
                for c in range(colours):
                    upper, lower = rays.weight[g + c, i, j, s], rays.weight[g + c, i + 1, j, s]
                    line[g, j, s, 4 + c] = (ONE - a) * upper + a * lower


@inlined(inline="always")
def _random(state):  # type: ignore[no-untyped-def]
    """Step a linear congruential generator (Numerical Recipes); return its state and a number in [0, 1)."""
    state = np.uint32((state * np.uint32(1664525) + np.uint32(1013904223)) & np.uint32(0xFFFFFFFF))
    return state, np.float32(state >> 8) / np.float32(16777216)


@compiled(fastmath=True)
def _render(out, rays, world, jitter, seed, first_row, last_row):  # type: ignore[no-untyped-def]
    width = out.shape[1]
    sets, _, columns, count = rays.origin.shape[:4]
    colours = 3 if sets == 1 else 1
    line = np.empty((sets, columns, count, 7), np.float32)
    for y in range(first_row, last_row):
        _interpolate_row(rays, y, colours, line)
        # Every row has its own random numbers, so that threads do not change the picture.
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
                    w = (ONE - b) * left[4] + b * right[4]
                    if colours == 1 and w == 0:
                        continue
                    dx, dy = jitter[s, 0] + jx, jitter[s, 1] + jy
                    dx -= np.float32(1.5) if dx >= 1 else HALF
                    dy -= np.float32(1.5) if dy >= 1 else HALF
                    p, _, u, v = _hit(
                        (ONE - b) * left[0] + b * right[0], (ONE - b) * left[1] + b * right[1], rays.z_mm,
                        (ONE - b) * left[2] + b * right[2] + dx * rays.pixel_slope,
                        (ONE - b) * left[3] + b * right[3] + dy * rays.pixel_slope, world,
                    )  # fmt: skip
                    if p < 0:
                        continue
                    for c in range(colours):
                        if c:
                            w = (ONE - b) * left[4 + c] + b * right[4 + c]
                        out[y, x, g + c] += w * _texel(world, p, u, v, g + c)


@compiled()
def _render_chief(color, depth, grid, oz, chief, world, first_row, last_row):  # type: ignore[no-untyped-def]
    rows, columns = chief.shape[:2]
    for y in range(first_row, last_row):
        for x in range(depth.shape[1]):
            gx, gy = (x - grid[0]) / grid[1], (y - grid[2]) / grid[3]
            i = min(max(math.floor(gy), 0), rows - 2)
            j = min(max(math.floor(gx), 0), columns - 2)
            a, b = gy - i, gx - j
            ray = (ONE - a) * ((ONE - b) * chief[i, j] + b * chief[i, j + 1])
            ray += a * ((ONE - b) * chief[i + 1, j] + b * chief[i + 1, j + 1])
            p, t, u, v = _hit(ray[0], ray[1], oz, ray[2], ray[3], world)
            if p >= 0:
                depth[y, x] = oz + t
                for c in range(3):
                    color[y, x, c] = _texel(world, p, u, v, c)

"""The reference renderer: every ray of every pixel, through its own point of the pupil, to the nearest plane.

Exact for planes with hard rims: parallax, blur, colour errors, vignetting and occlusion need no model of
their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np

from chromaperture.errors import InputError
from chromaperture.optics.ray_table import RayTable
from chromaperture.optics.scene import Plane

ONE = np.float32(1)  # keeps the kernels in single precision


def render(
    table: RayTable,
    planes: Sequence[Plane],
    *,
    background: tuple[float, float, float] = (0, 0, 0),
    seed: int = 0,
) -> np.ndarray:
    """Photograph a world of planes.

    Parameters
    ----------
    table : RayTable
        From `pinhole_rays` or `lens_rays`.
    planes : sequence of Plane
    background : (3,) float
        What rays that meet nothing see.
    seed : int
        Of the stratified positions inside the pixels.

    Returns
    -------
    (H, W, 3) float32, linear; reflectance 1 through the open pupil on the axis gives 1.

    Raises
    ------
    InputError
        A plane reaches behind the entrance pupil.
    """
    textures, shapes, frames = _packed(planes, table.z_mm)
    out = np.zeros((table.height_px, table.width_px, 3), np.float32)
    grid = np.array(
        [table.x_px[0], table.x_px[1] - table.x_px[0], table.y_px[0], table.y_px[1] - table.y_px[0]]
    )
    rng = np.random.default_rng(seed)
    count = table.origin.shape[3]
    # A low-discrepancy set over the pixel's area, shuffled against the pupil and turned by a random amount
    # per pixel.
    spread = np.stack(
        [np.arange(count) * 0.7548776662466927 % 1, np.arange(count) * 0.5698402909980532 % 1], -1
    )
    turn = rng.random(2)
    jitter = rng.permutation((spread + turn) % 1).astype(np.float32)
    _render(
        out, grid, np.float32(table.z_mm), table.origin, table.slope, table.weight, _pixel_slope(table),
        np.asarray(background, np.float32), textures, shapes, frames, jitter, seed,
    )  # fmt: skip
    return out


def _pixel_slope(table: RayTable) -> np.float32:
    """Change of a ray's slope from pixel to pixel in the middle; within a pixel it serves everywhere."""
    rows, columns = table.chief.shape[:2]
    j = columns // 2
    change = table.chief[rows // 2, j, 2] - table.chief[rows // 2, j - 1, 2]
    return np.float32(change / (table.x_px[j] - table.x_px[j - 1]))


def render_depth(table: RayTable, planes: Sequence[Plane]) -> np.ndarray:
    """Depth of what each pixel's chief ray meets; (H, W) float32, mm from the sensor, NaN for nothing."""
    _, depth = _chief(table, planes)
    return depth


def render_sharp(table: RayTable, planes: Sequence[Plane]) -> np.ndarray:
    """Colour of what each pixel's chief ray meets, neither blurred nor filtered; (H, W, 3) float32."""
    color, _ = _chief(table, planes)
    return color


def _chief(table: RayTable, planes: Sequence[Plane]) -> tuple[np.ndarray, np.ndarray]:
    texels, shapes, frames = _packed(planes, table.z_mm)
    color = np.zeros((table.height_px, table.width_px, 3), np.float32)
    depth = np.full((table.height_px, table.width_px), np.nan, np.float32)
    grid = np.array(
        [table.x_px[0], table.x_px[1] - table.x_px[0], table.y_px[0], table.y_px[1] - table.y_px[0]]
    )
    _render_chief(color, depth, grid, np.float32(table.z_mm), table.chief, texels, shapes, frames)
    return color, depth


def _packed(planes: Sequence[Plane], pupil_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lay the planes out for the kernels: texels, (P, 3) offset, height, width, (P, 12) geometry."""
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
                f"plane {i + 1} of the scene reaches behind the camera: all of it must lie beyond the "
                "entrance pupil, "
                f"{pupil_mm:.0f} mm from the sensor"
            )
        shapes[i] = offset, height, width
        normal = np.cross(p.right, p.down)
        frames[i] = [*corners[0], *(p.right / p.texel_mm), *(p.down / p.texel_mm), *normal]
        offset += height * width
    texels = np.concatenate([p.texture.reshape(-1, 4) for p in planes]).astype(np.float32)
    return texels, shapes, frames


@numba.njit(cache=True, inline="always", fastmath=True)
def _hit(ox, oy, oz, sx, sy, texels, shapes, frames):  # type: ignore[no-untyped-def]
    """Nearest plane on the ray (o + t s, oz + t): its number (-1 for none), t, and texel coordinates."""
    nearest, best, bu, bv = -1, np.float32(1e30), np.float32(0), np.float32(0)
    for p in range(shapes.shape[0]):
        f = frames[p]
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
        if texels[shapes[p, 0] + int(v) * shapes[p, 2] + int(u), 3] < 0.5:
            continue
        nearest, best, bu, bv = p, t, u, v
    return nearest, best, bu, bv


@numba.njit(cache=True, inline="always", fastmath=True)
def _texel(texels, shapes, p, u, v, channel):  # type: ignore[no-untyped-def]
    """Bilinear between texel centres, one channel; the rim repeats."""
    height, width = shapes[p, 1], shapes[p, 2]
    u = min(max(u - np.float32(0.5), np.float32(0)), np.float32(width - 1))
    v = min(max(v - np.float32(0.5), np.float32(0)), np.float32(height - 1))
    i, j = min(int(v), height - 2), min(int(u), width - 2)
    a, b = v - np.float32(i), u - np.float32(j)
    base = shapes[p, 0] + i * width + j
    top = (ONE - b) * texels[base, channel] + b * texels[base + 1, channel]
    return (ONE - a) * top + a * (
        (ONE - b) * texels[base + width, channel] + b * texels[base + width + 1, channel]
    )


@numba.njit(cache=True, parallel=True, fastmath=True)
def _render(  # type: ignore[no-untyped-def]
    out, grid, oz, origin, slope, weight, pixel_slope, background, texels, shapes, frames, spread, seed
):  # fmt: skip
    height, width = out.shape[:2]
    sets, rows, columns, count = origin.shape[:4]
    colours = 3 if sets == 1 else 1
    for y in numba.prange(height):
        # The table's rows are interpolated once a line of the image; light in it comes last.
        line = np.empty((sets, columns, count, 7), np.float32)
        gy = (y - grid[2]) / grid[3]
        i = min(max(int(gy), 0), rows - 2)
        a = np.float32(gy - i)
        for g in range(sets):
            for j in range(columns):
                for s in range(count):
                    for c in range(2):
                        line[g, j, s, c] = (ONE - a) * origin[g, i, j, s, c] + a * origin[g, i + 1, j, s, c]
                        line[g, j, s, 2 + c] = (ONE - a) * slope[g, i, j, s, c] + a * slope[g, i + 1, j, s, c]
                    for c in range(colours):
                        line[g, j, s, 4 + c] = (ONE - a) * weight[g + c, i, j, s] + a * weight[
                            g + c, i + 1, j, s
                        ]
        state = np.uint32((seed * 7919 + y * 2654435761 + 12345) & 0xFFFFFFFF)
        for x in range(width):
            state = np.uint32((state * np.uint32(1664525) + np.uint32(1013904223)) & np.uint32(0xFFFFFFFF))
            jx = np.float32(state >> 8) / np.float32(16777216)
            state = np.uint32((state * np.uint32(1664525) + np.uint32(1013904223)) & np.uint32(0xFFFFFFFF))
            jy = np.float32(state >> 8) / np.float32(16777216)
            gx = (x - grid[0]) / grid[1]
            j = min(max(int(gx), 0), columns - 2)
            b = np.float32(gx - j)
            for g in range(sets):
                for s in range(count):
                    left, right = line[g, j, s], line[g, j + 1, s]
                    w = (ONE - b) * left[4] + b * right[4]
                    if colours == 1 and w == 0:
                        continue
                    dx, dy = spread[s, 0] + jx, spread[s, 1] + jy
                    dx -= np.float32(1.5) if dx >= 1 else np.float32(0.5)
                    dy -= np.float32(1.5) if dy >= 1 else np.float32(0.5)
                    p, _, u, v = _hit(
                        (ONE - b) * left[0] + b * right[0], (ONE - b) * left[1] + b * right[1], oz,
                        (ONE - b) * left[2] + b * right[2] + dx * pixel_slope,
                        (ONE - b) * left[3] + b * right[3] + dy * pixel_slope, texels, shapes, frames,
                    )  # fmt: skip
                    for c in range(colours):
                        if c:
                            w = (ONE - b) * left[4 + c] + b * right[4 + c]
                        seen = background[g + c] if p < 0 else _texel(texels, shapes, p, u, v, g + c)
                        out[y, x, g + c] += w * seen


@numba.njit(cache=True, parallel=True)
def _render_chief(color, depth, grid, oz, chief, texels, shapes, frames):  # type: ignore[no-untyped-def]
    rows, columns = chief.shape[:2]
    for y in numba.prange(depth.shape[0]):
        for x in range(depth.shape[1]):
            gx, gy = (x - grid[0]) / grid[1], (y - grid[2]) / grid[3]
            i = min(max(math.floor(gy), 0), rows - 2)
            j = min(max(math.floor(gx), 0), columns - 2)
            a, b = gy - i, gx - j
            ray = (ONE - a) * ((ONE - b) * chief[i, j] + b * chief[i, j + 1])
            ray += a * ((ONE - b) * chief[i + 1, j] + b * chief[i + 1, j + 1])
            p, t, u, v = _hit(ray[0], ray[1], oz, ray[2], ray[3], texels, shapes, frames)
            if p >= 0:
                depth[y, x] = oz + t
                for c in range(3):
                    color[y, x, c] = _texel(texels, shapes, p, u, v, c)

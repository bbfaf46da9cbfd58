"""Displacement of each channel by a real lens, from its fitted blur, for aligning the channels.

Vignetting moves the centroids of the pupil over the frame, the lens has lateral colour, and blurs of different shape
are not shifted copies of each other. The displacement with the least colour fringes is that after which the blurred
channels differ least, for a scene with the power spectrum of photographs, S(f) ~ 1 / f^2:

    min over s_k of   sum_f S |H_k exp(2 pi i f.s_k) - H_g exp(2 pi i f.s_g)|^2,      s_g the centroid of green.

It is computed at a few image positions and depths and interpolated.
"""

from __future__ import annotations

from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from chromaperture.optics.lens_blur import ChannelRays, LensBlur, traced, transfer_at
from chromaperture.system.compilation import compiled
from chromaperture.system.threads import in_parallel

# Chosen by hand, not tuned, unless a reason is given.
_NODES = (7, 5)  # image positions along width and height
_REFINEMENT = 4  # the nodes are refined this many times by cubics, then interpolated linearly
_RADII = 7  # blur radii of the table
_FREQUENCIES = 24  # steps from 0 to the highest frequency, along an axis
_HIGHEST = 0.25  # cycles/px; higher frequencies are blurred away in defocused channels
_LOWEST = 1 / 35  # cycles/px; lower frequencies count as shading. One period of the windows of benchmarks/colour.py
_GREEN = 1
_STEPS = 6  # of Gauss-Newton


class LensMoves(NamedTuple):
    """What the displacement of the channels by a lens is computed from, for a device."""

    # (rows, columns, radii, 6) float32, px of the working scale: displacement of R, G, B, x before y each, at positions
    # evenly spaced over the frame and at blur radii.
    table: np.ndarray
    # ``first_px``, ``step_px``: the first radius, and from one to the next.
    first_px: float
    step_px: float
    # ``at_zero_px``, ``per_px``: radius at disparity 0, and by how much it grows a px of disparity, both of the
    # photograph.
    at_zero_px: float
    per_px: float
    factor: float  # px of the photograph a px of the working scale
    exact: bool  # whether channels are sampled by Lanczos' filter, else by cubics


class LensShift:
    """Displacement of the channels over the frame and a range of blur radii; the nearest outside of it."""

    def __init__(self, blur: LensBlur, *, near_mm: float, far_mm: float) -> None:
        self.blur = blur
        self.radii_px = np.linspace(self.radius_px(1 / near_mm), self.radius_px(1 / far_mm), _RADII)

    def radius_px(self, inverse_mm: np.ndarray | float) -> np.ndarray:
        """Compute the displacement of the pupil's edge on the axis, + beyond focus, for 1 / z, z from the pupil."""
        return np.asarray(self.blur.model.infinity_px - self.blur.model.scale_px_mm * np.asarray(inverse_mm))

    def inverse_mm(self, radius_px: np.ndarray | float) -> np.ndarray:
        """Invert `radius_px`."""
        return np.asarray((self.blur.model.infinity_px - np.asarray(radius_px)) / self.blur.model.scale_px_mm)

    def layer_radius_px(self, layer_px: np.ndarray) -> np.ndarray:
        """Convert layers, half disparities at the frame's centre (see `LensBlur.reference`), to `radius_px`."""
        at_infinity, scale = self.blur.reference
        return self.radius_px((at_infinity - layer_px) / scale)

    def __call__(self, radius_px: np.ndarray, *, first_row: int = 0, height: int | None = None) -> np.ndarray:
        """Return the displacement (3, 2, H, W), px, at blur radii of the frame, or of a band at ``first_row``."""
        out = np.empty((3, 2, *radius_px.shape), np.float32)
        planes, table = out.reshape(6, *radius_px.shape), self.table
        start, step = np.float32(self.radii_px[0]), np.float32(self.radii_px[1] - self.radii_px[0])
        radius = np.ascontiguousarray(radius_px, np.float32)
        rows = (first_row, height or len(radius))
        in_parallel(
            lambda _, first, last: _interpolate(table, radius, start, step, planes, first, last, *rows), len(radius)
        )
        return out

    def moves(self, factor: float, *, exact: bool) -> LensMoves:
        """Return this displacement in numbers, for photographs of ``factor`` px a px of its own."""
        first, second = (float(radius) for radius in self.radii_px[:2])
        at_zero, at_one = (float(radius) for radius in self.layer_radius_px(np.array([0.0, 1.0])))
        return LensMoves(self.table, first, second - first, at_zero, (at_one - at_zero) / factor, factor, exact)

    @cached_property
    def table(self) -> np.ndarray:
        """(rows, columns, radii, 6) float32."""
        columns, rows = _NODES
        coarse = np.empty((rows, columns, len(self.radii_px), 3, 2), np.float32)
        xs, ys = np.linspace(0, self.blur.width_px - 1, columns), np.linspace(0, self.blur.height_px - 1, rows)
        for j, i in product(range(rows), range(columns)):
            for n, radius in enumerate(self.radii_px):
                coarse[j, i, n] = least_fringes(traced(self.blur, (xs[i], ys[j]), float(self.inverse_mm(radius))))
        fine = _refined(coarse)
        return fine.reshape(*fine.shape[:3], 6)


def least_fringes(rays: list[ChannelRays]) -> np.ndarray:
    """Compute the displacements (3, 2), px, after which an object point's blurred channels differ least."""
    step = _HIGHEST / _FREQUENCIES
    fy, fx = step * np.arange(-_FREQUENCIES, _FREQUENCIES + 1)[:, None], step * np.arange(_FREQUENCIES + 1)
    f2 = fy**2 + fx**2
    power = np.where(f2 <= _HIGHEST**2, 1 / np.maximum(f2, _LOWEST**2), 0) * np.where(fx > 0, 2, 1)
    shift = np.array([r.weights @ r.points_px for r in rays])
    transfer = [transfer_at(r, step=step, count=_FREQUENCIES) for r in rays]

    def moved(k: int) -> np.ndarray:
        return np.asarray(transfer[k] * np.exp(2j * np.pi * (fy * shift[k, 1] + fx * shift[k, 0])))

    target = moved(_GREEN)
    for k in {0, 1, 2} - {_GREEN}:
        for _ in range(_STEPS):
            current = moved(k)
            slopes = np.stack([2j * np.pi * fx * current, 2j * np.pi * fy * current])
            normal = np.einsum("ahw,bhw,hw->ab", slopes.conj(), slopes, power).real
            right = np.einsum("ahw,hw->a", slopes.conj(), power * (target - current)).real
            shift[k] += np.linalg.solve(normal, right)
    return shift


def _refined(coarse: np.ndarray) -> np.ndarray:
    """Refine the first two axes by cubic splines."""
    from scipy.interpolate import make_interp_spline  # here: it loads scipy.optimize, which takes 0.15 s

    for axis in (0, 1):
        nodes = np.arange(coarse.shape[axis])
        fine = np.linspace(0, nodes[-1], _REFINEMENT * nodes[-1] + 1)
        coarse = make_interp_spline(nodes, coarse, k=3, axis=axis)(fine)
    return np.ascontiguousarray(coarse, np.float32)


@compiled()
def _interpolate(table, radius, start, step, out, first_row, last_row, offset, height):  # type: ignore[no-untyped-def]
    """Interpolate the table linearly in position and radius into ``out`` (6, H, W), clamped at its ends."""
    rows, columns, radii = table.shape[:3]
    width = radius.shape[1]
    for y in range(first_row, last_row):
        v = np.float32(y + offset) * np.float32(rows - 1) / np.float32(max(height - 1, 1))
        j = min(int(v), rows - 2)
        v -= np.float32(j)
        for x in range(width):
            u = np.float32(x) * np.float32(columns - 1) / np.float32(max(width - 1, 1))
            i = min(int(u), columns - 2)
            u -= np.float32(i)
            t = min(max((radius[y, x] - start) / step, np.float32(0)), np.float32(radii - 1))
            n = min(int(t), radii - 2)
            t -= np.float32(n)
            for c in range(6):
                total = np.float32(0)
                for dj in range(2):
                    for di in range(2):
                        weight = (v if dj else 1 - v) * (u if di else 1 - u)
                        a, b = table[j + dj, i + di, n, c], table[j + dj, i + di, n + 1, c]
                        total += weight * (a + t * (b - a))
                out[c, y, x] = total

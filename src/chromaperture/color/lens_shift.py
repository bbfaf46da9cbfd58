"""How far a real lens displaces each channel: what alignment needs to know of a fitted blur.

Vignetting moves the centroids of the pupil over the frame, the lens has lateral colour, and blurs of different shape
are no shifted copies. The displacement that leaves the least of a colour fringe is that after which the blurred
channels differ least, for a scene whose power falls as photographs' does, S(f) ~ 1 / f^2:

    min over s_k of   sum_f S |H_k exp(2 pi i f.s_k) - H_g exp(2 pi i f.s_g)|^2,      s_g the centroid of green.

It is computed for a few places and depths and interpolated between.
"""

from __future__ import annotations

from functools import cached_property
from itertools import product

import numba
import numpy as np
from scipy.interpolate import make_interp_spline

from chromaperture.optics.field_blur import FieldBlur
from chromaperture.optics.field_otf import Rays, traced, transfer_at

_PLACES = (7, 5)  # along width and height
_FINE = 4  # the coarse grid is refined so many times by cubics, and interpolated linearly between
_RADII = 7
_FREQUENCIES = 24  # up to the highest, along an axis
_HIGHEST = 0.25  # cycles a px; beyond, defocused channels hold nothing
_LOWEST = 1 / 35  # cycles a px: what changes more slowly is shading
_GREEN = 1
_STEPS = 6


class LensShift:
    """Displacement of the channels over a frame and a range of blur radii.

    Parameters
    ----------
    blur : FieldBlur
    near_mm, far_mm : float
        Range of distances from the entrance pupil; beyond it displacements are continued.
    """

    def __init__(self, blur: FieldBlur, *, near_mm: float, far_mm: float) -> None:
        self.blur = blur
        self.radii_px = np.linspace(self.radius_px(1 / near_mm), self.radius_px(1 / far_mm), _RADII)

    def radius_px(self, inverse_mm: np.ndarray | float) -> np.ndarray:
        """Displacement of the pupil's edge on the axis, + beyond focus: names a distance, the same all over the frame.

        Parameters
        ----------
        inverse_mm : float, 1/mm
            1 / z, z from the entrance pupil.
        """
        return np.asarray(self.blur.model.infinity_px - self.blur.model.scale_px_mm * np.asarray(inverse_mm))

    def inverse_mm(self, radius_px: np.ndarray | float) -> np.ndarray:
        """Undo `radius_px`."""
        return np.asarray((self.blur.model.infinity_px - np.asarray(radius_px)) / self.blur.model.scale_px_mm)

    def layer_radius_px(self, layer_px: np.ndarray) -> np.ndarray:
        """Radius of the distance that a half disparity in the middle of the frame names; see `FieldBlur.reference`."""
        at_infinity, scale = self.blur.reference
        return self.radius_px((at_infinity - layer_px) / scale)

    def __call__(self, radius_px: np.ndarray) -> np.ndarray:
        """Displacement of each channel from the view of the pupil's centre.

        Parameters
        ----------
        radius_px : (H, W) float, px, no NaN
            Of the frame's size.

        Returns
        -------
        (3, 2, H, W) float32, px, x before y: channel k shows at x + displacement what the centre view shows at x
        """
        out = np.empty((3, 2, *radius_px.shape), np.float32)
        first, step = self.radii_px[0], self.radii_px[1] - self.radii_px[0]
        radius = np.ascontiguousarray(radius_px, np.float32)
        _interpolate(self._table, radius, np.float32(first), np.float32(step), out.reshape(6, *radius_px.shape))
        return out

    @cached_property
    def _table(self) -> np.ndarray:
        """(rows, columns, radii, 6) float32."""
        columns, rows = _PLACES
        coarse = np.empty((rows, columns, len(self.radii_px), 3, 2), np.float32)
        xs, ys = np.linspace(0, self.blur.width_px - 1, columns), np.linspace(0, self.blur.height_px - 1, rows)
        for j, i in product(range(rows), range(columns)):
            for n, radius in enumerate(self.radii_px):
                coarse[j, i, n] = least_fringes(traced(self.blur, (xs[i], ys[j]), float(self.inverse_mm(radius))))
        return _refined(coarse).reshape(_fine(rows), _fine(columns), len(self.radii_px), 6)


def least_fringes(rays: list[Rays]) -> np.ndarray:
    """Displacement of each channel after which the blurred channels differ least; (3, 2) float64, px, (x, y).

    Parameters
    ----------
    rays : list of three Rays
        Of one point.
    """
    step = _HIGHEST / _FREQUENCIES
    fy, fx = step * np.arange(-_FREQUENCIES, _FREQUENCIES + 1)[:, None], step * np.arange(_FREQUENCIES + 1)
    f2 = fy**2 + fx**2
    power = np.where(f2 <= _HIGHEST**2, 1 / np.maximum(f2, _LOWEST**2), 0) * np.where(fx > 0, 2, 1)
    shift = np.array([r.weights @ r.places_px for r in rays])
    transfer = [transfer_at(r, step=step, count=_FREQUENCIES) for r in rays]

    def moved(k: int) -> np.ndarray:
        return np.asarray(transfer[k] * np.exp(2j * np.pi * (fy * shift[k, 1] + fx * shift[k, 0])))

    target = moved(_GREEN)
    for k in {0, 1, 2} - {_GREEN}:
        for _ in range(_STEPS):  # Gauss-Newton
            mine = moved(k)
            slopes = np.stack([2j * np.pi * fx * mine, 2j * np.pi * fy * mine])
            normal = np.einsum("ahw,bhw,hw->ab", slopes.conj(), slopes, power).real
            right = np.einsum("ahw,hw->a", slopes.conj(), power * (target - mine)).real
            shift[k] += np.linalg.solve(normal, right)
    return shift


def _fine(count: int) -> int:
    return _FINE * (count - 1) + 1


def _refined(coarse: np.ndarray) -> np.ndarray:
    """Interpolate the places by cubics."""
    for axis in (0, 1):
        nodes = np.arange(coarse.shape[axis])
        coarse = make_interp_spline(nodes, coarse, k=3, axis=axis)(np.linspace(0, nodes[-1], _fine(len(nodes))))
    return np.ascontiguousarray(coarse, np.float32)


@numba.njit(cache=True, parallel=True)
def _interpolate(table, radius, first, step, out):  # type: ignore[no-untyped-def]
    """Read the table linearly in place and radius; (6, H, W) is written, what lies outside takes the nearest."""
    rows, columns, radii = table.shape[:3]
    height, width = radius.shape
    for y in numba.prange(height):
        v = np.float32(y) * np.float32(rows - 1) / np.float32(max(height - 1, 1))
        j = min(int(v), rows - 2)
        v -= np.float32(j)
        for x in range(width):
            u = np.float32(x) * np.float32(columns - 1) / np.float32(max(width - 1, 1))
            i = min(int(u), columns - 2)
            u -= np.float32(i)
            t = min(max((radius[y, x] - first) / step, np.float32(0)), np.float32(radii - 1))
            n = min(int(t), radii - 2)
            t -= np.float32(n)
            for c in range(6):
                total = np.float32(0)
                for dj in range(2):
                    for di in range(2):
                        share = (v if dj else 1 - v) * (u if di else 1 - u)
                        a, b = table[j + dj, i + di, n, c], table[j + dj, i + di, n + 1, c]
                        total += share * (a + t * (b - a))
                out[c, y, x] = total

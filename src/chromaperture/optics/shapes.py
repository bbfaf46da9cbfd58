"""Regions of the pupil plane in pupil radii, x right, y down, seen from behind the camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Shape(Protocol):
    """A region of the pupil plane."""

    def contains(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Test which points lie inside; bool array of the shape of ``x``."""
        ...


@dataclass(frozen=True)
class Disc:
    """A disc, or with ``inner_radius`` a ring, in pupil radii."""

    center: tuple[float, float] = (0.0, 0.0)
    radius: float = 1.0
    inner_radius: float = 0.0

    def contains(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:  # noqa: D102 - see Shape
        r2 = (x - self.center[0]) ** 2 + (y - self.center[1]) ** 2
        return (r2 < self.radius**2) & (r2 >= self.inner_radius**2)


@dataclass(frozen=True)
class HalfPlane:
    """The points with ``normal . (x, y) >= offset``; ``normal`` is a unit vector."""

    normal: tuple[float, float]
    offset: float = 0.0

    def contains(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:  # noqa: D102 - see Shape
        return self.normal[0] * x + self.normal[1] * y >= self.offset


@dataclass(frozen=True)
class Square:
    """A square of the given side, turned by ``angle_deg`` about its centre."""

    center: tuple[float, float]
    side: float
    angle_deg: float = 0.0

    def contains(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:  # noqa: D102 - see Shape
        c, s = math.cos(math.radians(self.angle_deg)), math.sin(math.radians(self.angle_deg))
        dx, dy = x - self.center[0], y - self.center[1]
        return np.maximum(np.abs(c * dx + s * dy), np.abs(c * dy - s * dx)) < self.side / 2


@dataclass(frozen=True)
class Polygon:
    """A polygon given by its corners, even-odd rule; it need not be convex."""

    corners: tuple[tuple[float, float], ...]

    def contains(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:  # noqa: D102 - see Shape
        # Points are sorted by y, so that each edge is tested only against those in its range.
        order = np.argsort(y, axis=None)
        xs, ys = np.ravel(x)[order], np.ravel(y)[order]
        inside = np.zeros(xs.shape, bool)
        for (x0, y0), (x1, y1) in zip(self.corners, self.corners[1:] + self.corners[:1], strict=True):
            low, high = np.searchsorted(ys, (min(y0, y1), max(y0, y1)))
            if low < high:
                beside = slice(low, high)
                inside[beside] ^= xs[beside] < x0 + (ys[beside] - y0) * (x1 - x0) / (y1 - y0)
        out = np.empty(xs.shape, bool)
        out[order] = inside
        return out.reshape(np.shape(x))


@dataclass(frozen=True)
class Intersection:
    """The points that lie in every one of the shapes, such as half of a ring."""

    shapes: tuple[Shape, ...]

    def contains(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:  # noqa: D102 - see Shape
        inside = np.ones(np.shape(x), bool)
        for shape in self.shapes:
            inside &= shape.contains(x, y)
        return inside

"""Apertures as data: where each colour filter sits in the pupil, and what follows from that alone.

Pupil coordinates are in units of the pupil radius, seen from behind the camera looking at the scene, x right, y down
(``docs/conventions.md``). Nothing here knows a lens or an image.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

import numpy as np

from chromaperture.errors import InputError


class Shape(Protocol):
    """A region of the pupil plane."""

    def contains(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Tell which points lie inside; bool array of the shape of ``x``."""
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
class Filter:
    """A colour filter: the share of light it passes in the sensor's red, green and blue channel."""

    name: str
    transmission: tuple[float, float, float]


RED = Filter("red", (1.0, 0.0, 0.0))
GREEN = Filter("green", (0.0, 1.0, 0.0))
BLUE = Filter("blue", (0.0, 0.0, 1.0))
CYAN = Filter("cyan", (0.0, 1.0, 1.0))
MAGENTA = Filter("magenta", (1.0, 0.0, 1.0))
YELLOW = Filter("yellow", (1.0, 1.0, 0.0))
CLEAR = Filter("clear", (1.0, 1.0, 1.0))
OPAQUE = Filter("opaque", (0.0, 0.0, 0.0))


@dataclass(frozen=True)
class SubAperture:
    """One piece of film: a shape in the pupil and the filter that fills it."""

    shape: Shape
    filter: Filter


@dataclass(frozen=True)
class Aperture:
    """A colour-coded aperture.

    Attributes
    ----------
    name : str
        Identifier, such as ``cy_halves``.
    title : str
        What a person calls it.
    parts : tuple of SubAperture
        The pieces of film; they must not overlap.
    remainder : Filter
        What fills the pupil outside the pieces: ``CLEAR`` or ``OPAQUE``.
    views : tuple of str
        Names of the filters whose views are matched, in order: two (complementary halves), three, or none where the
        design has no parallax.
    """

    name: str
    title: str
    parts: tuple[SubAperture, ...]
    remainder: Filter
    views: tuple[str, ...]

    def filter_named(self, name: str) -> Filter:
        """Give the filter of that name; raises InputError where there is none."""
        for part in self.parts:
            if part.filter.name == name:
                return part.filter
        raise InputError(f"aperture {self.name!r} has no {name!r} filter")

    def with_film(self, film: Mapping[str, Sequence[float] | np.ndarray]) -> Aperture:
        """Give the same geometry with other film: R, G, B transmission by filter name; others keep theirs."""

        def swap(part: SubAperture) -> SubAperture:
            if part.filter.name not in film:
                return part
            red, green, blue = (float(t) for t in film[part.filter.name])
            return replace(part, filter=Filter(part.filter.name, (red, green, blue)))

        return replace(self, parts=tuple(map(swap, self.parts)))

    def transmission_map(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Transmission in R, G, B at pupil points.

        Parameters
        ----------
        x, y : (...) float
            Pupil coordinates, in pupil radii.

        Returns
        -------
        (..., 3) float64 in [0, 1]; 0 outside the pupil.
        """
        out = np.broadcast_to(np.array(self.remainder.transmission), (*np.shape(x), 3)).copy()
        for part in self.parts:
            out[part.shape.contains(x, y)] = part.filter.transmission
        out[np.hypot(x, y) >= 1] = 0
        return out


@cache
def pupil_grid(samples: int = 1000) -> tuple[np.ndarray, np.ndarray]:
    """Midpoints of a square grid over [-1, 1]^2, in pupil radii; two (samples, samples) arrays.

    An even count keeps the midpoints off the axes, so that mirrored halves come out equal.
    """
    axis = (np.arange(samples) + 0.5) * 2 / samples - 1
    x, y = np.meshgrid(axis, axis)
    return x, y


def channel_transmission(aperture: Aperture) -> np.ndarray:
    """Share of the light of an open pupil that reaches each sensor channel; (3,) float64."""
    x, y = pupil_grid()
    inside = np.hypot(x, y) < 1
    return aperture.transmission_map(x, y)[inside].mean(axis=0)


def centroids(aperture: Aperture, unmixing: np.ndarray | None = None) -> np.ndarray:
    """Centroid of the pupil as each channel sees it.

    A linear combination ``q`` of the sensor channels sees the pupil function ``sum_k q_k A_k``, so unmixing moves the
    centroids outwards: that is why CYX separates the views of an open design further than RGB does.

    Parameters
    ----------
    aperture : Aperture
    unmixing : (K, 3) float, optional
        Rows are combinations of R, G, B; the sensor channels themselves when absent.

    Returns
    -------
    (K, 2) float64, pupil radii; NaN for a channel that sees no light.
    """
    rows = np.eye(3) if unmixing is None else np.asarray(unmixing, float)
    x, y = pupil_grid()
    weights = aperture.transmission_map(x, y) @ rows.T
    mass = weights.sum(axis=(0, 1))
    moments = np.stack([(weights * x[..., None]).sum(axis=(0, 1)), (weights * y[..., None]).sum(axis=(0, 1))], -1)
    lit = np.abs(mass) > 1e-9 * x.size
    return np.where(lit[:, None], moments / np.where(lit, mass, 1.0)[:, None], np.nan)


_SQUARE_SIDE = math.sqrt(0.5)
_TANGENT_RADIUS = 1 / (1 + 2 / math.sqrt(3))  # three equal discs touching each other and the pupil's rim


def _three_discs(filters: Sequence[Filter], radius: float, distance: float) -> tuple[SubAperture, ...]:
    """Discs up, lower left, lower right (y is down, so "up" is negative)."""
    angles = (-90, 150, 30)
    return tuple(
        SubAperture(
            Disc((distance * math.cos(math.radians(a)), distance * math.sin(math.radians(a))), radius), colour
        )
        for a, colour in zip(angles, filters, strict=True)
    )


def _three_squares(filters: Sequence[Filter]) -> tuple[SubAperture, ...]:
    """Squares right, up, left: three quarters of the pupil's inscribed square, standing on its corner."""
    centers = ((0.5, 0.0), (0.0, -0.5), (-0.5, 0.0))
    return tuple(
        SubAperture(Square(center, _SQUARE_SIDE, 45), colour)
        for center, colour in zip(centers, filters, strict=True)
    )


DESIGNS: dict[str, Aperture] = {
    design.name: design
    for design in (
        Aperture("rgb_circles", "I: RGB circles", _three_discs((RED, GREEN, BLUE), 0.30, 0.60), OPAQUE,
                 ("red", "green", "blue")),
        Aperture("rgb_squares", "II: RGB squares", _three_squares((RED, GREEN, BLUE)), OPAQUE,
                 ("red", "green", "blue")),
        Aperture("cmy_squares", "III: CMY squares", _three_squares((CYAN, MAGENTA, YELLOW)), OPAQUE,
                 ("cyan", "magenta", "yellow")),
        Aperture("cmy_circles", "IV: CMY circles",
                 _three_discs((CYAN, MAGENTA, YELLOW), _TANGENT_RADIUS, 1 - _TANGENT_RADIUS), OPAQUE,
                 ("cyan", "magenta", "yellow")),
        Aperture("cy_halves", "V: cyan and yellow halves",
                 (SubAperture(HalfPlane((-1.0, 0.0)), CYAN), SubAperture(HalfPlane((1.0, 0.0)), YELLOW)), OPAQUE,
                 ("cyan", "yellow")),
        Aperture("magenta_annulus", "VI: magenta annulus",
                 (SubAperture(Disc(inner_radius=0.59), MAGENTA),), CLEAR, ()),
        Aperture("cy_open", "VII: cyan and yellow, open band",
                 (SubAperture(HalfPlane((-1.0, 0.0), 0.60), CYAN), SubAperture(HalfPlane((1.0, 0.0), 0.60), YELLOW)),
                 CLEAR, ("cyan", "yellow")),
        Aperture("open", "VIII: open", (), CLEAR, ()),
    )
}  # fmt: skip


def design_named(name: str) -> Aperture:
    """Look up one of the designs of Figure 10; raises InputError with the known names."""
    try:
        return DESIGNS[name]
    except KeyError:
        raise InputError(f"unknown aperture design {name!r}: choose one of {', '.join(DESIGNS)}") from None

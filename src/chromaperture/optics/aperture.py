"""Apertures as data: shapes and filters in the pupil, and their light and centroids.

Pupil coordinates are in units of the pupil radius, seen from behind the camera looking at the scene, x right,
y down (``docs/conventions.md``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from chromaperture.optics.filters import (
    BLUE,
    CLEAR,
    CYAN,
    FIXED,
    GREEN,
    MAGENTA,
    OPAQUE,
    RED,
    YELLOW,
    Filter,
    film_named,
)
from chromaperture.optics.shapes import Disc, HalfPlane, Intersection, Shape, Square
from chromaperture.system.errors import InputError

_LARGEST_OVERLAP = 1e-3  # of the pupil's area; touching neighbours overlap by less than a row of grid cells
# 17 ms a piece, most of it to find its area on a grid: 1 s for so many. Designs have two or three.
MOST_PIECES = 64


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
        For people.
    parts : tuple of SubAperture
        The pieces of film; they must not overlap.
    remainder : Filter
        Fills the pupil outside the pieces: ``CLEAR`` or ``OPAQUE``.
    views : tuple of str
        Names of the filters whose views are matched, in order: two (complementary halves), three, or none for a
        design without parallax.
    """

    name: str
    title: str
    parts: tuple[SubAperture, ...]
    remainder: Filter
    views: tuple[str, ...]

    def filter_named(self, name: str) -> Filter:
        """Return the filter of a name such as ``"cyan"``.

        Raises
        ------
        InputError
            The aperture has no such filter.
        """
        for part in self.parts:
            if part.filter.name == name:
                return part.filter
        raise InputError(f"aperture {self.name!r} has no {name!r} filter")

    def with_film(self, film: Mapping[str, Sequence[float] | np.ndarray]) -> Aperture:
        """Replace film in the same geometry.

        Parameters
        ----------
        film : mapping of str to (3,) float
            Transmission in R, G, B by the filter's name; other filters stay. Measured ones may lie somewhat outside 0
            to 1, by uneven light or a colour matrix; here they end there.
        """

        def swap(part: SubAperture) -> SubAperture:
            if part.filter.name not in film:
                return part
            red, green, blue = (float(t) for t in np.clip(film[part.filter.name], 0, 1))
            return replace(part, filter=Filter(part.filter.name, (red, green, blue)))

        return replace(self, parts=tuple(map(swap, self.parts)))

    def transmission_map(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Look up the transmission in R, G, B at pupil points.

        Parameters
        ----------
        x, y : (...) float
            Pupil coordinates, in pupil radii.

        Returns
        -------
        (..., 3) float64 in [0, 1]; 0 outside the pupil.
        """
        out = self.film_map(x, y)
        out[np.hypot(x, y) >= 1] = 0
        return out

    def film_map(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Look up the transmission like `transmission_map`, but without the pupil's rim.

        Parameters
        ----------
        x, y : (...,) float
            Pupil coordinates, radii.

        Returns
        -------
        (..., 3) float64
            In R, G, B.
        """
        out = np.broadcast_to(np.array(self.remainder.transmission), (*np.shape(x), 3)).copy()
        for part in self.parts:
            out[part.shape.contains(x, y)] = part.filter.transmission
        return out


@cache
def pupil_grid(samples: int = 1000) -> tuple[np.ndarray, np.ndarray]:
    """Compute midpoints of a square grid over [-1, 1]^2, in pupil radii; two (samples, samples) arrays.

    An even count keeps the midpoints off the axes, so that mirrored halves are equal.
    """
    axis = (np.arange(samples) + 0.5) * 2 / samples - 1
    x, y = np.meshgrid(axis, axis)
    return x, y


@cache
def _piece_moments(shapes: tuple[Shape, ...]) -> np.ndarray:
    """Integrate area and first moments of every piece and, last, of the rest of the pupil; (P + 1, 3).

    Independent of film: one integration is enough for every film and every combination of channels.
    """
    x, y = pupil_grid()
    piece = np.full(x.shape, len(shapes), np.int8)
    for i, shape in enumerate(shapes):
        piece[shape.contains(x, y)] = i
    inside = np.hypot(x, y) < 1
    rows = [np.bincount(piece[inside], weights, len(shapes) + 1) for weights in (None, x[inside], y[inside])]
    return np.stack(rows, axis=1) / np.count_nonzero(inside)


def channel_moments(aperture: Aperture) -> np.ndarray:
    """Compute light and its first moments (x, y) in the pupil for R, G, B; (3, 3) float64, open pupil = 1."""
    film = [part.filter.transmission for part in aperture.parts] + [aperture.remainder.transmission]
    return np.array(film).T @ _piece_moments(tuple(part.shape for part in aperture.parts))


def channel_transmission(aperture: Aperture) -> np.ndarray:
    """Compute the light in each sensor channel, as a fraction of that of an open pupil; (3,) float64."""
    return channel_moments(aperture)[:, 0]


def centroids(aperture: Aperture, unmixing: np.ndarray | None = None) -> np.ndarray:
    """Compute the centroid of each channel's pupil function.

    A linear combination ``q`` of the sensor channels has the pupil function ``sum_k q_k A_k``, so unmixing moves the
    centroids outwards: CYX separates the views of an open design further than RGB does.

    ``unmixing`` (K, 3) float: rows are combinations of R, G, B; the identity when absent. Returns (K, 2) float64, pupil
    radii; NaN for a channel without light..
    """
    rows = np.eye(3) if unmixing is None else np.asarray(unmixing, float)
    moments = rows @ channel_moments(aperture)
    mass = moments[:, :1]
    lit = np.abs(mass) > 1e-9
    return np.where(lit, moments[:, 1:] / np.where(lit, mass, 1.0), np.nan)


def made_of(aperture: Aperture, film: str) -> Aperture:
    """Replace the film of a design by a named set (``ideal``, ``real``, ``leaky``).

    Raises InputError: the film has no such colour, or its name is unknown.
    """
    sheets = film_named(film) | FIXED
    missing = sorted({part.filter.name for part in aperture.parts} - set(sheets))
    if missing:
        raise InputError(f"film {film!r} has no {', '.join(missing)} sheet: it has {', '.join(sheets)}")
    return aperture.with_film({name: sheet.transmission for name, sheet in sheets.items()})


def checked_aperture(aperture: Aperture) -> Aperture:
    """Validate a user's design and return it.

    Pieces may extend beyond the pupil, as film does under the rim of a stop; the pupil cuts them.

    Raises InputError: more than `MOST_PIECES` pieces, a piece wholly outside the pupil, two that overlap, a view that
    names no piece, or no light passes.
    """
    if len(aperture.parts) > MOST_PIECES:
        raise InputError(f"aperture {aperture.name!r} has {len(aperture.parts)} pieces, more than {MOST_PIECES}")
    x, y = pupil_grid(400)
    inside = np.hypot(x, y) < 1
    covers = [part.shape.contains(x, y) & inside for part in aperture.parts]
    for i, (part, cover) in enumerate(zip(aperture.parts, covers, strict=True)):
        if not cover.any():
            raise InputError(
                f"piece {i + 1} ({part.filter.name}) of {aperture.name!r} lies outside the pupil: "
                "coordinates are in pupil radii, from -1 to 1"
            )
        for j in range(i):
            overlap = np.count_nonzero(cover & covers[j]) / np.count_nonzero(inside)
            if overlap > _LARGEST_OVERLAP:
                raise InputError(
                    f"pieces {j + 1} ({aperture.parts[j].filter.name}) and {i + 1} ({part.filter.name}) of "
                    f"{aperture.name!r} overlap over {100 * overlap:.1f} % of the pupil: move or shrink one"
                )
    for view in aperture.views:
        aperture.filter_named(view)
    if not aperture.transmission_map(x, y).any():
        raise InputError(f"aperture {aperture.name!r} passes no light: add a piece of film or a clear remainder")
    return aperture


_SQUARE_SIDE = math.sqrt(0.5)
_TANGENT_RADIUS = 1 / (1 + 2 / math.sqrt(3))  # three equal discs touching each other and the pupil's rim
_LEFT, _RIGHT = (-1.0, 0.0), (1.0, 0.0)


def _three_discs(filters: Sequence[Filter], radius: float, distance: float) -> tuple[SubAperture, ...]:
    """Discs up, lower left, lower right (y is down, so "up" is negative)."""
    angles = (-90, 150, 30)
    return tuple(
        SubAperture(Disc((distance * math.cos(math.radians(a)), distance * math.sin(math.radians(a))), radius), colour)
        for a, colour in zip(angles, filters, strict=True)
    )


def _three_squares(filters: Sequence[Filter]) -> tuple[SubAperture, ...]:
    """Squares right, up, left: three quarters of the inscribed square turned by 45 degrees."""
    centers = ((0.5, 0.0), (0.0, -0.5), (-0.5, 0.0))
    return tuple(
        SubAperture(Square(center, _SQUARE_SIDE, 45), colour) for center, colour in zip(centers, filters, strict=True)
    )


def open_band(half_width: float) -> Aperture:
    """Build design VII: cyan and yellow caps left and right of an open band |x| < half_width, in pupil radii."""
    caps = (SubAperture(HalfPlane(_LEFT, half_width), CYAN), SubAperture(HalfPlane(_RIGHT, half_width), YELLOW))
    return Aperture("cy_open", "VII: cyan and yellow, open band", caps, CLEAR, ("cyan", "yellow"))


def open_disc(radius: float) -> Aperture:
    """Build design VII with an open disc of that radius inside cyan and yellow half rings."""
    ring = Disc(inner_radius=radius, radius=2.0)
    halves = tuple(
        SubAperture(Intersection((ring, HalfPlane(side))), colour) for side, colour in ((_LEFT, CYAN), (_RIGHT, YELLOW))
    )
    return Aperture("cy_open_disc", "VII b: cyan and yellow, open disc", halves, CLEAR, ("cyan", "yellow"))


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
                 (SubAperture(HalfPlane(_LEFT), CYAN), SubAperture(HalfPlane(_RIGHT), YELLOW)), OPAQUE,
                 ("cyan", "yellow")),
        Aperture("magenta_annulus", "VI: magenta annulus",
                 (SubAperture(Disc(inner_radius=0.59), MAGENTA),), CLEAR, ()),
        open_band(0.60),
        open_disc(0.835),
        Aperture("open", "VIII: open", (), CLEAR, ()),
    )
}  # fmt: skip


def design_named(name: str) -> Aperture:
    """Look up one of the designs of Figure 10.

    Parameters
    ----------
    name : str
        Such as ``"cy_halves"``.

    Raises
    ------
    InputError
        There is no such design; the message has the known names.
    """
    try:
        return DESIGNS[name]
    except KeyError:
        raise InputError(f"unknown aperture design {name!r}: choose one of {', '.join(DESIGNS)}") from None

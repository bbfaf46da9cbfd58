"""Apertures as data: shapes and filters in the pupil, and their light and centroids.

Pupil coordinates are in units of the pupil radius, seen from behind the camera looking at the scene, x right,
y down (``docs/conventions.md``).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

import numpy as np

from chromaperture.optics.gels import OF_SPECTRA, gel_named, seen
from chromaperture.system.errors import InputError


@dataclass(frozen=True)
class Filter:
    """A colour filter: its transmission in the sensor's red, green and blue channel."""

    name: str
    transmission: tuple[float, float, float]

    def __post_init__(self) -> None:
        if len(self.transmission) != 3 or not all(0 <= t <= 1 for t in self.transmission):
            raise InputError(
                f"filter {self.name!r} needs three transmissions (R, G, B) between 0 and 1, got {self.transmission}"
            )


RED = Filter("red", (1.0, 0.0, 0.0))
GREEN = Filter("green", (0.0, 1.0, 0.0))
BLUE = Filter("blue", (0.0, 0.0, 1.0))
CYAN = Filter("cyan", (0.0, 1.0, 1.0))
MAGENTA = Filter("magenta", (1.0, 0.0, 1.0))
YELLOW = Filter("yellow", (1.0, 1.0, 0.0))
CLEAR = Filter("clear", (1.0, 1.0, 1.0))
OPAQUE = Filter("opaque", (0.0, 0.0, 0.0))


def _film(**transmissions: tuple[float, float, float]) -> dict[str, Filter]:
    return {name: Filter(name, values) for name, values in transmissions.items()}


# "lee": film that is sold, see `gels`: Lee's 118 and 101; of other colours those nearest to "real", 780, 124, 715, 002.
# "real": stage-light film before a Bayer sensor; it reproduces the paper's Table 1 for designs V and VII.
# "leaky": crosstalk of the size measured by Setterfield et al. (2019) on a triple-pinhole camera, where a
# filter passed 0.10 to 0.47 in a wrong channel against 0.25 to 0.39 in its own.
FILMS: dict[str, dict[str, Filter]] = {
    "ideal": {f.name: f for f in (RED, GREEN, BLUE, CYAN, MAGENTA, YELLOW)},
    "lee": _film(
        red=(0.57, 0.10, 0.01),
        green=(0.10, 0.40, 0.23),
        blue=(0.06, 0.15, 0.46),
        cyan=(0.11, 0.42, 0.69),
        magenta=(0.58, 0.29, 0.55),
        yellow=(0.81, 0.60, 0.16),
    ),
    "real": _film(
        red=(0.62, 0.03, 0.02),
        green=(0.05, 0.60, 0.08),
        blue=(0.02, 0.10, 0.55),
        cyan=(0.10, 0.63, 0.65),
        magenta=(0.85, 0.12, 0.70),
        yellow=(0.92, 0.85, 0.10),
    ),
    "leaky": _film(
        red=(0.39, 0.25, 0.10),
        green=(0.26, 0.37, 0.20),
        blue=(0.10, 0.26, 0.39),
        cyan=(0.30, 0.62, 0.60),
        magenta=(0.70, 0.33, 0.65),
        yellow=(0.80, 0.75, 0.30),
    ),
}
USUAL_FILM = "lee"  # what is taken where nobody measured the film
FIXED = {"clear": CLEAR, "opaque": OPAQUE}


def film_named(name: str) -> dict[str, Filter]:
    """Look up a set of film by name; raises InputError with the known names."""
    try:
        return FILMS[name]
    except KeyError:
        raise InputError(f"unknown film {name!r}: choose one of {', '.join(FILMS)}") from None


def film_names(aperture: Aperture) -> list[str]:
    """List the colours of film of an aperture, in the order of its pieces."""
    return list(dict.fromkeys(part.filter.name for part in aperture.parts if part.filter.name not in FIXED))


def film_for(aperture: Aperture, film: str) -> dict[str, Filter]:
    """Look up a set of film by name, or gels such as ``118,101`` for the pieces of an aperture in their order."""
    if not re.search(r"\d|,|\.csv$", film):
        return film_named(film)
    names = film_names(aperture)
    chosen = [gel_named(text) for text in film.split(",")]
    if len(chosen) != len(names):
        raise InputError(
            f"{aperture.title} takes {len(names)} gels ({', '.join(names)}); film {film!r} is {len(chosen)}"
        )
    if own := [gel.file for gel in chosen if gel.file]:
        raise InputError(f"film {own[0]!r}: {OF_SPECTRA}; give what it finds as [filters.NAME] of an aperture file")
    passed = [seen("daylight").passed[gel].mean(axis=0).tolist() for gel in chosen]
    return _film(**dict(zip(names, passed, strict=True)))


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
        """Return the filter of a name such as ``"cyan"``; raises InputError where there is none."""
        for part in self.parts:
            if part.filter.name == name:
                return part.filter
        raise InputError(f"aperture {self.name!r} has no {name!r} filter")

    def with_film(self, film: Mapping[str, Sequence[float] | np.ndarray]) -> Aperture:
        """Replace film in the same geometry, by names; transmissions measured beyond 0 to 1 end there."""

        def swap(part: SubAperture) -> SubAperture:
            if part.filter.name not in film:
                return part
            red, green, blue = (float(t) for t in np.clip(film[part.filter.name], 0, 1))
            return replace(part, filter=Filter(part.filter.name, (red, green, blue)))

        return replace(self, parts=tuple(map(swap, self.parts)))

    def transmission_map(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Look up the transmission in R, G, B at pupil points, in radii; (..., 3) float64, 0 outside the pupil."""
        out = self.film_map(x, y)
        out[np.hypot(x, y) >= 1] = 0
        return out

    def film_map(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Look up the transmission like `transmission_map`, but without the pupil's rim; (..., 3) float64."""
        out = np.broadcast_to(np.array(self.remainder.transmission), (*np.shape(x), 3)).copy()
        for part in self.parts:
            out[part.shape.contains(x, y)] = part.filter.transmission
        return out


@cache
def pupil_grid(samples: int = 1000) -> tuple[np.ndarray, np.ndarray]:
    """Compute midpoints of a square grid over the pupil's [-1, 1]^2; an even count has none on the axes."""
    axis = (np.arange(samples) + 0.5) * 2 / samples - 1
    x, y = np.meshgrid(axis, axis)
    return x, y


@cache
def _piece_moments(shapes: tuple[Shape, ...]) -> np.ndarray:
    """Integrate area and first moments of every piece and, last, of the rest of the pupil; (P + 1, 3)."""
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
    """Compute the centroid of each channel's, or each unmixed combination's, light; (K, 2) pupil radii."""
    rows = np.eye(3) if unmixing is None else np.asarray(unmixing, float)
    moments = rows @ channel_moments(aperture)
    mass = moments[:, :1]
    lit = np.abs(mass) > 1e-9
    return np.where(lit, moments[:, 1:] / np.where(lit, mass, 1.0), np.nan)


def made_of(aperture: Aperture, film: str) -> Aperture:
    """Replace the film of a design by a named set (``ideal``, ``lee``, ``real``, ``leaky``), or by gels: 118,101."""
    sheets = film_for(aperture, film) | FIXED
    missing = sorted({part.filter.name for part in aperture.parts} - set(sheets))
    if missing:
        raise InputError(f"film {film!r} has no {', '.join(missing)} sheet: it has {', '.join(sheets)}")
    return aperture.with_film({name: sheet.transmission for name, sheet in sheets.items()})


def checked_aperture(aperture: Aperture) -> Aperture:
    """Validate a user's design and return it; pieces may extend beyond the pupil, which cuts them."""
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


LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709


@dataclass(frozen=True)
class ApertureFigures:
    """Figures of one design."""

    channel_transmission: np.ndarray  # (3,) float64; light in R, G, B over that of the open pupil
    efficiency_mean: float  # mean of the three
    efficiency_luminance: float  # the same, weighted by luminance (ITU-R BT.709)
    centroids: np.ndarray  # (K, 2) float64; of the K channels, pupil radii; NaN for a channel without light
    beta: float  # r_c / R, mean distance of the outlying centroids from the pupil's centre, half the baseline: Eq. (6)


def film_unmixing(aperture: Aperture) -> np.ndarray:
    """Compute the least-squares unmixing of white light into the views; (K, 3) float64, identity without views."""
    if not aperture.views:
        return np.eye(3)
    colours = np.array([aperture.filter_named(name).transmission for name in aperture.views])
    return np.linalg.pinv(colours.T)


def aperture_figures(aperture: Aperture, unmixing: np.ndarray | None = None) -> ApertureFigures:
    """Compute the figures of a design for the sensor's channels, or for combinations of them."""
    transmission = channel_transmission(aperture)
    rho = centroids(aperture, unmixing)
    seen = rho[np.isfinite(rho).all(axis=1)]
    distance = np.linalg.norm(seen, axis=1)
    outlying = distance > 1e-6  # green is the centred reference of complementary halves
    return ApertureFigures(
        channel_transmission=transmission,
        efficiency_mean=float(transmission.mean()),
        efficiency_luminance=float(transmission @ LUMINANCE),
        centroids=rho,
        beta=float(distance[outlying].mean()) if outlying.any() else 0.0,
    )

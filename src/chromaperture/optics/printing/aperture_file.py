"""User-defined apertures from a short TOML file or a simple drawing."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal
from xml.etree import ElementTree

import numpy as np
from pydantic import Field

from chromaperture.optics.aperture import (
    DESIGNS,
    FIXED,
    MOST_PIECES,
    Aperture,
    Disc,
    Filter,
    HalfPlane,
    Polygon,
    Shape,
    Square,
    SubAperture,
    checked_aperture,
    design_named,
    film_named,
    made_of,
)
from chromaperture.system.errors import InputError
from chromaperture.system.validation import Name, Table, checked, quoted, read_bytes, read_toml

_SUPPORTED = re.compile(r"[MLHVQCZmlhvqcz\d\s.,+\-eE]*")
_NUMBERS = {"M": 2, "L": 2, "H": 1, "V": 1, "Q": 4, "C": 6, "Z": 0}  # after each command, or a multiple of them
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[\s,]*")
_CURVE_STEPS = 32  # chords per curve: a quarter circle is off by 3e-4 of its radius
# Limits for damaged or hostile files; a cut-out needs far less.
MOST_SVG_BYTES = 2_000_000  # of the document; drawing programs embed previews of some 100 KB
_MOST_ELEMENTS = 10_000  # of the document, whatever they are
_LARGEST_UNIT = 1e9  # of a number, in user units: tenths of a micron on a sheet of 100 m
MOST_CORNERS = 10_000  # of a piece, chords of its curves included; its area takes 0.1 s to find
_MOST_COMMAND_NUMBERS = 10_000  # of a path; `svgelements` takes 0.1 s
LARGEST_COORDINATE = 1e3  # pupil radii: film reaches beyond the pupil, but larger numbers are of another unit


def read_svg_shapes(document: str | bytes) -> list[tuple[str, Shape]]:
    """Read the pieces of film of a drawing.

    A circle with the id ``pupil`` gives the scale; every other circle, rect, polygon and path is a piece of film named
    by its ``data-filter``, or else its ``fill``. SVG has x right and y down, as the pupil seen from behind the camera.

    ``document``: the SVG document; bytes are in UTF-8, or in the encoding that the document names. Returns list of
    (filter name, Shape), in pupil radii. Raises InputError: no pupil circle, an unsupported element or path command, a
    transform, or a document that is too large.
    """
    if len(document) > MOST_SVG_BYTES:
        raise InputError(
            f"the aperture drawing has {len(document)} characters, more than {MOST_SVG_BYTES}: simplify it"
        )
    try:
        root = ElementTree.fromstring(document)
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # unknown encodings
        raise InputError(f"the aperture drawing is not valid SVG: {error}") from None
    elements = [(element.tag.rsplit("}", 1)[-1], element.attrib) for element in islice(root.iter(), _MOST_ELEMENTS + 1)]
    if len(elements) > _MOST_ELEMENTS:
        raise InputError(f"the aperture drawing has more than {_MOST_ELEMENTS} elements: simplify it")
    pupils = [attrib for tag, attrib in elements if tag == "circle" and attrib.get("id") == "pupil"]
    if len(pupils) != 1:
        raise InputError('the aperture drawing needs one circle with id="pupil" that gives position and scale')
    cx, cy, radius = _numbers("circle", pupils[0], "cx", "cy", "r")
    if radius <= 0:
        raise InputError("the pupil circle of the aperture drawing has no radius")
    shapes: list[tuple[str, Shape]] = []
    for tag, attrib in elements:
        if "transform" in attrib:
            raise InputError(f"<{tag}> has a transform: flatten the transforms of the drawing before saving it")
        if tag not in ("circle", "rect", "polygon", "path") or attrib.get("id") == "pupil":
            continue
        name = attrib.get("data-filter") or attrib.get("fill")
        if name is None:
            raise InputError(f'a <{tag}> of the drawing has neither data-filter nor fill, such as fill="cyan"')
        if len(shapes) >= MOST_PIECES:
            raise InputError(f"the aperture drawing has more than {MOST_PIECES} pieces of film: simplify it")
        shapes.append((name.lower(), _shape(tag, attrib, np.array([cx, cy]), radius)))
    return shapes


def _shape(tag: str, attrib: Mapping[str, str], center: np.ndarray, radius: float) -> Shape:
    if tag == "circle":
        x, y, r = _numbers(tag, attrib, "cx", "cy", "r")
        (x, y), r = _in_radii(tag, np.array([[x, y]]) - center, radius)[0], abs(r) / radius
        if not r <= LARGEST_COORDINATE:
            raise InputError(f"a <circle> of the drawing has a radius of {r:g} pupil radii: check the pupil circle")
        return Disc((float(x), float(y)), r)
    if tag == "rect":
        x, y, width, height = _numbers(tag, attrib, "x", "y", "width", "height")
        corners = np.array([(x, y), (x + width, y), (x + width, y + height), (x, y + height)])
    else:
        corners = path_points(f"M {attrib.get('points', '')} Z" if tag == "polygon" else attrib.get("d", ""))
    if len(corners) < 3:
        raise InputError(f"a <{tag}> of the drawing has fewer than three corners")
    return Polygon(tuple((float(x), float(y)) for x, y in _in_radii(tag, corners - center, radius)))


def _in_radii(tag: str, offsets: np.ndarray, radius: float) -> np.ndarray:
    """Return offsets from the pupil's centre in pupil radii, (N, 2); raises InputError for those far outside."""
    if not np.abs(offsets).max() <= radius * LARGEST_COORDINATE:
        raise InputError(f"a <{tag}> of the drawing lies far outside the pupil circle: check the circle with id=pupil")
    return offsets / radius


def _numbers(tag: str, attrib: Mapping[str, str], *keys: str) -> list[float]:
    try:
        numbers = [float(attrib.get(key, 0)) for key in keys]
    except ValueError as error:
        raise InputError(
            f"a <{tag}> of the drawing has a length that is not a plain number: {quoted(str(error))}"
        ) from None
    if not all(abs(number) <= _LARGEST_UNIT for number in numbers):
        raise InputError(f"a <{tag}> of the drawing has a length that is not finite, or above {_LARGEST_UNIT:g}")
    return numbers


def path_points(commands: str) -> np.ndarray:
    """Convert a closed path of the SVG commands M L H V Q C Z to a polygon, (N, 2) user units."""
    from svgelements import Close, Line, Move, Path

    known = _SUPPORTED.match(commands)
    end = known.end() if known else 0
    if end < len(commands):
        raise InputError(
            f"path command {commands[end]!r} is not supported: convert arcs to Bezier curves (M L H V Q C Z)"
        )
    _check_grammar(commands)
    try:
        segments = list(Path(commands))
    except ValueError:
        raise InputError(f"a path of the drawing lacks numbers: {quoted(commands[:60])}") from None
    if any(isinstance(segment, Move) for segment in segments[1:]):
        raise InputError("a path of the drawing has more than one loop: draw each piece as its own path")
    steps = np.linspace(0, 1, _CURVE_STEPS + 1)[1:]
    points = [
        [segment.end] if isinstance(segment, Move | Line) else segment.npoint(steps)
        for segment in segments
        if not isinstance(segment, Close)
    ]
    out = np.concatenate(points).astype(float) if points else np.empty((0, 2))
    if len(out) > MOST_CORNERS:
        raise InputError(f"a path of the drawing has {len(out)} corners, more than {MOST_CORNERS}: simplify it")
    if not np.isfinite(out).all():
        raise InputError("a path of the drawing has numbers that are not finite")
    return out


def _check_grammar(commands: str) -> None:
    """Raise InputError unless every command has its numbers; what a parser makes of others is its own affair."""
    first, *rest = re.split(r"([MLHVQCZmlhvqcz])", commands)
    count = 0
    if first.strip() or (rest and rest[0] not in "Mm"):
        raise InputError(f"a path of the drawing must begin with M: {quoted(commands[:60])}")
    for command, text in zip(rest[::2], rest[1::2], strict=True):
        found = _NUMBER.findall(text.lstrip())
        count += len(found)
        each = _NUMBERS[command.upper()]
        whole = len(found) % each == 0 and found if each else not found
        if sum(map(len, found)) != len(text.lstrip()) or not whole:
            raise InputError(
                f"a path of the drawing lacks numbers, or has too many, after {command}: {quoted(text[:60])}"
            )
        if count > _MOST_COMMAND_NUMBERS:
            raise InputError(f"a path of the drawing has more than {_MOST_COMMAND_NUMBERS} numbers: simplify it")


def load_aperture(name_or_path: str | Path) -> Aperture:
    """Load an aperture by the name of a design, or from a ``.toml`` or ``.svg`` file; raises InputError."""
    path = Path(name_or_path)
    if path.suffix.lower() not in (".toml", ".svg"):
        return design_named(str(name_or_path))
    if not os.path.lexists(path):
        raise InputError(f"no aperture file {quoted(path)}: give a file, or one of {', '.join(DESIGNS)}")
    if path.suffix.lower() == ".toml":
        return aperture_from_dict(read_toml(path), name=path.stem)
    shapes = read_svg_shapes(read_bytes(path, most_bytes=MOST_SVG_BYTES))
    sheets = film_named("ideal") | FIXED
    parts = tuple(SubAperture(shape, _sheet(sheets, colour)) for colour, shape in shapes)
    return checked_aperture(Aperture(path.stem, path.stem, parts, FIXED["opaque"], _views(parts)))


# In pupil radii: film reaches beyond the pupil, but larger numbers are of another unit.
_Coordinate = Annotated[float, Field(ge=-LARGEST_COORDINATE, le=LARGEST_COORDINATE)]
_Length = Annotated[float, Field(gt=0, le=LARGEST_COORDINATE)]
_Point = tuple[_Coordinate, _Coordinate]


class _DiscTable(Table):
    center: _Point = (0.0, 0.0)
    radius: _Length = 1.0
    inner_radius: Annotated[float, Field(ge=0, le=LARGEST_COORDINATE)] = 0.0


class _HalfPlaneTable(Table):
    normal: _Point
    offset: _Coordinate = 0.0


class _SquareTable(Table):
    center: _Point
    side: _Length
    angle_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0


class _PartTable(Table):
    """``[[part]]``: a piece of film; one of the shapes."""

    filter: Name
    disc: _DiscTable | None = None
    half_plane: _HalfPlaneTable | None = None
    square: _SquareTable | None = None
    polygon: Annotated[tuple[_Point, ...], Field(min_length=3, max_length=MOST_CORNERS)] | None = None

    def shape(self) -> Shape:
        """Return the shape; raises InputError unless there is exactly one."""
        shapes: list[Shape] = []
        for kind, table in ((Disc, self.disc), (HalfPlane, self.half_plane), (Square, self.square)):
            if table is not None:
                shapes.append(kind(**dict(table)))
        if self.polygon is not None:
            shapes.append(Polygon(self.polygon))
        if len(shapes) != 1:
            raise InputError(f"a part needs a filter and one of disc, half_plane, square, polygon; got {len(shapes)}")
        return shapes[0]


class _FilterTable(Table):
    """``[filters.NAME]``."""

    transmission: tuple[float, float, float]


class _ApertureTable(Table):
    """An aperture file."""

    title: Name | None = None
    film: Name = "ideal"
    remainder: Literal["clear", "opaque"] = "opaque"
    views: Annotated[tuple[Name, ...], Field(max_length=MOST_PIECES)] | None = None
    filters: Annotated[dict[Name, _FilterTable], Field(max_length=MOST_PIECES)] = Field(default_factory=dict)
    part: Annotated[tuple[_PartTable, ...], Field(max_length=MOST_PIECES)] = ()


def load_made(name_or_path: str, film: str) -> Aperture:
    """Return a design made of a film, or that of a file with its own film."""
    aperture = load_aperture(name_or_path)
    return aperture if name_or_path.lower().endswith((".toml", ".svg")) else made_of(aperture, film)


def aperture_from_dict(data: Mapping[str, Any], *, name: str) -> Aperture:
    """Build an aperture from the contents of its TOML file.

    ``data``: ``part``: list of tables, each with ``filter`` and one of ``disc``, ``half_plane``, ``square``,
    ``polygon``; optional ``title``, ``film`` (ideal, lee, real, leaky), ``remainder`` (clear, opaque), ``views`` and
    ``[filters.NAME] transmission = [r, g, b]``. Raises InputError: see `load_aperture`.
    """
    table = checked(_ApertureTable, dict(data), where=f"aperture {quoted(name)}")
    own = {key: Filter(key, value.transmission) for key, value in table.filters.items()}
    sheets = film_named(table.film) | FIXED | own
    parts = tuple(SubAperture(part.shape(), _sheet(sheets, part.filter)) for part in table.part)
    views = _views(parts) if table.views is None else table.views
    title = name if table.title is None else table.title
    return checked_aperture(Aperture(name, title, parts, FIXED[table.remainder], views))


def _views(parts: tuple[SubAperture, ...]) -> tuple[str, ...]:
    """List the coloured filters in order, without repeats."""
    return tuple(dict.fromkeys(part.filter.name for part in parts if part.filter.name not in FIXED))


def _sheet(sheets: Mapping[str, Filter], name: str) -> Filter:
    if name not in sheets:
        name = quoted(name)
        raise InputError(f"unknown filter {name!r}: choose one of {', '.join(sheets)}, or define [filters.{name}]")
    return sheets[name]

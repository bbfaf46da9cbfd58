"""User-defined apertures from a short TOML file or a simple drawing."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from chromaperture.optics.aperture import DESIGNS, MOST_PIECES, Aperture, SubAperture, checked_aperture, design_named
from chromaperture.optics.filters import FIXED, Filter, film_named
from chromaperture.optics.printing.svg import LARGEST_COORDINATE, MOST_CORNERS, MOST_SVG_BYTES, read_svg_shapes
from chromaperture.optics.shapes import Disc, HalfPlane, Polygon, Shape, Square
from chromaperture.system.errors import InputError
from chromaperture.system.validation import Name, Table, checked, quoted, read_bytes, read_toml


def load_aperture(name_or_path: str | Path) -> Aperture:
    """Load an aperture by the name of a design, or from a ``.toml`` or ``.svg`` file.

    Raises InputError: unknown name, missing or malformed file, pieces that overlap or lie outside the pupil, unknown
    filters.
    """
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


def aperture_from_dict(data: Mapping[str, Any], *, name: str) -> Aperture:
    """Build an aperture from the contents of its TOML file.

    ``data``: ``part``: list of tables, each with ``filter`` and one of ``disc``, ``half_plane``, ``square``,
    ``polygon``; optional ``title``, ``film`` (ideal, real, leaky), ``remainder`` (clear, opaque), ``views`` and
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

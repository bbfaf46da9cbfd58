"""User-defined apertures from a short TOML file or a simple drawing."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from chromaperture.errors import InputError
from chromaperture.optics.aperture import DESIGNS, Aperture, SubAperture, checked_aperture, design_named
from chromaperture.optics.filters import FIXED, Filter, film_named
from chromaperture.optics.shapes import Disc, HalfPlane, Polygon, Shape, Square
from chromaperture.optics.svg import read_svg_shapes


def load_aperture(name_or_path: str | Path) -> Aperture:
    """Load an aperture by the name of a design, or from a ``.toml`` or ``.svg`` file.

    Raises
    ------
    InputError
        Unknown name, missing or malformed file, pieces that overlap or lie outside the pupil, unknown filters.
    """
    path = Path(name_or_path)
    if path.suffix.lower() not in (".toml", ".svg"):
        return design_named(str(name_or_path))
    if not path.is_file():
        raise InputError(f"no aperture file {path}: give a file, or one of {', '.join(DESIGNS)}")
    if path.suffix.lower() == ".svg":
        shapes = read_svg_shapes(path.read_text(encoding="utf-8"))
        sheets = film_named("ideal") | FIXED
        parts = tuple(SubAperture(shape, _sheet(sheets, colour)) for colour, shape in shapes)
        return checked_aperture(Aperture(path.stem, path.stem, parts, FIXED["opaque"], _views(parts)))
    try:
        return aperture_from_dict(tomllib.loads(path.read_text(encoding="utf-8")), name=path.stem)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path} is not valid TOML: {error}") from None


def aperture_from_dict(data: Mapping[str, Any], *, name: str) -> Aperture:
    """Build an aperture from the contents of its TOML file.

    Parameters
    ----------
    data : mapping
        ``part``: list of tables, each with ``filter`` and one of ``disc``, ``half_plane``, ``square``,
        ``polygon``; optional ``title``, ``film`` (ideal, real, leaky), ``remainder`` (clear, opaque),
        ``views`` and ``[filters.NAME] transmission = [r, g, b]``.
    name : str

    Raises
    ------
    InputError
        See `load_aperture`.
    """
    known = {"title", "film", "remainder", "views", "filters", "part"}
    if set(data) - known:
        raise InputError(f"aperture {name!r}: unknown keys {', '.join(sorted(set(data) - known))}; known are {known}")
    own = {key: Filter(key, tuple(value["transmission"])) for key, value in data.get("filters", {}).items()}
    sheets = film_named(data.get("film", "ideal")) | FIXED | own
    parts = tuple(SubAperture(_shape(part), _sheet(sheets, part.get("filter"))) for part in data.get("part", ()))
    remainder = data.get("remainder", "opaque")
    if remainder not in FIXED:
        raise InputError(f"aperture {name!r}: remainder must be clear or opaque, got {remainder!r}")
    views = tuple(data["views"]) if "views" in data else _views(parts)
    return checked_aperture(Aperture(name, data.get("title", name), parts, FIXED[remainder], views))


def _views(parts: tuple[SubAperture, ...]) -> tuple[str, ...]:
    """List the coloured filters in order, without repeats."""
    return tuple(dict.fromkeys(part.filter.name for part in parts if part.filter.name not in FIXED))


def _sheet(sheets: Mapping[str, Filter], name: object) -> Filter:
    if not isinstance(name, str) or name not in sheets:
        raise InputError(f"unknown filter {name!r}: choose one of {', '.join(sheets)}, or define [filters.{name}]")
    return sheets[name]


def _shape(part: Mapping[str, Any]) -> Shape:
    """Build the shape of one ``[[part]]`` table."""
    kinds: dict[str, Any] = {"disc": Disc, "half_plane": HalfPlane, "square": Square}
    given = [key for key in part if key != "filter"]
    if len(given) != 1 or given[0] not in (*kinds, "polygon"):
        raise InputError(f"a part needs a filter and one of {', '.join(kinds)}, polygon; got {', '.join(part)}")
    value = part[given[0]]
    try:
        if given[0] == "polygon":
            corners = tuple((float(x), float(y)) for x, y in value)
            if len(corners) < 3:
                raise InputError(f"a polygon needs at least three corners, got {len(corners)}")
            return Polygon(corners)
        return kinds[given[0]](**{k: tuple(v) if isinstance(v, list) else float(v) for k, v in value.items()})
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"cannot read {given[0]} = {value}: {error}") from None

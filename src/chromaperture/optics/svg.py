"""Shapes from a simple SVG drawing of an aperture.

A circle with the id ``pupil`` gives the scale; every other circle, rect, polygon and path is a piece of film named by
its ``data-filter``, or else its ``fill``. SVG has x right and y down, as has the pupil seen from behind the camera.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np

from chromaperture.errors import InputError
from chromaperture.optics.shapes import Disc, Polygon, Shape

_SUPPORTED = re.compile(r"[MLHVQCZmlhvqcz\d\s.,+\-eE]*")
_CURVE_STEPS = 32  # chords per curve: a quarter circle is off by 3e-4 of its radius
# Limits for damaged or hostile files; a cut-out needs far less.
_LARGEST = 2_000_000  # characters of the document
_MOST_CORNERS = 100_000  # of a piece


def read_svg_shapes(text: str) -> list[tuple[str, Shape]]:
    """Read the pieces of film of a drawing.

    Parameters
    ----------
    text : str
        The SVG document.

    Returns
    -------
    list of (filter name, Shape), in pupil radii

    Raises
    ------
    InputError
        No pupil circle, an unsupported element or path command, a transform, or a document that is too large.
    """
    if len(text) > _LARGEST:
        raise InputError(f"the aperture drawing has {len(text)} characters, more than {_LARGEST}: simplify it")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"the aperture drawing is not valid SVG: {error}") from None
    elements = [(element.tag.rsplit("}", 1)[-1], element.attrib) for element in root.iter()]
    pupils = [attrib for tag, attrib in elements if tag == "circle" and attrib.get("id") == "pupil"]
    if len(pupils) != 1:
        raise InputError('the aperture drawing needs one circle with id="pupil" that gives position and scale')
    cx, cy, radius = _numbers("circle", pupils[0], "cx", "cy", "r")
    if radius <= 0:
        raise InputError("the pupil circle of the aperture drawing has no radius")
    shapes = []
    for tag, attrib in elements:
        if "transform" in attrib:
            raise InputError(f"<{tag}> has a transform: flatten the transforms of the drawing before saving it")
        if tag not in ("circle", "rect", "polygon", "path") or attrib.get("id") == "pupil":
            continue
        name = attrib.get("data-filter") or attrib.get("fill")
        if name is None:
            raise InputError(f'a <{tag}> of the drawing has neither data-filter nor fill, such as fill="cyan"')
        shapes.append((name.lower(), _shape(tag, attrib, np.array([cx, cy]), radius)))
    return shapes


def _shape(tag: str, attrib: Mapping[str, str], center: np.ndarray, radius: float) -> Shape:
    if tag == "circle":
        x, y, r = _numbers(tag, attrib, "cx", "cy", "r")
        return Disc(((x - center[0]) / radius, (y - center[1]) / radius), r / radius)
    if tag == "rect":
        x, y, width, height = _numbers(tag, attrib, "x", "y", "width", "height")
        corners = np.array([(x, y), (x + width, y), (x + width, y + height), (x, y + height)])
    else:
        corners = path_points(f"M {attrib.get('points', '')} Z" if tag == "polygon" else attrib.get("d", ""))
    if len(corners) < 3:
        raise InputError(f"a <{tag}> of the drawing has fewer than three corners")
    return Polygon(tuple((float(x), float(y)) for x, y in (corners - center) / radius))


def _numbers(tag: str, attrib: Mapping[str, str], *keys: str) -> list[float]:
    try:
        return [float(attrib.get(key, 0)) for key in keys]
    except ValueError as error:
        raise InputError(f"a <{tag}> of the drawing has a length that is not a plain number: {error}") from None


def path_points(commands: str) -> np.ndarray:
    """Convert a closed path of lines and Bezier curves to a polygon.

    Parameters
    ----------
    commands : str
        Path data with the commands M L H V Q C Z.

    Returns
    -------
    (N, 2) float64, user units

    Raises
    ------
    InputError
        Arcs and other commands, a second loop, missing numbers, or too many corners.
    """
    from svgelements import Close, Line, Move, Path

    known = _SUPPORTED.match(commands)
    end = known.end() if known else 0
    if end < len(commands):
        raise InputError(
            f"path command {commands[end]!r} is not supported: convert arcs to Bezier curves (M L H V Q C Z)"
        )
    try:
        segments = list(Path(commands))
    except ValueError:
        raise InputError(f"a path of the drawing lacks numbers: {commands[:60]!r}") from None
    if any(isinstance(segment, Move) for segment in segments[1:]):
        raise InputError("a path of the drawing has more than one loop: draw each piece as its own path")
    steps = np.linspace(0, 1, _CURVE_STEPS + 1)[1:]
    points = [
        [segment.end] if isinstance(segment, Move | Line) else segment.npoint(steps)
        for segment in segments
        if not isinstance(segment, Close)
    ]
    out = np.concatenate(points).astype(float) if points else np.empty((0, 2))
    if len(out) > _MOST_CORNERS:
        raise InputError(f"a path of the drawing has {len(out)} corners, more than {_MOST_CORNERS}: simplify it")
    if not np.isfinite(out).all():
        raise InputError("a path of the drawing has numbers that are not finite")
    return out

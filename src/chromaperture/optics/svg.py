"""Shapes out of a simple SVG drawing of an aperture.

A circle with the id ``pupil`` gives the scale; every other circle, rect, polygon and path is a piece of film
named by its ``data-filter``, or else its ``fill``. SVG has x right and y down, as the pupil seen from behind
the camera has.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np

from chromaperture.errors import InputError
from chromaperture.optics.shapes import Disc, Polygon, Shape

_TOKEN = re.compile(r"[A-Za-z]|[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_ARGUMENTS = {"M": 2, "L": 2, "H": 1, "V": 1, "Q": 4, "C": 6, "Z": 0}
_CURVE_STEPS = 32  # chords per curve: a quarter circle is off by 3e-4 of its radius


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
        No pupil circle, an element or a path command that is not understood, a transform.
    """
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"the aperture drawing is not valid SVG: {error}") from None
    elements = [(element.tag.rsplit("}", 1)[-1], element.attrib) for element in root.iter()]
    pupils = [attrib for tag, attrib in elements if tag == "circle" and attrib.get("id") == "pupil"]
    if len(pupils) != 1:
        raise InputError(
            'the aperture drawing needs one circle with id="pupil" that gives position and scale'
        )
    cx, cy, radius = (float(pupils[0].get(key, 0)) for key in ("cx", "cy", "r"))
    if radius <= 0:
        raise InputError("the pupil circle of the aperture drawing has no radius")
    shapes = []
    for tag, attrib in elements:
        if "transform" in attrib:
            raise InputError(
                f"<{tag}> has a transform: flatten the transforms of the drawing before saving it"
            )
        if tag not in ("circle", "rect", "polygon", "path") or attrib.get("id") == "pupil":
            continue
        name = attrib.get("data-filter") or attrib.get("fill")
        if name is None:
            raise InputError(
                f'a <{tag}> of the drawing has neither data-filter nor fill, such as fill="cyan"'
            )
        shapes.append((name.lower(), _shape(tag, attrib, (cx, cy), radius)))
    return shapes


def _shape(tag: str, attrib: dict[str, str], center: tuple[float, float], radius: float) -> Shape:
    def number(key: str) -> float:
        return float(attrib.get(key, 0))

    if tag == "circle":
        middle = ((number("cx") - center[0]) / radius, (number("cy") - center[1]) / radius)
        return Disc(middle, number("r") / radius)
    if tag == "rect":
        x, y, width, height = (number(key) for key in ("x", "y", "width", "height"))
        points = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    elif tag == "polygon":
        values = [float(v) for v in _TOKEN.findall(attrib.get("points", ""))]
        points = list(zip(values[::2], values[1::2], strict=True))
    else:
        points = path_points(attrib.get("d", ""))
    if len(points) < 3:
        raise InputError(f"a <{tag}> of the drawing has fewer than three corners")
    return Polygon(tuple(((x - center[0]) / radius, (y - center[1]) / radius) for x, y in points))


def path_points(commands: str) -> list[tuple[float, float]]:
    """Turn a closed path of lines and Bezier curves into a polygon; InputError for arcs and second loops."""
    tokens = _TOKEN.findall(commands)
    points: list[tuple[float, float]] = []
    here = np.zeros(2)
    command, i = "", 0
    while i < len(tokens):
        if tokens[i].isalpha():
            command, i = tokens[i], i + 1
            if command.upper() == "M" and points:
                raise InputError(
                    "a path of the drawing has more than one loop: draw each piece as its own path"
                )
        if command.upper() not in _ARGUMENTS:
            raise InputError(
                f"path command {command!r} is not supported: convert arcs to Bezier curves (M L H V Q C Z)"
            )
        count = _ARGUMENTS[command.upper()]
        if count == 0:
            continue
        values = np.array([float(v) for v in tokens[i : i + count]])
        if len(values) < count:
            raise InputError(f"path command {command!r} lacks numbers")
        i += count
        origin = here if command.islower() else np.zeros(2)
        if command.upper() in "HV":
            axis = 0 if command.upper() == "H" else 1
            target = here.copy()
            target[axis] = values[0] + origin[axis]
            new = [target]
        else:
            new = _bezier(here, values.reshape(-1, 2) + origin)
        points += [(float(p[0]), float(p[1])) for p in new]
        here = np.asarray(new[-1])
        if command.upper() == "M":
            command = "l" if command.islower() else "L"  # further pairs after a move are lines
    return points


def _bezier(start: np.ndarray, control: np.ndarray) -> list[np.ndarray]:
    """Sample a Bezier curve by de Casteljau's construction; a line gives its end only."""
    if len(control) == 1:
        return [control[0]]
    out = []
    for t in np.linspace(0, 1, _CURVE_STEPS + 1)[1:]:
        level = np.vstack([start, control])
        while len(level) > 1:
            level = (1 - t) * level[:-1] + t * level[1:]
        out.append(level[0])
    return out


def stroke_points(commands: str) -> tuple[list[tuple[float, float]], list[int]]:
    """Vertices and matplotlib path codes (1 move, 2 line, 79 close) of a path of moves and lines."""
    tokens = _TOKEN.findall(commands)
    here = np.zeros(2)
    vertices: list[tuple[float, float]] = []
    codes: list[int] = []
    command, i = "", 0
    while i < len(tokens):
        if tokens[i].isalpha():
            command, i = tokens[i], i + 1
        if command.upper() == "Z":
            vertices.append((0.0, 0.0))
            codes.append(79)
            continue
        count = _ARGUMENTS[command.upper()]
        values = [float(v) for v in tokens[i : i + count]]
        i += count
        origin = here if command.islower() else np.zeros(2)
        target = here.copy()
        if command.upper() in "HV":
            axis = 0 if command.upper() == "H" else 1
            target[axis] = values[0] + origin[axis]
        else:
            target = np.array(values) + origin
        here = target
        vertices.append((float(here[0]), float(here[1])))
        codes.append(1 if command.upper() == "M" else 2)
        command = {"M": "L", "m": "l"}.get(command, command)
    return vertices, codes

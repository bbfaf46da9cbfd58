"""Printable templates of an aperture at its true size: what to cut, and which side looks at the scene."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture
from chromaperture.optics.shapes import Disc, HalfPlane, Intersection, Polygon, Shape, Square

_PAGE_MM = (210.0, 297.0)
_COLOURS = {"red": "#e03030", "green": "#20a040", "blue": "#3050e0", "cyan": "#30c0d8", "magenta": "#d840b0",
            "yellow": "#f2dc30", "clear": "#ffffff", "opaque": "#404040"}  # fmt: skip
_OUTLINE_STEPS = 720


def outline(shape: Shape) -> list[np.ndarray]:
    """Give closed outlines of a shape within the unit pupil.

    Parameters
    ----------
    shape : Shape

    Returns
    -------
    list of (N, 2) float64, pupil radii; holes are outlines of their own that run the other way round
    """
    if isinstance(shape, Intersection):
        loops = [loop for part in shape.shapes if not isinstance(part, HalfPlane) for loop in outline(part)]
        for part in shape.shapes:
            if isinstance(part, HalfPlane):
                loops = [_clipped(loop, np.array(part.normal), part.offset) for loop in loops]
        return [loop for loop in loops if len(loop) > 2]
    if isinstance(shape, HalfPlane):
        return [_clipped(_circle((0, 0), 1.0), np.array(shape.normal), shape.offset)]
    if isinstance(shape, Disc):
        loops = [_circle(shape.center, shape.radius)]
        if shape.inner_radius:
            loops.append(_circle(shape.center, shape.inner_radius)[::-1])  # holes run the other way round
        return [_in_pupil(loop) for loop in loops]
    if isinstance(shape, Square):
        angle = math.radians(shape.angle_deg)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * shape.side / 2
        return [_in_pupil(corners @ turn.T + shape.center)]
    if isinstance(shape, Polygon):
        return [_in_pupil(np.array(shape.corners))]
    raise InputError(
        f"no outline is known for {type(shape).__name__}: give the aperture as discs, squares or polygons"
    )


def _circle(center: tuple[float, float], radius: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, _OUTLINE_STEPS, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle)], -1) * radius + center


def _in_pupil(loop: np.ndarray) -> np.ndarray:
    """Pull what lies beyond the rim onto it; pieces of film end at the pupil."""
    fine = np.concatenate(
        [
            np.linspace(a, b, 64, endpoint=False) if len(loop) < 64 else a[None]
            for a, b in zip(loop, np.roll(loop, -1, 0), strict=True)
        ]
    )
    return fine / np.maximum(np.hypot(*fine.T), 1)[:, None]


def _clipped(loop: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Sutherland-Hodgman against one line."""
    out = []
    for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
        ha, hb = a @ normal - offset, b @ normal - offset
        if ha >= 0:
            out.append(a)
        if ha * hb < 0:
            out.append(a + (b - a) * ha / (ha - hb))
    return np.array(out)


def template_svg(aperture: Aperture, *, pupil_diameter_mm: float) -> str:
    """Draw the template as SVG in millimetres.

    Parameters
    ----------
    aperture : Aperture
    pupil_diameter_mm : float
        Diameter of the stop the film is put into.

    Returns
    -------
    str
        A page of A4: each piece alone to cut, all pieces together, a 50 mm scale bar, and the orientation.

    Raises
    ------
    InputError
        A diameter that does not fit the page.
    """
    if not 0.5 <= pupil_diameter_mm <= 80:
        raise InputError(f"a pupil of {pupil_diameter_mm:g} mm does not fit the page: give 0.5 to 80 mm")
    radius = pupil_diameter_mm / 2
    pitch = pupil_diameter_mm + 18
    per_row = max(1, int((_PAGE_MM[0] - 20) // pitch))
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_PAGE_MM[0]:g}mm" height="{_PAGE_MM[1]:g}mm" '
        f'viewBox="0 0 {_PAGE_MM[0]:g} {_PAGE_MM[1]:g}" font-family="sans-serif">',
        f'<text x="10" y="14" font-size="6">{aperture.title}, pupil {pupil_diameter_mm:g} mm</text>',
        '<text x="10" y="20" font-size="3.2">Print at 100 %. The arrow points up in the scene.</text>',
        '<text x="10" y="25" font-size="3.2">The side you read faces the sensor: as seen from behind the '
        "camera.</text>",
        '<path d="M 10 32 H 60 M 10 30 V 34 M 60 30 V 34 M 20 31 V 33 M 30 31 V 33 M 40 31 V 33 M 50 31 V '
        '33" '
        'fill="none" stroke="black" stroke-width="0.2"/>',
        '<text x="62" y="33" font-size="3.5">50 mm: measure before you cut</text>',
    ]
    drawings: list[tuple[str, list[tuple[str, list[np.ndarray]]]]] = []
    pieces = [(part.filter.name, outline(part.shape)) for part in aperture.parts]
    drawings.append(("assembled", pieces))
    drawings += [(f"cut: {name}", [(name, loops)]) for name, loops in pieces]
    for i, (label, drawn) in enumerate(drawings):
        cx = 10 + pitch * (i % per_row + 0.5)
        cy = 40 + (pitch + 6) * (i // per_row + 0.5)
        parts.append(_drawing(label, drawn, cx, cy, radius))
    parts.append("</svg>")
    return "\n".join(parts) + "\n"


def _drawing(
    label: str, pieces: list[tuple[str, list[np.ndarray]]], cx: float, cy: float, radius: float
) -> str:
    out = []
    for name, loops in pieces:
        path = " ".join(
            "M " + " L ".join(f"{cx + radius * x:.3f} {cy + radius * y:.3f}" for x, y in loop) + " Z"
            for loop in loops
        )
        fill = _COLOURS.get(name, "#c0c0c0")
        out.append(f'<path d="{path}" fill="{fill}" fill-rule="evenodd" stroke="black" stroke-width="0.1"/>')
    out.append(
        f'<circle cx="{cx:.3f}" cy="{cy:.3f}" r="{radius:.3f}" fill="none" stroke="black" '
        'stroke-width="0.1"/>'
    )
    marks = " ".join(
        f"M {cx + sx * (radius + 1):.3f} {cy + sy * (radius + 1):.3f} l {3 * sx:g} {3 * sy:g}"
        for sx, sy in ((1, 0), (-1, 0), (0, 1))
    )
    top = cy - radius
    arrow = f"M {cx:.3f} {top - 1:.3f} v -4 m -1.2 1.6 l 1.2 -1.6 l 1.2 1.6"
    out.append(f'<path d="{marks} {arrow}" fill="none" stroke="black" stroke-width="0.2"/>')
    out.append(
        f'<text x="{cx:.3f}" y="{cy + radius + 7.5:.3f}" font-size="3.2" text-anchor="middle">{label}</text>'
    )
    return "\n".join(out)


def write_template(path: Path, aperture: Aperture, *, pupil_diameter_mm: float) -> None:
    """Write the template as ``.svg`` or ``.pdf``, at its true size; raises InputError for other names."""
    if path.suffix.lower() == ".svg":
        path.write_text(template_svg(aperture, pupil_diameter_mm=pupil_diameter_mm), encoding="utf-8")
        return
    if path.suffix.lower() != ".pdf":
        raise InputError(f"a template is written as .svg or .pdf, not {path.name!r}")
    svg = template_svg(aperture, pupil_diameter_mm=pupil_diameter_mm)
    _svg_to_pdf(svg, path)


def _svg_to_pdf(svg: str, path: Path) -> None:
    """Redraw the template's own SVG (paths, circles, texts) with matplotlib, which writes PDF."""
    from xml.etree import ElementTree

    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.patches import Circle, PathPatch
    from matplotlib.path import Path as Outline

    from chromaperture.optics.svg import stroke_points

    figure = pyplot.figure(figsize=(_PAGE_MM[0] / 25.4, _PAGE_MM[1] / 25.4))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, _PAGE_MM[0]), ylim=(_PAGE_MM[1], 0))
    axes.axis("off")
    point = 72 / 25.4  # points per mm
    for element in ElementTree.fromstring(svg):
        tag, a = element.tag.rsplit("}", 1)[-1], element.attrib
        width = float(a.get("stroke-width", 0)) * point
        if tag == "text":
            anchor = "center" if a.get("text-anchor") == "middle" else "left"
            axes.text(
                float(a["x"]),
                float(a["y"]),
                element.text or "",
                fontsize=float(a["font-size"]) * point,
                ha=anchor,
            )
        elif tag == "circle":
            axes.add_patch(Circle((float(a["cx"]), float(a["cy"])), float(a["r"]), fill=False, lw=width))
        elif tag == "path":
            vertices, codes = stroke_points(a["d"])
            filled = a["fill"] != "none"
            face = a["fill"] if filled else "none"
            axes.add_patch(PathPatch(Outline(vertices, codes), facecolor=face, edgecolor="black", lw=width))
    figure.savefig(path, format="pdf")
    pyplot.close(figure)

"""Printable templates of an aperture at its true size: what to cut, and which side faces the sensor."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from chromaperture.optics.aperture import Aperture, Disc, HalfPlane, Intersection, Polygon, Shape, Square
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PAGE_MM = (210.0, 297.0)  # A4
_COLOURS = {"red": "#e03030", "green": "#20a040", "blue": "#3050e0", "cyan": "#30c0d8", "magenta": "#d840b0",
            "yellow": "#f2dc30", "clear": "#ffffff", "opaque": "#404040"}  # fmt: skip
_OUTLINE_STEPS = 720  # chords of a circle: off by 1e-5 of its radius
_TAB_MM = 3.0  # of film beyond the pupil's rim, by which a ring holds it; chosen by hand
_RIM = 1e-3  # of the pupil's radius: what is nearer lies on its rim
_SIDE_STEPS = 64  # points of a polygon's side, so that it can follow the rim of the pupil


def outline(shape: Shape) -> list[np.ndarray]:
    """Compute the closed outlines of a shape within the unit pupil; holes turn the other way."""
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
            loops.append(_circle(shape.center, shape.inner_radius)[::-1])
        return [_in_pupil(loop) for loop in loops]
    if isinstance(shape, Square):
        angle = math.radians(shape.angle_deg)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * shape.side / 2
        return [_in_pupil(corners @ turn.T + shape.center)]
    if isinstance(shape, Polygon):
        return [_in_pupil(np.array(shape.corners))]
    raise InputError(f"no outline is known for {type(shape).__name__}: give the aperture as discs, squares or polygons")


def _circle(center: tuple[float, float], radius: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, _OUTLINE_STEPS, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle)], -1) * radius + center


def _in_pupil(loop: np.ndarray) -> np.ndarray:
    """Project points beyond the rim onto it: pieces of film end at the pupil."""
    fine = np.concatenate(
        [
            np.linspace(a, b, _SIDE_STEPS, endpoint=False) if len(loop) < _SIDE_STEPS else a[None]
            for a, b in zip(loop, np.roll(loop, -1, 0), strict=True)
        ]
    )
    return fine / np.maximum(np.hypot(*fine.T), 1)[:, None]


def _clipped(loop: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Clip a polygon at a line (Sutherland and Hodgman 1974); keeps the side of the normal."""
    out = []
    for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
        ha, hb = a @ normal - offset, b @ normal - offset
        if ha >= 0:
            out.append(a)
        if ha * hb < 0:
            out.append(a + (b - a) * ha / (ha - hb))
    return np.array(out)


def template_figure(aperture: Aperture, *, pupil_diameter_mm: float) -> Figure:
    """Draw the template on a page of A4: all pieces together, each alone to cut, a 50 mm scale bar, the orientation."""
    if not 0.5 <= pupil_diameter_mm <= 80:
        raise InputError(f"a pupil of {pupil_diameter_mm:g} mm does not fit the page: give 0.5 to 80 mm")
    figure, axes = new_page(_PAGE_MM)
    add_text(axes, 10, 14, f"{aperture.title}, pupil {pupil_diameter_mm:g} mm", size_mm=6)
    add_text(axes, 10, 20, "Print at 100 %. The arrow points up in the scene.")
    add_text(axes, 10, 25, "The side you read faces the sensor: as seen from behind the camera.")
    _line(axes, (10, 32), (60, 32))
    for x in range(10, 61, 10):
        half = 2 if x in (10, 60) else 1
        _line(axes, (x, 32 - half), (x, 32 + half))
    add_text(axes, 62, 33, "50 mm: measure before you cut", size_mm=3.5)
    add_text(
        axes,
        10,
        38,
        f"Cut film along the dashes, {_TAB_MM:g} mm wider: a ring of black card holds it by them. Let two",
        size_mm=3,
    )
    add_text(
        axes, 10, 42, "films overlap by 0.3 mm where they meet: a gap lets white light into both views.", size_mm=3
    )

    pieces = [(part.filter.name, outline(part.shape)) for part in aperture.parts]
    pitch = pupil_diameter_mm + 18  # room for marks and label
    per_row = max(1, int((_PAGE_MM[0] - 20) // pitch))
    drawings = [("assembled", pieces), *((f"cut: {name}", [(name, loops)]) for name, loops in pieces)]
    for i, (label, drawn) in enumerate(drawings):
        center = (10 + pitch * (i % per_row + 0.5), 40 + (pitch + 6) * (i // per_row + 0.5))
        _draw_pieces(axes, drawn, label, center, pupil_diameter_mm / 2)
    return figure


def _draw_pieces(
    axes: Axes, pieces: list[tuple[str, list[np.ndarray]]], label: str, center: tuple[float, float], radius: float
) -> None:
    from matplotlib.patches import Circle, PathPatch
    from matplotlib.path import Path as Outline

    (cx, cy), name = center, label.replace(": ", "-")
    for i, (film, loops) in enumerate(pieces):
        closed = [Outline(np.vstack([loop, loop[:1]]) * radius + center, closed=True) for loop in loops]
        face = _COLOURS.get(film, "#c0c0c0")
        patch = PathPatch(
            Outline.make_compound_path(*closed), facecolor=face, edgecolor="black", lw=points(0.1), gid=f"{name}-{i}"
        )
        axes.add_patch(patch)
        if len(pieces) == 1 and film not in ("clear", "opaque"):
            tabs = [Outline(_with_tab(loop, _TAB_MM / radius) * radius + center) for loop in loops]
            axes.add_patch(
                PathPatch(Outline.make_compound_path(*tabs), fill=False, ls="--", lw=points(0.2), gid=f"{name}-{i}-tab")
            )
    axes.add_patch(Circle(center, radius, fill=False, lw=points(0.1), gid=f"{name}-pupil"))
    for sx, sy in ((1, 0), (-1, 0), (0, 1)):
        _line(axes, *((cx + sx * (radius + r), cy + sy * (radius + r)) for r in (1, 4)))
    top = cy - radius - 5
    _line(axes, (cx, top + 4), (cx, top))
    _line(axes, (cx - 1.2, top + 1.6), (cx, top), (cx + 1.2, top + 1.6))
    add_text(axes, cx, cy + radius + 7.5, label, ha="center")


def _with_tab(loop: np.ndarray, width: float) -> np.ndarray:
    """Extend what lies on the rim of the unit pupil outwards, for a ring that holds the film; closed."""
    closed = np.vstack([loop, loop[:1]])
    on_rim = np.hypot(*closed.T) > 1 - _RIM
    return np.where(on_rim[:, None], closed * (1 + width), closed)


def _line(axes: Axes, *ends: tuple[float, float]) -> None:
    axes.plot(*np.array(ends).T, color="black", lw=points(0.2), solid_capstyle="butt")


def write_template(path: Path, aperture: Aperture, *, pupil_diameter_mm: float) -> None:
    """Write the template as ``.svg`` or ``.pdf``, at its true size; raises InputError for other names."""
    if path.suffix.lower() not in (".svg", ".pdf"):
        raise InputError(f"a template is written as .svg or .pdf, not {path.name!r}")
    write_pages(path, [template_figure(aperture, pupil_diameter_mm=pupil_diameter_mm)], aperture.title)


_MM_PER_INCH = 25.4


def points(mm: float) -> float:
    """Convert mm to points of 1/72 inch."""
    return 72 * mm / _MM_PER_INCH


def new_page(size_mm: tuple[float, float]) -> tuple[Figure, Axes]:
    """Return a page of that width and height, and its axes; data coordinates are mm from its top-left corner."""
    from matplotlib.figure import Figure

    width, height = size_mm
    figure = Figure(figsize=(width / _MM_PER_INCH, height / _MM_PER_INCH))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    return figure, axes


def add_text(axes: Axes, x: float, y: float, text: str, *, size_mm: float = 3.2, ha: str = "left") -> None:
    """Write a line of text, by the left end or the middle (``ha="center"``) of its baseline."""
    axes.text(x, y, text, fontsize=points(size_mm), ha=ha, zorder=4)


def write_pages(path: Path, pages: Iterable[Figure], title: str) -> None:
    """Write pages without a date: the first as ``.svg``, or all as ``.pdf``."""
    drawn = io.BytesIO()  # the library for PDF reports a full disk as an error of its compression
    if path.suffix.lower() == ".svg":
        next(iter(pages)).savefig(drawn, format="svg", metadata={"Title": title, "Date": None})
    else:
        from matplotlib.backends.backend_pdf import PdfPages

        with PdfPages(drawn, metadata={"Title": title, "CreationDate": None}) as pdf:
            for page in pages:
                pdf.savefig(page)
    path.write_bytes(drawn.getvalue())

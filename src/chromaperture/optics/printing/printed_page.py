"""Pages to print at their true size, drawn once for SVG and PDF."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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

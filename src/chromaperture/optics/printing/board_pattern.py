"""A printable chessboard of true size, for the pose, surrounded by speckle, for the disparity."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from chromaperture.optics.printing.template import add_text, new_page, write_pages
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPERS = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}  # landscape, mm
# Side of the squares, mm, where none is given: 9 x 6 inner corners fit with their rim; chosen by hand
_SQUARE_MM = {"a4": 22.0, "a3": 30.0, "letter": 22.0}
SPECKLE_DPI = 100  # a dot is 0.25 mm, a fifth of the smallest disc
_EDGE_MM = 6.0  # unprintable margin of most printers
_FOOT_MM = 12.0  # scale bar and text
_SCALES_MM = (1.2, 2.5, 5.0, 10.0)  # diameters: half a pixel's footprint at 1 m to that of a blurred one at 4 m
_GREYS = (40, 90, 150, 215)  # of 255; chosen by hand, not tuned
_COVERAGE = 0.4  # of the page, by the discs of one size; chosen by hand, not tuned


@dataclass(frozen=True)
class BoardPage:
    """A page with a chessboard; lengths in mm from the page's top-left corner."""

    paper: str
    size_mm: tuple[float, float]  # (width, height)
    inner_corners: tuple[int, int]  # (columns, rows)
    square_mm: float
    origin_mm: tuple[float, float]  # (x, y); top-left corner of the first square

    @property
    def caption(self) -> str:
        """Text at the foot of the page."""
        columns, rows = self.inner_corners
        return (
            f"{columns} x {rows} inner corners, {self.square_mm:g} mm squares. Print at 100 %, no fitting to the page; "
            "measure the bar and put what you find into session.toml."
        )

    def squares(self) -> list[tuple[float, float]]:
        """Top-left corners of the black squares, mm."""
        x0, y0 = self.origin_mm
        columns, rows = self.inner_corners
        return [
            (x0 + i * self.square_mm, y0 + j * self.square_mm)
            for j in range(rows + 1)
            for i in range(columns + 1)
            if (i + j) % 2 == 0
        ]


def board_page(*, columns: int = 9, rows: int = 6, square_mm: float | None = None, paper: str = "a3") -> BoardPage:
    """Lay out a chessboard of inner corners on a page of ``a4``, ``a3`` or ``letter``; raises InputError."""
    if paper.lower() not in PAPERS:
        raise InputError(f"paper {paper!r} is not known: choose one of {', '.join(PAPERS)}")
    if min(columns, rows) < 3 or (columns + rows) % 2 == 0:
        raise InputError(
            f"a board of {columns} x {rows} inner corners looks the same upside down: take at least 3 each way, one "
            "number odd and one even, such as 9 x 6"
        )
    width, height = PAPERS[paper.lower()]
    square_mm = _SQUARE_MM[paper.lower()] if square_mm is None else square_mm
    # A white rim of half a square around the board: the corner detector needs it.
    room = min((width - 2 * _EDGE_MM) / (columns + 2), (height - 2 * _EDGE_MM - _FOOT_MM) / (rows + 2))
    if not 2 <= square_mm <= room:
        raise InputError(
            f"squares of {square_mm:g} mm do not fit {columns} x {rows} corners on {paper}: give 2 to "
            f"{np.floor(10 * room) / 10:g} mm, or a larger paper"
        )
    board = ((columns + 1) * square_mm, (rows + 1) * square_mm)
    origin = ((width - board[0]) / 2, (height - _FOOT_MM - board[1]) / 2)
    return BoardPage(paper.lower(), (width, height), (columns, rows), float(square_mm), origin)


def speckle(size_mm: tuple[float, float], *, seed: int = 7) -> np.ndarray:
    """Draw discs of several sizes and greys, uint8 at `SPECKLE_DPI`; those of each size cover 0.4 of the page."""
    rng = np.random.default_rng(seed)
    per_mm = SPECKLE_DPI / 25.4
    width, height = (round(s * per_mm) for s in size_mm)
    picture = np.full((height, width), 128, np.uint8)
    for scale in sorted(_SCALES_MM, reverse=True):  # small ones on top, so that every scale stays visible
        count = round(_COVERAGE * size_mm[0] * size_mm[1] / (np.pi * scale**2 / 4))
        places = rng.uniform(0, 1, (count, 2)) * (width, height) * 16
        for (x, y), grey in zip(places.astype(int), rng.choice(_GREYS, count), strict=True):
            # 4 fractional bits: positions and radii in sixteenths of a px, with smooth edges
            cv2.circle(picture, (int(x), int(y)), round(8 * scale * per_mm), int(grey), -1, cv2.LINE_AA, 4)
    return picture


def _drawn(page: BoardPage, seed: int, *, board: bool) -> Figure:
    """Draw a page of speckle, with the chessboard or without."""
    from matplotlib.patches import Rectangle

    width, height = page.size_mm
    figure, axes = new_page(page.size_mm)
    texture = speckle((width - 2 * _EDGE_MM, height - 2 * _EDGE_MM), seed=seed)
    extent = (_EDGE_MM, width - _EDGE_MM, height - _EDGE_MM, _EDGE_MM)
    axes.imshow(texture, cmap="gray", vmin=0, vmax=255, extent=extent, aspect="auto", interpolation="none")
    if board:
        foot = height - _EDGE_MM - _FOOT_MM
        for x, y, w, h, fill in _rectangles(page, foot):
            axes.add_patch(Rectangle((x, y), w, h, facecolor=fill, edgecolor="none", zorder=3))
        add_text(axes, _EDGE_MM + 104, foot + 4, "100 mm: measure it")
        add_text(axes, _EDGE_MM + 2, foot + 9, page.caption)
    return figure


def _rectangles(page: BoardPage, foot: float) -> list[tuple[float, float, float, float, str]]:
    """List white rim, foot, black squares and scale bar: x, y, width, height, fill; in painting order."""
    square, (x0, y0) = page.square_mm, page.origin_mm
    columns, rows = page.inner_corners
    width, _ = page.size_mm
    shapes = [
        (x0 - square / 2, y0 - square / 2, (columns + 2) * square, (rows + 2) * square, "white"),
        (_EDGE_MM, foot, width - 2 * _EDGE_MM, _FOOT_MM + 1, "white"),  # overlaps the speckle's edge
    ]
    shapes += [(x, y, square, square, "black") for x, y in page.squares()]
    # 100 mm in blocks of 10, to check the printer's scale with a ruler.
    shapes += [(_EDGE_MM + 2 + 10 * i, foot + 2, 10.0, 2.0, "black" if i % 2 == 0 else "#bbbbbb") for i in range(10)]
    return shapes


def write_board(path: Path, page: BoardPage, *, wall_pages: int = 0) -> None:
    """Write the board as ``.pdf``, with pages of speckle for the wall, or as ``.svg``, at its true size."""
    suffix = path.suffix.lower()
    if suffix not in (".svg", ".pdf"):
        raise InputError(f"a board is written as .pdf or .svg, not {path.name!r}")
    if suffix == ".svg" and wall_pages:
        raise InputError("an SVG holds one page: write the wall's speckle as .pdf, or leave --wall-pages out")
    pages = (_drawn(page, seed, board=seed == 0) for seed in range(1 + wall_pages))
    write_pages(path, pages, f"Chessboard, {page.caption}")

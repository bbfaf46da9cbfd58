"""``chromaperture board``: a chessboard to print."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from chromaperture.cli.options import Quiet
from chromaperture.errors import InputError


def board(
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write, .pdf or .svg.")],
    columns: Annotated[int, typer.Option(help="Inner corners along the long side.")] = 9,
    rows: Annotated[int, typer.Option(help="Inner corners along the short side.")] = 6,
    square: Annotated[str, typer.Option(help="Side of a square, such as 22mm or 3cm.")] = "22mm",
    paper: Annotated[str, typer.Option(help="a4, a3 or letter; landscape.")] = "a4",
    wall_pages: Annotated[int, typer.Option(help="Pages of speckle for the wall around the board.", min=0)] = 0,
    quiet: Quiet = False,
) -> None:
    """Write a chessboard of true size, in speckle that helps the matcher.

    chromaperture board --out board.pdf --square 30mm --paper a3 --wall-pages 3
    """
    from chromaperture.optics.board_pattern import board_page, write_board
    from chromaperture.storage import staged

    page = board_page(columns=columns, rows=rows, square_mm=millimetres(square), paper=paper)
    with staged(out.parent) as stage:
        write_board(stage.path(out.name), page, wall_pages=wall_pages)
    if not quiet:
        typer.echo(f"Wrote {out}: {page.caption}")


def millimetres(text: str) -> float:
    """Read a length such as 30mm, 3cm or 30 (mm)."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(mm|cm)?\s*", text)
    if not match:
        raise InputError(f"{text!r} is not a length: write it like 30mm or 3cm")
    return float(match[1]) * (10 if match[2] == "cm" else 1)

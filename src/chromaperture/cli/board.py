"""``chromaperture board``: a chessboard to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from chromaperture.cli.options import Quiet, inner_corners


def board(
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write, .pdf or .svg.")],
    board: Annotated[str, typer.Option(help="Inner corners along the long and the short side.")] = "9x6",
    square_mm: Annotated[
        float | None, typer.Option(help="Side of a square, mm; default 30 on A3, 22 on A4 and Letter.")
    ] = None,
    paper: Annotated[str, typer.Option(help="a3, a4 or letter; landscape.")] = "a3",
    wall_pages: Annotated[
        int | None,
        typer.Option(help="Pages of speckle for the wall around the board; default 4, in a .svg none.", min=0),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write a chessboard of true size, in speckle that helps the matcher.

    chromaperture board --out board.pdf

    chromaperture board --out board.pdf --paper a4      (squares of 22 mm)
    """
    from chromaperture.optics.printing.board_pattern import board_page, write_board
    from chromaperture.system.storage import staged

    columns, rows = inner_corners(board)
    page = board_page(columns=columns, rows=rows, square_mm=square_mm, paper=paper)
    with staged(out.parent) as stage:
        default = 0 if out.suffix.lower() == ".svg" else 4
        write_board(stage.path(out.name), page, wall_pages=default if wall_pages is None else wall_pages)
    if not quiet:
        typer.echo(f"Wrote {out}: {page.caption}")

"""``chromaperture check``: one photograph against the calibration."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Annotated

import typer

from chromaperture.cli.options import BlackLevel, Camera, Json, Quiet, WhiteLevel
from chromaperture.errors import CaptureWarning, InputError

_STYLES = {"ok": "green", "warn": "bold red", "cannot tell": "dim"}


def check(
    photo: Annotated[Path, typer.Argument(help="Photograph, best of the chessboard.", metavar="PHOTO")],
    camera: Camera,
    board: Annotated[str, typer.Option(help="Inner corners of the chessboard.")] = "9x6",
    square: Annotated[
        str | None, typer.Option(help="Side of its squares, such as 30mm; without it no board is searched.")
    ] = None,
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check whether focus, aperture and filter are still as calibrated. Exit code 0: yes; 1: a check warns.

    chromaperture check board.png --camera camera.asdf --square 30mm
    """
    from dataclasses import asdict

    from rich.markup import escape

    from chromaperture.camera import load_camera
    from chromaperture.capture.exif import read_exif
    from chromaperture.cli.board import millimetres
    from chromaperture.cli.console import out as console
    from chromaperture.cli.console import print_json, table
    from chromaperture.evaluation.health import Board, Check, check_camera, is_healthy
    from chromaperture.products.measure_file import read_capture

    corners = re.fullmatch(r"\s*(\d+)\s*[x×]\s*(\d+)\s*", board)
    if not corners or min(int(corners[1]), int(corners[2])) < 3:
        raise InputError(f"--board {board!r} is not understood: give the inner corners, such as 9x6")
    size = (int(corners[1]), int(corners[2]))
    target = Board(size, millimetres(square)) if square else None
    eye = load_camera(camera)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CaptureWarning)
        image = read_capture(photo, eye, black_level=black_level, white_level=white_level)
    file_checks = [
        Check("file", "warn", str(w.message), "give the original file: 16 bit, or 4:4:4")
        for w in caught
        if issubclass(w.category, CaptureWarning)
    ] or [Check("file", "ok", "no loss of colour resolution or levels was found")]
    checks = file_checks + check_camera(image, eye.calibration, board=target, exif=read_exif(photo))
    if json:
        print_json({"photo": photo.name, "ok": is_healthy(checks), "checks": [asdict(c) for c in checks]})
    elif not quiet:
        rows = table(f"{photo.name} against {camera.name}", "test", "verdict", "found", "what to do", left=4)
        for c in checks:
            verdict = f"[{_STYLES[c.verdict]}]{c.verdict}[/]"
            rows.add_row(c.name, verdict, escape(c.finding), escape(c.advice))
        console.print(rows)
    if not is_healthy(checks):
        raise typer.Exit(1)

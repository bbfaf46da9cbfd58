"""``chromaperture check``: one photograph against the calibration."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from chromaperture.cli.console import out as console
from chromaperture.cli.console import print_json, table
from chromaperture.cli.options import (
    BlackLevel,
    Camera,
    ChromaSiting,
    Json,
    Left,
    Mosaic,
    Primaries,
    Quiet,
    Right,
    WhiteLevel,
    inner_corners,
    left_of_pair,
)
from chromaperture.system.errors import CaptureWarning, InputError

if TYPE_CHECKING:
    from chromaperture.evaluation.checks import Check

_STYLES = {"ok": "green", "warn": "bold red", "cannot tell": "dim"}


def check(
    camera: Camera,
    photo: Annotated[
        Path | None,
        typer.Argument(help="Photograph, best of the chessboard; with --coloured of a neutral print.", metavar="PHOTO"),
    ] = None,
    coloured: Annotated[
        Path | None,
        typer.Option(
            help="Of a coloured print at the same place and distance: check where the chroma of such files lies.",
            metavar="PHOTO",
        ),
    ] = None,
    board: Annotated[
        str | None, typer.Option(help="Inner corners of the chessboard, such as 9x6; default the calibration's.")
    ] = None,
    square_mm: Annotated[float | None, typer.Option(help="Side of its squares, mm; default the calibration's.")] = None,
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    mosaic: Mosaic = None,
    siting: ChromaSiting = None,
    primaries: Primaries = None,
    left: Left = None,
    right: Right = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check whether focus, aperture and filter are still as calibrated.

    Exit code 0: as calibrated; 1: changed; 2: it cannot tell, because no board was found or the input cannot be used.

    chromaperture check board.png --camera camera.asdf

    chromaperture check neutral.jpg --coloured orange.jpg --camera camera.asdf
    """
    from chromaperture.camera.camera import CodedApertureCamera
    from chromaperture.capture.exif import other_colours, read_exif
    from chromaperture.cli.setup import stated_facts, with_stated
    from chromaperture.evaluation.checks import Check
    from chromaperture.evaluation.health import check_camera, outcome
    from chromaperture.model.camera_file import Calibration
    from chromaperture.model.camera_parts import Board

    if left or right:
        photo = left_of_pair(left, right, [photo])
    if photo is None:
        raise InputError("give a photograph, or --left and --right of a dual-pixel camera")
    calibration = with_stated(Calibration.load(camera), stated_facts(siting, primaries, mosaic))
    if coloured is not None and calibration.sensor.dual_pixel is not None:
        raise InputError("--coloured is for film: the halves of a dual-pixel sensor have one colour")
    if coloured is not None:
        from chromaperture.evaluation.chroma_siting import check_siting

        found = check_siting(photo, coloured, calibration)
        code = {"ok": 0, "warn": 1, "cannot tell": 2}[found.verdict]
        read = ("Chroma is read right.", "Chroma is read wrong.", "Cannot tell where the chroma of the files lies.")
        names = {"photo": photo.name, "coloured": coloured.name}
        _tell(names, camera.name, [found], code, read[code], json=json, quiet=quiet)
        return
    eye = CodedApertureCamera(calibration)
    known = eye.calibration.board
    size = inner_corners(board) if board else known.inner_corners if known else (9, 6)
    side_mm = square_mm if square_mm is not None else known.square_mm if known else None
    if side_mm is not None and not side_mm > 0:
        raise InputError(f"--square-mm must be positive, got {side_mm:g}")
    target = None if side_mm is None else Board(size, side_mm)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CaptureWarning)
        taken = eye.photograph(photo, right=right, black_level=black_level, white_level=white_level)
    height, width = taken.image.shape[:2]
    if eye.shows_frame_at((width, height)):
        eye = eye.at_size(width, height)
    file_checks = [
        Check("file", "warn", str(w.message), "give the original file, of 16 bit")
        for w in caught
        if issubclass(w.category, CaptureWarning)
    ]
    if taken.form is not None:
        file_checks.insert(0, Check("kind", "ok", str(taken.form)))
    differs = other_colours(photo, eye.calibration.provenance)
    if differs:
        finding, _, advice = differs.partition("; ")
        file_checks.append(Check("colours", "warn", finding, advice))
    checks = file_checks + check_camera(taken.image, eye.calibration, board=target, exif=read_exif(photo))
    code = outcome(checks)
    verdict = (
        "As calibrated.",
        "Changed since the calibration, or not a photograph of this camera: see the tests that warn.",
        "Cannot tell: focus, iris and filter orientation were not checked, because no board was measured.",
    )[code]
    _tell({"photo": photo.name}, camera.name, checks, code, verdict, json=json, quiet=quiet)


def _tell(
    names: dict[str, str], camera: str, checks: list[Check], code: int, verdict: str, *, json: bool, quiet: bool
) -> None:
    """Print what was found, and end with the exit code."""
    from dataclasses import asdict

    if json:
        print_json(
            names
            | {"ok": all(c.verdict != "warn" for c in checks), "exit_code": code, "verdict": verdict}
            | {"checks": [asdict(c) for c in checks]}
        )
    elif not quiet:
        rows = table(f"{', '.join(names.values())} against {camera}", "test", "verdict", "found", "what to do", left=4)
        for c in checks:
            rows.add_row(c.name, f"[{_STYLES[c.verdict]}]{c.verdict}[/]", escape(c.finding), escape(c.advice))
        console.print(rows)
        console.print(verdict)
    if code:
        raise typer.Exit(code)

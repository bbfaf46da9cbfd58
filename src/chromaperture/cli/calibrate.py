"""``chromaperture calibrate``."""

from __future__ import annotations

import shlex
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from chromaperture.cli.console import after_compilation, print_files, print_json, progress, say_warning, table
from chromaperture.cli.console import out as console
from chromaperture.cli.options import Json, Quiet, check_output
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    from chromaperture.calibration.calibrate_session import CalibrationResult
    from chromaperture.calibration.session import Session


def calibrate(
    session: Annotated[
        Path, typer.Argument(help="Folder with session.toml, distances.csv, board/, tilt/.", metavar="SESSION_DIR")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Camera file to write.", metavar="CAMERA.asdf")],
    lens_from: Annotated[
        Path | None, typer.Option(help="Camera file of the same lens and focus, where tilts or boards are few.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="HTML report to write; default beside the camera file.", metavar="FILE")
    ] = None,
    no_blur: Annotated[
        bool, typer.Option("--no-blur", help="Leave out the lens's blur: faster, quality accurate is less so.")
    ] = False,
    per_pixel: Annotated[
        bool, typer.Option("--per-pixel", help="Curves free at every image position, for a dozen boards or more.")
    ] = False,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no report.")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate a camera from a folder of photographs.

    chromaperture calibrate my_session --out camera.asdf

    A report with pictures is written beside it, camera.report.html.

    For it three boards are measured at quality accurate: about 24 s at the most.

    Exit code 1: the camera cannot be used.

    docs/calibration-session.md shows how the folder is laid out.
    """
    from chromaperture.calibration.calibrate_session import calibrate_session
    from chromaperture.calibration.options import CalibrationConfig
    from chromaperture.calibration.session import read_session
    from chromaperture.evaluation.verdict import unusable, with_accurate_noise
    from chromaperture.model.camera_file import Calibration
    from chromaperture.system.storage import staged

    check_output(out, ".asdf", inputs=[lens_from])
    known_session = read_session(session) if (session / "session.toml").is_file() else None
    if known_session is not None and not known_session.square_mm:
        if lens_from or report or no_blur or per_pixel:
            raise InputError("flat boards take no --lens-from, --report, --no-blur or --per-pixel: leave these out")
        _calibrate_flat(known_session, out, json=json, quiet=quiet)
        return
    page = report or out.with_suffix(".report.html")
    if not no_report:
        check_output(page, ".html", inputs=[out], option="--report")
    for path in [out] if no_report else [out, page]:
        with staged(path.parent):  # fails now and not after minutes of work
            pass
    known = Calibration.load(lens_from) if lens_from else None
    kept = out.parent / f".{out.stem}.calibrating"  # measurements of an interrupted run
    with progress(quiet=quiet) as update:
        result = calibrate_session(
            session,
            CalibrationConfig(lens_blur=not no_blur, per_pixel=per_pixel),
            lens_from=known,
            command=shlex.join(["chromaperture", *sys.argv[1:]]),
            progress=after_compilation(update, "paper", "real-time", "accurate", quiet=quiet),
            keep_in=kept,
        )
        if not no_report:
            result = with_accurate_noise(result, progress=update)
    files = [out]
    if not no_report:  # first: a picture that cannot be read leaves no camera file without its report
        from chromaperture.evaluation.report import write_report

        files.append(page)
        write_report(page, result)
    result.camera.save(out)
    shutil.rmtree(kept, ignore_errors=True)
    faults = unusable(result)
    if json:
        print_json(result.camera.summary() | {"unusable_because": faults})
    elif not quiet:
        _print_result(result, faults)
        print_files(files)
    else:
        for sentence in result.outliers.values():
            say_warning(sentence)
    if faults:
        if json or quiet:
            say_warning(f"this calibration cannot be used: {'; '.join(faults)}")
        raise typer.Exit(1)


def _calibrate_flat(session: Session, out: Path, *, json: bool, quiet: bool) -> None:
    """Calibrate a dual-pixel camera by flat boards."""
    from chromaperture.calibration.flat_boards import calibrate_flat_boards

    with progress(quiet=quiet) as update:
        result = calibrate_flat_boards(
            session,
            command=shlex.join(["chromaperture", *sys.argv[1:]]),
            progress=after_compilation(update, "paper", "real-time", "accurate", quiet=quiet),
        )
    result.camera.save(out)
    if json:
        print_json(result.camera.summary())
    elif not quiet:
        console.print(result.camera.title + f", in focus at {result.camera.in_focus_text}", markup=False)
        for note in result.notes:
            console.print(f"note: {note}", markup=False)
        print_files([out])


def _print_result(result: CalibrationResult, faults: list[str]) -> None:
    import numpy as np

    from chromaperture.evaluation.verdict import QUALITY, board_errors, sentences

    def number(value: float, form: str) -> str:
        return format(value, form) if np.isfinite(value) else "-"

    heads = ("photograph", "ruler [mm]", "disparity [px]", "middle [mm]", "frame [mm]", "frame [%]")
    boards = table(f"Boards at quality {QUALITY}: measured - ruler", *heads, left=0)
    middle, frame = result.fits[QUALITY].residual_mm, board_errors(result)
    for i, board in enumerate(result.boards):
        boards.add_row(
            board.name,
            f"{board.ruler_mm:.0f}",
            number(board.disparity_px[QUALITY], "+.3f"),
            number(middle[i], "+.1f"),
            number(frame[i], "+.1f"),
            number(100 * frame[i] / board.ruler_mm, "+.2f"),
        )
    console.print(boards)
    cal = result.camera
    console.print(
        f"focal length {cal.lens.focal_length_mm:.2f} mm, in focus at {cal.in_focus_text}, "
        f"baseline {cal.baseline_mm:.2f} mm, rms {result.fits[QUALITY].rms_mm:.1f} mm in the middle of the frame"
    )
    for note in result.notes:
        console.print(f"note: {note}", markup=False)
    for sentence in sentences(result):
        console.print(sentence.text, style={"good": "green", "weak": "yellow"}.get(sentence.tone, ""), markup=False)
    if faults:
        console.print(f"This calibration cannot be used: {'; '.join(faults)}.", style="bold red", markup=False)

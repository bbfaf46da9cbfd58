"""``chromaperture session new``: the folder of a calibration session before its first photograph."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from chromaperture.cli.options import (
    BOARDS_PANEL,
    CAMERA_PANEL,
    Command,
    Commands,
    FarthestMm,
    Mosaic,
    NearestMm,
    Quiet,
    inner_corners,
)
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    from chromaperture.color.encoding import StatedFacts

app = typer.Typer(cls=Commands, help="Prepare a calibration session.", no_args_is_help=True)


@app.callback()
def _session() -> None:
    """Prepare a calibration session."""


@app.command(cls=Command)
def new(
    folder: Annotated[
        Path, typer.Argument(help="Folder of the session; made where it does not exist.", metavar="FOLDER")
    ],
    design: Annotated[str, typer.Option(help="Design of the aperture.", rich_help_panel=CAMERA_PANEL)] = "cy_halves",
    focus_mm: Annotated[
        float,
        typer.Option(help="Focus distance from the sensor, mm, roughly; inf allowed.", rich_help_panel=CAMERA_PANEL),
    ] = 2000.0,
    sensor_width_mm: Annotated[
        float | None, typer.Option(help="Width of the sensor, mm, from the data sheet.", rich_help_panel=CAMERA_PANEL)
    ] = None,
    photo: Annotated[
        Path | None,
        typer.Option(help="Any photograph of this camera: its format, size, lens.", rich_help_panel=CAMERA_PANEL),
    ] = None,
    mosaic: Mosaic = None,
    nearest_mm: NearestMm = 1000.0,
    farthest_mm: FarthestMm = 4000.0,
    distances: Annotated[
        int, typer.Option(help="How many distances, even in disparity.", rich_help_panel=BOARDS_PANEL)
    ] = 12,
    tilts: Annotated[int, typer.Option(help="Tilted board views.", rich_help_panel=BOARDS_PANEL)] = 12,
    board: Annotated[
        str, typer.Option(help="Inner corners along the long and the short side.", rich_help_panel=BOARDS_PANEL)
    ] = "9x6",
    square_mm: Annotated[float, typer.Option(help="Side of a square, mm.", rich_help_panel=BOARDS_PANEL)] = 30.0,
    quiet: Quiet = False,
) -> None:
    """Write session.toml, distances.csv, the list of shots and the folders of a calibration session.

    Nothing is overwritten: a folder that holds one of these files already is refused.

    chromaperture session new my_session --photo photo.png --sensor-width-mm 22.3
    """
    from chromaperture.calibration.session_plan import FOLDERS, PlannedSession, plan_files
    from chromaperture.cli.setup import stated_facts
    from chromaperture.optics.aperture import design_named
    from chromaperture.system.storage import staged

    stated = stated_facts(None, None, mosaic)
    plan = PlannedSession(
        design=design_named(design).name,
        nearest_mm=nearest_mm,
        farthest_mm=farthest_mm,
        focus_mm=focus_mm,
        distances=distances,
        tilts=tilts,
        inner_corners=inner_corners(board),
        square_mm=square_mm,
        sensor_width_mm=sensor_width_mm,
        mosaic=mosaic,
        **({} if photo is None else _facts(photo, stated)),
    )
    files = plan_files(plan)
    for name in files:
        if (folder / name).exists():
            raise InputError(f"{folder / name} exists already, and is not overwritten; choose another folder")
    with staged(folder) as stage:
        for name, text in files.items():
            stage.path(name).write_text(text, encoding="utf-8")
        for name in FOLDERS:
            (folder / name).mkdir(exist_ok=True)
    if not quiet:
        unknown = files["session.toml"].count('= "?"')
        typer.echo(f"Wrote {folder}: {', '.join(files)} and the folders {', '.join(f'{name}/' for name in FOLDERS)}")
        if unknown:
            typer.echo(f'Replace {unknown} "?" in {folder / "session.toml"}; then photograph what shots.md lists')
        else:
            typer.echo(f"Photograph what {folder / 'shots.md'} lists")


def _facts(photo: Path, stated: StatedFacts) -> dict[str, Any]:
    """Read from a photograph what the plan keeps of it."""
    from chromaperture.capture.exif import read_exif
    from chromaperture.capture.files import decode

    decoded = decode(photo, stated=stated)
    height, width = decoded.array.shape[:2]
    exif = read_exif(photo)
    facts: dict[str, Any] = {
        "suffix": photo.suffix,
        "size_px": (width, height),
        "focal_length_mm": exif.focal_length_mm,
        "f_number": exif.f_number,
    }
    if decoded.sensor_levels is not None:
        facts |= dict(zip(("black_level", "white_level"), decoded.sensor_levels, strict=True))
    return facts

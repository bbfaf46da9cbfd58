"""``chromaperture depth``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def depth(
    images: Annotated[
        list[Path], typer.Argument(help="Photographs through the colour-coded aperture.", metavar="IMAGE...")
    ],
    camera: Annotated[
        Path | None,
        typer.Option("--camera", "-c", help="Camera file from 'chromaperture calibrate'.", metavar="CAMERA.asdf"),
    ] = None,
    design: Annotated[
        str | None, typer.Option(help="Without a camera file: name of the aperture design. Gives disparity only.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the results; default beside the image.")
    ] = None,
    quality: Annotated[str, typer.Option(help="paper, real-time or accurate.")] = "real-time",
    black_level: Annotated[float | None, typer.Option(help="Counts of no light; default the camera file's.")] = None,
    white_level: Annotated[float | None, typer.Option(help="Counts of a full well; default the camera file's.")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file with [matcher] and [depth] settings.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
) -> None:
    """Measure depth in millimetres for every pixel of one or more photographs.

    chromaperture depth photo.png --camera camera.asdf --out results

    chromaperture depth photo.jpg --design rgb_squares        (no calibration: disparity in px)
    """
    from chromaperture.cli.console import (
        announce_compilation,
        print_files,
        print_json,
        progress,
        report_table,
        say_error,
    )
    from chromaperture.cli.console import out as console
    from chromaperture.cli.setup import camera_for
    from chromaperture.errors import ChromapertureError, InputError
    from chromaperture.products.measure_file import measure_file

    if len({(out or image.parent, image.stem) for image in images}) < len(images):
        raise InputError("two images would write the same files; measure them into different --out folders")
    announce_compilation(quiet=quiet or json)
    reports, failed = [], 0
    with progress(quiet=quiet or json) as update:
        for i, image in enumerate(images):
            try:
                eye = camera_for(image, camera, design, quality=quality, config=config)
                reports.append(
                    measure_file(
                        image,
                        eye,
                        out=out,
                        black_level=black_level,
                        white_level=white_level,
                        listener=lambda name, i=i, image=image: update(f"{image.name}: {name}", i, len(images)),  # type: ignore[misc]
                    )
                )
            except ChromapertureError as error:
                say_error(error)
                failed += 1
    if json:
        print_json([report.summary for report in reports])
    elif reports and not quiet:
        console.print(report_table(reports))
        if camera is None:
            console.print("No calibration: disparity in px only. Depth in mm needs a camera file (--camera).")
        print_files([file for report in reports for file in report.files])
    if failed:
        raise typer.Exit(2)

"""``chromaperture demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from chromaperture.cli.options import Json, Quiet


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")] = Path("chromaperture-demo"),
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure the captures that come with the package and write their depth maps."""
    from rich.markup import escape

    from chromaperture.camera import load_camera
    from chromaperture.cli.console import announce_compilation, announce_duration, print_json, print_reports, progress
    from chromaperture.cli.console import out as console
    from chromaperture.products.measure_file import measure_file
    from chromaperture.products.samples import SAMPLES, sample_camera, sample_image

    announce_compilation(quiet=quiet)
    reports = []
    with progress(quiet=quiet) as update:
        for i, name in enumerate(SAMPLES):

            def show(stage: str, i: int = i, name: str = name) -> None:
                update(f"{name}: {stage}", i, len(SAMPLES))

            camera = load_camera(sample_camera(name), quality="accurate")
            announce_duration(camera, len(SAMPLES) if i == 0 else 0, quiet=quiet)
            reports.append(measure_file(sample_image(name), camera, out=out, listener=show))
    if json:
        print_json([report.summary for report in reports])
    elif not quiet:
        print_reports(reports)
        first = next(f for f in reports[0].files if f.name.endswith(".preview.png"))
        console.print(f"Look at [bold]{escape(str(first))}[/]", soft_wrap=True)

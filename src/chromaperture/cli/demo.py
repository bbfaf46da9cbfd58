"""``chromaperture demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")] = Path("chromaperture-demo"),
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
) -> None:
    """Measure the captures that come with the package and show what a depth camera gives."""
    from rich.markup import escape

    from chromaperture.camera import load_camera
    from chromaperture.cli.console import announce_compilation, print_files, print_json, progress, report_table
    from chromaperture.cli.console import out as console
    from chromaperture.products.measure_file import measure_file
    from chromaperture.products.samples import SAMPLES, sample_camera, sample_image

    announce_compilation(quiet=quiet or json)
    reports = []
    with progress(quiet=quiet or json) as update:
        for i, name in enumerate(SAMPLES):
            reports.append(
                measure_file(
                    sample_image(name),
                    load_camera(sample_camera(name), quality="accurate"),
                    out=out,
                    listener=lambda stage, i=i, name=name: update(f"{name}: {stage}", i, len(SAMPLES)),  # type: ignore[misc]
                )
            )
    if json:
        print_json([report.summary for report in reports])
    elif not quiet:
        console.print(report_table(reports))
        print_files([file for report in reports for file in report.files])
        first = next(f for f in reports[0].files if f.name.endswith(".preview.png"))
        console.print(f"Look at [bold]{escape(str(first))}[/]", soft_wrap=True)

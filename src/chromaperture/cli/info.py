"""``chromaperture info``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def info(
    camera: Annotated[Path, typer.Argument(help="Camera file.", metavar="CAMERA.asdf")],
    json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only check that the file can be read.")] = False,
) -> None:
    """Show what a camera file says: lens, focus, baseline, aperture, how it was calibrated."""
    from rich.markup import escape
    from rich.table import Table

    from chromaperture.camera_file import Calibration
    from chromaperture.cli.console import out, print_json

    summary = Calibration.load(camera).summary()
    if json:
        print_json(summary)
    elif not quiet:
        provenance = summary.pop("provenance")
        table = Table(title=escape(str(camera)), show_header=False)
        for name, value in {**summary, **provenance}.items():
            if name not in ("boards", "files"):
                table.add_row(name, escape(f"{value:.6g}" if isinstance(value, float) else str(value)))
        out.print(table)

"""``chromaperture info``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from chromaperture.cli.options import Json, Quiet


def info(
    camera: Annotated[Path, typer.Argument(help="Camera file.", metavar="CAMERA.asdf")],
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show the content of a camera file: lens, focus, baseline, aperture, how it was calibrated."""
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

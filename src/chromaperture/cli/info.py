"""``chromaperture info``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from chromaperture.cli.options import Json, Quiet

_LEFT_OUT = ("boards", "files")  # of the provenance: long lists, which --json prints


def info(
    camera: Annotated[Path, typer.Argument(help="Camera file.", metavar="CAMERA.asdf")],
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show the content of a camera file: lens, focus, baseline, aperture, how it was calibrated."""
    from rich.markup import escape

    from chromaperture.camera_file import Calibration
    from chromaperture.cli.console import out, print_json, table

    summary = Calibration.load(camera).summary()
    if json:
        print_json(summary)
    elif not quiet:
        figures = {**summary, **summary.pop("provenance")}
        rows = table(str(camera), "figure", "value", left=2)
        for name, value in figures.items():
            if name not in _LEFT_OUT and name != "provenance":
                rows.add_row(name, escape(as_text(value)))
        out.print(rows)
        out.print("Boards and hashes of all files: --json", markup=False)


def as_text(value: Any) -> str:
    """Format a value for people: one line an entry of a list or a mapping, "-" for what is unknown or empty."""
    if isinstance(value, dict):
        return "\n".join(f"{name}: {' '.join(as_text(v).splitlines())}" for name, v in value.items()) or "-"
    if isinstance(value, list | tuple):
        entries = [as_text(v) for v in value]
        return ("\n" if any(isinstance(v, str | dict | list | tuple) for v in value) else ", ").join(entries) or "-"
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)

"""``chromaperture view``."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from chromaperture.cli.options import Quality, Quiet, Seconds, check_output

if TYPE_CHECKING:
    from chromaperture.files.map_page import Page


def view(
    file: Annotated[
        Path, typer.Argument(help="Any file that 'depth' wrote, a map (TIFF, PNG, .npy), a PLY, or a camera file.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write the page here, one file to keep or send; serve nothing.")
    ] = None,
    quality: Quality = "real-time",
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; the next free one is taken.")] = 8080,
    seconds: Seconds = None,
    quiet: Quiet = False,
) -> None:
    """Show a result in the browser: maps with the values under the cursor, colour, points.

    chromaperture view results/photo.depth.tiff

    chromaperture view camera.asdf --out camera.html
    """
    from chromaperture.app.listening import PageServer
    from chromaperture.files.map_page import render
    from chromaperture.system.storage import staged

    if out is not None:
        check_output(out, ".html", inputs=[file])
    text = render(page_of(file, quality))
    if out is not None:
        with staged(out.parent) as stage:
            stage.path(out.name).write_text(text, encoding="utf-8")
        if not quiet:
            typer.echo(f"Wrote {out}")
        return
    end = time.monotonic() + (math.inf if seconds is None else seconds)
    with PageServer(text, port=port) as server:
        # With --quiet too: without its token nobody can open the page.
        typer.echo(f"Look at this address; Ctrl-C ends it:\n\n    {server.url}\n", err=quiet)
        try:
            while time.monotonic() < end:
                time.sleep(min(0.5, max(0.0, end - time.monotonic())))
        except KeyboardInterrupt:
            pass  # the usual way to stop


def page_of(file: Path, quality: str) -> Page:
    """Return the page of a result or a camera; raises InputError where the file is neither."""
    from chromaperture.app.result_page import camera_page, result_page
    from chromaperture.model.camera_file import Calibration
    from chromaperture.products.result_files import read_result

    if file.suffix == ".asdf":
        return camera_page(Calibration.load(file), file.name, quality=quality)
    return result_page(read_result(file))

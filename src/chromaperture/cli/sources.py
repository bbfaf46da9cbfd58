"""``chromaperture sources``."""

from __future__ import annotations

import typer

from chromaperture.cli.console import print_json
from chromaperture.cli.options import Json


def sources(json: Json = False) -> None:
    """List the cameras that are connected, and which extra is missing for the others."""
    from dataclasses import asdict

    from chromaperture.capture.open import connected_sources

    kinds = connected_sources()
    if json:
        print_json([asdict(kind) for kind in kinds])
        return
    for kind in kinds:
        for spec in kind.specs:
            typer.echo(spec)
        if kind.note:
            typer.echo(f"{kind.kind}: {kind.note}")
    typer.echo("always: a folder, a 'glob', a picture, a video, replay:FOLDER, simulate:FOLDER")

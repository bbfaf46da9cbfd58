"""``chromaperture``: depth in millimetres from one photograph through a colour-coded aperture."""

from __future__ import annotations

import importlib
import sys
import warnings
from typing import Annotated

import typer

from chromaperture import __version__
from chromaperture.cli.console import say_error, show_warning
from chromaperture.cli.simulate import simulate_rgbd
from chromaperture.errors import CaptureWarning, ChromapertureError

app = typer.Typer(
    help=__doc__,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_COMMANDS = (
    "demo", "depth", "calibrate", "info", "check", "board", "apertures", "refocus", "transparency", "simulate",
    "sources", "record", "export", "evaluate", "reconstruct", "live",
)  # fmt: skip
for name in _COMMANDS:  # each is a function in a module of its own name
    app.command()(getattr(importlib.import_module(f"chromaperture.cli.{name}"), name))
app.command("simulate-rgbd")(simulate_rgbd)


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"chromaperture {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Declare the options before the subcommand."""


def main() -> None:
    """Run the command line; invalid input is one line on standard error and exit code 2."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", CaptureWarning)
            warnings.showwarning = show_warning
            app()
    except ChromapertureError as error:
        say_error(error)
        sys.exit(2)
    except KeyboardInterrupt:
        say_error("interrupted; nothing half-written was left behind")
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(141)  # the reader of our output has gone, as after "| head"

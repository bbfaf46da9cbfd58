"""``chromaperture``: depth in millimetres from one photograph through a colour-coded aperture."""

from __future__ import annotations

import contextlib
import errno
import importlib
import sys
import warnings
from typing import Annotated

import typer

from chromaperture import __version__
from chromaperture.cli import new_session
from chromaperture.cli.console import forget_warnings, say_error, show_warning
from chromaperture.cli.simulate import simulate_rgbd
from chromaperture.errors import CaptureWarning, ChromapertureError

app = typer.Typer(
    help="Depth in millimetres from one photograph through a colour-coded aperture.",
    no_args_is_help=True,
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
app.add_typer(new_session.app, name="session")


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
            forget_warnings()
            try:
                app(prog_name="chromaperture")
            finally:
                sys.stdout.flush()  # here, where a full device is reported
    except ChromapertureError as error:
        say_error(error)
        sys.exit(2)
    except KeyboardInterrupt:
        say_error("interrupted; nothing half-written was left behind")
        sys.exit(130)
    except BrokenPipeError:
        _drop_output()
        sys.exit(141)  # the reader of our output has gone, as after "| head"
    except OSError as error:
        if error.errno == errno.ENOSPC:
            say_error("the disk is full: the output could not be written; free some space and repeat")
            _drop_output()
        elif error.filename is not None:
            say_error(f"cannot use {error.filename} ({error.strerror}); choose another name")
        else:
            raise
        sys.exit(2)


def _drop_output() -> None:
    """Discard what cannot be printed: Python would report it again at exit."""
    with contextlib.suppress(OSError):
        sys.stdout.close()

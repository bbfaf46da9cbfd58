"""``chromaperture``: depth in millimetres from one photograph through a colour-coded aperture."""

from __future__ import annotations

import contextlib
import errno
import importlib
import signal
import sys
import warnings
from importlib.metadata import entry_points
from typing import Annotated, NoReturn

import typer

from chromaperture import __version__
from chromaperture.cli import new_session
from chromaperture.cli.console import forget_warnings, say_error, show_warning
from chromaperture.cli.options import Command, Commands
from chromaperture.cli.simulate import simulate_rgbd
from chromaperture.cli.terminal import stop_on_signals
from chromaperture.system.errors import FREE_MEMORY, CaptureWarning, ChromapertureError, lacks_memory

app = typer.Typer(
    cls=Commands,
    help="Depth in millimetres from one photograph through a colour-coded aperture.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_COMMANDS = (
    "demo", "depth", "calibrate", "info", "check", "board", "apertures", "films", "refocus", "transparency", "simulate",
    "sources", "record", "export", "reconstruct", "live", "serve", "view", "compare",
)  # fmt: skip
for name in _COMMANDS:  # each is a function in a module of its own name
    app.command(cls=Command)(getattr(importlib.import_module(f"chromaperture.cli.{name}"), name))
for entry in entry_points(group="chromaperture.commands"):  # of packages beside this one
    app.command(entry.name, cls=Command)(entry.load())
app.command("simulate-rgbd", cls=Command)(simulate_rgbd)
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
    """Run the command line; whatever fails is one line and 2, Ctrl-C 130, SIGTERM 143, a closed pipe 141."""
    with stop_on_signals() as stop:
        try:
            _run()
        except ChromapertureError as error:
            _end(2, str(error))
        except (KeyboardInterrupt, Exception) as error:
            if stop.signal is not None or isinstance(error, KeyboardInterrupt):  # a library may raise another error
                _end(stop.code, _STOPPED[stop.code])
            if isinstance(error, BrokenPipeError):
                _end(141)  # as after "| head"
            reason = _reason(error)
            if reason is None:
                raise
            _end(2, reason)
        if stop.signal == signal.SIGTERM:  # commands that end well by Ctrl-C, such as `record`, do so by SIGTERM
            _end(stop.code)


_STOPPED = {130: "interrupted; no file was left half-written", 143: "ended by SIGTERM; no file was left half-written"}


def _run() -> None:
    """Run the command; the library for the command line exits by itself where a signal or a pipe ends it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", CaptureWarning)
            warnings.showwarning = show_warning
            forget_warnings()
            try:
                app(prog_name="chromaperture")
            finally:
                sys.stdout.flush()  # here, where a full device is reported
    except SystemExit as end:
        if end.code == 0:
            return
        reason = end.__cause__ or end.__context__
        while reason is not None:
            if isinstance(reason, KeyboardInterrupt | BrokenPipeError):
                raise reason from None
            reason = reason.__cause__ or reason.__context__
        raise


def _reason(error: BaseException) -> str | None:
    """Say in one sentence what the machine cannot do; None for what is a fault of the program."""
    if lacks_memory(error):
        detail = " ".join(str(error).split())[:200]  # characters
        return f"not enough memory{f' ({detail})' if detail else ''}; {FREE_MEMORY}"
    if not isinstance(error, OSError):
        return None
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return "the disk is full: the output could not be written; free some space and repeat"
    if error.filename is not None:
        return f"cannot use {error.filename} ({error.strerror}); choose another name"
    return f"the system reports: {error.strerror or error}; mend this and repeat"


def _end(code: int, message: str = "") -> NoReturn:
    """Exit; Python would report again at its end what cannot be printed."""
    if message:
        say_error(message)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            with contextlib.suppress(OSError):
                stream.close()
    sys.exit(code)

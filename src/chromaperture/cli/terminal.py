"""The process around the command line: where it prints to, and how it is told to stop."""

from __future__ import annotations

import codecs
import contextlib
import io
import os
import signal
import sys
from collections.abc import Iterator
from types import FrameType

# Signs of our output beyond ASCII, and what stands for them where they cannot be shown; others become "?".
_PLAIN = {"±": "+-", "×": "x", "µ": "u", "σ": "sigma", "°": " deg", "…": "...", "–": "-", "—": "-", "→": "->", "−": "-"}
_ERRORS = "chromaperture"  # name of the error handler of codecs


def prepare_output() -> None:
    """Let everything be printed: to a closed stream nowhere, to one of few letters with others in their place."""
    codecs.register_error(_ERRORS, _plainly)
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the caller; its number must not become that of an output file
            stream = open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8")  # noqa: SIM115
            setattr(sys, name, stream)
        elif name != "stdin" and isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors=_ERRORS)


def _plainly(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_PLAIN.get(sign, "?") for sign in error.object[error.start : error.end]), error.end


class Stop:
    """Which signal asked the process to end; None before."""

    def __init__(self) -> None:
        self.signal: int | None = None

    @property
    def code(self) -> int:
        """Exit code of a process that a signal ended, by the shell's rule; without a signal that of Ctrl-C."""
        return 128 + (self.signal or signal.SIGINT)


@contextlib.contextmanager
def stop_on_signals() -> Iterator[Stop]:
    """Raise KeyboardInterrupt on SIGTERM as on Ctrl-C, and keep which it was; nothing in other threads."""
    stop = Stop()

    def handle(number: int, frame: FrameType | None) -> None:
        stop.signal = number
        if number == signal.SIGTERM:
            signal.signal(number, signal.SIG_IGN)  # a second one would interrupt the cleaning up
        raise KeyboardInterrupt

    before = {}
    # A process started in the background by a shell script ignores Ctrl-C, and goes on to do so.
    for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGTERM, signal.SIG_DFL)):
        with contextlib.suppress(ValueError):
            if signal.getsignal(number) == usual:
                before[number] = signal.signal(number, handle)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def leave_at_once(number: int, frame: FrameType | None) -> None:
    """End the process while modules are imported: there is nothing to clean up, and a module may take any exception."""
    with contextlib.suppress(OSError):
        os.write(2, b"error: interrupted; nothing was begun\n")
    os._exit(128 + number)

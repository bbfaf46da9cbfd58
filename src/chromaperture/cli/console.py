"""Print for all subcommands: results on standard output, progress, warnings and errors on standard error."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from chromaperture.system.errors import CaptureWarning

if TYPE_CHECKING:
    from chromaperture.camera.camera import CodedApertureCamera
    from chromaperture.products.measure_file import Written

Update = Callable[[str, int, int], None]  # what is being done, how many are done, of how many; 0: nobody knows

FINISHED = "photographs done"  # how a step begins of which several parts are worked on at a time
LINE_EVERY_S = 2.0  # between two lines of progress, where there is no terminal; chosen by hand
SAME_AFTER = 2.5  # times as long between two lines that say the same; chosen by hand
_FEW = 50  # parts: as kernels, the slowest of which take fifty times as long as the quickest
_SPEED_OVER_S = 600.0  # the remaining time follows the last so many seconds: one photograph may take minutes
# Of quality accurate, with colours and files: photographs of 720x480 px take 1.5 to 2 s on two cores, a camera's first
# in a program 4.5 s (chromaperture demo).
ACCURATE_S_A_MEGAPIXEL = 5.0

_LONG_S = 10.0  # of a measurement that is announced; chosen by hand
_CAPTION = (
    "nearest, farthest: all but 5 % of the pixels are beyond, before; how sure: of half of the pixels the error bar "
    "(one standard deviation) is shorter"
)
out = Console()
err = Console(stderr=True)
_shown: set[str] = set()  # warnings printed in this run


def forget_warnings() -> None:
    """Begin a run: every warning is printed again."""
    _shown.clear()


def say_error(error: BaseException | str) -> None:
    """Print one line on standard error."""
    with contextlib.suppress(OSError):  # a full device; the exit code remains
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)


def say_warning(message: str) -> None:
    """Print one line on standard error."""
    print(f"warning: {' '.join(message.split())}", file=sys.stderr)


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print the package's own warnings as one line, each once a run; others as Python does."""
    if issubclass(category, CaptureWarning):
        if str(message) not in _shown:
            say_warning(str(message))
        _shown.add(str(message))
    else:
        print(warnings.formatwarning(message, category, filename, lineno, line), file=sys.stderr)


@contextlib.contextmanager
def progress(*, quiet: bool) -> Iterator[Update]:
    """Yield ``update(what, done, total)``, a bar on a terminal, else a line every `LINE_EVERY_S` with news."""
    if quiet:
        yield lambda what, done, total: None
    elif err.is_interactive:
        with _bar() as update:
            yield update
    else:
        with _lines(LINE_EVERY_S) as update:
            yield update


class _TimeLeft(TimeRemainingColumn):
    def render(self, task: Task) -> Text:
        known = _can_estimate(task.completed, task.total)
        return super().render(task) if known else Text("-:--:--", style="progress.remaining")


@contextlib.contextmanager
def _bar() -> Iterator[Update]:
    """Show a bar for the present step: elapsed and remaining time are the step's."""
    columns = (
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn("left"), _TimeLeft(),
    )  # fmt: skip
    with Progress(*columns, console=err, transient=True, speed_estimate_period=_SPEED_OVER_S) as bar:
        shown: TaskID | None = None
        before = (0, 0)

        def update(what: str, done: int, total: int) -> None:
            nonlocal shown, before
            if shown is None or done < before[0] or total != before[1]:  # another step
                if shown is not None:
                    bar.remove_task(shown)
                shown = bar.add_task("", total=total or None)
            bar.update(shown, description=escape(what), completed=done)
            before = (done, total)

        yield update


@contextlib.contextmanager
def _lines(every_s: float) -> Iterator[Update]:
    """Print the newest state as a line, from a thread; one that lasts is said again after `SAME_AFTER`."""
    newest: tuple[str, int, int] | None = None
    ended, began = threading.Event(), time.monotonic()

    def run() -> None:
        printed: tuple[str, int, int] | None = None
        said = began
        first = (0, 0, began)  # of this step: how many were done, of how many, and when
        while not ended.wait(every_s):
            state, now = newest, time.monotonic()
            if state is not None and (state != printed or now - said >= SAME_AFTER * every_s):
                printed, said = state, now
                if state[1] < first[0] or state[2] != first[1]:
                    first = (*state[1:], now)
                minutes, seconds = divmod(int(now - began), 60)
                counted = state[1] - first[0] if _can_estimate(*state[1:]) else 0
                left = _remaining(counted, state[2] - state[1], now - first[2])
                print(f"[{minutes}:{seconds:02d}] {_line(*state)}{left}", file=sys.stderr, flush=True)

    def update(what: str, done: int, total: int) -> None:
        nonlocal newest
        newest = (what, done, total)

    thread = threading.Thread(target=run, daemon=True, name="progress")
    try:
        thread.start()
    except RuntimeError:  # no more threads: the work goes on without a word
        yield update
        return
    try:
        yield update
    finally:
        ended.set()
        thread.join()


def _can_estimate(done: float, total: float | None) -> bool:
    """Whether the remaining time is known: of few parts, of which some take much longer, once a third is done."""
    return 3 * done >= (total or 0) or (total or 0) > _FEW


def _remaining(done: int, left: int, seconds: float) -> str:
    """State the remaining time, where it is worth saying: from half a minute on."""
    expected_s = seconds * left / done if done > 0 else 0.0
    return f", about {duration(expected_s)} left" if expected_s >= 30 else ""


def _line(what: str, done: int, total: int) -> str:
    """State which one is being worked on; how many are done where several are, or nobody knows of how many."""
    if not total:
        return f"{what}, {done} done"
    if what.startswith(FINISHED):
        return f"{done} of {total} {what}"
    return f"{what}, {min(done + 1, total)} of {total}"


def compile_kernels(*qualities: str, quiet: bool) -> None:
    """Compile what the matchers of qualities need and this machine has not got yet, and show how far it is."""
    with progress(quiet=quiet) as update:
        _compile(update, *qualities, quiet=quiet)


def after_compilation(update: Update, *qualities: str, quiet: bool) -> Update:
    """Return an update that compiles the kernels the first time; faults of the input are said before that."""
    waiting = [True]

    def show(what: str, done: int, total: int) -> None:
        if waiting:
            waiting.clear()
            _compile(update, *qualities, quiet=quiet)
        update(what, done, total)

    return show


def _compile(update: Update, *qualities: str, quiet: bool) -> None:
    from chromaperture.system.compile_ahead import compile_ahead

    def show(what: str, done: int, total: int) -> None:
        if done == 0 and not quiet:
            err.print(f"Compiling {total} kernels once for this machine; later runs start at once.", soft_wrap=True)
        update(what, done, total)

    compile_ahead(*qualities, update=show)


def announce_duration(camera: CodedApertureCamera, photographs: int, *, quiet: bool) -> None:
    """Estimate how long quality accurate takes for photographs, where one would wonder."""
    sensor = camera.calibration.sensor
    megapixels = sensor.width_px * sensor.height_px / 1e6
    each_s = ACCURATE_S_A_MEGAPIXEL * megapixels / camera.config.scale**2  # the working scale's pixels
    if quiet or camera.config.quality != "accurate" or photographs * each_s < _LONG_S:
        return
    several = f", {duration(photographs * each_s)} for {photographs}" if photographs > 1 else ""
    say = f"Quality accurate: about {duration(each_s)} a photograph of {megapixels:.2g} megapixels{several}"
    basis = f"{ACCURATE_S_A_MEGAPIXEL:.0f} s a megapixel, as measured on two cores of an Intel Xeon server"
    print(f"{say} (an estimate: {basis}); --quality real-time is faster and tells less.", file=sys.stderr, flush=True)


def other_quality(camera: CodedApertureCamera, *, per: str = "photograph") -> str:
    """Say what the other quality would take; empty where the camera has only one."""
    if "accurate" not in camera.calibration.depth:
        return ""
    if camera.config.quality == "accurate":
        return "--quality real-time takes a fraction of a second and tells less."
    sensor, scale = camera.calibration.sensor, camera.config.scale
    each_s = ACCURATE_S_A_MEGAPIXEL * sensor.width_px * sensor.height_px / 1e6 / scale**2
    return f"--quality accurate tells more, and takes about {duration(each_s)} a {per}."


def duration(seconds: float) -> str:
    """Return a time in words."""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def print_reports(reports: Sequence[Written], *, note: str = "", verbose: bool = False) -> None:
    """Print a summary of measured images, a note, and the files written."""
    out.print(_table(reports, verbose=verbose))
    if note:
        out.print(note)
    print_files([file for report in reports for file in report.files])


def _table(reports: Sequence[Written], *, verbose: bool) -> Table:
    """Tabulate distances, error bars and time; of every stage where it is asked for."""
    calibrated = any(r.summary["depth_percentiles_mm"] for r in reports)
    unit, key = ("mm", "depth_percentiles_mm") if calibrated else ("px", "disparity_percentiles_px")
    quality = reports[0].summary["config"]["quality"]
    title = "Distance from the sensor plane" if calibrated else "Disparity (no calibration: no millimetres)"
    summaries = table(f"{title}, quality {quality}", "image", *(report.summary["image"] for report in reports))
    digits = 0 if calibrated else 2

    def row(name: str, cells: Iterable[str], style: str = "") -> None:
        summaries.add_row(name, *cells, style=style)

    names = ("nearest", "middle", "farthest") if calibrated else ("least", "middle", "greatest")
    for percentile, name in zip(("5", "50", "95"), names, strict=True):
        values = [(r.summary[key] or {}).get(percentile) for r in reports]
        row(name, ("-" if v is None else f"{v:.{digits}f} {unit}" for v in values))
    if calibrated:
        sigmas = [r.summary["sigma_median_mm"] for r in reports]
        row("how sure", ("-" if s is None else f"±{s:.0f} mm" for s in sigmas))
    row("pixels measured", (f"{r.summary['fill_rate']:.1%}" for r in reports))
    row("time", (f"{sum(r.summary['seconds'].values()):.1f} s" for r in reports), "dim")
    for stage in reports[0].summary["seconds"] if verbose else ():
        row(f"time, {stage}", (f"{1000 * r.summary['seconds'][stage]:.0f} ms" for r in reports), "dim")
    summaries.caption = _CAPTION if calibrated else None
    return summaries


def table(title: str, *headings: str, left: int = 1) -> Table:
    """Create a table whose first columns are left-aligned, the others right-aligned."""
    rows = Table(title=escape(title))
    for i, heading in enumerate(headings):
        rows.add_column(escape(heading), justify="left" if i < left else "right", overflow="fold")
    return rows


def print_files(files: list[Path]) -> None:
    """Print what was written, one line a folder."""
    folders: dict[Path, list[str]] = {}
    for file in files:
        folders.setdefault(file.parent, []).append(file.name)
    for folder, names in folders.items():
        out.print(f"Wrote to [bold]{escape(str(folder))}[/]: {escape(', '.join(names))}", soft_wrap=True)


def print_json(value: Any) -> None:
    """Print JSON on standard output."""
    from chromaperture.system.storage import to_json

    print(to_json(value))

"""Print for all subcommands: results on standard output, progress, warnings and errors on standard error."""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from chromaperture.compilation import is_compiled
from chromaperture.errors import CaptureWarning
from chromaperture.products.measure_file import Written

out = Console()
err = Console(stderr=True)
_shown: set[str] = set()  # warnings printed in this run


def forget_warnings() -> None:
    """Begin a run: every warning is printed again."""
    _shown.clear()


def say_error(error: BaseException | str) -> None:
    """Print one line on standard error."""
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
def progress(*, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on standard error; yields ``update(what, done, total)``."""
    if quiet:
        yield lambda what, done, total: None
        return
    text = TextColumn("{task.description}")
    columns = (SpinnerColumn(), text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task("", total=None)

        def update(what: str, done: int, total: int) -> None:
            bar.update(task, description=what, completed=done, total=total)

        yield update


def announce_compilation(*, quiet: bool) -> None:
    """Announce that the first run takes longer, when no compiled matcher is on disk."""
    if quiet:
        return
    from chromaperture.disparity.cpu import strips as matcher  # any module with kernels of the matcher

    if not is_compiled(matcher):
        err.print("Compiling the matcher once for this machine (about a minute); later runs start at once.")


def print_reports(reports: Sequence[Written], *, note: str = "") -> None:
    """Print a summary of measured images, a note, and the files written."""
    out.print(_table(reports))
    if note:
        out.print(note)
    print_files([file for report in reports for file in report.files])


def _table(reports: Sequence[Written]) -> Table:
    """Tabulate fill rate, depth percentiles and time per stage."""
    calibrated = any(r.summary["depth_percentiles_mm"] for r in reports)
    unit, key = ("mm", "depth_percentiles_mm") if calibrated else ("px", "disparity_percentiles_px")
    title = "Depth from the sensor plane" if calibrated else "Disparity (no calibration: no millimetres)"
    summaries = table(title, "image", *(report.summary["image"] for report in reports))
    digits = 0 if calibrated else 2

    def row(name: str, cells: Iterable[str], style: str = "") -> None:
        summaries.add_row(name, *cells, style=style)

    row("fill rate", (f"{r.summary['fill_rate']:.1%}" for r in reports))
    for percentile, name in (("5", "nearest 5 %"), ("50", "median"), ("95", "farthest 5 %")):
        values = [(r.summary[key] or {}).get(percentile) for r in reports]
        row(name, ("-" if v is None else f"{v:.{digits}f} {unit}" for v in values))
    if calibrated:
        sigmas = [r.summary["sigma_median_mm"] for r in reports]
        row("median error bar", ("-" if s is None else f"±{s:.0f} mm" for s in sigmas))
    for stage in reports[0].summary["seconds"]:
        row(f"time, {stage}", (f"{1000 * r.summary['seconds'][stage]:.0f} ms" for r in reports), "dim")
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
    from chromaperture.storage import to_json

    print(to_json(value))

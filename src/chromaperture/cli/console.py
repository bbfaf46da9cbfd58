"""What all subcommands print with: results on standard output, progress and complaints on standard error."""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from chromaperture.errors import CaptureWarning
from chromaperture.products.measure_file import Report

out = Console()
err = Console(stderr=True)


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
    """Print our own warnings as one line; others as Python does."""
    if issubclass(category, CaptureWarning):
        say_warning(str(message))
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
    """Say beforehand that the first run takes longer, where no compiled matcher lies beside its source."""
    import chromaperture.disparity

    folders = [Path(folder, "__pycache__") for folder in chromaperture.disparity.__path__]
    if not quiet and not any(any(folder.glob("*.nbi")) for folder in folders):
        err.print("Compiling the matcher once for this machine (about a minute); later runs start at once.")


def report_table(reports: list[Report]) -> Table:
    """Give the summary of measured images: fill rate, depth percentiles, time per stage."""
    calibrated = any(r.summary["depth_percentiles_mm"] for r in reports)
    unit, key = ("mm", "depth_percentiles_mm") if calibrated else ("px", "disparity_percentiles_px")
    table = Table(title="Depth from the sensor plane" if calibrated else "Disparity (no calibration: no millimetres)")
    table.add_column("image")
    for report in reports:
        table.add_column(escape(report.summary["image"]), justify="right")
    digits = 0 if calibrated else 2

    def row(name: str, cells: Iterable[str], style: str = "") -> None:
        table.add_row(name, *cells, style=style)

    row("fill rate", (f"{r.summary['fill_rate']:.1%}" for r in reports))
    for percentile, name in (("5", "nearest 5 %"), ("50", "median"), ("95", "farthest 5 %")):
        values = [(r.summary[key] or {}).get(percentile) for r in reports]
        row(name, ("-" if v is None else f"{v:.{digits}f} {unit}" for v in values))
    if calibrated:
        sigmas = [r.summary["sigma_median_mm"] for r in reports]
        row("median error bar", ("-" if s is None else f"±{s:.0f} mm" for s in sigmas))
    for stage in reports[0].summary["seconds"]:
        row(f"time, {stage}", (f"{1000 * r.summary['seconds'][stage]:.0f} ms" for r in reports), "dim")
    return table


def print_files(files: list[Path]) -> None:
    """Say what was written, a folder a line."""
    folders: dict[Path, list[str]] = {}
    for file in files:
        folders.setdefault(file.parent, []).append(file.name)
    for folder, names in folders.items():
        out.print(f"Wrote to [bold]{escape(str(folder))}[/]: {escape(', '.join(names))}", soft_wrap=True)


def print_json(value: Any) -> None:
    """Print JSON on standard output."""
    from chromaperture.storage import to_json

    print(to_json(value))

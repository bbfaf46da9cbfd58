"""``chromaperture evaluate``: the figures and tables of the paper."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from chromaperture.cli.options import Json, Quiet
from chromaperture.system.errors import InputError
from chromaperture_paper.registry import EXHIBITS

if TYPE_CHECKING:
    from chromaperture_paper.registry import Exhibit
    from chromaperture_paper.run import Outcome


def evaluate(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Names of the list above, such as figure-10 table-1; all when absent.", metavar="NAME"),
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder of real sessions and white sheets; simulated when absent.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the report.")] = Path("evaluation"),
    quick: Annotated[bool, typer.Option("--quick", help="Small pictures: minutes, not a quarter of an hour.")] = False,
    workers: Annotated[int, typer.Option(help="Processes for sweeps; 0 is one a core.")] = 0,
    cluster: Annotated[
        str | None, typer.Option(help="Dask scheduler that runs the sweeps, such as tcp://10.0.0.1:8786.")
    ] = None,
    camera: Annotated[
        list[Path] | None, typer.Option("--camera", "-c", help="Camera files, one a design, instead of calibrating.")
    ] = None,
    again: Annotated[bool, typer.Option("--again", help="Make what is finished anew too.")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make the paper's figures and tables, with the paper's numbers beside those measured.

    chromaperture evaluate all --out evaluation

    Every figure has its own folder with pictures and CSV files.

    report.html contains all of them. An interrupted run continues where it stopped.

    The names are those of this list, or "all":
    """
    from chromaperture.cli.console import compile_kernels, print_json, progress, say_warning
    from chromaperture.system.cluster import dask_distributed
    from chromaperture_paper.context import Context
    from chromaperture_paper.run import evaluate as run
    from chromaperture_paper.run import write_page

    if workers < 0:
        raise InputError(f"--workers must be at least 0, got {workers}")
    if camera and data is None:
        raise InputError("--camera is used with --data, the folder of its photographs")
    for path in camera or ():
        if not path.is_file():
            raise InputError(f"no camera file at {path}")
    if cluster:
        dask_distributed()
    exhibits = _chosen(names or [], data)
    compile_kernels("paper", "real-time", quiet=quiet)
    context = Context(out, data=data, quick=quick, workers=workers, cluster=cluster, cameras=tuple(camera or ()))
    with progress(quiet=quiet) as update:
        outcomes = run(exhibits, context, again=again, progress=update)
    page = write_page(out, outcomes, quick=quick)
    for outcome in outcomes:
        if outcome.problem:
            say_warning(f"{outcome.exhibit.name} skipped: {outcome.problem}")
    if json:
        print_json([{"name": o.exhibit.name, "problem": o.problem, **(o.result or {})} for o in outcomes])
    elif not quiet:
        _print_outcomes(outcomes, page)
    if any(outcome.problem for outcome in outcomes):
        raise typer.Exit(1)


# Below the first sentences of the help; the mark keeps one line an exhibit.
evaluate.__doc__ = f"{inspect.cleandoc(evaluate.__doc__ or '')}\n\n\b\n" + "\n".join(
    f"{name:<11}  {exhibit.title}" for name, exhibit in EXHIBITS.items()
)


def _chosen(names: list[str], data: Path | None) -> list[Exhibit]:
    """Return the exhibits to make; raises InputError for those named that have no input."""
    from chromaperture_paper.registry import chosen

    if data is not None and not data.is_dir():
        raise InputError(f"--data {data} is no folder: give the one that holds the sessions, or leave it out")
    exhibits = chosen(names)
    if data is not None:
        return exhibits
    unable = [e.name for e in exhibits if e.only_data]
    if unable and names and "all" not in names:
        raise InputError(f"{', '.join(unable)} needs photographs: give their folder with --data")
    return [e for e in exhibits if not e.only_data]


def _print_outcomes(outcomes: list[Outcome], page: Path) -> None:
    from chromaperture.cli.console import out

    kept = sum(o.kept for o in outcomes)
    made = sum(o.result is not None for o in outcomes) - kept
    out.print(f"{made} made, {kept} kept from before, {len(outcomes) - made - kept} skipped")
    out.print(f"Wrote {page}", soft_wrap=True, markup=False)

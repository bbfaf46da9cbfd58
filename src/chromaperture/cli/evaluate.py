"""``chromaperture evaluate``: the figures and tables of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from chromaperture.errors import InputError


def evaluate(
    names: Annotated[
        list[str] | None, typer.Argument(help="Figures and tables, such as figure-10 table-1; all when absent.")
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
    json: Annotated[bool, typer.Option("--json", help="Print the results as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
) -> None:
    """Make the paper's figures and tables and put the paper's numbers beside ours.

    chromaperture evaluate all --out evaluation

    Every figure has its own folder with pictures and CSV files; report.html holds all of them. A run that was
    interrupted goes on where it stopped.
    """
    from chromaperture.cli.console import announce_compilation, print_json, progress, say_warning
    from chromaperture.cli.console import out as console
    from chromaperture.evaluation.paper.cluster import dask_distributed
    from chromaperture.evaluation.paper.context import Context
    from chromaperture.evaluation.paper.html_page import write_page
    from chromaperture.evaluation.paper.registry import chosen
    from chromaperture.evaluation.paper.run import evaluate as run

    if workers < 0:
        raise InputError(f"--workers must be at least 0, got {workers}")
    if camera and data is None:
        raise InputError("--camera is used with --data, the folder of its photographs")
    for path in camera or ():
        if not path.is_file():
            raise InputError(f"no camera file at {path}")
    if cluster:
        dask_distributed()
    if data is not None and not data.is_dir():
        raise InputError(f"--data {data} is no folder: give the one that holds the sessions, or leave it out")
    exhibits = chosen(names or [])
    if data is None:  # what has no simulated input is asked for by name or not at all
        unable = [e.name for e in exhibits if e.only_data]
        if unable and names and "all" not in names:
            raise InputError(f"{', '.join(unable)} needs photographs: give their folder with --data")
        exhibits = [e for e in exhibits if not e.only_data]
    announce_compilation(quiet=quiet or json)
    context = Context(out, data=data, quick=quick, workers=workers, cluster=cluster, cameras=tuple(camera or ()))
    with progress(quiet=quiet or json) as update:
        outcomes = run(exhibits, context, again=again, progress=update)
    page = write_page(out, outcomes, quick=quick)
    for outcome in outcomes:
        if outcome.problem:
            say_warning(f"{outcome.exhibit.name} skipped: {outcome.problem}")
    if json:
        print_json([{"name": o.exhibit.name, "problem": o.problem, **(o.result or {})} for o in outcomes])
    elif not quiet:
        kept = sum(o.kept for o in outcomes)
        made = sum(o.result is not None for o in outcomes) - kept
        console.print(f"{made} made, {kept} kept from before, {len(outcomes) - made - kept} skipped")
        console.print(f"Wrote {page}", soft_wrap=True, markup=False)
    if any(outcome.problem for outcome in outcomes):
        raise typer.Exit(1)

"""Makes exhibits one by one; what is finished lies in its own folder and is not made again."""

from __future__ import annotations

import csv
import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from chromaperture.errors import ChromapertureError
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Exhibit, Made
from chromaperture.storage import staged, write_json

RESULT = "result.json"


@dataclass(frozen=True)
class Outcome:
    """One exhibit after the run; ``result`` is the content of its result.json, None where it was not made."""

    exhibit: Exhibit
    result: dict[str, Any] | None
    kept: bool = False
    problem: str = ""


def evaluate(
    exhibits: Sequence[Exhibit],
    context: Context,
    *,
    again: bool = False,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> list[Outcome]:
    """Make exhibits, each into its folder below ``context.out``.

    Parameters
    ----------
    exhibits : sequence of Exhibit
    context : Context
    again : bool
        Make those too that are finished.
    progress : callable
        Told what is made, how many are done, and of how many.

    Returns
    -------
    list of Outcome, one an exhibit; what could not be made says why and stops none of the others
    """
    context.tell = progress
    outcomes = []
    for number, exhibit in enumerate(exhibits):
        progress(exhibit.title, number, len(exhibits))
        stamp = stamp_of(exhibit, context)
        finished = None if again else finished_result(context.out / exhibit.name, stamp)
        missing = missing_files(exhibit, context.data)
        if finished is not None:
            outcomes.append(Outcome(exhibit, finished, kept=True))
        elif missing:
            outcomes.append(Outcome(exhibit, None, problem=missing))
        else:
            outcomes.append(_made(exhibit, context, stamp))
    progress("done", len(exhibits), len(exhibits))
    return outcomes


def missing_files(exhibit: Exhibit, data: Path | None) -> str:
    """Say which files an exhibit misses below the data folder; empty where none."""
    if data is None:
        return ""
    missing = [name for name in exhibit.files if not (data / name).is_file()]
    if not missing:
        return ""
    more = f" and {len(missing) - 6} more" if len(missing) > 6 else ""
    return f"{data} has no {', '.join(missing[:6])}{more}"


def stamp_of(exhibit: Exhibit, context: Context) -> dict[str, Any]:
    """Give what a result depends on; another stamp makes it again."""
    stamp = {"version": metadata.version("chromaperture"), "quick": context.quick, "data": ""}
    data = context.data
    if data is not None and exhibit.reads_all:
        paths = [*sorted(data.rglob("*")), *context.cameras]
    elif data is not None and exhibit.files:
        paths = [data / name for name in exhibit.files]
    else:
        return stamp
    return stamp | {"data": _fingerprint(data, paths)}


def _fingerprint(data: Path, paths: Sequence[Path]) -> str:
    """Of the files' names, sizes and times: another folder, or photographs taken again, make it anew."""
    total = hashlib.sha256(str(data.resolve()).encode())
    for path in paths:
        if path.is_file():
            stat = path.stat()
            total.update(f"{path} {stat.st_size} {stat.st_mtime_ns}".encode())
    return total.hexdigest()[:16]


def finished_result(folder: Path, stamp: dict[str, Any]) -> dict[str, Any] | None:
    """Read a result with this stamp whose files are all there; None where there is none."""
    try:
        result = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(result, dict) or result.get("stamp") != stamp:
        return None
    return result if all((folder / name).is_file() for name in result.get("files", ())) else None


def _made(exhibit: Exhibit, context: Context, stamp: dict[str, Any]) -> Outcome:
    start = time.perf_counter()
    try:
        made = exhibit.make(context)
    except ChromapertureError as error:
        return Outcome(exhibit, None, problem=str(error))
    return Outcome(exhibit, write_made(context.out / exhibit.name, exhibit, made, stamp, time.perf_counter() - start))


def write_made(folder: Path, exhibit: Exhibit, made: Made, stamp: dict[str, Any], seconds: float) -> dict[str, Any]:
    """Write pictures, CSV files and, last, result.json, whole or not at all; gives the content of the latter."""
    with staged(folder) as stage:
        for drawn in made.drawn:
            drawn.figure.savefig(stage.path(f"{drawn.stem}.png"), format="png", metadata={"Software": None})
        for listed in made.listed:
            with stage.path(f"{listed.stem}.csv").open("w", encoding="utf-8", newline="") as file:
                csv.writer(file).writerows([listed.table.head, *listed.table.rows])
        result = {
            "name": exhibit.name,
            "title": exhibit.title,
            "stamp": stamp,
            "source": made.source,
            "seconds": round(seconds, 1),
            "files": list(stage.names),
            "pictures": [{"file": f"{d.stem}.png", "caption": d.caption} for d in made.drawn],
            "tables": [{"file": f"{t.stem}.csv", **asdict(t.table)} for t in made.listed if t.on_page],
            "compared": [asdict(c) for c in made.compared],
            "lines": list(made.lines),
        }
        write_json(stage.path(RESULT), result)
    return dict(json.loads((folder / RESULT).read_text(encoding="utf-8")))

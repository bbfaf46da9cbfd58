"""Make exhibits one by one, each into its own folder; finished ones are not made again."""

from __future__ import annotations

import base64
import csv
import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from chromaperture.evaluation.report import page_template
from chromaperture.system.errors import ChromapertureError
from chromaperture.system.storage import staged, write_json
from chromaperture_paper.context import Context
from chromaperture_paper.registry import Content, Exhibit

RESULT = "result.json"


@dataclass(frozen=True)
class Outcome:
    """One exhibit after the run; ``result`` is the content of its result.json, None if it was not made."""

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
    """Make exhibits, each into its folder below ``context.out``, finished ones only ``again``.

    A problem with one does not stop the others. ``progress`` receives the step, how many are done, and of how many.
    """
    context.progress = progress
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
    """Return a message that names the files missing below the data folder; empty if none."""
    missing = [name for name in exhibit.files if data is not None and not (data / name).is_file()]
    if not missing:
        return ""
    more = f" and {len(missing) - 6} more" if len(missing) > 6 else ""
    return f"{data} has no {', '.join(missing[:6])}{more}"


def stamp_of(exhibit: Exhibit, context: Context) -> dict[str, Any]:
    """Return what a result depends on; with another stamp it is made again."""
    stamp = {"version": metadata.version("chromaperture"), "quick": context.quick, "data": ""}
    data = context.data
    if data is None or not (exhibit.reads_all or exhibit.files):
        return stamp
    if exhibit.reads_all:
        return stamp | {"data": _fingerprint(data, [*sorted(data.rglob("*")), *context.cameras])}
    return stamp | {"data": _fingerprint(data, [data / name for name in exhibit.files])}


def _fingerprint(data: Path, paths: Sequence[Path]) -> str:
    """Hash names, sizes and times of the files, which change where photographs are taken again."""
    total = hashlib.sha256(str(data.resolve()).encode())
    for path in paths:
        if path.is_file():
            stat = path.stat()
            total.update(f"{path} {stat.st_size} {stat.st_mtime_ns}".encode())
    return total.hexdigest()[:16]


def finished_result(folder: Path, stamp: dict[str, Any]) -> dict[str, Any] | None:
    """Read a complete result with this stamp; None if there is none."""
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
        content = exhibit.make(context)
    except ChromapertureError as error:
        return Outcome(exhibit, None, problem=str(error))
    seconds = time.perf_counter() - start
    return Outcome(exhibit, _write(context.out / exhibit.name, exhibit, content, stamp, seconds))


def _write(folder: Path, exhibit: Exhibit, content: Content, stamp: dict[str, Any], seconds: float) -> dict[str, Any]:
    """Write figures, CSV files and result.json atomically; return the content of the latter."""
    with staged(folder) as stage:
        for chart in content.charts:
            chart.figure.savefig(stage.path(f"{chart.stem}.png"), format="png", metadata={"Software": None})
        for table in content.tables:
            with stage.path(f"{table.stem}.csv").open("w", encoding="utf-8", newline="") as file:
                csv.writer(file).writerows([table.head, *table.rows])
        result = {
            "name": exhibit.name,
            "title": exhibit.title,
            "stamp": stamp,
            "source": content.source,
            "seconds": round(seconds, 1),
            "files": list(stage.names),
            "pictures": [{"file": f"{c.stem}.png", "caption": c.caption} for c in content.charts],
            "tables": [
                {"file": f"{t.stem}.csv", "caption": t.caption, "head": t.head, "rows": t.rows}
                for t in content.tables
                if t.on_page
            ],
            "compared": [asdict(c) for c in content.comparisons],
            "lines": list(content.lines),
        }
        write_json(stage.path(RESULT), result)
    return dict(json.loads((folder / RESULT).read_text(encoding="utf-8")))


def page_html(out: Path, outcomes: Sequence[Outcome], *, quick: bool) -> str:
    """Render the page from the exhibits' folders below ``out``."""
    size = "Small pictures (--quick): figures are coarser than those of the full run." if quick else "Full run."
    return page_template("paper.html").render(
        title="The paper, reproduced",
        subtitle=f"chromaperture {metadata.version('chromaperture')}. {size}",
        sections=[_section(out, outcome) for outcome in outcomes],
    )


def write_page(out: Path, outcomes: Sequence[Outcome], *, quick: bool) -> Path:
    """Write ``report.html`` atomically; return its path."""
    text = page_html(out, outcomes, quick=quick)
    with staged(out) as stage:
        stage.path("report.html").write_text(text, encoding="utf-8")
    return out / "report.html"


def _section(out: Path, outcome: Outcome) -> dict[str, Any]:
    exhibit, result = outcome.exhibit, outcome.result or {}
    pictures = [
        {**p, "data": base64.b64encode((out / exhibit.name / p["file"]).read_bytes()).decode("ascii")}
        for p in result.get("pictures", ())
    ]
    return {**result, "name": exhibit.name, "title": exhibit.title, "problem": outcome.problem, "pictures": pictures}

"""The page: one HTML file with all figures inside."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from chromaperture.evaluation.report import page_template
from chromaperture.system.storage import staged
from chromaperture_paper.run import Outcome


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

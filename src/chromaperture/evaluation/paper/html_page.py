"""The page: one HTML file with all pictures inside."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from chromaperture.evaluation.paper.run import Outcome
from chromaperture.evaluation.report import page_template
from chromaperture.storage import staged


def page_html(out: Path, outcomes: Sequence[Outcome], *, quick: bool) -> str:
    """Give the page as HTML.

    Parameters
    ----------
    out : Path
        Folder with a folder for every exhibit.
    outcomes : sequence of Outcome
    quick : bool

    Returns
    -------
    str
    """
    template = page_template("paper.html")
    size = "Small pictures (--quick): figures are coarser than those of the full run." if quick else "Full run."
    return template.render(
        title="The paper, reproduced",
        subtitle=f"chromaperture {metadata.version('chromaperture')}. {size}",
        sections=[_section(out, outcome) for outcome in outcomes],
    )


def write_page(out: Path, outcomes: Sequence[Outcome], *, quick: bool) -> Path:
    """Write ``report.html``, whole or not at all; gives its path."""
    text = page_html(out, outcomes, quick=quick)
    with staged(out) as stage:
        stage.path("report.html").write_text(text, encoding="utf-8")
    return out / "report.html"


def _section(out: Path, outcome: Outcome) -> dict[str, Any]:
    section: dict[str, Any] = {
        "name": outcome.exhibit.name,
        "title": outcome.exhibit.title,
        "problem": outcome.problem,
        "source": "",
        "seconds": 0.0,
        "pictures": [],
        "tables": [],
        "compared": [],
        "lines": [],
    }
    if outcome.result is None:
        return section
    section |= {key: outcome.result[key] for key in ("source", "seconds", "tables", "compared", "lines")}
    folder = out / outcome.exhibit.name
    section["pictures"] = [
        {"caption": p["caption"], "data": base64.b64encode((folder / p["file"]).read_bytes()).decode("ascii")}
        for p in outcome.result["pictures"]
    ]
    return section

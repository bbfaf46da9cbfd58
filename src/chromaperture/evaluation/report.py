"""The calibration report: one HTML file that needs nothing else, for the photographer first, then the researcher."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from matplotlib.figure import Figure

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.evaluation import blur_evidence, evidence, figures, tables
from chromaperture.evaluation.tables import Table
from chromaperture.evaluation.verdict import sentences
from chromaperture.storage import staged


@dataclass(frozen=True)
class Picture:
    """A picture as base64 PNG and the sentence that says what to see."""

    data: str
    caption: str


@dataclass(frozen=True)
class Section:
    """One part of the page."""

    title: str
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    lines: tuple[str, ...] = ()


def page_template(name: str) -> Template:
    """Give one of the templates of self-contained pages."""
    loader = PackageLoader("chromaperture.evaluation")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined).get_template(name)


def report_html(result: CalibrationResult, *, title: str) -> str:
    """Give the report as one HTML page with its pictures inside.

    Parameters
    ----------
    result : CalibrationResult
    title : str

    Returns
    -------
    str
    """
    template = page_template("report.html")
    calibration = result.calibration
    subtitle = (
        f"{calibration.aperture.title}, {calibration.lens.focal_length_mm:.1f} mm lens, "
        f"{calibration.sensor.width_px}x{calibration.sensor.height_px} px, {len(result.boards)} boards"
    )
    verdict = sentences(result)
    return template.render(title=title, subtitle=subtitle, verdict=verdict, sections=_sections(result))


def write_report(path: str | Path, result: CalibrationResult, *, title: str | None = None) -> None:
    """Write the report, whole or not at all."""
    path = Path(path)
    text = report_html(result, title=title or f"Calibration of {result.session.folder.name}")
    with staged(path.parent) as stage:
        stage.path(path.name).write_text(text, encoding="utf-8")


def _sections(result: CalibrationResult) -> list[Section]:
    index, before, after = figures.flat_board(result)
    share = f"{after / before:.2f}" if before > 0 else "-"
    flat = (
        f"The wall of {result.boards[index].name} is flat; with one curve for all of the frame it bulges by "
        f"{before:.0f} mm rms, with a curve for every pixel {after:.0f} mm of noise and error are left (ratio {share})."
    )
    sections = [
        _drawn("What a distance is good to", result, figures.draw_reach,
               "Below a dotted line the camera is good to 1 or 2 %; averaging over pixels leaves the lower curve.",
               tables.steps(result)),
        _drawn("True against measured", result, figures.draw_true_against_measured,
               "Points on the line, and below within the grey bands, are right; a trend would mean a wrong curve. "
               "(The paper's Figure 6.)"),
        _drawn("Over the frame", result, figures.draw_surfaces,
               "The focus surface is curved and the rim of the lens cuts the pupil: the corners have their own "
               "curve. (Figure 7.)"),
        _drawn("A flat wall", result, figures.draw_flat_board, f"{flat} (Figure 8.)"),
        _drawn("Layers and sub-pixel", result, figures.draw_layers,
               "Whole layers of disparity are coarse; the parabola through the best three takes the steps away. "
               "(Figure 9; the layers are the measured disparity rounded.)"),
        _drawn("Board by board", result, figures.draw_residuals,
               "Left, all of the frame: median, half and nine tenths of the pixels; right, what the median is worth "
               "in distance.", tables.boards(result)),
        _drawn("Ruler and corners", result, evidence.draw_ruler,
               "The chessboard's own size gives its distance again; a point outside the band is a misread ruler or "
               "board.", lines=() if result.ruler else ("No board poses: nothing to compare the ruler with.",)),
        _drawn("Corners found", result, evidence.draw_corners,
               "Red dots are the corners; look for missing boards and corners off their squares."),
        _drawn("Film", result, evidence.draw_film,
               "A good pair keeps apart: the light each film should stop is near zero.", tables.unmixing(result)),
        _drawn("The lens's blur", result, blur_evidence.draw_blur,
               "How a point is blurred over the frame, near and far: the two halves of the pupil in their colours, cut "
               "by the lens's rims towards the corners.", lines=blur_evidence.blur_lines(result)),
        _drawn("Depth by blur", result, blur_evidence.draw_layers_of_blur,
               "What quality accurate reads on every board: half and nine tenths of the cells over the frame."),
        _drawn("White sheets", result, evidence.draw_transparency,
               "The open pupil shows the vignetting; the aperture's maps should be even, a ramp from side to side "
               "says that the film is off the stop."),
        _drawn("Parameters", result, evidence.draw_correlation,
               "Near ±1 two parameters trade against each other: a combination of them is known better than each.",
               tables.parameters(result)),
        Section("Notes", lines=tuple(result.notes) or ("Nothing was missing.",)),
        Section("Where this comes from", tables=(tables.provenance(result),)),
    ]  # fmt: skip
    return sections


def _drawn(
    title: str,
    result: CalibrationResult,
    draw: Callable[[CalibrationResult], Figure | None],
    caption: str,
    *shown: Table,
    lines: tuple[str, ...] = (),
) -> Section:
    """One section about a picture; a picture that has nothing to show leaves its line."""
    figure = draw(result)
    if figure is None:
        return Section(title, tables=shown, lines=lines or ("The session holds nothing to show here.",))
    return Section(title, (Picture(encoded(figure), caption),), shown, lines)


def encoded(figure: Figure) -> str:
    """Give a figure as base64 PNG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return base64.b64encode(buffer.getvalue()).decode("ascii")



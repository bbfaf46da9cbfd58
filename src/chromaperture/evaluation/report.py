"""The calibration report: one self-contained HTML file, first for the photographer, then for the researcher."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from matplotlib.figure import Figure

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.evaluation import figures, tables
from chromaperture.evaluation.tables import Table
from chromaperture.evaluation.verdict import sentences
from chromaperture.system.storage import staged

Draw = Callable[[CalibrationResult], Figure | None]


def page_template(name: str) -> Template:
    """Load a template of the self-contained pages."""
    loader = PackageLoader("chromaperture.evaluation")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined).get_template(name)


def report_html(result: CalibrationResult, *, title: str) -> str:
    """Render the report as one HTML page that contains its figures."""
    calibration = result.calibration
    subtitle = (
        f"{calibration.aperture.title}, {calibration.lens.focal_length_mm:.1f} mm lens, "
        f"{calibration.sensor.width_px}x{calibration.sensor.height_px} px, {len(result.boards)} boards"
    )
    return page_template("report.html").render(
        title=title, subtitle=subtitle, verdict=sentences(result), sections=_sections(result)
    )


def write_report(path: str | Path, result: CalibrationResult) -> None:
    """Write the report atomically."""
    path = Path(path)
    text = report_html(result, title=f"Calibration of {result.session.folder.name}")
    with staged(path.parent) as stage:
        stage.path(path.name).write_text(text, encoding="utf-8")


def _sections(result: CalibrationResult) -> list[dict[str, Any]]:
    index, before, after = figures.flat_board(result)
    ratio = f"{after / before:.2f}" if before > 0 else "-"
    flat = (
        f"The wall of {result.boards[index].name} is flat; with one curve for all of the frame it bulges by "
        f"{before:.0f} mm rms, with a curve for every pixel {after:.0f} mm of noise and error are left (ratio {ratio})."
    )
    return [
        _drawn("What a distance is good to", result, figures.draw_accuracy,
               "Over the whole frame, on boards full of texture. Below a dotted line one pixel is good to 1 or 2 %; "
               "averaging over pixels leaves the calibration alone. Grey: nearer or farther than all boards. There the "
               "depth curve goes on straight, and no line holds what that costs: a camera calibrated up to 3 m was 2 % "
               "off at 4 m. Photograph boards as near and as far as you measure.",
               tables.steps(result), lines=_noise_of_accurate(result)),
        _drawn("True against measured", result, figures.draw_true_against_measured,
               "Points on the line, and below within the grey bands, are right; a trend would mean a wrong curve. "
               "Medians over the frame; of quality accurate, over its cells. (The paper's Figure 6.)"),
        _drawn("Over the frame", result, figures.draw_surfaces,
               "The focus surface is curved and the rim of the lens cuts the pupil: the corners have their own "
               "curve. (Figure 7.)"),
        _drawn("A flat wall", result, figures.draw_flat_board, f"{flat} (Figure 8.)"),
        _drawn("Layers and sub-pixel", result, figures.draw_layers,
               "Whole layers of disparity are coarse; the parabola through the best three removes the steps. "
               "(Figure 9; the layers are the measured disparity rounded.)"),
        _drawn("Board by board", result, figures.draw_residuals,
               "Left, all of the frame: median, half and nine tenths of the pixels; right, the error of the median in "
               "distance.", tables.boards(result)),
        _drawn("Ruler and corners", result, figures.draw_ruler,
               "The size of the chessboard determines its distance independently; a point at more than three times the "
               "band is a misread ruler or board.",
               lines=() if result.ruler else ("No board poses: nothing to compare the ruler with.",)),
        _drawn("Corners found", result, figures.draw_corners,
               "Red dots are the corners; look for missing boards and corners off their squares."),
        _drawn("Film", result, figures.draw_film,
               "In a good pair, the transmission of each film is near zero where it should block.",
               tables.unmixing(result)),
        *_tone_curve(result),
        _drawn("The lens's blur", result, figures.draw_blur,
               "How a point is blurred over the frame, near and far: the two halves of the pupil in their colours, cut "
               "by the lens's rims towards the corners.", lines=figures.blur_lines(result)),
        _drawn("Depth by blur", result, figures.draw_layers_of_blur,
               "What quality accurate measures on every board: half and nine tenths of the cells over the frame."),
        _drawn("White sheets", result, figures.draw_transparency,
               "The open pupil shows the vignetting; the aperture's maps should be even, a ramp from side to side "
               "means that the film is off the stop."),
        _drawn("Parameters", result, figures.draw_correlation,
               "Near ±1, a combination of the two parameters is known better than each of them.",
               tables.parameters(result)),
        _section("Notes", lines=result.notes or ("Nothing was missing.",)),
        _section("Where this comes from", tables=(tables.provenance(result),)),
    ]  # fmt: skip


def _tone_curve(result: CalibrationResult) -> list[dict[str, Any]]:
    """Return the section of the response; none where decoded values are light."""
    if result.calibration.sensor.response is None:
        return []
    caption = (
        "What the chessboards show of the tone curve, which is undone in all photographs. The darkest tones are "
        "known least. Linear files have none."
    )
    return [_drawn("Tone curve", result, figures.draw_response, caption)]


def _noise_of_accurate(result: CalibrationResult) -> tuple[str, ...]:
    """State on which boards the noise of quality accurate was measured."""
    noise = np.asarray(result.pixel_sigma_px.get("accurate", ()), float)
    names = [board.name for board, sigma in zip(result.boards, noise, strict=False) if np.isfinite(sigma)]
    if names:
        return (
            f"One pixel at quality accurate: measured on {', '.join(names)}, interpolated between them. Flat boards "
            "flatter that quality, which makes surfaces smooth.",
        )
    if result.layers is None:
        return ()
    return ("One pixel at quality accurate was not measured: it takes 8 s a megapixel and board.",)


def _section(
    title: str, *, pictures: Sequence[dict[str, str]] = (), tables: Sequence[Table] = (), lines: Sequence[str] = ()
) -> dict[str, Any]:
    return {"title": title, "pictures": pictures, "tables": tables, "lines": lines}


def _drawn(
    title: str, result: CalibrationResult, draw: Draw, caption: str, *shown: Table, lines: Sequence[str] = ()
) -> dict[str, Any]:
    """Make the section of a figure; without a figure it has a line instead."""
    figure = draw(result)
    if figure is None:
        return _section(title, tables=shown, lines=lines or ("The session holds nothing to show here.",))
    return _section(title, pictures=[{"data": encoded(figure), "caption": caption}], tables=shown, lines=lines)


def encoded(figure: Figure) -> str:
    """Encode a figure as base64 PNG, without metadata that would differ from run to run."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return base64.b64encode(buffer.getvalue()).decode("ascii")

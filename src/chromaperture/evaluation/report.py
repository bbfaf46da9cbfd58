"""The calibration report: one self-contained HTML file, first for the photographer, then for the researcher."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Sequence
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from matplotlib.figure import Figure

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.evaluation import figures
from chromaperture.evaluation.verdict import QUALITY, board_errors, depth_accuracy, qualities, sentences
from chromaperture.files.map_page import TextTable
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
        f"{calibration.pupil_title}, {calibration.lens.focal_length_mm:.1f} mm lens, "
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
               accuracy_table(result), lines=_noise_of_accurate(result)),
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
               "distance.", boards_table(result)),
        _drawn("Ruler and corners", result, figures.draw_ruler,
               "The size of the chessboard determines its distance independently; a point at more than three times the "
               "band is a misread ruler or board.",
               lines=() if result.ruler else ("No board poses: nothing to compare the ruler with.",)),
        _drawn("Corners found", result, figures.draw_corners,
               "Red dots are the corners; look for missing boards and corners off their squares."),
        _drawn("Film", result, figures.draw_film,
               "In a good pair, the transmission of each film is near zero where it should block.",
               unmixing_table(result)),
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
               parameters_table(result)),
        _section("Notes", lines=result.notes or ("Nothing was missing.",)),
        _section("Where this comes from", tables=(provenance_table(result),)),
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
    title: str, *, pictures: Sequence[dict[str, str]] = (), tables: Sequence[TextTable] = (), lines: Sequence[str] = ()
) -> dict[str, Any]:
    return {"title": title, "pictures": pictures, "tables": tables, "lines": lines}


def _drawn(
    title: str, result: CalibrationResult, draw: Draw, caption: str, *shown: TextTable, lines: Sequence[str] = ()
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


def round_distances(near_mm: float, far_mm: float) -> np.ndarray:
    """Return at most nine round distances within a range; mm."""
    span = far_mm - near_mm
    step = next((s for s in (10, 20, 50, 100, 200, 250, 500, 1000, 2000) if span / s <= 8), 5000)
    return np.arange(np.ceil(near_mm / step) * step, far_mm + 1e-6, step)


def accuracy_table(result: CalibrationResult) -> TextTable:
    """List the depth per px of disparity and the standard deviations at round distances."""
    found = [depth_accuracy(result, quality) for quality in qualities(result)]
    rows = []
    for distance in round_distances(result.calibration.near_mm, result.calibration.far_mm):
        at = partial(np.interp, distance, found[0].depth_mm)
        step = float(at(found[0].step_mm))
        cells = [f"{mm:.0f}" for mm in (distance, step, 0.1 * step)]
        for accuracy in found:
            pixel, curve = (float(at(values)) for values in (accuracy.pixel_sigma_mm, accuracy.curve_sigma_mm))
            cells += [_number(pixel, ".0f"), _number(100 * pixel / distance, ".1f"), f"{curve:.1f}"]
        rows.append(cells)
    head = ["distance, mm", "1 px, mm", "0.1 px, mm"]
    for quality in qualities(result):
        head += [f"one pixel, {quality} ±, mm", "%", "calibration ±, mm"]
    return TextTable("Depth per step of disparity on the axis, and one standard deviation over the frame", head, rows)


def boards_table(result: CalibrationResult) -> TextTable:
    """List the boards with their readings and errors."""
    errors = board_errors(result)
    rows = []
    for i, board in enumerate(result.boards):
        rows.append((
            board.name + (" (outlier)" if board.name in result.outliers else ""),
            f"{board.ruler_mm:.0f}",
            _number(board.pose_mm, ".1f"),
            _number(float(board.disparity_px[QUALITY]), "+.3f"),
            _number(float(result.fits[QUALITY].residual_mm[i]), "+.1f"),
            _number(float(errors[i]), "+.1f"),
            _number(100 * float(errors[i]) / board.ruler_mm, "+.2f"),
            _number(float(result.pixel_sigma_px[QUALITY][i]), ".3f"),
        ))  # fmt: skip
    head = ("photograph", "ruler, mm", "pose, mm", "disparity, px", "error, middle, mm", "error, frame, mm", "%",
            "sigma of a pixel, px")  # fmt: skip
    return TextTable(f"Boards at quality {QUALITY}; errors are measured minus ruler", head, rows)


def unmixing_table(result: CalibrationResult) -> TextTable:
    """List the colours of the film and the rows of M^-1."""
    calibration = result.calibration
    rows = [(f"{name} film, colour", *(f"{v:.3f}" for v in color)) for name, color in calibration.film.filters.items()]
    rows += [
        (f"M⁻¹, {name}", *(f"{v:+.3f}" for v in row))
        for name, row in zip(calibration.aperture.views, calibration.unmixing, strict=False)
    ]
    return TextTable(
        "White light through the film, 1 = full scale, and the unmixing (Eq. 1)", ("", "R", "G", "B"), rows
    )


def parameters_table(result: CalibrationResult) -> TextTable:
    """List the fitted parameters with standard deviations, and what is derived from them."""
    calibration = result.calibration
    rows = []
    for quality, fit in result.fits.items():
        sigma = np.sqrt(np.diag(np.asarray(fit.model.covariance)))
        values = (fit.model.infinity_disparity_px, fit.model.scale_px_mm, fit.model.sensor_to_pupil_mm)
        names = ("disparity of infinity A, px", "scale B, px mm", "sensor to pupil δ, mm")
        for name, value, s in zip(names, values, sigma, strict=True):
            rows.append((f"{name} ({quality})", f"{float(np.asarray(value)):.4g}", f"{s:.2g}", "fitted on the axis"))
    lens = calibration.lens
    rows += [
        ("focal length, mm", f"{lens.focal_length_mm:.3f}", "", "derived: 1/f = 1/z_if + 1/z_of"),
        ("focal length, px", f"{lens.camera_matrix[0, 0]:.1f}", "", "tilted boards, scaled by the ruler"),
        ("radial distortion k1", f"{lens.distortion[0]:+.4f}", "", "tilted boards"),
        ("in focus at", calibration.in_focus_text, "", "derived: B / A + δ"),
        ("baseline b, mm", f"{calibration.baseline_mm:.3f}", "", "derived: 2 μ B / F"),
    ]
    if result.ruler is not None:
        pupil, sigma_mm = f"{result.ruler.sensor_to_pupil_mm:.2f}", f"{result.ruler.sigma_mm:.2g}"
        rows += [
            ("sensor to pupil δ, mm", pupil, sigma_mm, "ruler against poses"),
            ("scale of the focal length", f"{result.ruler.scale:.5f}", "", "ruler against poses"),
        ]
    return TextTable("d = A - B / (distance - δ)", ("parameter", "value", "±", "how"), rows)


def provenance_table(result: CalibrationResult) -> TextTable:
    """List how the camera file was made."""
    known = result.calibration.provenance
    rows = [
        (str(name).replace("_", " "), _text(value)) for name, value in known.items() if name not in ("boards", "notes")
    ]
    return TextTable("", ("", ""), [*rows, ("chromaperture", metadata.version("chromaperture"))])


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k}: {_text(v)}" for k, v in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"

"""Tables of the calibration report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib import metadata

import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.evaluation.verdict import QUALITY, board_errors, depth_accuracy, qualities


@dataclass(frozen=True)
class Table:
    """A table whose cells are text."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def round_distances(near_mm: float, far_mm: float) -> np.ndarray:
    """Return at most nine round distances within a range; mm."""
    span = far_mm - near_mm
    step = next((s for s in (10, 20, 50, 100, 200, 250, 500, 1000, 2000) if span / s <= 8), 5000)
    return np.arange(np.ceil(near_mm / step) * step, far_mm + 1e-6, step)


def steps(result: CalibrationResult) -> Table:
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
    return Table("Depth per step of disparity on the axis, and one standard deviation over the frame", head, rows)


def boards(result: CalibrationResult) -> Table:
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
    return Table(f"Boards at quality {QUALITY}; errors are measured minus ruler", head, rows)


def unmixing(result: CalibrationResult) -> Table:
    """List the colours of the film and the rows of M^-1."""
    calibration = result.calibration
    rows = [(f"{name} film, colour", *(f"{v:.3f}" for v in color)) for name, color in calibration.film.filters.items()]
    rows += [
        (f"M⁻¹, {name}", *(f"{v:+.3f}" for v in row))
        for name, row in zip(calibration.aperture.views, calibration.unmixing, strict=False)
    ]
    return Table("White light through the film, 1 = full scale, and the unmixing (Eq. 1)", ("", "R", "G", "B"), rows)


def parameters(result: CalibrationResult) -> Table:
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
    return Table("d = A - B / (distance - δ)", ("parameter", "value", "±", "how"), rows)


def provenance(result: CalibrationResult) -> Table:
    """List how the camera file was made."""
    known = result.calibration.provenance
    rows = [
        (str(name).replace("_", " "), _text(value)) for name, value in known.items() if name not in ("boards", "notes")
    ]
    return Table("", ("", ""), [*rows, ("chromaperture", metadata.version("chromaperture"))])


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k}: {_text(v)}" for k, v in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"

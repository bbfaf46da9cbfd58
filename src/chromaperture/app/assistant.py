"""The calibration assistant: what is there, what to photograph next and why, and what it is worth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.app.forecast import BOARD_SIGMA_PX, Forecast, Gain, Lens, best_gain, forecast
from chromaperture.app.messages import collect_warnings
from chromaperture.app.session_folder import Kind, SessionFolder
from chromaperture.calibration.fit_response import disparity_error
from chromaperture.calibration.session import Session, nominal_depth_model
from chromaperture.calibration.session_plan import PlannedSession
from chromaperture.capture.exif import read_exif
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.conversion import DepthModel
from chromaperture.evaluation.checks import Check
from chromaperture.evaluation.session_checks import (
    CheckedShot,
    Exposed,
    Reading,
    check_board,
    check_exposed,
    check_sheet,
    check_tilt,
    check_tone,
)
from chromaperture.optics.aperture import USUAL_FILM, design_named, made_of
from chromaperture.system.errors import InputError

CELLS = (6, 4)  # of the frame, in which corners are counted; chosen by hand
FEWEST_BOARDS, ENOUGH_BOARDS = 5, 12  # for fields over the frame (`CalibrationConfig.min_field_boards`); a good dozen
FEWEST_TILTS, ENOUGH_TILTS = 4, 8  # `chessboard.MIN_VIEWS`; a dozen is best
_WORTHWHILE = 0.05  # part of the error bar that a board must take off to be asked for; chosen by hand
_CURVE_BOARDS = 3  # from which the boards' own curve predicts the next one's disparity: it has two unknowns
_SIDE = 0.05  # of the focus distance: clearly off the focus; chosen by hand
_SAME = 0.02  # of the distance: the same place again; chosen by hand
_LEANS = {
    "left": "its left edge towards you", "right": "its right edge towards you", "top": "its top towards you",
    "bottom": "its bottom towards you",
}  # fmt: skip
_LEAN_DEG = 10.0  # from which a lean counts; chosen by hand


def check_shot(
    folder: SessionFolder,
    photograph: Path,
    kind: Kind,
    *,
    ruler_mm: float | None = None,
    sheet: str = "",
    exposure_ms: float | None = None,
) -> CheckedShot:
    """Check one photograph against the session; raises InputError where it cannot be read or a fact is missing."""
    session = folder.prepare(photograph)
    image, notes = read_for_check(session, photograph)
    if kind == "tilt":
        return check_tilt(image, session, notes=notes)
    if kind == "tone":
        return _check_exposure(folder, session, photograph, image, exposure_ms)
    if kind == "white":
        if sheet not in sheets_of(folder):
            raise InputError("which white sheet is this? Choose one of the list")
        with collect_warnings():  # of 8 bits, which is said of the photograph itself
            clear = session.white("open")
        return CheckedShot(Reading(), check_sheet(image, sheet, design=session.design, clear=clear))
    if ruler_mm is None or not 0 < ruler_mm < 1e6:
        raise InputError("give the distance from the sensor's mark to the board, in mm")
    curve = curve_so_far(folder, session)
    ends = (folder.facts.nearest_mm, folder.facts.farthest_mm)
    found = check_board(image, session, ruler_mm=ruler_mm, range_mm=ends, notes=notes, curve=curve)
    again = [known for known in folder.rulers_mm() if abs(known / ruler_mm - 1) < _SAME]
    if again:
        finding = f"there is a board at {again[0]:.0f} mm already"
        found.checks.append(Check("distance", "cannot tell", finding, "another distance tells more"))
    return found


def _check_exposure(
    folder: SessionFolder, session: Session, photograph: Path, image: np.ndarray, exposure_ms: float | None
) -> CheckedShot:
    """Check one of the photographs of a sheet at two exposures, against that whose exposure differs most."""
    if exposure_ms is not None and not 0 < exposure_ms < 1e7:
        raise InputError("give the exposure time in ms; 1/125 s is 8")
    exposure = exposure_ms if exposure_ms is not None else read_exif(photograph).exposure
    if exposure is None:
        raise InputError("this file does not state its exposure time: give it in ms; 1/125 s is 8")
    typed = exposure_ms is not None
    reading, checks = Reading(width_px=session.sensor.width_px, exposure=exposure, is_exposure_typed=typed), []
    others = [s for s in folder.of_kind("tone") if s.reading.exposure and s.reading.is_exposure_typed == typed]
    checks.append(check_exposed(image))
    if checks[0].verdict == "warn":
        return CheckedShot(reading, checks)
    if not others:
        if folder.of_kind("tone"):
            raise InputError("give the exposure times of both photographs, or of none")
        finding = "the first exposure; nothing can be said of one alone"
        checks.append(Check("tone curve", "cannot tell", finding, "now the same at a half or a quarter of it"))
        return CheckedShot(reading, checks)
    other = max(others, key=lambda s: abs(np.log(float(s.reading.exposure or 1) / exposure)))
    before = read_for_check(session, folder.folder / other.file)[0]
    found, curve = check_tone(Exposed(before, float(other.reading.exposure or 1)), Exposed(image, exposure),
                              design=session.design, is_encoded=folder.is_encoded)  # fmt: skip
    if curve is not None:
        points = zip(curve.level.tolist(), curve.exponent.tolist(), strict=True)
        reading = replace(reading, tone=tuple(points))
    return CheckedShot(reading, sorted([*found, *checks], key=lambda check: check.verdict != "warn"))


def readings(folder: SessionFolder, session: Session, kind: Kind) -> list[Reading]:
    """Return what was read of the kept photographs of a kind, in px of the session's pictures as they are now."""
    return [shot.reading.at_width(session.sensor.width_px) for shot in folder.of_kind(kind)]


def curve_so_far(folder: SessionFolder, session: Session) -> DepthModel | None:
    """Fit d = A - B / z to the boards so far, delta being the engraved lens's; None where they are too few."""
    boards = readings(folder, session, "board")
    known = [r for r in boards if np.isfinite(r.disparity_px) and r.ruler_mm]
    nominal = nominal_depth_model(session)
    z = np.array([float(r.ruler_mm or 0) for r in known]) - float(nominal.sensor_to_pupil_mm)
    if len(known) < _CURVE_BOARDS or np.ptp(1 / z) * z.min() < _SIDE:
        return None
    slope, offset = np.polyfit(1 / z, [r.disparity_px for r in known], 1)
    return None if slope >= 0 else DepthModel(float(offset), float(-slope), float(nominal.sensor_to_pupil_mm))


def sheets_of(folder: SessionFolder) -> dict[str, str]:
    """Return the white sheets of a session, and what each is photographed through."""
    facts = folder.facts
    sheets = PlannedSession(facts.design, facts.nearest_mm, facts.farthest_mm, facts.focus_mm).white_sheets
    return {"open": sheets["open"]} | sheets  # first: the others are compared with it


def lens_of(folder: SessionFolder, session: Session) -> Lens:
    """Return what the forecast needs."""
    aperture, nominal = made_of(design_named(session.design), USUAL_FILM), nominal_depth_model(session)
    curve = curve_so_far(folder, session)
    return Lens(
        model=curve or nominal,
        aperture=aperture,
        reach=view_reach(design_named(session.design)),
        focal_px=float(nominal.sensor_to_pupil_mm) / session.sensor.pixel_pitch_mm,
        board_mm=(max(session.inner_corners) - 1) * session.square_mm,
        ruler_error_mm=session.ruler_error_mm,
        near_mm=folder.facts.nearest_mm,
        far_mm=folder.facts.farthest_mm,
        board_sigma_px=_board_sigma(readings(folder, session, "board"), curve),
        scale_error=disparity_error(session.design, folder.tone_error or 0.0),
    )


def _board_sigma(boards: list[Reading], curve: DepthModel | None) -> float:
    """Return the scatter of the boards about their own curve, px, where they are enough to show it."""
    known = [r for r in boards if np.isfinite(r.disparity_px)]
    if curve is None or len(known) < FEWEST_BOARDS:
        return BOARD_SIGMA_PX
    z = np.array([float(r.ruler_mm or 0) for r in known]) - float(curve.sensor_to_pupil_mm)
    line = float(curve.infinity_disparity_px) - float(curve.scale_px_mm) / z
    off = np.array([r.disparity_px for r in known]) - line
    rms = float(np.sqrt((off**2).sum() / (len(known) - 2)))  # two parameters were fitted
    return float(np.clip(rms, BOARD_SIGMA_PX / 5, BOARD_SIGMA_PX))


def state(folder: SessionFolder) -> dict[str, Any]:
    """Return everything that the page shows of a session."""
    session, boards = folder.session(), folder.rulers_mm()
    tilts, have = folder.of_kind("tilt"), {Path(s.file).stem for s in folder.of_kind("white")}
    sheets = [{"name": n, "through": through, "have": n in have} for n, through in sheets_of(folder).items()]
    predicted, gain = None, None
    if session is not None:
        lens = lens_of(folder, session)
        scatter = [r.pixel_sigma_px for r in readings(folder, session, "board")]
        pixel = [sigma for sigma in scatter if np.isfinite(sigma)]
        predicted = forecast(lens, boards, len(tilts), pixel_sigma_px=float(np.median(pixel)) if pixel else 0.0)
        gain = best_gain(lens, boards, len(tilts), candidates(folder))
    cells = frame_cells(folder, session)
    return {
        "name": folder.folder.name,
        "facts": folder.facts.model_dump(),
        "size_px": folder.size_px,
        "holding": folder.holding and folder.holding.model_dump(),
        "shots": [_shown(shot) for shot in folder.shots],
        "sheets": sheets,
        "cells": cells.tolist(),
        "covered": float((cells > 0).mean()),
        "boards_mm": boards,
        "tone": [list(point) for shot in folder.of_kind("tone") for point in shot.reading.tone],
        "tone_error": folder.tone_error,
        "leans": [list(shot.reading.lean_deg) for shot in tilts],
        "forecast": None if predicted is None else _rows(predicted),
        "gain": None if gain is None else vars(gain),
        "next": advice(folder, cells, gain),
        "ready": len(boards) >= FEWEST_BOARDS and len(tilts) >= FEWEST_TILTS,
    }


def candidates(folder: SessionFolder) -> list[float]:
    """Return distances at which a board could be photographed: even in disparity, over the range."""
    facts = folder.facts
    plan = PlannedSession(facts.design, facts.nearest_mm, facts.farthest_mm, facts.focus_mm, distances=16)
    free = [d for d in plan.distances_mm if all(abs(known / d - 1) >= _SAME for known in folder.rulers_mm())]
    return [float(d) for d in free or plan.distances_mm]


def frame_cells(folder: SessionFolder, session: Session | None) -> np.ndarray:
    """Count the corners of the tilted boards, which fix the lens, in cells of the frame; (rows, columns) int."""
    columns, rows = CELLS
    cells = np.zeros((rows, columns), int)
    if session is None:
        return cells
    for reading in readings(folder, session, "tilt"):
        corners = reading.corners_px
        if corners is not None:
            x = (corners[:, 0] / session.sensor.width_px * columns).astype(int).clip(0, columns - 1)
            y = (corners[:, 1] / session.sensor.height_px * rows).astype(int).clip(0, rows - 1)
            np.add.at(cells, (y, x), 1)
    return cells


def advice(folder: SessionFolder, cells: np.ndarray, gain: Gain | None) -> dict[str, Any]:
    """Say what to photograph next, and why."""
    facts, boards = folder.facts, folder.rulers_mm()
    focus = facts.focus_mm
    if not boards:
        return _board(focus, "There it is sharp: the best place to check light, board and focus before the others.")
    if not any(at < (1 - _SIDE) * focus for at in boards):
        return _board(facts.nearest_mm, "Nothing stands nearer than the focus yet: near and far curves differ, and "
                      "this shows whether the film is the right way round.")  # fmt: skip
    if not any(at > (1 + _SIDE) * focus for at in boards):
        return _board(facts.farthest_mm, "Nothing stands beyond the focus yet; out there the error bar is largest.")
    worth = gain is not None and gain.after < (1 - _WORTHWHILE) * gain.before
    if gain is not None and len(boards) < FEWEST_BOARDS:
        return _gaining(gain)
    tilts = len(folder.of_kind("tilt"))
    if tilts < FEWEST_TILTS:
        return _tilt(folder, cells)
    have = {Path(shot.file).stem for shot in folder.of_kind("white")}
    for name, through in sheets_of(folder).items():
        if name not in have:
            return _sheet(name, through)
    if folder.is_encoded and folder.tone_error is None:
        return _exposures(folder)
    if gain is not None and worth and len(boards) < ENOUGH_BOARDS:  # a calibration is possible; this is a better one
        return _gaining(gain)
    if tilts < ENOUGH_TILTS:
        return _tilt(folder, cells)
    return {"kind": "calibrate", "text": "Calibrate now", "why": "Everything that is needed is there. More boards at "
            "new distances still help a little."}  # fmt: skip


def _board(at_mm: float, why: str) -> dict[str, Any]:
    at = 10 * round(at_mm / 10)
    return {"kind": "board", "ruler_mm": at, "text": f"The board, square to the camera, at about {at} mm", "why": why}


def _gaining(gain: Gain) -> dict[str, Any]:
    return _board(gain.at_mm, "Of all distances this one takes most off the error bar: the curve's worst from "
                  f"{gain.before:.1%} to {gain.after:.1%} of the distance.")  # fmt: skip


def _tilt(folder: SessionFolder, cells: np.ndarray) -> dict[str, Any]:
    """Ask for the lean that is missing most, where the frame is empty."""
    counts = dict.fromkeys(_LEANS, 0)
    for shot in folder.of_kind("tilt"):
        left, top = shot.reading.lean_deg
        counts["left"] += left > _LEAN_DEG
        counts["right"] += left < -_LEAN_DEG
        counts["top"] += top > _LEAN_DEG
        counts["bottom"] += top < -_LEAN_DEG
    lean = min(counts, key=lambda name: counts[name])
    row, column = np.unravel_index(int(cells.argmin()), cells.shape)
    heights, sides = ("above", "", "", "below"), ("left of", "left of", "", "", "right of", "right of")
    place = " and ".join(w for w in (heights[row], sides[column]) if w) or "in"
    where = f"{place} the middle of the picture"
    empty = float((cells == 0).mean())
    why = "Leaning boards fix the lens: its focal length and its distortion."
    if empty:
        why += f" {empty:.0%} of the frame has not seen one."
    return {"kind": "tilt", "text": f"The board leaning by about 20 degrees, {_LEANS[lean]}, {where}", "why": why}


def _sheet(name: str, through: str) -> dict[str, Any]:
    why = {"open": "It is what the films are compared with."}.get(
        name, "The colours of this film separate the views; without its sheet, usual film is assumed."
    )
    return {"kind": "white", "sheet": name, "text": f"White paper in even light, filling the frame, through {through}",
            "why": why}  # fmt: skip


def _exposures(folder: SessionFolder) -> dict[str, Any]:
    """Ask for a sheet at two exposures: cameras that write 8 bits have a tone curve, which is only assumed."""
    taken = folder.of_kind("tone")
    text = "White paper, filling the frame, exposed as bright as it may be without being too bright"
    if taken:
        text = "The same paper, nothing moved, at a quarter or a half of the exposure"
    return {"kind": "tone", "text": text, "why": "Files of 8 bits have a tone curve that cannot be switched off. Two "
            "exposures tell whether it is the assumed one; the error bars allow for what is found."}  # fmt: skip


def _shown(shot: Any) -> dict[str, Any]:
    return {
        "file": shot.file,
        "kind": shot.kind,
        "ruler_mm": shot.reading.ruler_mm,
        "usable": all(check.verdict != "warn" for check in shot.checks),
        "checks": [shown_check(check) for check in shot.checks],
    }


def shown_check(check: Check) -> dict[str, str]:
    """Return a check as the page shows it."""
    return {"name": check.name, "verdict": check.verdict, "finding": check.finding, "advice": check.advice}


def _rows(predicted: Forecast) -> dict[str, list[float]]:
    return {
        "distance_mm": predicted.distance_mm.tolist(),
        "pixel_mm": predicted.pixel_mm.tolist(),
        "calibration_mm": predicted.calibration_mm.tolist(),
        "total_mm": predicted.total_mm.tolist(),
    }


def read_for_check(session: Session, path: Path) -> tuple[np.ndarray, list[str]]:
    """Read a photograph of a session; returns it and what reading it warned of; raises InputError."""
    with collect_warnings() as notes:
        image = session.read(path)
    return image, notes()

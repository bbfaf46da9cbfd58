"""Calibrate a camera from a session folder (paper section 3.4)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.calibration.assemble_camera import assemble_camera, origin
from chromaperture.calibration.calibrate_blur import LayerEvidence, calibrate_blur, fit_layers, lens_moves
from chromaperture.calibration.chessboard import Intrinsics
from chromaperture.calibration.curves import (
    Evidence,
    curve_without_blur,
    fit_curve,
    fit_curves,
    weaknesses,
    with_accurate,
    without_outliers,
)
from chromaperture.calibration.fit_fields import DepthFit
from chromaperture.calibration.fit_response import disparity_error, with_response
from chromaperture.calibration.flat_boards import with_order_found
from chromaperture.calibration.options import DEFAULT, Cache, CalibrationConfig, Progress, silent
from chromaperture.calibration.place_boards import BoardDistances, PlacedBoards, measure_pinhole, place_boards
from chromaperture.calibration.read_boards import BoardMeasurement, grid, measure_again, measure_boards, pixel_sigma
from chromaperture.calibration.rendered_boards import rendered_nonlinearity
from chromaperture.calibration.session import Session, nominal_depth_model, read_session
from chromaperture.calibration.white_sheets import FILM_ERROR, measure_white_sheets, unmeasured_film
from chromaperture.capture.picture_header import same_frame
from chromaperture.depth.field import DepthField, degree_of, with_scale_error
from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import MATCHED_SIZE, resized
from chromaperture.settings.methods import QUALITIES, Quality
from chromaperture.system.errors import InputError

_FAR_OFF = 0.5  # of a ruler, which no board that was measured in mm is off by; chosen by hand


@dataclass(frozen=True)
class CalibrationResult:
    """A camera and the evidence for it."""

    calibration: Calibration  # of the pictures that were matched, see `Session`; all px below are theirs
    fits: Mapping[Quality, DepthFit]  # the curve on the axis, with its covariance
    notes: Sequence[str]  # a sentence for everything that was missing or weak
    session: Session  # decoded as its boards show; noise that was measured is in ``calibration.sensor``
    residual_px: Mapping[Quality, np.ndarray]  # (boards, h, w) float32: measured minus fitted on the grid; NaN unknown
    # (boards,) float64: robust standard deviation of a pixel's disparity about the median residual of its board
    pixel_sigma_px: Mapping[Quality, np.ndarray]
    intrinsics: Intrinsics | None  # None where there were too few tilted boards
    tilts: Mapping[str, np.ndarray]  # (N, 2) float32, px: corners of the tilted boards, by file name
    evidence: Evidence  # the measurements that the curves were fitted to
    layers: LayerEvidence | None = None  # those for the curve of ``accurate``; None without a lens blur
    config: CalibrationConfig = field(default_factory=CalibrationConfig)

    @property
    def boards(self) -> list[BoardMeasurement]:
        """What was measured on each board."""
        return self.evidence.boards

    @property
    def outliers(self) -> Mapping[str, str]:
        """Boards that contradict the others, by file name, with a sentence each."""
        return self.evidence.outliers

    @property
    def ruler(self) -> BoardDistances | None:
        """Ruler against poses; None where there were too few poses."""
        return self.evidence.distances if np.isfinite(self.ruler_residual_mm).any() else None

    @property
    def ruler_residual_mm(self) -> np.ndarray:
        """Ruler minus the distance by pose, (boards,) float64, mm; NaN where there is no pose."""
        return self.evidence.distances.residual_mm

    @property
    def grid_x_px(self) -> np.ndarray:
        """Image positions of the columns of the boards' grids, (w,) float64."""
        return grid(self.calibration.sensor.width_px, self.calibration.sensor.width_px)

    @property
    def grid_y_px(self) -> np.ndarray:
        """Image positions of the rows of the boards' grids, (h,) float64."""
        return grid(self.calibration.sensor.height_px, self.calibration.sensor.width_px)

    @property
    def camera(self) -> Calibration:
        """The camera of the photographs as they are: what a camera file holds."""
        return resized(self.calibration, *self.session.photograph_size_px)


def calibrate_session(
    folder: str | Path,
    config: CalibrationConfig = DEFAULT,
    *,
    lens_from: Calibration | None = None,
    command: str | None = None,
    progress: Progress = silent,
    keep_in: str | Path | None = None,
) -> CalibrationResult:
    """Calibrate the camera of a session folder.

    ``folder``: laid out as ``docs/calibration-session.md`` shows; ``lens_from``: the same lens at the same focus, for a
    session without tilted boards or with few boards: its pinhole is used, and its blur is the start of the fit of the
    blur; ``command``: command line, for the camera file's provenance; ``progress``: called with the name of the step,
    the number done, and the total; ``keep_in``: folder for measurements of single photographs, from which an
    interrupted run resumes. Raises InputError: something is missing or invalid; the message names it.
    """
    cache = Cache(None if keep_in is None else Path(keep_in))
    session = read_session(folder)
    if not session.square_mm:
        raise InputError(f"{session.folder} is a session of flat boards, which `calibrate_flat_boards` calibrates")
    order_notes: tuple[str, ...] = ()
    if session.sensor.dual_pixel is not None:
        session, order_notes = with_order_found(session)
        config = dataclasses.replace(config, lens_blur=False)  # of ramps, which chessboards do not tell
    lens_from = _at_size_of(session, lens_from)
    lens = lens_from.blur if lens_from else None
    pinhole = measure_pinhole(session, lens_from, cache=cache, progress=progress)
    session, tone_notes = with_response(session, pinhole.corners)
    sheets = measure_white_sheets(session)
    placed = place_boards(session, pinhole, config)
    session = dataclasses.replace(session, square_mm=placed.square_mm)
    nominal = dict.fromkeys(QUALITIES, DepthField.constant(nominal_depth_model(session)))
    draft = assemble_camera(session, sheets, placed.intrinsics, nominal, config, rulers_mm=_near_truth(session, placed))
    boards = measure_boards(session, draft, pinhole, placed, cache=cache, progress=progress)
    everything = Evidence(sheets.sensor, boards, placed.distances, session.ruler_error_mm, np.ones(len(boards), bool))
    selected = without_outliers(everything, "paper")
    boards = selected.boards
    shifted = fit_curves(selected, config, progress=progress)
    start = dataclasses.replace(draft, depth=with_accurate(shifted, draft.design))
    blurred = calibrate_blur(start, session, selected, config, lens=lens, cache=cache, progress=progress)
    moves = lens_moves(blurred.camera)
    matched = dataclasses.replace(blurred.camera, channel_moves_px=moves)
    if moves is not None:
        boards = measure_again(boards, session, matched, cache=cache, progress=progress)
        selected = dataclasses.replace(selected, boards=boards)
    rendered = rendered_nonlinearity(matched, session, selected, config, cache=cache, progress=progress)
    evidence = dataclasses.replace(selected, rendered=rendered)
    curves = shifted if moves is None and not rendered else fit_curves(evidence, config, progress=progress)
    fields = {**with_accurate(curves, draft.design), "accurate": blurred.camera.depth["accurate"]}
    depth = {quality: with_scale_error(field, _scale_error(session)) for quality, field in fields.items()}
    residuals = {quality: curve.residual_px.astype(np.float32) for quality, curve in curves.items()}
    of_steps = [step.notes for step in (sheets, pinhole, placed, blurred)] + [curve.notes for curve in curves.values()]
    fits = {quality: curve.fit for quality, curve in curves.items()}
    result = CalibrationResult(
        calibration=assemble_camera(
            session,
            sheets,
            placed.intrinsics,
            depth,
            config,
            blur=blurred.camera.blur,
            channel_moves_px=moves,
            rulers_mm=[board.ruler_mm for board, is_used in zip(boards, evidence.used, strict=True) if is_used],
        ),
        fits=fits,
        notes=(*order_notes, *tone_notes, *chain(*of_steps), *_weaknesses(session, evidence, fits)),
        session=dataclasses.replace(session),  # without the boards that it keeps
        residual_px=residuals,
        pixel_sigma_px={quality: pixel_sigma(residual) for quality, residual in residuals.items()},
        intrinsics=placed.intrinsics,
        tilts={path.name: pinhole.corners[path] for path in session.tilts if path in pinhole.corners},
        evidence=evidence,
        layers=blurred.layers,
        config=config,
    )
    made_from = origin(session, sheets, config, command=command, lens_from=lens_from)
    camera = dataclasses.replace(result.calibration, provenance=made_from | _figures(result))
    return dataclasses.replace(result, calibration=camera)


def _near_truth(session: Session, placed: PlacedBoards) -> list[float]:
    """Return the rulers without those that are off by half, in inches or with a 0 too many: they widen every search."""
    rulers, residuals = list(session.boards.values()), placed.distances.residual_mm
    return [ruler for ruler, off in zip(rulers, residuals, strict=True) if not abs(off) > _FAR_OFF * ruler]


def _at_size_of(session: Session, lens_from: Calibration | None) -> Calibration | None:
    """Return another design's camera in the session's pixels; as it is where it is not of that aspect."""
    size = (session.sensor.width_px, session.sensor.height_px)
    if lens_from is None or not same_frame((lens_from.sensor.width_px, lens_from.sensor.height_px), size):
        return lens_from
    full = (lens_from.sensor.width_px, lens_from.sensor.height_px) == session.photograph_size_px
    return resized(lens_from, *size) if full else lens_from


def _weaknesses(session: Session, evidence: Evidence, fits: Mapping[Quality, DepthFit]) -> tuple[str, ...]:
    """Return a sentence for a tone curve that is not known, for every outlier, and for what the boards do not tell."""
    tone, notes = _tone_error(session), [*evidence.outliers.values()]
    if tone:
        says = f"decoded light grows with the power 1 +- {session.tone_error:.2f} of the exposure: "
        notes.insert(0, f"{says}every error bar allows for {tone:.1%} of the disparity")
    return (*notes, *weaknesses(evidence, fits, at_infinity=session.focuses_at_infinity))


def _figures(result: CalibrationResult) -> dict[str, Any]:
    """Figures of the fit for the camera file."""
    sensor, residuals = result.calibration.sensor, result.fits["real-time"].residual_mm
    return {
        MATCHED_SIZE: [sensor.width_px, sensor.height_px],
        "field_degree": degree_of(len(result.calibration.depth["real-time"].scale_px_mm)),
        "intrinsics_rms_px": result.intrinsics.rms_px if result.intrinsics else None,
        "rms_on_axis_mm": {quality: round(fit.rms_mm, 2) for quality, fit in result.fits.items()},
        "boards": [
            {"file": board.name, "ruler_mm": float(board.ruler_mm), "residual_mm": round(float(residual), 2)}
            for board, residual in zip(result.boards, residuals, strict=True)
        ],
        "notes": list(result.notes),
    }


def _tone_error(session: Session) -> float:
    """Return the relative error of all disparities by the tone curve that the session's photographs were found with."""
    return disparity_error(session.design, session.tone_error)


def _scale_error(session: Session) -> float:
    """Return the relative error of all disparities that no board shows: by the tone curve, and by film not measured."""
    return float(np.hypot(_tone_error(session), FILM_ERROR if unmeasured_film(session) else 0.0))


def leave_one_out(result: CalibrationResult, board: int, qualities: Sequence[Quality] = QUALITIES) -> Calibration:
    """Return the camera as calibrated without one board, which it can then measure independently.

    Only the depth curves of ``qualities`` are fitted again: film, pinhole and lens blur hardly depend on one board.
    """
    evidence, camera = result.evidence.without(board), result.calibration
    fields = dict(camera.depth)
    scale_error = _scale_error(result.session)
    for quality in qualities:
        if quality == "accurate" and result.layers is not None:
            fields[quality] = fit_layers(result.layers, evidence.distances, evidence.used)
        else:
            curve = curve_without_blur(camera.design) if quality == "accurate" else quality
            fields[quality] = fit_curve(evidence, curve, result.config).field
        fields[quality] = with_scale_error(fields[quality], scale_error)
    return dataclasses.replace(camera, depth=fields)

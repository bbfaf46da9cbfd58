"""Calibrate a camera from a session folder (paper section 3.4)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.calibration.assemble_camera import assemble_camera, curve_without_blur, nominal_depth_model
from chromaperture.calibration.board_distances import BoardDistances
from chromaperture.calibration.calibrate_blur import BlurredCamera, LayerEvidence, calibrate_blur, fit_layers
from chromaperture.calibration.calibration_config import DEFAULT, CalibrationConfig
from chromaperture.calibration.chessboard import Intrinsics
from chromaperture.calibration.curves import (
    Evidence,
    FittedCurve,
    fit_curve,
    fit_curves,
    weaknesses,
    with_accurate,
    without_outliers,
)
from chromaperture.calibration.fit_curve import DepthFit
from chromaperture.calibration.fit_response import with_response
from chromaperture.calibration.lens_moves import lens_moves
from chromaperture.calibration.measurement_cache import Store
from chromaperture.calibration.place_boards import Pinhole, PlacedBoards, measure_pinhole, place_boards
from chromaperture.calibration.progress import Progress, silent
from chromaperture.calibration.provenance import origin
from chromaperture.calibration.read_boards import BoardMeasurement, grid, measure_again, measure_boards, pixel_sigma
from chromaperture.calibration.rendered_boards import rendered_nonlinearity
from chromaperture.calibration.session import Session, read_session
from chromaperture.calibration.tone_curve import disparity_error
from chromaperture.calibration.white_sheets import WhiteSheets, measure_white_sheets
from chromaperture.capture.picture_header import same_frame
from chromaperture.depth.field import DepthField, degree_of, with_scale_error
from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import MATCHED_SIZE, resized
from chromaperture.settings.methods import QUALITIES, Quality


@dataclass(frozen=True)
class CalibrationResult:
    """A camera and the evidence for it."""

    calibration: Calibration  # of the pictures that were matched, see `Session`; all px below are theirs
    fits: Mapping[Quality, DepthFit]  # the curve on the axis, with its covariance
    boards: list[BoardMeasurement]
    notes: Sequence[str]  # a sentence for everything that was missing or weak
    session: Session  # decoded as its boards show; noise that was measured is in ``calibration.sensor``
    grid_x_px: np.ndarray  # (w,) float64: image positions of the boards' grids
    grid_y_px: np.ndarray  # (h,) float64
    residual_px: Mapping[Quality, np.ndarray]  # (boards, h, w) float32: measured minus fitted on the grid; NaN unknown
    # (boards,) float64: robust standard deviation of a pixel's disparity about the median residual of its board
    pixel_sigma_px: Mapping[Quality, np.ndarray]
    intrinsics: Intrinsics | None  # None where there were too few tilted boards
    tilts: Mapping[str, np.ndarray]  # (N, 2) float32, px: corners of the tilted boards, by file name
    ruler: BoardDistances | None  # ruler against poses; None where there were too few poses
    ruler_residual_mm: np.ndarray  # (boards,) float64, mm; ruler minus the distance by pose; NaN where there is no pose
    outliers: Mapping[str, str]  # boards that contradict the others, by file name, with a sentence each
    evidence: Evidence  # the measurements that the curves were fitted to
    layers: LayerEvidence | None = None  # those for the curve of ``accurate``; None without a lens blur
    config: CalibrationConfig = field(default_factory=CalibrationConfig)

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

    Parameters
    ----------
    folder : str or Path
        Laid out as ``docs/calibration-session.md`` shows.
    config : CalibrationConfig
    lens_from : Calibration, optional
        The same lens at the same focus, for a session without tilted boards or with few boards: its pinhole is used,
        and its blur is the start of the fit of the blur.
    command : str, optional
        Command line, for the camera file's provenance.
    progress : callable, optional
        Called with the name of the step, the number done, and the total.
    keep_in : str or Path, optional
        Folder for measurements of single photographs, from which an interrupted run resumes.

    Raises
    ------
    InputError
        Something is missing or invalid; the message names it.
    """
    store = Store(None if keep_in is None else Path(keep_in))
    session = read_session(folder)
    lens_from = _at_size_of(session, lens_from)
    lens = lens_from.blur if lens_from else None
    pinhole = measure_pinhole(session, lens_from, store=store, progress=progress)
    session, tone_notes = with_response(session, pinhole.corners)
    sheets = measure_white_sheets(session)
    placed = place_boards(session, pinhole, config)
    nominal = dict.fromkeys(QUALITIES, DepthField.constant(nominal_depth_model(session)))
    draft = assemble_camera(session, sheets, placed.intrinsics, nominal, config)
    boards = measure_boards(session, draft, pinhole, placed, store=store, progress=progress)
    everything = Evidence(sheets.sensor, boards, placed.distances, session.ruler_error_mm, np.ones(len(boards), bool))
    selected = without_outliers(everything, "paper")
    shifted = fit_curves(selected, config, progress=progress)
    start = dataclasses.replace(draft, depth=with_accurate(shifted, draft.design))
    blurred = calibrate_blur(start, session, selected, config, lens=lens, store=store, progress=progress)
    moves = lens_moves(blurred.camera)
    matched = dataclasses.replace(blurred.camera, channel_moves_px=moves)
    if moves is not None:
        boards = measure_again(boards, session, matched, store=store, progress=progress)
        selected = dataclasses.replace(selected, boards=boards)
    rendered = rendered_nonlinearity(matched, session, selected, config, store=store, progress=progress)
    evidence = dataclasses.replace(selected, rendered=rendered)
    curves = shifted if moves is None and not rendered else fit_curves(evidence, config, progress=progress)
    steps = _Steps(session, config, tone_notes, sheets, pinhole, placed, evidence, curves, blurred)
    depth = {**with_accurate(curves, draft.design), "accurate": blurred.camera.depth["accurate"]}
    depth = {quality: with_scale_error(curve, steps.tone) for quality, curve in depth.items()}
    made_from = origin(
        session.folder, steps.files, config, command=command, lens_from=lens_from, form=session.form,
        developed=sheets.developed,
    )  # fmt: skip
    camera = assemble_camera(
        session, sheets, placed.intrinsics, depth, config, blur=blurred.camera.blur, channel_moves_px=moves,
        provenance=made_from | steps.figures,
    )  # fmt: skip
    return steps.result(camera)


def _at_size_of(session: Session, lens_from: Calibration | None) -> Calibration | None:
    """Return another design's camera in the session's pixels; as it is where it is not of that aspect."""
    size = (session.sensor.width_px, session.sensor.height_px)
    if lens_from is None or not same_frame((lens_from.sensor.width_px, lens_from.sensor.height_px), size):
        return lens_from
    full = (lens_from.sensor.width_px, lens_from.sensor.height_px) == session.photograph_size_px
    return resized(lens_from, *size) if full else lens_from


@dataclass(frozen=True)
class _Steps:
    """What the steps returned, and what the camera file and the result hold of it."""

    session: Session
    config: CalibrationConfig
    tone_notes: tuple[str, ...]
    sheets: WhiteSheets
    pinhole: Pinhole
    placed: PlacedBoards
    evidence: Evidence
    curves: Mapping[Quality, FittedCurve]
    blurred: BlurredCamera

    @property
    def fits(self) -> dict[Quality, DepthFit]:
        return {quality: curve.fit for quality, curve in self.curves.items()}

    @property
    def tone(self) -> float:
        return _tone_error(self.session)

    @property
    def notes(self) -> tuple[str, ...]:
        curves = (note for curve in self.curves.values() for note in curve.notes)
        parts = (self.sheets, self.pinhole, self.placed, self.blurred)
        steps = (*self.tone_notes, *(note for part in parts for note in part.notes), *curves)
        if self.tone:
            steps = (*steps, f"decoded light grows with the power 1 +- {self.session.tone_error:.2f} of the exposure: "
                     f"every error bar allows for {self.tone:.1%} of the disparity")  # fmt: skip
        return (
            *steps,
            *self.evidence.outliers.values(),
            *weaknesses(self.evidence, self.fits, at_infinity=self.session.focuses_at_infinity),
        )

    @property
    def files(self) -> tuple[Path, ...]:
        """Everything that was read."""
        texts = (self.session.folder / name for name in ("session.toml", "distances.csv"))
        return (*texts, *self.session.boards, *self.session.tilts, *self.sheets.files)

    @property
    def figures(self) -> dict[str, Any]:
        """Figures of the fit for the camera file."""
        intrinsics, residuals = self.placed.intrinsics, self.fits["real-time"].residual_mm
        return {
            MATCHED_SIZE: [self.session.sensor.width_px, self.session.sensor.height_px],
            "field_degree": degree_of(len(self.curves["real-time"].field.scale_px_mm)),
            "intrinsics_rms_px": intrinsics.rms_px if intrinsics else None,
            "rms_on_axis_mm": {quality: round(fit.rms_mm, 2) for quality, fit in self.fits.items()},
            "boards": [
                {"file": board.name, "ruler_mm": float(board.ruler_mm), "residual_mm": round(float(residual), 2)}
                for board, residual in zip(self.evidence.boards, residuals, strict=True)
            ],
            "notes": list(self.notes),
        }

    def result(self, camera: Calibration) -> CalibrationResult:
        width, height, distances = camera.sensor.width_px, camera.sensor.height_px, self.placed.distances
        residuals = {quality: curve.residual_px.astype(np.float32) for quality, curve in self.curves.items()}
        corners = self.pinhole.corners
        return CalibrationResult(
            calibration=camera,
            fits=self.fits,
            boards=self.evidence.boards,
            notes=self.notes,
            session=self.session,
            grid_x_px=grid(width, width),
            grid_y_px=grid(height, width),
            residual_px=residuals,
            pixel_sigma_px={quality: pixel_sigma(residual) for quality, residual in residuals.items()},
            intrinsics=self.placed.intrinsics,
            tilts={path.name: corners[path] for path in self.session.tilts if path in corners},
            ruler=distances if np.isfinite(distances.residual_mm).any() else None,
            ruler_residual_mm=distances.residual_mm,
            outliers=self.evidence.outliers,
            evidence=self.evidence,
            layers=self.blurred.layers,
            config=self.config,
        )


def _tone_error(session: Session) -> float:
    """Return the relative error of all disparities by the tone curve that the session's photographs were found with."""
    return disparity_error(session.design, session.tone_error)


def leave_one_out(result: CalibrationResult, board: int, qualities: Sequence[Quality] = QUALITIES) -> Calibration:
    """Return the camera as calibrated without one board, which it can then measure independently.

    Only the depth curves of ``qualities`` are fitted again: film, pinhole and lens blur hardly depend on one board.
    """
    evidence, camera = result.evidence.without(board), result.calibration
    fields = dict(camera.depth)
    tone = _tone_error(result.session)
    for quality in qualities:
        if quality == "accurate" and result.layers is not None:
            fields[quality] = fit_layers(result.layers, evidence.distances, evidence.used)
        else:
            curve = curve_without_blur(camera.design) if quality == "accurate" else quality
            fields[quality] = fit_curve(evidence, curve, result.config).field
        fields[quality] = with_scale_error(fields[quality], tone)
    return dataclasses.replace(camera, depth=fields)

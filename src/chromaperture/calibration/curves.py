"""Depth curves from measured boards: fields over the frame where the boards suffice, else one curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from chromaperture.calibration.fit_fields import (
    DepthFit,
    check_scale,
    fit_depth_field,
    fit_depth_model,
    ranked_curves,
    with_local,
)
from chromaperture.calibration.options import DEFAULT, CalibrationConfig, Progress, reported, silent
from chromaperture.calibration.place_boards import BoardDistances, find_outliers
from chromaperture.calibration.read_boards import MEASURED, BoardMeasurement, grid
from chromaperture.color.unmixing import mixes_three_views
from chromaperture.depth.conversion import depth_to_disparity, disparity_to_depth
from chromaperture.depth.field import DepthField
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.model.camera_parts import CameraSensor
from chromaperture.optics.aperture import design_named
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError
from chromaperture.system.robust import robust_sigma

_THIN = 2  # every other point of the boards' grid enters the fit: neighbours have the matcher's window in common
# Boards on both sides reach beyond 0 by this disparity, or by this part of what they span (a phone's lens: 0.6 px).
_ONE_SIDE_PX = 0.3  # chosen by hand, not tuned
_ONE_SIDE_PART = 0.1  # chosen by hand, not tuned
_WEAK_FOCUS = 0.01  # relative standard deviation of the in-focus distance that earns a note; chosen by hand


@dataclass(frozen=True)
class Evidence:
    """The measurements on the boards of a session."""

    sensor: CameraSensor
    boards: list[BoardMeasurement]
    distances: BoardDistances
    ruler_error_mm: float
    used: np.ndarray  # (N,) bool; boards that the curves are fitted to
    # Boards that contradict the others, by file name, with a sentence each.
    outliers: Mapping[str, str] = field(default_factory=dict)
    # Measured on boards rendered with the blur of the lens, where that is known.
    rendered: Mapping[Quality, Nonlinearity] = field(default_factory=dict)

    @property
    def from_sensor_mm(self) -> np.ndarray:
        """Distance of every board from the sensor plane, by ruler and pose together; (N,) float64."""
        return self.distances.from_pupil_mm + self.distances.sensor_to_pupil_mm

    def without(self, board: int) -> Evidence:
        """Return the evidence with one board unused."""
        used = self.used.copy()
        used[board] = False
        return replace(self, used=used)


@dataclass(frozen=True)
class FittedCurve:
    """The depth curve of one quality, its agreement on the axis, its residuals on the boards' grids, and notes."""

    field: DepthField
    fit: DepthFit
    residual_px: np.ndarray
    notes: tuple[str, ...] = ()


def fit_on_axis(evidence: Evidence, quality: Quality) -> DepthFit:
    """Fit one curve to the middle of the frame; raises InputError where the boards do not determine it."""
    disparity = np.array([board.disparity_px[quality] for board in evidence.boards])
    sigma = evidence.distances.covariance.diagonal()[:-1]
    return fit_depth_model(
        evidence.from_sensor_mm,
        np.where(evidence.used, disparity, np.nan),
        disparity_sigma_px=np.array([board.sigma_px[quality] for board in evidence.boards]),
        distance_sigma_mm=float(np.sqrt(np.median(sigma))),
        sensor_to_pupil_mm=evidence.distances.sensor_to_pupil_mm,
        sensor_to_pupil_sigma_mm=evidence.distances.sigma_mm,
    )


def without_outliers(evidence: Evidence, quality: Quality) -> Evidence:
    """Find boards whose ruler contradicts their corners or, where they have none, the fitted curve.

    Outliers without corners become unused. Those with corners stay, and their ruler says what the pose does.
    """
    names = [board.name for board in evidence.boards]
    ruler = np.array([board.ruler_mm for board in evidence.boards])
    by_pose = ruler - evidence.distances.residual_mm
    no_pose = ~np.isfinite(by_pose)
    fit = fit_on_axis(evidence, quality)
    slope_px_mm = np.abs(depth_to_disparity(ruler + 1.0, fit.model) - depth_to_disparity(ruler, fit.model))
    by_curve = robust_sigma(fit.residual_px) / slope_px_mm  # includes the matcher's nonlinearity, no board's fault
    sigma = np.where(no_pose, np.hypot(evidence.ruler_error_mm, by_curve), evidence.distances.residual_sigma_mm)
    measured = np.where(no_pose, ruler + fit.residual_mm, by_pose)
    outliers = find_outliers(names, ruler, measured, sigma, ruler_error_mm=evidence.ruler_error_mm)
    is_outlier = np.isin(names, list(outliers))
    boards = [
        replace(board, ruler_mm=float(stands)) if moved else board
        for board, stands, moved in zip(evidence.boards, by_pose, is_outlier & ~no_pose, strict=True)
    ]
    return replace(evidence, boards=boards, used=evidence.used & ~(no_pose & is_outlier), outliers=outliers)


def fit_curves(
    evidence: Evidence, config: CalibrationConfig, *, progress: Progress = silent
) -> dict[Quality, FittedCurve]:
    """Fit the depth curves of all qualities that match shifted views; see `fit_curve`."""
    return {quality: fit_curve(evidence, quality, config) for quality in reported(MEASURED, "depth curves", progress)}


def with_accurate(curves: Mapping[Quality, FittedCurve], design: str) -> dict[Quality, DepthField]:
    """Return the depth fields of all qualities, ``accurate`` without a lens blur."""
    fields = {quality: curve.field for quality, curve in curves.items()}
    return {**fields, "accurate": fields[curve_without_blur(design)]}


def fit_curve(evidence: Evidence, quality: Quality, config: CalibrationConfig = DEFAULT) -> FittedCurve:
    """Fit fields over the frame and the matcher's nonlinearity, or one curve where the boards are too few.

    Raises InputError where the boards do not determine even one curve.
    """
    sensor, boards = evidence.sensor, evidence.boards
    size = (sensor.width_px, sensor.height_px)
    axis = fit_on_axis(evidence, quality)
    columns, rows = (grid(n, sensor.width_px) for n in size)
    y, x = np.meshgrid(rows, columns, indexing="ij")
    grids = np.stack([board.grid_px[quality] for board in boards])
    samples = (thin(x), thin(y), thin(grids), evidence.distances)
    known = evidence.rendered.get(quality)
    for degree in config.field_degrees if evidence.used.sum() >= config.min_field_boards else ():
        options: dict[str, Any] = {"size_px": size, "degree": degree, "boards": evidence.used}
        for curve in ranked_curves(*samples, **options, known=known):
            try:
                fields, _ = fit_depth_field(*samples, **options, nonlinearity=curve)
                check_scale(fields, size)
            except InputError:  # B runs away, or a nonlinearity that is not monotonic
                continue
            if config.per_pixel:
                fields = with_local(
                    fields, columns, rows, grids, evidence.distances, size_px=size, boards=evidence.used
                )
            return FittedCurve(fields, *_agreement(evidence, fields, quality, x, y))
    note = f"{quality}: too little to fit fields over the frame, one depth curve for all of it"
    fitted = depth_to_disparity(evidence.from_sensor_mm, axis.model)
    return FittedCurve(DepthField.constant(axis.model), axis, grids - fitted[:, None, None], (note,))


def _agreement(
    evidence: Evidence, field: DepthField, quality: Quality, x: np.ndarray, y: np.ndarray
) -> tuple[DepthFit, np.ndarray]:
    """Compare the medians over the frame with the boards' distances; return the fit on the axis and all residuals."""
    size = (evidence.sensor.width_px, evidence.sensor.height_px)
    model = field.at(x, y, *size)
    errors, residuals = [], []
    for board, distance in zip(evidence.boards, evidence.from_sensor_mm, strict=True):
        disparity = board.grid_px[quality]
        depth = disparity_to_depth(disparity, model)[0].astype(float)
        residuals.append(disparity - depth_to_disparity(distance, model))
        errors.append((_median(depth - distance), _median(residuals[-1])))
    residual_mm, residual_px = np.array(errors).T
    used = residual_mm[evidence.used]
    fit = DepthFit(field.on_axis(*size), residual_mm, residual_px, float(np.sqrt(np.nanmean(used**2))))
    return fit, np.stack(residuals)


def thin(grids: np.ndarray) -> np.ndarray:
    """Return every other point of a grid, or of many, as (..., P)."""
    cut = grids[..., ::_THIN, ::_THIN]
    return cut.reshape(*cut.shape[:-2], -1)


def _median(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def weaknesses(evidence: Evidence, fits: Mapping[Quality, DepthFit], *, at_infinity: bool = False) -> tuple[str, ...]:
    """Return a sentence for every parameter that the boards determine badly.

    ``at_infinity``: the lens is focused at infinity, where no board can stand.
    """
    if at_infinity:
        return ()
    disparity = np.array([board.disparity_px["real-time"] for board in evidence.boards])[evidence.used]
    found = []
    lowest, highest = np.nanmin(disparity), np.nanmax(disparity)
    least = min(_ONE_SIDE_PX, _ONE_SIDE_PART * (highest - lowest))
    if lowest > -least or highest < least:
        side, other = ("beyond", "nearer than") if lowest > -least else ("nearer than", "beyond")
        found.append(
            f"all boards stand {side} the focus: the in-focus distance is extrapolated; photograph two or three "
            f"boards {other} the focus as well"
        )
    model = fits["real-time"].model
    relative = np.sqrt(max(float(np.asarray(model.covariance)[0, 0]), 0.0)) / float(model.infinity_disparity_px)
    if relative > _WEAK_FOCUS:
        sigma = relative * float(model.in_focus_mm)
        found.append(f"the in-focus distance is known to {sigma:.0f} mm only: photograph more boards, near and far")
    return tuple(found)


def curve_without_blur(design: str) -> Quality:
    """Return the quality whose curve serves ``accurate`` without a lens blur: the one that matches the same views."""
    return "real-time" if mixes_three_views(design_named(design)) else "paper"

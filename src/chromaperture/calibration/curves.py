"""Depth curves of a camera from its measured boards: fields where the boards suffice, one curve where they do not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from chromaperture.calibration.board_distances import BoardDistances, find_outliers
from chromaperture.calibration.choose_curve import ranked_curves
from chromaperture.calibration.fit_curve import DepthFit, fit_depth_model
from chromaperture.calibration.fit_fields import fit_depth_field
from chromaperture.calibration.fit_local_fields import with_local
from chromaperture.calibration.read_boards import BoardMeasurement, grid
from chromaperture.camera_file import Sensor
from chromaperture.config import Quality
from chromaperture.depth.conversion import depth_to_disparity, disparity_to_depth
from chromaperture.depth.field import DepthField
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.errors import InputError

_FIELD_DEGREES = (4, 2)  # the second where the first is drawn by noise
_LEAST_SCALE = 0.1  # of the median: vignetting cuts the rim of the pupil, where an open design has its film
_MIN_FIELD_BOARDS = 5
_THIN = 2  # points of the grid
_ONE_SIDE_PX = 0.3


@dataclass(frozen=True)
class Evidence:
    """What the boards of a session say, and which of them are believed.

    Attributes
    ----------
    sensor : Sensor
    boards : list of BoardMeasurement
    distances : BoardDistances
    ruler_error_mm : float
    believed : (N,) bool
    per_pixel : bool
        Curves are free at every place of the frame instead of smooth over it.
    rendered : dict of quality to Nonlinearity
        What the matcher reads besides the shift on boards rendered with the lens's blur, where that is known.
    """

    sensor: Sensor
    boards: list[BoardMeasurement]
    distances: BoardDistances
    ruler_error_mm: float
    believed: np.ndarray
    per_pixel: bool = False
    rendered: Mapping[Quality, Nonlinearity] = field(default_factory=dict)

    @property
    def from_sensor_mm(self) -> np.ndarray:
        """Distance of every board from the sensor plane, ruler and pose together; (N,) float64."""
        return self.distances.from_pupil_mm + self.distances.sensor_to_pupil_mm

    def without(self, board: int) -> Evidence:
        """Give the evidence with one board not believed."""
        believed = self.believed.copy()
        believed[board] = False
        return replace(self, believed=believed)


@dataclass(frozen=True)
class FittedCurve:
    """The depth curve of one quality, its agreement on the axis, and its residuals on the boards' grids."""

    field: DepthField
    fit: DepthFit
    residual_px: np.ndarray


def fit_on_axis(evidence: Evidence, quality: Quality) -> DepthFit:
    """Fit one curve to the middle of the frame; raises InputError where the boards do not fix it."""
    used = evidence.believed
    disparity = np.array([board.disparity_px[quality] for board in evidence.boards])
    sigma = evidence.distances.covariance.diagonal()[:-1]
    return fit_depth_model(
        evidence.from_sensor_mm,
        np.where(used, disparity, np.nan),
        disparity_sigma_px=np.array([board.sigma_px[quality] for board in evidence.boards]),
        distance_sigma_mm=float(np.sqrt(np.median(sigma))),
        sensor_to_pupil_mm=evidence.distances.sensor_to_pupil_mm,
        sensor_to_pupil_sigma_mm=evidence.distances.sigma_mm,
    )


def doubt(evidence: Evidence, names: list[str], quality: Quality) -> tuple[Evidence, dict[str, str]]:
    """Find boards that contradict the others: by their corners, or where they have none by the fitted curve.

    Returns
    -------
    evidence : Evidence
        With boards of unknown distance not believed any more. A board with corners keeps its place: its pose tells it.
    outliers : dict of file name to sentence
    """
    ruler = np.array([board.ruler_mm for board in evidence.boards])
    by_pose = ruler - evidence.distances.residual_mm
    blind = ~np.isfinite(by_pose)
    fit = fit_on_axis(evidence, quality)
    slope = np.abs(_slope_px(fit, ruler))
    typical = 1.4826 * np.nanmedian(np.abs(fit.residual_px))  # a matcher's nonlinearity is no board's fault
    by_curve = ruler + fit.residual_mm
    sigma = np.where(blind, np.hypot(evidence.ruler_error_mm, typical / slope), evidence.distances.residual_sigma_mm)
    outliers = find_outliers(
        names, ruler, np.where(blind, by_curve, by_pose), sigma, ruler_error_mm=evidence.ruler_error_mm
    )
    believed = evidence.believed & ~(blind & np.isin(names, list(outliers)))
    return replace(evidence, believed=believed), outliers


def _slope_px(fit: DepthFit, depth_mm: np.ndarray) -> np.ndarray:
    """Change of the disparity with depth; (N,) px per mm."""
    return np.asarray(depth_to_disparity(depth_mm + 1.0, fit.model) - depth_to_disparity(depth_mm, fit.model))


def fit_curve(evidence: Evidence, quality: Quality, notes: list[str]) -> FittedCurve:
    """Fit fields over the frame and the matcher's nonlinearity, as far as the boards carry them.

    Parameters
    ----------
    evidence : Evidence
    quality : Quality
    notes : list of str
        Gets a sentence about everything that is weak.

    Raises
    ------
    InputError
        The boards do not fix even one curve.
    """
    sensor, boards = evidence.sensor, evidence.boards
    axis = fit_on_axis(evidence, quality)
    columns, rows = (grid(n, sensor.width_px) for n in (sensor.width_px, sensor.height_px))
    y, x = np.meshgrid(rows, columns, indexing="ij")
    grids = np.stack([board.grid_px[quality] for board in boards])
    count = int(evidence.believed.sum())
    where = (thin(x), thin(y), thin(grids), evidence.distances)
    size = (sensor.width_px, sensor.height_px)
    for degree in _FIELD_DEGREES if count >= _MIN_FIELD_BOARDS else ():
        known = evidence.rendered.get(quality)
        for curve in ranked_curves(*where, size_px=size, degree=degree, boards=evidence.believed, known=known):
            try:
                fields, _ = fit_depth_field(
                    *where, size_px=size, degree=degree, nonlinearity=curve, boards=evidence.believed
                )
                scale = np.asarray(fields.model(*size).scale_px_mm)
            except InputError:  # B not positive somewhere, or a nonlinearity that turns back
                continue
            if np.min(scale) > _LEAST_SCALE * np.median(scale):
                if evidence.per_pixel:
                    fields = with_local(
                        fields, columns, rows, grids, evidence.distances, size_px=size, boards=evidence.believed
                    )
                return FittedCurve(fields, *_agreement(evidence, fields, quality, x, y))
    notes.append(f"{quality}: too little to fit fields over the frame, one depth curve for all of it")
    fitted = depth_to_disparity(evidence.from_sensor_mm, axis.model)
    return FittedCurve(DepthField.constant(axis.model), axis, grids - fitted[:, None, None])


def _agreement(
    evidence: Evidence, field: DepthField, quality: Quality, x: np.ndarray, y: np.ndarray
) -> tuple[DepthFit, np.ndarray]:
    """Compare the medians of the whole frame with the boards' distances; the curve is that of the middle."""
    size = (evidence.sensor.width_px, evidence.sensor.height_px)
    model = field.at(x, y, *size)
    errors, residuals = [], []
    for board, distance in zip(evidence.boards, evidence.from_sensor_mm, strict=True):
        disparity = board.grid_px[quality]
        depth = disparity_to_depth(disparity, model)[0].astype(float)
        residuals.append(disparity - depth_to_disparity(distance, model))
        errors.append((_median(depth - distance), _median(residuals[-1])))
    residual_mm, residual_px = np.array(errors).T
    used = residual_mm[evidence.believed]
    fit = DepthFit(field.on_axis(*size), residual_mm, residual_px, float(np.sqrt(np.nanmean(used**2))))
    return fit, np.stack(residuals)


def thin(grids: np.ndarray) -> np.ndarray:
    """Take every other point of a grid, or of many, as (..., P): neighbours share the matcher's window anyway."""
    cut = grids[..., ::_THIN, ::_THIN]
    return cut.reshape(*cut.shape[:-2], -1)


def _median(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def weaknesses(evidence: Evidence, fits: dict[Quality, DepthFit]) -> list[str]:
    """Say which parameters the boards do not fix well, a sentence each."""
    disparity = np.array([board.disparity_px["real-time"] for board in evidence.boards])[evidence.believed]
    found = []
    if np.nanmin(disparity) > -_ONE_SIDE_PX or np.nanmax(disparity) < _ONE_SIDE_PX:
        side, other = ("beyond", "nearer than") if np.nanmin(disparity) > -_ONE_SIDE_PX else ("nearer than", "beyond")
        found.append(
            f"all boards stand {side} the focus: the in-focus distance is extrapolated; photograph two or three "
            f"boards {other} the focus as well"
        )
    model = fits["real-time"].model
    sigma_focus = np.sqrt(max(float(np.asarray(model.covariance)[0, 0]), 0.0)) * model.in_focus_mm
    share = sigma_focus / float(np.asarray(model.infinity_disparity_px))
    if share > 0.01 * model.in_focus_mm:
        found.append(f"the in-focus distance is known to {share:.0f} mm only: photograph more boards, near and far")
    return found

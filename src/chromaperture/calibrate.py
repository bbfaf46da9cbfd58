"""From a session folder to a camera file: the depth curve on the axis, then its fields over the frame.

The steps are those of paper section 3.4: pinhole calibration, boards at measured distances, fit of the curve.
"""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chromaperture.boards import MEASURED, BoardMeasurement, grid, measure_board, spread
from chromaperture.calibration import Calibration, Film, Lens
from chromaperture.color.unmixing import ideal_unmixing
from chromaperture.config import QUALITIES, MatcherConfig, Quality
from chromaperture.depth.chessboard import (
    MIN_VIEWS,
    Intrinsics,
    board_distance,
    centered_pinhole,
    find_corners,
    fit_intrinsics,
)
from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.field import DepthField, degree_of, fit_depth_field
from chromaperture.depth.fit import DepthFit, RulerFit, fit_depth_model, fit_ruler
from chromaperture.disparity.estimate import colour_spaces
from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture, centroids, channel_transmission, design_named
from chromaperture.session import Session, read_session

_FIELD_DEGREES = (4, 2)  # the second where the first is drawn by noise
_LEAST_SCALE = 0.1  # of the median: vignetting cuts the rim of the pupil, where an open design has its film
_MIN_FIELD_BOARDS = 5
_RANGE_MARGIN = (0.9, 1.3)  # the working range reaches a little beyond the boards

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class CalibrationResult:
    """A camera and the evidence for it.

    Attributes
    ----------
    calibration : Calibration
    fits : dict of quality to DepthFit
        The curve on the axis, with its covariance.
    boards : list of BoardMeasurement
    notes : list of str
        What was missing or weak, a sentence each.
    session : Session
    grid_x_px : (w,) float64, grid_y_px : (h,) float64
        Where the boards' grids lie in the frame.
    residual_px : dict of quality to (boards, h, w) float32, px
        Measured minus fitted disparity on the grid, at the ruler's distance; NaN unknown.
    spread_px : dict of quality to (boards,) float64, px
        Robust standard deviation of one pixel's disparity about its board's own median residual.
    intrinsics : Intrinsics or None
        None where there were too few tilted boards.
    tilts : dict of str to (N, 2) float32, px
        Corners of the tilted boards, by file name.
    ruler : RulerFit or None
        Ruler against poses; None where there were too few poses.
    ruler_residual_mm : (boards,) float64, mm
        Ruler minus the distance by pose; NaN where there is no pose.
    outliers : dict of str to str
        Boards that contradict the others, by file name, with a sentence each.
    """

    calibration: Calibration
    fits: Mapping[Quality, DepthFit]
    boards: list[BoardMeasurement]
    notes: list[str]
    session: Session
    grid_x_px: np.ndarray
    grid_y_px: np.ndarray
    residual_px: Mapping[Quality, np.ndarray]
    spread_px: Mapping[Quality, np.ndarray]
    intrinsics: Intrinsics | None
    tilts: Mapping[str, np.ndarray]
    ruler: RulerFit | None
    ruler_residual_mm: np.ndarray
    outliers: Mapping[str, str]


def calibrate_session(
    folder: str | Path,
    *,
    lens_from: Calibration | None = None,
    progress: Progress = lambda what, done, total: None,
) -> CalibrationResult:
    """Calibrate the camera of a session folder.

    Parameters
    ----------
    folder : str or Path
        Laid out as ``docs/calibration-session.md`` shows.
    lens_from : Calibration, optional
        The same lens at the same focus, for a session without tilted boards of its own.
    progress : callable, optional
        Called with what is being done, how many are done, and of how many.

    Returns
    -------
    CalibrationResult

    Raises
    ------
    InputError
        Something is missing or does not fit; the message names it.
    """
    session = read_session(folder)
    aperture = design_named(session.design)
    ideal_unmixing(aperture)  # refuses designs without parallax before any work is done
    notes: list[str] = []
    film = _measure_film(session, aperture, notes)
    intrinsics, corners = _measure_intrinsics(session, lens_from, notes, progress)
    guess = _nominal_depth_model(session, aperture)
    start = DepthField.constant(guess)
    draft = _assemble(session, film, intrinsics, {quality: start for quality in QUALITIES}, {})

    poses = [_pose(session, corners.get(path), intrinsics) for path in session.boards]
    rulers = np.array(list(session.boards.values()))
    unscaled = intrinsics
    pupil, intrinsics = _measure_pupil(session, rulers, np.array(poses), guess, intrinsics, notes)
    from_sensor = pupil.scale * np.array(poses) + pupil.sensor_to_pupil_mm
    boards: list[BoardMeasurement] = []
    fits: dict[Quality, DepthFit] = {}
    for i, path in enumerate(session.boards):
        progress("board disparity", i, len(session.boards))
        board = measure_board(session, draft, path)
        boards.append(dataclasses.replace(board, corners_px=corners.get(path), pose_mm=float(from_sensor[i])))
    progress("board disparity", len(boards), len(boards))
    for quality in MEASURED:
        fits[quality] = fit_depth_model(
            rulers,
            np.array([board.disparity_px[quality] for board in boards]),
            disparity_sigma_px=np.array([board.sigma_px[quality] for board in boards]),
            distance_sigma_mm=max(session.ruler_error_mm / 2, 0.1),  # "errs by up to": two standard deviations
            sensor_to_pupil_mm=pupil.sensor_to_pupil_mm,
            sensor_to_pupil_sigma_mm=pupil.sigma_mm,
        )
    fields = {quality: _fit_field(session, boards, quality, fits[quality], notes) for quality in MEASURED}
    # The optimiser matches the same views with the same score and only pools them better: it needs no curve of its own,
    # and refitting one to its boards changed nothing.
    first = colour_spaces(aperture, draft.unmixing, MatcherConfig.preset("accurate"))[0]
    fields["accurate"] = fields["paper" if np.array_equal(first, draft.unmixing) else "real-time"]
    provenance = {
        "command": f"chromaperture calibrate {session.folder.name}",
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "field_degree": degree_of(len(fields["real-time"].scale_px_mm)),
        "intrinsics_rms_px": intrinsics.rms_px if intrinsics else None,
        "rms_on_axis_mm": {quality: round(fit.rms_mm, 2) for quality, fit in fits.items()},
        "boards": [
            {"file": board.name, "ruler_mm": float(ruler), "residual_mm": round(float(residual), 2)}
            for board, ruler, residual in zip(boards, rulers, fits["real-time"].residual_mm, strict=True)
        ],
        "notes": notes,
    }
    calibration = _assemble(session, film, intrinsics, fields, provenance)
    residuals = {quality: _residuals(calibration, boards, quality) for quality in MEASURED}
    return CalibrationResult(
        calibration=calibration,
        fits=fits,
        boards=boards,
        notes=notes,
        session=session,
        grid_x_px=grid(session.sensor.width_px),
        grid_y_px=grid(session.sensor.height_px),
        residual_px=residuals,
        spread_px={quality: spread(residual) for quality, residual in residuals.items()},
        intrinsics=intrinsics,
        tilts={path.name: corners[path] for path in session.tilts if path in corners},
        ruler=pupil if unscaled is not None and np.isfinite(from_sensor).any() else None,
        ruler_residual_mm=rulers - from_sensor,
        outliers={},
    )


def _residuals(calibration: Calibration, boards: list[BoardMeasurement], quality: Quality) -> np.ndarray:
    """Measured minus fitted disparity on the grid, at the ruler's distances; (boards, h, w) float32, px."""
    sensor = calibration.sensor
    model = calibration.depth_model(quality)
    shape = (sensor.height_px, sensor.width_px)
    rows, columns = (grid(n).astype(int) for n in shape)
    infinity, scale = (
        np.broadcast_to(np.asarray(m), shape)[np.ix_(rows, columns)]
        for m in (model.infinity_disparity_px, model.scale_px_mm)
    )
    fitted = [infinity - scale / (board.ruler_mm - model.sensor_to_pupil_mm) for board in boards]
    measured = [board.grid_px[quality] for board in boards]
    return (np.stack(measured) - np.stack(fitted)).astype(np.float32)


def _measure_film(session: Session, aperture: Aperture, notes: list[str]) -> Film:
    """Colours of the filters from the white sheets; ideal film where a sheet is missing."""
    clear = session.white("open")
    if clear is None:
        notes.append("no white sheet through the open pupil: colours are relative to full scale")
        clear = np.ones(3)
    colors, ideal = {}, []
    for name in aperture.views:
        measured = session.sheet(name)
        if measured is None:
            ideal.append(name)
            measured = np.array(aperture.filter_named(name).transmission) * clear
        colors[name] = measured
    if ideal:
        notes.append(f"no sheet of {', '.join(ideal)} film: assumed ideal, so the views mix a little")
    white = session.white(session.design)
    if white is None:
        notes.append("no white sheet through the aperture: the colour balance is computed from the film")
        film = aperture.with_film({n: c / clear for n, c in colors.items()})
        white = np.maximum(channel_transmission(film), 1e-3) * clear
    return Film(colors, clear, white)


def _measure_intrinsics(
    session: Session, lens_from: Calibration | None, notes: list[str], progress: Progress
) -> tuple[Intrinsics | None, dict[Path, np.ndarray]]:
    """Pinhole from the tilted boards; corners of every board that has them."""
    paths = [*session.tilts, *session.boards]
    corners = {}
    for i, path in enumerate(paths):
        progress("chessboards", i, len(paths))
        found = find_corners(session.read(path)[..., 1], session.inner_corners)
        if found is not None:
            corners[path] = found
    progress("chessboards", len(paths), len(paths))
    if lens_from is not None:
        return Intrinsics(lens_from.lens.camera_matrix, lens_from.lens.distortion, 0.0), corners
    tilted = [corners[p] for p in session.tilts if p in corners]
    if len(tilted) < MIN_VIEWS:
        notes.append(f"{len(tilted)} tilted boards with corners: intrinsics are nominal, points may be off by a few %")
        return None, corners
    size = (session.sensor.width_px, session.sensor.height_px)
    return fit_intrinsics(tilted, size, session.inner_corners, session.square_mm), corners


def _nominal_depth_model(session: Session, aperture: Aperture) -> DepthModel:
    """Thin-lens curve from the engraved focal length and f-number, the start of everything."""
    f, z_f = session.nominal_focal_length_mm, session.focused_at_about_mm
    z_f -= f  # from the pupil
    if z_f <= f:
        raise InputError(f"focused_at_about_mm = {session.focused_at_about_mm:g} lies inside the focal length")
    image_distance = f * z_f / (z_f - f)
    reach = np.linalg.norm(centroids(aperture, ideal_unmixing(aperture)), axis=1).mean()
    baseline = reach * f / session.nominal_f_number  # 2 r_c, with the pupil radius f / 2N
    scale = baseline * image_distance / (2 * session.sensor.pixel_pitch_mm)
    return DepthModel(scale / z_f, scale, image_distance)


def _assemble(
    session: Session, film: Film, intrinsics: Intrinsics | None, depth: Mapping[Quality, DepthField], provenance: dict
) -> Calibration:
    sensor = session.sensor
    if intrinsics is None:
        nominal = _nominal_depth_model(session, design_named(session.design))
        focal_px = float(nominal.sensor_to_pupil_mm) / sensor.pixel_pitch_mm
        matrix = centered_pinhole(focal_px, (sensor.width_px, sensor.height_px))
        intrinsics = Intrinsics(matrix, np.zeros(5), 0.0)
    image_distance = float(intrinsics.camera_matrix[0, 0]) * sensor.pixel_pitch_mm
    curve = depth["real-time"].on_axis(sensor.width_px, sensor.height_px)
    z_f = float(curve.scale_px_mm) / float(curve.infinity_disparity_px)
    rulers = list(session.boards.values()) or [session.focused_at_about_mm]
    return Calibration(
        design=session.design,
        sensor=sensor,
        lens=Lens(
            focal_length_mm=1 / (1 / image_distance + 1 / z_f),  # paper section 3.4: 1/f = 1/z_if + 1/z_of
            camera_matrix=intrinsics.camera_matrix,
            distortion=intrinsics.distortion,
            f_number=session.nominal_f_number,
        ),
        film=film,
        depth=depth,
        near_mm=min(rulers) * _RANGE_MARGIN[0],
        far_mm=max(rulers) * _RANGE_MARGIN[1],
        provenance=provenance,
    )


def _pose(session: Session, corners: np.ndarray | None, intrinsics: Intrinsics | None) -> float:
    """Distance of a board from the pupil by its own corners, mm; NaN where they were not found."""
    if corners is None or intrinsics is None:
        return np.nan
    return board_distance(corners, intrinsics, session.inner_corners, session.square_mm)


def _fit_field(
    session: Session, boards: list[BoardMeasurement], quality: Quality, fit: DepthFit, notes: list[str]
) -> DepthField:
    """Fields of the depth curve over the frame; one curve for all of it where the boards do not suffice."""
    size = (session.sensor.width_px, session.sensor.height_px)
    grids = np.stack([board.grid_px[quality] for board in boards])
    delta = float(np.asarray(fit.model.sensor_to_pupil_mm))
    rows, columns = grid(session.sensor.height_px), grid(session.sensor.width_px)
    inverse, y, x = np.meshgrid(
        [1 / (board.ruler_mm - delta) for board in boards], rows, columns, indexing="ij"
    )
    if len(boards) >= _MIN_FIELD_BOARDS:
        for degree in _FIELD_DEGREES:
            field, _ = fit_depth_field(
                x.ravel(), y.ravel(), inverse.ravel(), grids.ravel().astype(float), np.ones(grids.size),
                size_px=size, degree=degree, sensor_to_pupil_mm=delta, covariance=fit.model.covariance,
            )  # fmt: skip
            scale = field.model(*size).scale_px_mm
            if np.min(scale) > _LEAST_SCALE * np.median(scale):
                return field
    notes.append(f"{quality}: too little to fit fields over the frame, one depth curve for all of it")
    return DepthField.constant(fit.model)


def _measure_pupil(
    session: Session,
    ruler_mm: np.ndarray,
    pose_mm: np.ndarray,
    guess: DepthModel,
    intrinsics: Intrinsics | None,
    notes: list[str],
) -> tuple[RulerFit, Intrinsics | None]:
    """Distance from sensor to pupil from ruler and poses, which also corrects the focal length in px."""
    seen = np.isfinite(pose_mm)
    if intrinsics is None or seen.sum() < MIN_VIEWS:
        notes.append("no board poses: the distance from sensor to pupil is the lens's image distance to about 10 mm")
        return RulerFit(1.0, float(np.median(guess.sensor_to_pupil_mm)), 10.0), intrinsics
    ruler = fit_ruler(ruler_mm[seen], pose_mm[seen], ruler_sigma_mm=session.ruler_error_mm / 2)
    matrix = intrinsics.camera_matrix.copy()
    matrix[[0, 1], [0, 1]] *= ruler.scale
    return ruler, Intrinsics(matrix, intrinsics.distortion, intrinsics.rms_px)

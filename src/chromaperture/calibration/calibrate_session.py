"""From a session folder to a camera file: the depth curve on the axis, then its fields over the frame.

The steps are those of paper section 3.4: pinhole calibration, boards at measured distances, fit of the curve.
"""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from chromaperture.calibration.board_distances import BoardDistances, check_units, fit_distances
from chromaperture.calibration.chessboard import (
    MIN_VIEWS,
    Intrinsics,
    board_distance,
    find_corners,
    fit_intrinsics,
)
from chromaperture.calibration.choose_curve import MANY_BOARDS
from chromaperture.calibration.curves import Evidence, FittedCurve, doubt, fit_curve, weaknesses
from chromaperture.calibration.fit_blur import Progress
from chromaperture.calibration.fit_curve import DepthFit
from chromaperture.calibration.lens_blur import LayerEvidence, add_blur, fit_layers
from chromaperture.calibration.measurement_cache import Store
from chromaperture.calibration.read_boards import MEASURED, BoardMeasurement, grid, measure_board, spread
from chromaperture.calibration.rendered_boards import rendered_nonlinearity
from chromaperture.calibration.session import Session, read_session
from chromaperture.calibration.white_sheets import measure_film, with_noise
from chromaperture.camera_file import Calibration, Film, Lens
from chromaperture.color.unmixing import ideal_unmixing, view_reach
from chromaperture.config import QUALITIES, Quality
from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.field import DepthField, degree_of
from chromaperture.disparity.views import view_spaces
from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture, design_named
from chromaperture.optics.pinhole import centered_pinhole

_PUPIL_SIGMA_MM = 10.0  # of the guess that the pupil lies one image distance before the sensor
_CORNER_SIGMA = 0.03  # px, and as a share of the blur radius
_RANGE_MARGIN = (0.9, 1.3)  # the working range reaches a little beyond the boards


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
    ruler : BoardDistances or None
        Ruler against poses; None where there were too few poses.
    ruler_residual_mm : (boards,) float64, mm
        Ruler minus the distance by pose; NaN where there is no pose.
    outliers : dict of str to str
        Boards that contradict the others, by file name, with a sentence each.
    evidence : Evidence
        What the curves were fitted to.
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
    ruler: BoardDistances | None
    ruler_residual_mm: np.ndarray
    outliers: Mapping[str, str]
    evidence: Evidence
    layers: LayerEvidence | None = None


def calibrate_session(
    folder: str | Path,
    *,
    lens_from: Calibration | None = None,
    lens_blur: bool = True,
    per_pixel: bool = False,
    progress: Progress = lambda what, done, total: None,
    keep_in: str | Path | None = None,
) -> CalibrationResult:
    """Calibrate the camera of a session folder.

    Parameters
    ----------
    folder : str or Path
        Laid out as ``docs/calibration-session.md`` shows.
    lens_from : Calibration, optional
        The same lens at the same focus, for a session without tilted boards of its own or with few boards: its
        pinhole is taken over, and its blur is where the fit of the blur starts.
    lens_blur : bool
        Fit the lens's blur too, which takes most of the time; quality ``accurate`` gains most of its accuracy by it.
    per_pixel : bool
        Leave the depth curves of shifted views free at every place of the frame, drawn to smooth fields where boards
        say little; the lens's blur is smooth in any case.
    progress : callable, optional
        Called with what is being done, how many are done, and of how many.
    keep_in : str or Path, optional
        Folder for what was measured in each photograph: a run that was interrupted goes on from there.

    Returns
    -------
    CalibrationResult

    Raises
    ------
    InputError
        Something is missing or does not fit; the message names it.
    """
    session = read_session(folder)
    store = Store(None if keep_in is None else Path(keep_in))
    aperture = design_named(session.design)
    ideal_unmixing(aperture)  # refuses designs without parallax before any work is done
    notes: list[str] = []
    session = dataclasses.replace(session, sensor=with_noise(session, notes))
    film = measure_film(session, aperture, notes)
    intrinsics, corners = _measure_intrinsics(session, lens_from, notes, progress, store)
    guess = _nominal_depth_model(session, aperture)
    start = DepthField.constant(guess)
    draft = _assemble(session, film, intrinsics, {quality: start for quality in QUALITIES}, {})

    paths = list(session.boards)
    names = [path.name for path in paths]
    rulers = np.array([session.boards[path] for path in paths])
    poses = np.array([_pose(session, corners.get(path), intrinsics) for path in paths])
    check_units(rulers, poses, where="distances.csv")
    distances = fit_distances(
        rulers,
        poses,
        ruler_sigma_mm=max(session.ruler_error_mm / np.sqrt(3), 0.1),  # "errs by up to"
        pose_sigma_mm=np.array([_pose_sigma(session, guess, corners.get(path)) for path in paths]),
        sensor_to_pupil_mm=float(guess.sensor_to_pupil_mm),
        sensor_to_pupil_sigma_mm=_PUPIL_SIGMA_MM,
    )
    intrinsics = _rescaled(intrinsics, distances, notes)
    boards: list[BoardMeasurement] = []
    for i, path in enumerate(paths):
        progress("board disparity", i, len(paths))
        board = measure_board(session, draft, path, store=store)
        by_pose = float(rulers[i] - distances.residual_mm[i])
        boards.append(dataclasses.replace(board, corners_px=corners.get(path), pose_mm=by_pose))
    progress("board disparity", len(boards), len(boards))

    everything = Evidence(
        session.sensor, boards, distances, session.ruler_error_mm, np.ones(len(boards), bool), per_pixel
    )
    evidence, outliers = doubt(everything, names, "paper")
    doubts: list[str] = []
    curves = {quality: fit_curve(evidence, quality, doubts) for quality in MEASURED}
    calibration, layers = _assemble(session, film, intrinsics, _by_quality(curves, draft), {}), None
    if lens_blur:
        used = evidence.believed
        lens = lens_from.blur if lens_from else None
        calibration, layers = add_blur(
            calibration, session, distances, used, notes, lens=lens, store=store, progress=progress
        )
        if used.sum() < MANY_BOARDS:
            rendered = rendered_nonlinearity(calibration, session, distances, used, store=store, progress=progress)
            evidence, doubts = dataclasses.replace(evidence, rendered=rendered), []
            curves = {quality: fit_curve(evidence, quality, doubts) for quality in MEASURED}
    notes += doubts
    fits = {quality: curve.fit for quality, curve in curves.items()}
    notes += [*outliers.values(), *weaknesses(evidence, fits)]
    fields = _by_quality(curves, draft)
    if layers is not None:
        fields["accurate"] = calibration.depth["accurate"]
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
    residuals = {quality: curve.residual_px.astype(np.float32) for quality, curve in curves.items()}
    assembled = _assemble(session, film, intrinsics, fields, provenance)
    calibration = dataclasses.replace(assembled, blur=calibration.blur)
    return CalibrationResult(
        calibration=calibration,
        fits=fits,
        boards=boards,
        notes=notes,
        session=session,
        grid_x_px=grid(session.sensor.width_px, session.sensor.width_px),
        grid_y_px=grid(session.sensor.height_px, session.sensor.width_px),
        residual_px=residuals,
        spread_px={quality: spread(residual) for quality, residual in residuals.items()},
        intrinsics=intrinsics,
        tilts={path.name: corners[path] for path in session.tilts if path in corners},
        ruler=distances if np.isfinite(distances.residual_mm).any() else None,
        ruler_residual_mm=distances.residual_mm,
        outliers=outliers,
        evidence=evidence,
        layers=layers,
    )


def leave_one_out(
    result: CalibrationResult, board: int, qualities: Sequence[Quality] = QUALITIES
) -> Calibration:
    """Give the camera as it would be without one board, whose depth can then be measured as that of any scene.

    Only the depth curves of ``qualities`` are fitted anew: film, pinhole and lens blur do not depend on one board.
    """
    evidence, calibration = result.evidence.without(board), result.calibration
    fields = dict(calibration.depth)
    for quality in qualities:
        if quality == "accurate" and result.layers is not None:
            fields[quality] = fit_layers(result.layers, evidence.distances, evidence.believed)
        else:
            curve = _like_accurate(calibration) if quality == "accurate" else quality
            fields[quality] = fit_curve(evidence, curve, []).field
    return dataclasses.replace(calibration, depth=fields)


def _by_quality(curves: Mapping[Quality, FittedCurve], draft: Calibration) -> dict[Quality, DepthField]:
    """Give the field of every quality, as far as shifted views tell."""
    fields = {quality: curve.field for quality, curve in curves.items()}
    return {**fields, "accurate": fields[_like_accurate(draft)]}


def _like_accurate(camera: Calibration) -> Quality:
    """Name the quality whose curve the optimiser shares.

    It matches the same views with the same score and only pools them better: it needs no curve of its own, and
    refitting one to its boards changed nothing.
    """
    first = view_spaces(camera.aperture, camera.unmixing, "both")[0].rows
    return "paper" if np.array_equal(first, camera.unmixing) else "real-time"


def _measure_intrinsics(
    session: Session, lens_from: Calibration | None, notes: list[str], progress: Progress, store: Store
) -> tuple[Intrinsics | None, dict[Path, np.ndarray]]:
    """Pinhole from the tilted boards; corners of every board that has them."""
    paths = [*session.tilts, *session.boards]
    corners = {}
    for i, path in enumerate(paths):
        progress("chessboards", i, len(paths))
        found = store.arrays(path, ("corners", session.inner_corners, session.sensor), partial(_corners, session, path))
        if found["corners"].size:
            corners[path] = found["corners"]
    progress("chessboards", len(paths), len(paths))
    if lens_from is not None:
        size = (lens_from.sensor.width_px, lens_from.sensor.height_px)
        if size != (session.sensor.width_px, session.sensor.height_px):
            raise InputError(
                f"the camera file to take the lens from is of {size[0]}x{size[1]} px and the session of "
                f"{session.sensor.width_px}x{session.sensor.height_px}: calibrate the lens again at this size"
            )
        return Intrinsics(lens_from.lens.camera_matrix, lens_from.lens.distortion, 0.0), corners
    tilted = [corners[p] for p in session.tilts if p in corners]
    if len(tilted) < MIN_VIEWS:
        notes.append(f"{len(tilted)} tilted boards with corners: intrinsics are nominal, points may be off by a few %")
        return None, corners
    size = (session.sensor.width_px, session.sensor.height_px)
    return fit_intrinsics(tilted, size, session.inner_corners, session.square_mm), corners


def _corners(session: Session, path: Path) -> dict[str, np.ndarray]:
    """Corners of one board; none of them where the board is not found."""
    found = find_corners(session.read(path)[..., 1], session.inner_corners)
    return {"corners": np.zeros((0, 2), np.float32) if found is None else found}


def _nominal_depth_model(session: Session, aperture: Aperture) -> DepthModel:
    """Thin-lens curve from the engraved focal length and f-number, the start of everything."""
    f, z_f = session.nominal_focal_length_mm, session.focused_at_about_mm
    z_f -= f  # from the pupil
    if z_f <= f:
        raise InputError(f"focused_at_about_mm = {session.focused_at_about_mm:g} lies inside the focal length")
    image_distance = f * z_f / (z_f - f)
    reach = view_reach(aperture)
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


def _pose_sigma(session: Session, guess: DepthModel, corners: np.ndarray | None) -> float:
    """How well a board's corners tell its distance, mm.

    Blur moves corners, the outermost above all, by a share of its radius; what that does to the distance depends on
    how large the board is in the picture.
    """
    if corners is None:
        return np.inf
    aperture = design_named(session.design)
    reach = view_reach(aperture)
    width_px = float(np.ptp(corners, axis=0).max())
    length_mm = (max(session.inner_corners) - 1) * session.square_mm
    depth_mm = length_mm * float(guess.sensor_to_pupil_mm) / session.sensor.pixel_pitch_mm / width_px
    disparity = guess.infinity_disparity_px - guess.scale_px_mm / depth_mm
    return depth_mm * _CORNER_SIGMA * (1 + abs(float(disparity)) / reach) / (width_px / 2)


def _rescaled(intrinsics: Intrinsics | None, distances: BoardDistances, notes: list[str]) -> Intrinsics | None:
    """Correct the focal length in px by what ruler and poses say together."""
    if intrinsics is None or not np.isfinite(distances.residual_mm).any():
        notes.append(
            "no board poses: the distance from sensor to pupil is the lens's image distance, to "
            f"{_PUPIL_SIGMA_MM:.0f} mm"
        )
        return intrinsics
    matrix = intrinsics.camera_matrix.copy()
    matrix[[0, 1], [0, 1]] *= distances.scale
    return Intrinsics(matrix, intrinsics.distortion, intrinsics.rms_px)

"""From a session folder to a camera file: the depth curve on the axis, then its fields over the frame.

The steps are those of paper section 3.4: pinhole calibration, boards at measured distances, fit of the curve.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chromaperture.calibrate_blur import add_blur
from chromaperture.calibration import Calibration, Film, Lens
from chromaperture.camera import sensor_noise
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
from chromaperture.disparity.estimate import colour_spaces, estimate_disparity
from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture, centroids, channel_transmission, design_named
from chromaperture.session import Session, read_session

_MEASURED: tuple[Quality, ...] = ("paper", "real-time")
_MIDDLE = 1 / 3  # share of the width and height that stands for the axis
_GRID_PX = 6  # every sixth px each way: neighbours share their window anyway
_FIELD_DEGREES = (4, 2)  # the second where the first is drawn by noise
_LEAST_SCALE = 0.1  # of the median: vignetting cuts the rim of the pupil, where an open design has its film
_MIN_FIELD_BOARDS = 5
_MIN_SIGMA_PX = 0.05  # two halves blur as mirror images, not as shifted copies: a shift reads that much wrong
_RANGE_MARGIN = (0.9, 1.3)  # the working range reaches a little beyond the boards

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class BoardMeasurement:
    """One board: where it stood and what each quality measured.

    ``disparity_px`` and ``sigma_px`` are of the middle of its photograph, ``grid_px`` of every few px of the frame.
    """

    name: str
    ruler_mm: float
    disparity_px: Mapping[Quality, float]
    sigma_px: Mapping[Quality, float]
    grid_px: Mapping[Quality, np.ndarray]


@dataclass(frozen=True)
class CalibrationResult:
    """A camera and the evidence for it."""

    calibration: Calibration
    fits: Mapping[Quality, DepthFit]
    boards: list[BoardMeasurement]
    notes: list[str]


def calibrate_session(
    folder: str | Path,
    *,
    lens_from: Calibration | None = None,
    lens_blur: bool = True,
    progress: Progress = lambda what, done, total: None,
) -> CalibrationResult:
    """Calibrate the camera of a session folder.

    Parameters
    ----------
    folder : str or Path
        Laid out as ``docs/calibration-session.md`` shows.
    lens_from : Calibration, optional
        The same lens at the same focus, for a session without tilted boards of its own.
    lens_blur : bool
        Fit the lens's blur too, which takes most of the time; quality ``accurate`` gains most of its accuracy by it.
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
    pupil, intrinsics = _measure_pupil(session, rulers, np.array(poses), guess, intrinsics, notes)
    boards: list[BoardMeasurement] = []
    fits: dict[Quality, DepthFit] = {}
    for i, path in enumerate(session.boards):
        progress("board disparity", i, len(session.boards))
        boards.append(_measure_board(session, draft, path))
    progress("board disparity", len(boards), len(boards))
    for quality in _MEASURED:
        fits[quality] = fit_depth_model(
            rulers,
            np.array([board.disparity_px[quality] for board in boards]),
            disparity_sigma_px=np.array([board.sigma_px[quality] for board in boards]),
            distance_sigma_mm=max(session.ruler_error_mm / 2, 0.1),  # "errs by up to": two standard deviations
            sensor_to_pupil_mm=pupil.sensor_to_pupil_mm,
            sensor_to_pupil_sigma_mm=pupil.sigma_mm,
        )
    fields = {quality: _fit_field(session, boards, quality, fits[quality], notes) for quality in _MEASURED}
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
    if lens_blur:
        calibration, _ = add_blur(calibration, session, notes, progress=progress)
    return CalibrationResult(calibration, fits, boards, notes)


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


def _measure_board(session: Session, draft: Calibration, path: Path) -> BoardMeasurement:
    """Median disparity of the frame's middle, with the standard error of that median, at every quality."""
    image = session.read(path)
    noise = sensor_noise(image, draft)
    medians: dict[Quality, float] = {}
    errors: dict[Quality, float] = {}
    grids: dict[Quality, np.ndarray] = {}
    for quality in _MEASURED:
        low, high = draft.disparity_range_px(quality)
        config = MatcherConfig.preset(quality).with_range(1.5 * low - 1, 1.5 * high + 1)  # the lens is not known yet
        disparity = estimate_disparity(
            image, aperture=draft.aperture, unmixing=draft.unmixing, noise_variance=noise, config=config
        ).value_px
        medians[quality], errors[quality] = _middle_median(disparity, config)
        grids[quality] = disparity[_GRID_PX // 2 :: _GRID_PX, _GRID_PX // 2 :: _GRID_PX]
    return BoardMeasurement(path.name, session.boards[path], medians, errors, grids)


def _fit_field(
    session: Session, boards: list[BoardMeasurement], quality: Quality, fit: DepthFit, notes: list[str]
) -> DepthField:
    """Fields of the depth curve over the frame; one curve for all of it where the boards do not suffice."""
    size = (session.sensor.width_px, session.sensor.height_px)
    grids = np.stack([board.grid_px[quality] for board in boards])
    delta = float(np.asarray(fit.model.sensor_to_pupil_mm))
    rows, columns = (_GRID_PX // 2 + _GRID_PX * np.arange(n) for n in grids.shape[1:])
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


def _middle_median(disparity: np.ndarray, config: MatcherConfig) -> tuple[float, float]:
    """Median over the middle of the frame and its standard error; NaN where too little is known."""
    rows, columns = (slice(round(n * (1 - _MIDDLE) / 2), round(n * (1 + _MIDDLE) / 2)) for n in disparity.shape)
    middle = disparity[rows, columns]
    known = middle[np.isfinite(middle)]
    if known.size < middle.size / 4:
        return np.nan, np.nan
    median = float(np.median(known))
    spread = 1.4826 * float(np.median(np.abs(known - median)))
    window_px = (1 + config.window_decay) / (1 - config.window_decay)  # neighbours share their window
    return median, max(_MIN_SIGMA_PX, 1.2533 * spread * window_px / np.sqrt(known.size))


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

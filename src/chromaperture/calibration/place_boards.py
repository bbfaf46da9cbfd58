"""The pinhole from tilted boards, and the distances of the boards from ruler and pose (paper section 3.4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from chromaperture.calibration.chessboard import (
    MIN_VIEWS,
    Intrinsics,
    board_color,
    board_distance,
    color_notes,
    find_corners,
    fit_intrinsics,
)
from chromaperture.calibration.options import Cache, CalibrationConfig, Progress, reported
from chromaperture.calibration.session import Session, check_units, nominal_depth_model
from chromaperture.color.unmixing import view_reach
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import design_named
from chromaperture.system.errors import InputError
from chromaperture.system.robust import huber_weights

# Error of a corner, px, and as a fraction of the blur radius. Chosen by hand; `fit_distances` corrects it by rulers.
_CORNER_SIGMA = 0.03
_LEAST_RULER_SIGMA_MM = 0.1  # a ruler stated to err by 0 would leave the fit without a solution
_TRIED = 4  # photographs, of which one shows whether squares were counted; chosen by hand
_FEWEST_CORNERS = 3  # a side of OpenCV's boards
_ROUNDS = 20  # of reweighting; chosen by hand, far more than it needs
_MIN_POSES = 4  # two determine delta and scale; chosen by hand
_SCALE_SIGMA = 0.05  # prior of scale: Zhang's method finds a focal length to better than 5 %
# Focal lengths by tilted boards and by rulers differ by 2.7 % at most in nine sessions (4.5 standard deviations of the
# former, which does not know that a board's corners err alike), in seven of them by .7 %; squares printed at 96 %,
# which the tilts do not mind, make it 4 % and 5 to 13. Chosen by hand between.
_OTHER_SQUARES, _OTHER_SQUARES_SIGMAS = 0.032, 4.0
_FIXED_SCALE_SIGMA = 1e-6  # without poses
_MOST_FACTOR, _FACTOR_SIGMA = 5.0, 1.0  # limit of the correction of the corners' error; prior, in natural logarithms
_OUTLIER = 5.0  # standard deviations, and at least twice the ruler's own error; chosen by hand
_NO_WEIGHT = 1e-6  # of a ruler that is off by twice that: a weight of 0 could leave the equations singular


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics, None where there were too few tilted boards; and the corners of all boards that were found."""

    intrinsics: Intrinsics | None
    corners: Mapping[Path, np.ndarray]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class PlacedBoards:
    """Distances of the boards square to the axis, and intrinsics whose focal length the rulers corrected."""

    distances: BoardDistances
    intrinsics: Intrinsics | None
    notes: tuple[str, ...]
    square_mm: float  # as stated, or what rulers and tilted boards contradict it by


def measure_pinhole(session: Session, lens_from: Calibration | None, *, cache: Cache, progress: Progress) -> Pinhole:
    """Find the corners of all boards; fit the pinhole to the tilted ones, or take that of ``lens_from``."""
    corners, colors = {}, {}
    for path in reported([*session.tilts, *session.boards], "chessboards", progress):
        what = ("corners, color", session.inner_corners, session.sensor)
        found = cache.get(path, what, partial(_corners, session, path))
        if not found["corners"].size:
            continue
        corners[path] = found["corners"]
        if path in session.boards:
            colors[path.name] = found["color"]
    if not corners:
        _check_count(session)
    notes = color_notes(colors)
    size = (session.sensor.width_px, session.sensor.height_px)
    if lens_from is not None:
        other = (lens_from.sensor.width_px, lens_from.sensor.height_px)
        if other != size:
            raise InputError(
                f"the camera file to take the lens from is of {other[0]}x{other[1]} px and the session of "
                f"{size[0]}x{size[1]}: calibrate the lens again at this size"
            )
        return Pinhole(Intrinsics(lens_from.lens.camera_matrix, lens_from.lens.distortion, 0.0), corners, notes)
    tilted = [corners[path] for path in session.tilts if path in corners]
    if len(tilted) < MIN_VIEWS:
        note = f"{len(tilted)} tilted boards with corners: intrinsics are nominal, points may be off by a few %"
        return Pinhole(None, corners, (note, *notes))
    fitted = fit_intrinsics(tilted, size, session.inner_corners, session.square_mm)
    if fitted.bend_mm:
        off = f"your board is bent: its middle stands {abs(fitted.bend_mm):.1f} mm off its ends"
        notes = (f"{off}. The focal length allows for it; glue the board onto something flat", *notes)
    return Pinhole(fitted, corners, notes)


def _check_count(session: Session) -> None:
    """Raise InputError where no board has the stated inner corners, but one has as many squares."""
    columns, rows = session.inner_corners
    for path in [*session.tilts, *session.boards][:_TRIED] if min(columns, rows) > _FEWEST_CORNERS else ():
        if find_corners(session.read(path)[..., 1], (columns - 1, rows - 1)) is not None:
            raise InputError(
                f"no photograph shows a board of {columns} x {rows} inner corners, but {path.name} one of "
                f"{columns - 1} x {rows - 1}: session.toml seems to count squares; write inner_corners = "
                f"[{columns - 1}, {rows - 1}]"
            )


def _corners(session: Session, path: Path) -> dict[str, np.ndarray]:
    """Return the corners of one board and its mean colour; no corners where the board is not found."""
    image = session.read(path)
    found = find_corners(image[..., 1], session.inner_corners)
    if found is None:
        return {"corners": np.zeros((0, 2), np.float32), "color": np.full(3, np.nan)}
    return {"corners": found, "color": board_color(image, found)}


def place_boards(session: Session, pinhole: Pinhole, config: CalibrationConfig) -> PlacedBoards:
    """Fit the distances of all boards to rulers and poses; raises InputError for rulers in another unit than mm."""
    corners, intrinsics = [pinhole.corners.get(path) for path in session.boards], pinhole.intrinsics
    rulers = np.array([*session.boards.values()])
    poses = np.array([
        np.nan if found is None or intrinsics is None
        else board_distance(found, intrinsics, session.inner_corners, session.square_mm)
        for found in corners
    ])  # fmt: skip
    check_units(rulers, poses, where="distances.csv")
    distances = fit_distances(
        rulers,
        poses,
        ruler_sigma_mm=max(session.ruler_error_mm / np.sqrt(3), _LEAST_RULER_SIGMA_MM),  # a uniform error up to that
        pose_sigma_mm=np.array([_pose_sigma(session, found) for found in corners]),
        sensor_to_pupil_mm=float(nominal_depth_model(session).sensor_to_pupil_mm),
        sensor_to_pupil_sigma_mm=config.pupil_sigma_mm,
    )
    if intrinsics is None or not np.isfinite(distances.residual_mm).any():
        note = (
            "no board poses: the distance from sensor to pupil is the lens's image distance, to "
            f"{config.pupil_sigma_mm:.0f} mm"
        )
        return PlacedBoards(distances, intrinsics, (note,), session.square_mm)
    other = abs(distances.scale - 1)
    if other > max(_OTHER_SQUARES, _OTHER_SQUARES_SIGMAS * intrinsics.focal_sigma):
        square_mm = session.square_mm * distances.scale
        note = (
            f"your squares are {square_mm:.1f} mm, not {session.square_mm:g} mm as session.toml says: otherwise rulers "
            f"and tilted boards differ by {other:.1%}. They count as {square_mm:.1f} mm here; measure a row of ten and "
            "correct square_mm or the rulers, or photograph more tilted boards"
        )
        return PlacedBoards(distances, intrinsics, (note,), square_mm)
    matrix = intrinsics.camera_matrix.copy()
    matrix[[0, 1], [0, 1]] *= distances.scale
    return PlacedBoards(distances, replace(intrinsics, camera_matrix=matrix), (), session.square_mm)


def _pose_sigma(session: Session, corners: np.ndarray | None) -> float:
    """Return the standard deviation of the distance by pose, mm; inf without corners.

    Blur moves corners, the outermost most, by a fraction of its radius. The effect on the distance falls with the size
    of the board in the picture.
    """
    if corners is None:
        return np.inf
    nominal, reach = nominal_depth_model(session), view_reach(design_named(session.design))
    width_px = float(np.ptp(corners, axis=0).max())
    length_mm = (max(session.inner_corners) - 1) * session.square_mm
    depth_mm = length_mm * float(nominal.sensor_to_pupil_mm) / session.sensor.pixel_pitch_mm / width_px
    disparity = nominal.infinity_disparity_px - nominal.scale_px_mm / depth_mm
    return depth_mm * _CORNER_SIGMA * (1 + abs(float(disparity)) / reach) / (width_px / 2)


@dataclass(frozen=True)
class BoardDistances:
    """Distances of the boards, and pupil and focal length by them."""

    from_pupil_mm: np.ndarray  # z, (N,) float64, from ruler and pose together
    # sensor_to_pupil_mm, sigma_mm: delta and its standard deviation
    sensor_to_pupil_mm: float
    sigma_mm: float
    scale: float  # factor by which to correct the focal length in px
    covariance: np.ndarray  # (N + 1, N + 1) float64, mm^2, of the z of all boards and, last, of delta
    residual_mm: np.ndarray  # (N,) float64; ruler minus distance from the sensor by pose, NaN without a pose
    residual_sigma_mm: np.ndarray  # (N,) float64; its expected standard deviation


def fit_distances(
    ruler_mm: np.ndarray,
    pose_mm: np.ndarray,
    *,
    ruler_sigma_mm: float,
    pose_sigma_mm: np.ndarray,
    sensor_to_pupil_mm: float,
    sensor_to_pupil_sigma_mm: float,
) -> BoardDistances:
    """Fit distances to rulers (from the sensor plane) and poses (from the entrance pupil, NaN unknown), robustly; mm.

    A ruler errs by a few mm at any distance. A pose is proportional to the focal length and errs with blur and
    distance. With z the distance of a board from the pupil::

        ruler = z + delta + e,        scale * pose = z + p

    both observe z, the sensor-to-pupil distance delta, and the correction ``scale`` of the focal length: a linear
    problem except for the weights. The prior of delta alone determines it when fewer than four boards have a pose.
    """
    ruler, pose = np.asarray(ruler_mm, float), np.asarray(pose_mm, float)
    n = len(ruler)
    seen = np.isfinite(pose)
    if seen.sum() < _MIN_POSES:
        pose, seen = np.full(n, np.nan), np.zeros(n, bool)
    # Unknowns: z of every board, delta, scale. Rows: rulers, poses, the two priors.
    rows, values, weights = np.zeros((2 * n + 2, n + 2)), np.zeros(2 * n + 2), np.zeros(2 * n + 2)
    board = np.arange(n)
    rows[board, board], rows[board, n], values[:n] = 1, 1, ruler
    rows[n + board, board], rows[n + board, n + 1] = 1, np.where(seen, -pose, 0)
    rows[2 * n, n], values[2 * n], weights[2 * n] = 1, sensor_to_pupil_mm, 1 / sensor_to_pupil_sigma_mm
    rows[2 * n + 1, n + 1], values[2 * n + 1] = 1, 1.0
    weights[2 * n + 1] = 1 / (_SCALE_SIGMA if seen.any() else _FIXED_SCALE_SIGMA)
    weights[:n] = 1 / ruler_sigma_mm
    robust, pose_sigma = np.ones(n), np.asarray(pose_sigma_mm, float)
    for turn in range(_ROUNDS):  # a misread ruler loses weight; it shows only where there is a pose
        w = weights.copy()
        w[:n] *= np.sqrt(robust)
        w[n : 2 * n] = np.where(seen, 1 / pose_sigma, 0.0)
        information = (rows * (w**2)[:, None]).T @ rows
        solution = np.linalg.solve(information, (rows * (w**2)[:, None]).T @ values)
        by_pose = np.where(seen, solution[n + 1] * pose + solution[n], np.nan)
        expected = np.where(seen, np.hypot(ruler_sigma_mm, np.where(seen, pose_sigma, 0.0)), np.inf)
        standard = np.where(seen, np.abs(ruler - by_pose) / expected, 0.0)
        robust = np.where(standard > 2 * _OUTLIER, _NO_WEIGHT, huber_weights(standard))
        if turn == _ROUNDS // 2 and seen.any():
            factor = _pose_factor((ruler - by_pose)[seen], np.asarray(pose_sigma_mm, float)[seen], ruler_sigma_mm)
            pose_sigma = factor * np.asarray(pose_sigma_mm, float)
    covariance = np.linalg.inv(information)[: n + 1, : n + 1]
    return BoardDistances(
        solution[:n], float(solution[n]), float(np.sqrt(covariance[n, n])), float(solution[n + 1]), covariance,
        ruler - by_pose, np.where(seen, expected, np.nan),
    )  # fmt: skip


def _pose_factor(residual_mm: np.ndarray, pose_sigma_mm: np.ndarray, ruler_sigma_mm: float) -> float:
    """Return the most probable factor on the stated error of the poses, given the residuals against the rulers.

    The precision of corners depends on print, light and lens and is known to a factor of two at best, whereas the error
    of the ruler is stated in the session.
    """
    factors = np.geomspace(1 / _MOST_FACTOR, _MOST_FACTOR, 81)  # steps of 4 %
    variance = ruler_sigma_mm**2 + (factors[:, None] * pose_sigma_mm) ** 2
    degrees = max(len(residual_mm) - 2, 1) / len(residual_mm)  # delta and scale take two degrees of freedom
    squares = np.minimum(residual_mm**2, _OUTLIER**2 * variance)
    cost = 0.5 * (squares / variance + degrees * np.log(variance)).sum(axis=1)
    cost += 0.5 * (np.log(factors) / _FACTOR_SIGMA) ** 2
    return float(factors[int(cost.argmin())])


def find_outliers(
    names: Sequence[str], ruler_mm: np.ndarray, measured_mm: np.ndarray, sigma_mm: np.ndarray, *, ruler_error_mm: float
) -> dict[str, str]:
    """Find boards whose ruler contradicts the measurement, and pairs that were swapped; a sentence by name.

    ``measured_mm`` is the distance from the sensor by corners or fitted curve, NaN unknown; ``sigma_mm`` the standard
    deviation of its difference to the ruler; (N,) each.
    """
    ruler, measured = np.asarray(ruler_mm, float), np.asarray(measured_mm, float)
    limit = np.maximum(_OUTLIER * np.asarray(sigma_mm, float), 2 * ruler_error_mm)
    wrong = np.flatnonzero(np.abs(ruler - measured) > limit).tolist()
    found: dict[str, str] = {}
    for i in wrong:
        others = [j for j in wrong if j != i and abs(measured[i] - ruler[j]) < limit[i]
                  and abs(measured[j] - ruler[i]) < limit[j]]  # fmt: skip
        if others:
            found[names[i]] = f"{names[i]} and {names[others[0]]} are swapped: each stands where the other's ruler says"
        else:
            found[names[i]] = (
                f"{names[i]} is {abs(ruler[i] - measured[i]):.0f} mm off its ruler: it stands at {measured[i]:.0f} mm, "
                f"the ruler says {ruler[i]:.0f} mm"
            )
    return found

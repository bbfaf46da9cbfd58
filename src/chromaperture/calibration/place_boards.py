"""The pinhole from tilted boards, and the distances of the boards from ruler and pose (paper section 3.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from chromaperture.calibration.assemble_camera import nominal_depth_model
from chromaperture.calibration.board_distances import BoardDistances, check_units, fit_distances
from chromaperture.calibration.board_light import board_color, color_notes
from chromaperture.calibration.calibration_config import CalibrationConfig
from chromaperture.calibration.chessboard import MIN_VIEWS, Intrinsics, board_distance, find_corners, fit_intrinsics
from chromaperture.calibration.measurement_cache import Store
from chromaperture.calibration.progress import Progress, reported
from chromaperture.calibration.session import Session
from chromaperture.color.unmixing import view_reach
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import design_named
from chromaperture.system.errors import InputError

# Error of a corner, px, and as a fraction of the blur radius. Chosen by hand; `fit_distances` corrects it by rulers.
_CORNER_SIGMA = 0.03
_LEAST_RULER_SIGMA_MM = 0.1  # a ruler stated to err by 0 would leave the fit without a solution


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


def measure_pinhole(session: Session, lens_from: Calibration | None, *, store: Store, progress: Progress) -> Pinhole:
    """Find the corners of all boards; fit the pinhole to the tilted ones, or take that of ``lens_from``."""
    corners, colors = {}, {}
    for path in reported([*session.tilts, *session.boards], "chessboards", progress):
        what = ("corners, color", session.inner_corners, session.sensor)
        found = store.arrays(path, what, partial(_corners, session, path))
        if not found["corners"].size:
            continue
        corners[path] = found["corners"]
        if path in session.boards:
            colors[path.name] = found["color"]
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
    return Pinhole(fit_intrinsics(tilted, size, session.inner_corners, session.square_mm), corners, notes)


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
        return PlacedBoards(distances, intrinsics, (note,))
    matrix = intrinsics.camera_matrix.copy()
    matrix[[0, 1], [0, 1]] *= distances.scale
    return PlacedBoards(distances, Intrinsics(matrix, intrinsics.distortion, intrinsics.rms_px), ())


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

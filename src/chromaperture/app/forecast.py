"""Foretell a calibration's error bar, and where one more board gains most, from where the boards stand alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from chromaperture.calibration.place_boards import fit_distances
from chromaperture.depth.conversion import DepthModel
from chromaperture.optics.aperture import Aperture
from chromaperture.optics.depth_error_bound import Texture, disparity_bound
from chromaperture.optics.simulator.sensor import SensorModel

# Standard deviations of the engraved lens's curve, before any board: focal length and f-number are known to some 5 %,
# the f-number enters B directly, the focus distance A; chosen by hand.
_NOMINAL_SCALE, _NOMINAL_FOCUS = 0.15, 0.15
_PUPIL_SIGMA_MM = 10.0  # of delta without poses, `CalibrationConfig.pupil_sigma_mm`
BOARD_SIGMA_PX = 0.05  # of a board's median disparity, at first: `calibration/read_boards.py`
_CORNER_SIGMA_PX = 0.03  # of a corner, `calibration/place_boards.py`
_FEWEST_TILTS = 4  # below, boards have no poses: `calibration/chessboard.py`
_DISTANCES = 25  # over the range; chosen by hand
_BOUND_DISTANCES = 7  # at which the bound of a pixel is computed, 10 ms each; chosen by hand


@dataclass(frozen=True)
class Lens:
    """What is known of a lens before its calibration, and of its range."""

    model: DepthModel  # the engraved one, or the curve of the boards so far
    aperture: Aperture
    reach: float  # half disparity over blur radius
    focal_px: float
    board_mm: float  # length of the board's longer side, between its outermost corners
    ruler_error_mm: float
    near_mm: float
    far_mm: float
    # Standard deviation of a board's disparity about the curve, by the boards so far where there are enough.
    board_sigma_px: float = BOARD_SIGMA_PX
    scale_error: float = 0.0  # relative, of all disparities: by the tone curve


@dataclass(frozen=True)
class Forecast:
    """The predicted error bar; (N,) float64 arrays, mm, one standard deviation."""

    distance_mm: np.ndarray  # from the sensor plane
    pixel_mm: np.ndarray  # of one pixel by the noise of light, on a textured surface: the Cramer-Rao bound
    calibration_mm: np.ndarray  # of the curve; the same for all pixels of one distance

    @property
    def total_mm(self) -> np.ndarray:
        """Both together."""
        return np.hypot(self.pixel_mm, self.calibration_mm)


@dataclass(frozen=True)
class Gain:
    """Where one more board helps most: the worst error of the curve over the range, relative to distance."""

    at_mm: float
    before: float
    after: float


def forecast(lens: Lens, boards_mm: Sequence[float], tilts: int, *, pixel_sigma_px: float = 0.0) -> Forecast:
    """Foretell the error bar over the range from the boards' distances to the sensor plane so far."""
    distance = np.linspace(lens.near_mm, lens.far_mm, _DISTANCES)
    z = distance - float(lens.model.sensor_to_pupil_mm)
    slope = float(lens.model.scale_px_mm) / z**2
    coarse = np.linspace(lens.near_mm, lens.far_mm, _BOUND_DISTANCES)
    bound = np.array([_bound(lens, at) for at in coarse])
    pixel = np.maximum(np.interp(distance, coarse, bound), pixel_sigma_px)
    return Forecast(distance, pixel / slope, curve_sigma(lens, boards_mm, tilts, distance))


def best_gain(lens: Lens, boards_mm: Sequence[float], tilts: int, candidates_mm: Sequence[float]) -> Gain:
    """Return the candidate distance whose board takes most off the worst relative error of the curve."""
    distance = np.linspace(lens.near_mm, lens.far_mm, _DISTANCES)

    def worst(boards: Sequence[float]) -> float:
        return float((curve_sigma(lens, boards, tilts, distance) / distance).max())

    after = [worst([*boards_mm, at]) for at in candidates_mm]
    best = int(np.argmin(after))
    return Gain(float(candidates_mm[best]), worst(boards_mm), after[best])


def curve_sigma(lens: Lens, boards_mm: Sequence[float], tilts: int, distance_mm: np.ndarray) -> np.ndarray:
    """Return the standard deviation of depth by the curve's covariance at (N,) distances to the sensor plane, mm."""
    b, delta = float(lens.model.scale_px_mm), float(lens.model.sensor_to_pupil_mm)
    middle = 1 / np.sqrt((lens.near_mm - delta) * (lens.far_mm - delta))  # 1 / z, where A and B hardly correlate
    prior_a = _NOMINAL_FOCUS * b * middle + _NOMINAL_SCALE * b * middle
    information = np.diag([1 / prior_a**2, 1 / (_NOMINAL_SCALE * b) ** 2, 1 / _PUPIL_SIGMA_MM**2])
    boards = np.asarray(boards_mm, float)
    if boards.size:
        sigma_mm, delta_sigma_mm = _placed(lens, boards, tilts)
        information[2, 2] = 1 / delta_sigma_mm**2
        rows = _jacobian(boards - delta, b)
        sigma = np.hypot(lens.board_sigma_px, np.abs(rows[:, 2]) * sigma_mm)
        information = information + (rows / sigma[:, None] ** 2).T @ rows
    covariance = np.linalg.inv(information)
    rows = _jacobian(np.asarray(distance_mm, float) - delta, b)
    variance = np.einsum("ni,ij,nj->n", rows, covariance, rows)
    z = np.asarray(distance_mm, float) - delta
    variance = variance + (lens.scale_error * (float(lens.model.infinity_disparity_px) - b / z)) ** 2
    return np.asarray(np.sqrt(variance) / np.abs(rows[:, 2]))


def _jacobian(z_mm: np.ndarray, b: float) -> np.ndarray:
    """Return the derivatives of d by A, B and delta; (N, 3). That by delta is also that by the distance, negated."""
    return np.stack([np.ones_like(z_mm), -1 / z_mm, -b / z_mm**2], axis=1)


def _placed(lens: Lens, boards_mm: np.ndarray, tilts: int) -> tuple[np.ndarray, float]:
    """Return how well the boards' distances and delta are known, by ruler and poses; mm."""
    delta = float(lens.model.sensor_to_pupil_mm)
    z = boards_mm - delta
    radius = np.abs(float(lens.model.infinity_disparity_px) - float(lens.model.scale_px_mm) / z) / lens.reach
    width_px = lens.board_mm * lens.focal_px / z
    pose_sigma = z * _CORNER_SIGMA_PX * (1 + radius) / (width_px / 2)
    found = fit_distances(
        boards_mm,
        z if tilts >= _FEWEST_TILTS else np.full(len(z), np.nan),
        ruler_sigma_mm=max(lens.ruler_error_mm / np.sqrt(3), 0.1),
        pose_sigma_mm=pose_sigma,
        sensor_to_pupil_mm=delta,
        sensor_to_pupil_sigma_mm=_PUPIL_SIGMA_MM,
    )
    return np.sqrt(np.median(np.diag(found.covariance)[:-1])) * np.ones(len(z)), found.sigma_mm


def _bound(lens: Lens, at_mm: float) -> float:
    z = at_mm - float(lens.model.sensor_to_pupil_mm)
    radius = (float(lens.model.infinity_disparity_px) - float(lens.model.scale_px_mm) / z) / lens.reach
    return _bound_at(lens.aperture, round(radius * 4) / 4, lens.reach)


@lru_cache(maxsize=256)
def _bound_at(aperture: Aperture, radius_px: float, reach: float) -> float:
    return disparity_bound(aperture, radius_px, reach, SensorModel(), Texture(), 1.0)

"""Boards at known distances: what the matcher reads on each of them, with the very settings of the camera's use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chromaperture.calibration import Calibration
from chromaperture.camera import sensor_noise
from chromaperture.config import MatcherConfig, Quality
from chromaperture.disparity.estimate import estimate_disparity
from chromaperture.session import Session

MEASURED: tuple[Quality, ...] = ("paper", "real-time")
_MIDDLE = 1 / 3  # share of the width and height that stands for the axis
_GRID_PX = 6  # every sixth px each way: neighbours share their window anyway
_MIN_SIGMA_PX = 0.05  # two halves blur as mirror images, not as shifted copies: a shift reads that much wrong


@dataclass(frozen=True)
class BoardMeasurement:
    """One board: where it stood and what each quality measured.

    Attributes
    ----------
    name : str
        File name of the photograph.
    ruler_mm : float
        Distance from the sensor plane by ruler.
    disparity_px, sigma_px : dict of quality to float, px
        Median over the middle of the photograph and its standard error.
    grid_px : dict of quality to (h, w) float32, px
        Disparity of every few px of the frame, NaN unknown.
    corners_px : (N, 2) float32 or None
        Chessboard corners, row by row; None where the board was not found.
    pose_mm : float, mm
        Distance from the sensor plane by the board's own corners; NaN where there are none.
    """

    name: str
    ruler_mm: float
    disparity_px: Mapping[Quality, float]
    sigma_px: Mapping[Quality, float]
    grid_px: Mapping[Quality, np.ndarray]
    corners_px: np.ndarray | None = None
    pose_mm: float = np.nan


def grid(count: int) -> np.ndarray:
    """Places along one side of the frame at which boards are kept; px."""
    return np.arange(_GRID_PX // 2, count, _GRID_PX, dtype=float)


def measure_board(session: Session, draft: Calibration, path: Path) -> BoardMeasurement:
    """Median disparity of the frame's middle, with the standard error of that median, at every quality."""
    image = session.read(path)
    noise = sensor_noise(image, draft)
    medians: dict[Quality, float] = {}
    errors: dict[Quality, float] = {}
    grids: dict[Quality, np.ndarray] = {}
    for quality in MEASURED:
        low, high = draft.disparity_range_px(quality)
        config = MatcherConfig.preset(quality).with_range(1.5 * low - 1, 1.5 * high + 1)  # the lens is not known yet
        disparity = estimate_disparity(
            image, aperture=draft.aperture, unmixing=draft.unmixing, noise_variance=noise, config=config
        ).value_px
        medians[quality], errors[quality] = _middle_median(disparity, config)
        grids[quality] = disparity[_GRID_PX // 2 :: _GRID_PX, _GRID_PX // 2 :: _GRID_PX]
    return BoardMeasurement(path.name, session.boards[path], medians, errors, grids)


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


def spread(residual_px: np.ndarray) -> np.ndarray:
    """Robust standard deviation of single pixels about each board's own median; (boards,) float64, px."""
    flat = residual_px.reshape(len(residual_px), -1).astype(float)
    known = np.isfinite(flat).any(axis=1)
    spread = np.full(len(flat), np.nan)
    centre = np.nanmedian(flat[known], axis=1, keepdims=True)
    spread[known] = 1.4826 * np.nanmedian(np.abs(flat[known] - centre), axis=1)
    return spread

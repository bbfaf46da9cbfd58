"""Boards at known distances: what the matcher reads on each of them, with the very settings of the camera's use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chromaperture.calibration.measurement_cache import Store
from chromaperture.calibration.session import Session
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import sensor_noise
from chromaperture.config import PaperConfig, Quality, RealTimeConfig
from chromaperture.disparity.estimate import estimate_disparity

MEASURED: tuple[Quality, ...] = ("paper", "real-time")
_MIDDLE = 1 / 3  # share of the width and height that stands for the axis
_GRID_PX = 6  # neighbours share their window anyway
_GRID_COLUMNS = 120  # at most, so that memory does not grow with the sensor
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
        Median over the middle of the photograph and its standard error; NaN where too little is known.
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


def grid(count: int, width_px: int) -> np.ndarray:
    """Places along a side of ``count`` px at which boards are kept; px.

    Parameters
    ----------
    count : int
        Width or height of the frame, px.
    width_px : int
        Width of the frame, which sets the distance of two places.
    """
    step = max(_GRID_PX, round(width_px / _GRID_COLUMNS))
    return np.arange(step // 2, count, step, dtype=float)


def measure_board(session: Session, draft: Calibration, path: Path, *, store: Store) -> BoardMeasurement:
    """Match one board at every quality; the photograph is not kept.

    Parameters
    ----------
    session : Session
    draft : Calibration
        Film and sensor as they are, depth curves to some 20 %: they only set the search range.
    path : Path
    store : Store
    """

    def measured() -> dict[str, np.ndarray]:
        return read_board(session.read(path), draft)

    film = {name: color.tolist() for name, color in draft.film.filters.items()}
    kept = store.arrays(path, ("board", draft.design, draft.sensor, film, _configs(draft)), measured)
    return BoardMeasurement(
        path.name,
        session.boards[path],
        {q: float(kept[f"{q} middle"][0]) for q in MEASURED},
        {q: float(kept[f"{q} middle"][1]) for q in MEASURED},
        {q: kept[q] for q in MEASURED},
    )


def read_board(image: np.ndarray, draft: Calibration) -> dict[str, np.ndarray]:
    """Match a photograph of a board at every quality, on the grid of places at which boards are kept.

    Parameters
    ----------
    image : (H, W, 3) float32
    draft : Calibration
        Film and sensor as they are, depth curves to some 20 %: they only set the search range.

    Returns
    -------
    dict of str to array
        By quality (h, w) disparities, px; by "QUALITY middle" the median about the axis and its standard error.
    """
    noise = sensor_noise(image, draft)
    found = {}
    rows, columns = (grid(n, draft.sensor.width_px).astype(int) for n in image.shape[:2])
    for quality, config in _configs(draft).items():
        disparity = estimate_disparity(
            image, aperture=draft.aperture, unmixing=draft.unmixing, noise_variance=noise, config=config
        ).value_px
        found[f"{quality} middle"] = np.array(_middle_median(disparity, config))
        found[quality] = disparity[np.ix_(rows, columns)]
    return found


def _configs(draft: Calibration) -> dict[Quality, PaperConfig | RealTimeConfig]:
    """Search wider than the lens's nominal figures say: it is not known yet."""
    presets: dict[Quality, PaperConfig | RealTimeConfig] = {"paper": PaperConfig(), "real-time": RealTimeConfig()}
    ranges = {quality: draft.disparity_range_px(quality) for quality in presets}
    return {
        quality: presets[quality].with_range(1.5 * low - 1, 1.5 * high + 1)
        for quality, (low, high) in ranges.items()
    }


def _middle_median(disparity: np.ndarray, config: PaperConfig | RealTimeConfig) -> tuple[float, float]:
    """Median over the middle of the frame and its standard error; NaN where too little is known."""
    rows, columns = (slice(round(n * (1 - _MIDDLE) / 2), round(n * (1 + _MIDDLE) / 2)) for n in disparity.shape)
    middle = disparity[rows, columns]
    known = middle[np.isfinite(middle)]
    if known.size < middle.size / 4:
        return np.nan, np.nan
    median = float(np.median(known))
    spread = 1.4826 * float(np.median(np.abs(known - median)))
    decay = config.correlation.window_decay
    window_px = (1 + decay) / (1 - decay)  # neighbours share their window
    return median, max(_MIN_SIGMA_PX, 1.2533 * spread * window_px / np.sqrt(known.size))


def spread(residual_px: np.ndarray) -> np.ndarray:
    """Robust standard deviation of single pixels about each board's own median; (boards,) float64, px."""
    flat = residual_px.reshape(len(residual_px), -1).astype(float)
    known = np.isfinite(flat).any(axis=1)
    found = np.full(len(flat), np.nan)
    centre = np.nanmedian(flat[known], axis=1, keepdims=True)
    found[known] = 1.4826 * np.nanmedian(np.abs(flat[known] - centre), axis=1)
    return found

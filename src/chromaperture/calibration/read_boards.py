"""Measure the disparity of boards at known distances, with the matcher settings of the camera's qualities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from chromaperture.calibration.options import Cache, Progress, reported
from chromaperture.calibration.place_boards import Pinhole, PlacedBoards
from chromaperture.calibration.session import Session
from chromaperture.camera.method import sensor_noise
from chromaperture.color.image import SATURATION
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.views import view_spaces
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import PaperConfig, Quality, RealTimeConfig
from chromaperture.system.robust import MEDIAN_INEFFICIENCY, robust_sigma

MEASURED: tuple[Quality, ...] = ("paper", "real-time")  # qualities that match shifted views
_MIDDLE = 1 / 3  # of the width and height: the part of the frame that counts as the axis
_KNOWN = 1 / 4  # of the pixels there must have a disparity; chosen by hand
_GRID_PX = 6  # pitch of the grid: neighbours have the matcher's window in common
_GRID_COLUMNS = 120  # at most, so that memory does not grow with the sensor
_MIN_SIGMA_PX = 0.05  # bias of shift matching on mirrored halves: up to 0.06 px (test_rendered_boards.py)
# Smoothing of boards before quality "real-time" reads them, px: through two filters, and through three whose channels
# are taken where the lens moves them. Prints are finer than what is photographed later, and fine texture is displaced
# more: film leaks, lenses aberrate (docs/decisions.md, *Boards as coarse as scenes*, *Channels where the lens moves
# them*; there, why not through three filters otherwise).
_COARSER_PX, _COARSER_MOVED_PX = 0.8, 1.5
_SEARCH = (1.5, 1.0)  # the nominal range is searched times the first, px the second wider: the lens is known to 20 %


@dataclass(frozen=True)
class BoardMeasurement:
    """One board: its distance and the disparity that each quality measured."""

    name: str  # file name of the photograph
    ruler_mm: float  # distance from the sensor plane by ruler
    disparity_px: Mapping[Quality, float]  # median over the middle of the photograph; NaN where too little is known
    sigma_px: Mapping[Quality, float]  # its standard error
    grid_px: Mapping[Quality, np.ndarray]  # (h, w) float32: disparity on a grid over the frame, NaN unknown
    corners_px: np.ndarray | None = None  # (N, 2) float32, row by row; None where the board was not found
    pose_mm: float = np.nan  # distance from the sensor plane by the board's own corners; NaN without


def grid(count: int, width_px: int) -> np.ndarray:
    """Return the image positions of the boards' grid along a side of ``count`` px, in a frame of ``width_px``; px."""
    step = max(_GRID_PX, round(width_px / _GRID_COLUMNS))
    return np.arange(step // 2, count, step, dtype=float)


def measure_boards(
    session: Session, draft: Calibration, pinhole: Pinhole, placed: PlacedBoards, *, cache: Cache, progress: Progress
) -> list[BoardMeasurement]:
    """Match all boards of a session; photographs are not kept.

    ``draft`` has the true film and sensor; its depth curves only set the search range and may be off by 20 %.
    """
    readings = _readings(session, draft, MEASURED, cache=cache, progress=progress)
    boards = []
    for i, (path, kept) in enumerate(readings):
        boards.append(
            BoardMeasurement(
                name=path.name,
                ruler_mm=session.boards[path],
                disparity_px={q: float(kept[f"{q} middle"][0]) for q in MEASURED},
                sigma_px={q: float(kept[f"{q} middle"][1]) for q in MEASURED},
                grid_px={q: kept[q] for q in MEASURED},
                corners_px=pinhole.corners.get(path),
                pose_mm=float(session.boards[path] - placed.distances.residual_mm[i]),
            )
        )
    return boards


def measure_again(
    boards: list[BoardMeasurement], session: Session, camera: Calibration, *, cache: Cache, progress: Progress
) -> list[BoardMeasurement]:
    """Return boards whose disparity of "real-time" is measured with the camera's ``channel_moves_px``."""
    quality: Quality = "real-time"
    return [
        replace(
            board,
            disparity_px={**board.disparity_px, quality: float(kept[f"{quality} middle"][0])},
            sigma_px={**board.sigma_px, quality: float(kept[f"{quality} middle"][1])},
            grid_px={**board.grid_px, quality: kept[quality]},
        )
        for board, (_, kept) in zip(
            boards, _readings(session, camera, (quality,), cache=cache, progress=progress), strict=True
        )
    ]


def _readings(
    session: Session, draft: Calibration, qualities: tuple[Quality, ...], *, cache: Cache, progress: Progress
) -> Iterator[tuple[Path, Mapping[str, np.ndarray]]]:
    """Yield every board's photograph and what `read_board` measures on it."""
    film = {name: color.tolist() for name, color in draft.film.filters.items()}
    configs = {quality: config for quality, config in _configs(draft).items() if quality in qualities}
    moves = None if draft.channel_moves_px is None else draft.channel_moves_px.tolist()
    for path in reported(list(session.boards), "board disparity", progress):

        def measured(path: Path = path) -> dict[str, np.ndarray]:
            return read_board(session.read(path), draft, qualities=qualities)

        what = ("board", draft.design, draft.sensor, film, configs, _COARSER_PX, _COARSER_MOVED_PX, moves)
        yield path, cache.get(path, what, measured)


def read_board(
    image: np.ndarray, draft: Calibration, *, qualities: tuple[Quality, ...] = MEASURED
) -> dict[str, np.ndarray]:
    """Match a photograph of a board, (H, W, 3) float32, at every quality.

    ``draft`` has the true film and sensor; its depth curves, to 20 %, only set the search range. Returns by quality the
    (h, w) disparities on the grid, px, and by "QUALITY middle" the median about the axis and its standard error.
    """
    noise = sensor_noise(image, draft)
    found = {}
    rows, columns = (grid(n, draft.sensor.width_px).astype(int) for n in image.shape[:2])
    for quality, config in _configs(draft).items():
        if quality not in qualities:
            continue
        seen = coarser(image, _coarser_px(draft)) if quality == "real-time" else image
        disparity = estimate_disparity(
            seen, aperture=draft.aperture, unmixing=draft.unmixing, noise_variance=noise, config=config,
            channel_moves_px=draft.channel_moves_px,
        ).value_px  # fmt: skip
        found[f"{quality} middle"] = np.array(_middle_median(disparity, config))
        found[quality] = disparity[np.ix_(rows, columns)]
    return found


def coarser(image: np.ndarray, sigma_px: float) -> np.ndarray:
    """Smooth a photograph; pixels that are saturated or not finite stay so; (H, W, 3) float32."""
    if sigma_px == 0:
        return image
    finite = np.isfinite(image)
    clean = np.where(finite, image, np.float32(0)).astype(np.float32)
    smooth = cv2.GaussianBlur(clean, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
    return np.where(finite & (image < SATURATION), smooth, image)


def _coarser_px(draft: Calibration) -> float:
    if len(view_spaces(draft.aperture, draft.unmixing, RealTimeConfig().space)[0].directions) == 2:
        return _COARSER_PX
    return 0.0 if draft.channel_moves_px is None else _COARSER_MOVED_PX


def _configs(draft: Calibration) -> dict[Quality, PaperConfig | RealTimeConfig]:
    """Return the matcher settings of every quality, over a wider range than the draft's."""
    factor, more = _SEARCH
    presets: dict[Quality, PaperConfig | RealTimeConfig] = {"paper": PaperConfig(), "real-time": RealTimeConfig()}
    ranges = {quality: draft.disparity_range_px(quality) for quality in presets}
    return {
        quality: presets[quality].with_range(factor * low - more, factor * high + more)
        for quality, (low, high) in ranges.items()
    }


def _middle_median(disparity: np.ndarray, config: PaperConfig | RealTimeConfig) -> tuple[float, float]:
    """Return the median over the middle of the frame and its standard error; NaN where too little is known."""
    rows, columns = (slice(round(n * (1 - _MIDDLE) / 2), round(n * (1 + _MIDDLE) / 2)) for n in disparity.shape)
    middle = disparity[rows, columns]
    known = middle[np.isfinite(middle)]
    if known.size < middle.size * _KNOWN:
        return np.nan, np.nan
    median = float(np.median(known))
    window_px = config.correlation.window_px  # so many neighbours have one error
    error = MEDIAN_INEFFICIENCY * robust_sigma(known - median) * window_px / np.sqrt(known.size)
    return median, max(_MIN_SIGMA_PX, error)


def pixel_sigma(residual_px: np.ndarray) -> np.ndarray:
    """Return the robust standard deviation of single pixels about the median of their board; (boards,) float64, px."""
    boards = residual_px.reshape(len(residual_px), -1).astype(float)
    return np.array([robust_sigma(row - np.nanmedian(row)) if np.isfinite(row).any() else np.nan for row in boards])

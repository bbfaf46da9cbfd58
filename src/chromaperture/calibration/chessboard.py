"""Chessboards: corners, intrinsics and distances, by OpenCV (Zhang's method, paper reference [21])."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import cv2
import numpy as np
from scipy.optimize import minimize_scalar

from chromaperture.optics.pinhole import centered_pinhole
from chromaperture.system.errors import InputError
from chromaperture.system.threads import limited_opencv_threads

MIN_VIEWS = 4  # two determine the pinhole, more average its errors; chosen by hand
_PERFECT_PX = 0.01  # reprojection error below which models are equally good: corners are never better
_CONTRAST_PERCENTILES = (0.5, 99.5)  # of the picture, set to black and white before the search; chosen by hand
_START_FOCAL = 1.2  # focal length over the longer side of the frame: the start of the fit
_THOROUGH = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
_SQUARE_PX = (24, 60)  # second search: smallest squares it gets, by enlarging, and those it need not enlarge
# A small board in the middle of the frame determines neither the principal point nor high orders of distortion: free
# parameters diverge together (centre 47 px off at 0.11 px rms) and bias the focal length. A model with more parameters
# (their number is beside it) is used only where Schwarz's information criterion prefers it.
_CENTERED = (
    cv2.CALIB_USE_INTRINSIC_GUESS
    | cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_FIX_ASPECT_RATIO
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K2
    | cv2.CALIB_FIX_K3
)
_FREE_CENTER = _CENTERED & ~cv2.CALIB_FIX_PRINCIPAL_POINT
_MODELS = ((_CENTERED, 0), (_FREE_CENTER, 2), (_FREE_CENTER & ~cv2.CALIB_FIX_K2, 3))
# A bent board: twice the gain in log-likelihood is 9 and the bend .14 mm at most for six flat ones, 100 for one bent by
# .5 mm (synthetic corners). Chosen by hand between.
_BENT, _LEAST_BEND_MM, _MOST_BEND_MM = 40.0, 0.3, 30.0
# Largest change of the logarithm of red or blue over green that is no fault; chosen by hand. Without a fault it is at
# most .013 in eight sessions of ray-traced lenses, .052 in one of the magenta annulus, whose views have unlike colours.
_LARGEST_CHANGE = 0.08


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole with radial and tangential distortion."""

    camera_matrix: np.ndarray  # (3, 3) float64, px
    distortion: np.ndarray  # (5,) float64, OpenCV's k1, k2, p1, p2, k3
    rms_px: float  # reprojection error over all corners
    focal_sigma: float = math.inf  # of the focal length, relative: one standard deviation; inf where it was not fitted
    bend_mm: float = 0.0  # by which the middle of the board stands off its ends, where that is found; sagitta


def find_corners(plane: np.ndarray, inner_corners: tuple[int, int]) -> np.ndarray | None:
    """Find the inner corners of a board, sub-pixel; (N, 2) float32, px, row by row, or None.

    ``plane`` is linear, the channel with the most symmetric blur: green for complementary halves.
    """
    low, high = np.percentile(plane, _CONTRAST_PERCENTILES)
    if not high > low:
        return None
    level = np.clip((np.asarray(plane, np.float32) - np.float32(low)) / np.float32(high - low), 0, 1)
    # A gamma curve and an exhaustive search find blurred boards; linear light and a short one find small squares.
    searches = ((np.sqrt(level), _THOROUGH), (level, 0))
    for picture, flags in searches:
        # CALIB_CB_ACCURACY takes three times as long, and is not needed where the corners are found again.
        corners = _detect(picture, inner_corners, 1, flags)
        if corners is not None:
            again = _refined(corners, level, inner_corners)
            return again if again is not None else _detect(picture, inner_corners, 1, flags | cv2.CALIB_CB_ACCURACY)
    return None


def _detect(level: np.ndarray, inner_corners: tuple[int, int], scale: int, flags: int) -> np.ndarray | None:
    """Find corners in a picture in [0, 1] after enlarging it; (N, 2) float32, px of the given picture."""
    inset = (scale - 1) / 2  # centre of the first pixel, px of the enlarged picture
    if scale > 1:
        size = (level.shape[1] * scale, level.shape[0] * scale)
        grow = np.array([[scale, 0, inset], [0, scale, inset]])
        level = cv2.warpAffine(level, grow, size, flags=cv2.INTER_CUBIC)
    grey = np.clip(255 * level, 0, 255).astype(np.uint8)
    found, corners = cv2.findChessboardCornersSB(grey, inner_corners, flags=flags)
    return (corners.reshape(-1, 2) - np.float32(inset)) / np.float32(scale) if found else None


def _refined(corners: np.ndarray, level: np.ndarray, inner_corners: tuple[int, int]) -> np.ndarray | None:
    """Find the corners again in linear light and with the board enlarged; (N, 2) float32, px, or None.

    With squares 17 to 21 px wide the detector's corners lie up to 0.4 % of the board too far out, with larger ones less
    than 0.1 %, and least in a picture twice as large. A blurred board may not be found again.
    """
    columns, rows = inner_corners
    square_px = float(np.median(np.linalg.norm(np.diff(corners.reshape(rows, columns, 2), axis=1), axis=2)))
    reach = 1.5 * square_px  # the outer row of squares, and paper around it
    left, top = np.maximum(np.floor(corners.min(axis=0) - reach), 0).astype(int)
    right, bottom = np.ceil(corners.max(axis=0) + reach).astype(int) + 1
    scale = 1 if square_px > _SQUARE_PX[1] else max(2, math.ceil(_SQUARE_PX[0] / square_px))
    again = _detect(level[top:bottom, left:right], inner_corners, scale, cv2.CALIB_CB_ACCURACY)
    if again is None:
        return None
    again += np.array([left, top], np.float32)
    same = np.abs(again - corners).max() < square_px / 2  # a symmetric board may be numbered from another corner
    return again if same else None


def board_points(inner_corners: tuple[int, int], square_mm: float) -> np.ndarray:
    """Return the corners in the board's own coordinates, in the order of `find_corners`; (N, 3) float32, mm."""
    columns, rows = inner_corners
    grid = np.zeros((columns * rows, 3), np.float32)
    grid[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2) * square_mm
    return grid


def fit_intrinsics(
    views: list[np.ndarray], image_size: tuple[int, int], inner_corners: tuple[int, int], square_mm: float
) -> Intrinsics:
    """Fit the pinhole to several views, (N, 2) float32 px each, of a tilted board.

    The principal point and a second term of radial distortion are free only where the corners support it, and so is
    the board's bend: 1 mm, taken for flat, makes the focal length 6 % too long. Raises InputError for fewer than four
    views.
    """
    if len(views) < MIN_VIEWS:
        raise InputError(f"{len(views)} tilted boards with corners; intrinsics need at least {MIN_VIEWS}")
    grid = board_points(inner_corners, square_mm)
    flat = _fitted(views, image_size, grid)
    samples = 2 * sum(len(view) for view in views)

    def misfit(mm: float, along: int) -> float:
        return _rms_of(views, image_size, _bent(grid, mm, along), _CENTERED)[0]

    most = (-_MOST_BEND_MM, _MOST_BEND_MM)
    searches = [minimize_scalar(misfit, bounds=most, method="bounded", args=(along,)) for along in (0, 1)]
    along = int(searches[1].fun < searches[0].fun)
    bend_mm, rms = float(searches[along].x), float(searches[along].fun)
    gain = 2 * samples * np.log(max(flat.rms_px, _PERFECT_PX) / max(rms, _PERFECT_PX))
    if gain < _BENT or abs(bend_mm) < _LEAST_BEND_MM:
        return flat
    return replace(_fitted(views, image_size, _bent(grid, bend_mm, along)), bend_mm=bend_mm)


def _bent(grid: np.ndarray, mm: float, along: int) -> np.ndarray:
    """Bend a board into a cylinder whose middle stands off its ends; ``along`` its columns, 0, or rows, 1."""
    place = grid[:, along] / np.ptp(grid[:, along]) * 2 - 1
    return np.column_stack([grid[:, :2], mm * (1 - place**2)]).astype(np.float32)


def _rms_of(views: list[np.ndarray], image_size: tuple[int, int], grid: np.ndarray, flags: int) -> tuple[Any, ...]:
    """Fit one model of the pinhole; what OpenCV returns."""
    guess = centered_pinhole(_START_FOCAL * max(image_size), image_size)
    with limited_opencv_threads(1):
        return cast(tuple[Any, ...], cv2.calibrateCameraExtended(
            [grid] * len(views), views, image_size, guess, np.zeros(5), flags=flags
        ))  # fmt: skip


def _fitted(views: list[np.ndarray], image_size: tuple[int, int], grid: np.ndarray) -> Intrinsics:
    """Fit the model that the corners support, see `_MODELS`."""
    samples = 2 * sum(len(view) for view in views)
    best, least = None, np.inf
    for flags, numbers in _MODELS:
        rms, matrix, distortion, _, _, sigmas, *_ = _rms_of(views, image_size, grid, flags)
        criterion = 2 * samples * np.log(max(rms, _PERFECT_PX)) + numbers * np.log(samples)
        if criterion < least:
            focal_sigma = float(sigmas[1, 0] / matrix[1, 1])  # of y: that of x is fixed to it, and stated as 0
            best = Intrinsics(matrix, distortion.ravel()[:5].astype(float), float(rms), focal_sigma)
            least = criterion
    assert best is not None
    return best


def board_distance(
    corners: np.ndarray, intrinsics: Intrinsics, inner_corners: tuple[int, int], square_mm: float
) -> float:
    """Return the distance of the board's plane from the entrance pupil along the optical axis; mm."""
    grid = board_points(inner_corners, square_mm)
    _, rotation, translation = cv2.solvePnP(grid, corners, intrinsics.camera_matrix, intrinsics.distortion)
    normal = cv2.Rodrigues(rotation)[0][:, 2]
    return float(normal @ translation[:, 0] / normal[2])


def board_color(image: np.ndarray, corners_px: np.ndarray) -> np.ndarray:
    """Return the mean colour of linear light between the inner corners; (3,) float64, NaN if a pixel is."""
    inside = np.zeros(image.shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, cv2.convexHull(np.asarray(corners_px, np.float32)).round().astype(np.int32), 1)
    return np.asarray(image[inside > 0].mean(axis=0), float)


def color_notes(colors: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Return a sentence where the `board_color` of boards, by name, changes; none where it does not.

    A chessboard is grey, and blur hardly changes its mean colour: what changes from board to board is the gain of a
    channel, by an automatic white balance or by other light. Film and blur are fitted as if all boards had one colour.
    """
    known = {name: color for name, color in colors.items() if np.isfinite(color).all() and color.min() > 0}
    if not known:
        return ()
    ratios = np.log([color[[0, 2]] / color[1] for color in known.values()])
    change = np.abs(ratios - np.median(ratios, axis=0)).max(axis=1)
    worst = int(change.argmax())
    if change[worst] < _LARGEST_CHANGE:
        return ()
    return (
        f"the colour of the boards changes by up to {np.expm1(change[worst]):.0%} ({list(known)[worst]}): set the "
        "camera's white balance by hand, and light all boards alike",
    )

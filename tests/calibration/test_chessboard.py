"""Corners of chessboards: where a pinhole puts them, whatever the size of the squares and whichever way up."""

import cv2
import numpy as np
import pytest

from chromaperture.calibration.chessboard import Intrinsics, board_distance, board_points, find_corners, fit_intrinsics
from chromaperture.optics.pinhole import centered_pinhole

INNER, SQUARE_MM = (9, 6), 30.0
SIZE, FOCAL_PX = (480, 320), 700.0
CAMERA = Intrinsics(centered_pinhole(FOCAL_PX, SIZE), np.zeros(5), 0.0)
TEXELS, CELLS = 24, 6  # of a square of the board, and of a pixel of the picture, each way


def photograph(distance_mm: float, *, upside_down: bool = False, blur_px: float = 0.7, seed: int = 0) -> np.ndarray:
    """A board square to the axis, averaged over the area of every pixel, blurred, with noise."""
    columns, rows = INNER[0] + 1, INNER[1] + 1
    squares = np.indices((rows, columns)).sum(axis=0) % 2
    board = np.pad(np.kron(squares, np.ones((TEXELS, TEXELS))), TEXELS, constant_values=1.0).astype(np.float32)
    if upside_down:
        board = np.ascontiguousarray(board[::-1, ::-1])
    scale = CELLS * FOCAL_PX * SQUARE_MM / distance_mm / TEXELS
    wide = (CELLS * SIZE[0], CELLS * SIZE[1])
    shift = [(wide[i] - 1) / 2 - scale * (board.shape[1 - i] - 1) / 2 for i in (0, 1)]
    place = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    flags = cv2.INTER_NEAREST
    picture = cv2.warpAffine(board, place, wide, flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=1.0)
    picture = cv2.GaussianBlur(cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA), (0, 0), blur_px)
    noise = np.random.default_rng(seed).normal(0, 0.003, picture.shape)
    return (0.1 + 0.7 * picture + noise).astype(np.float32)


# Squares of 35, 21, 18.5, 13, 9.5, 8.9 and 7 px: a detector that works at a few scales of its own is wrong at some.
@pytest.mark.parametrize("distance_mm", [600, 1000, 1135, 1600, 2200, 2360, 3000])
def test_corners_lie_where_the_pinhole_puts_them(distance_mm: int) -> None:
    found = find_corners(photograph(distance_mm), INNER)
    assert found is not None
    grid = board_points(INNER, SQUARE_MM)[:, :2]
    middle = np.array([(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2])
    expected = middle + (grid - grid.mean(axis=0)) * FOCAL_PX / distance_mm
    turned = 2 * middle - expected  # the same board may be counted from its other end
    error = min(np.abs(found - expected).max(), np.abs(found - turned).max())
    assert error < 0.12  # noise moves a corner by .01 px; the rest is the pixel grid
    assert board_distance(found, CAMERA, INNER, SQUARE_MM) == pytest.approx(distance_mm, rel=1.5e-3)


def test_a_board_upside_down_stands_at_the_same_distance() -> None:
    ways = [find_corners(photograph(1200, upside_down=turned), INNER) for turned in (False, True)]
    upright, turned = (board_distance(corners, CAMERA, INNER, SQUARE_MM) for corners in ways if corners is not None)
    assert turned == pytest.approx(upright, rel=1e-3)  # noise falls on other pixels of the board


@pytest.mark.parametrize("along", [0, 1])
@pytest.mark.parametrize("bend_mm", [0.0, 1.0, 10.0])
def test_a_bent_board_is_found_and_does_not_change_the_focal_length(bend_mm: float, along: int, rng) -> None:
    size, focal_px = (720, 480), 1650.0
    matrix = centered_pinhole(focal_px, size)
    board = board_points(INNER, SQUARE_MM).astype(float)
    board -= board.mean(axis=0)
    board[:, 2] = bend_mm * (1 - (board[:, along] / board[:, along].max()) ** 2)
    views = []
    for i in range(12):
        turn = np.array([0.35 * np.sin(i), 0.4 * np.cos(i), 0.1])
        seen, _ = cv2.projectPoints(board, turn, np.array([0, 0, 1700.0]), matrix, np.zeros(5))
        views.append((seen.reshape(-1, 2) + rng.normal(0, 0.1, (len(board), 2))).astype(np.float32))
    found = fit_intrinsics(views, size, INNER, SQUARE_MM)
    assert abs(found.bend_mm) == pytest.approx(bend_mm, abs=0.2)  # .1 is found; taken for flat, 1 mm makes 6 %
    assert found.camera_matrix[0, 0] == pytest.approx(focal_px, rel=0.015)  # .3 % is the fit's own error


@pytest.mark.parametrize("plane", [np.zeros((60, 80)), np.full((60, 80), 0.5), np.eye(80)[:60]])
def test_no_board_no_corners(plane: np.ndarray) -> None:
    assert find_corners(plane.astype(np.float32), INNER) is None


def test_the_fit_of_the_pinhole_repeats_to_the_bit() -> None:
    # On several threads OpenCV adds in the order in which they finish, and results differed by 1e-7 from run to run.
    rng = np.random.default_rng(3)
    grid, views = board_points(INNER, SQUARE_MM), []
    for tilt in rng.uniform(-0.4, 0.4, (12, 3)):
        corners = cv2.projectPoints(grid, tilt, np.array([-120.0, -75.0, 900.0]), CAMERA.camera_matrix, None)[0][:, 0]
        views.append((corners + rng.normal(0, 0.1, corners.shape)).astype(np.float32))
    first, *others = (fit_intrinsics(views, SIZE, INNER, SQUARE_MM) for _ in range(12))
    for other in others:
        np.testing.assert_array_equal(other.camera_matrix, first.camera_matrix)
        np.testing.assert_array_equal(other.distortion, first.distortion)

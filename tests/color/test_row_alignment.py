"""Channels aligned row by row: the stages one after the other, and a second interpolator, are the oracles."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from chromaperture.color.alignment import (
    align_channels,
    fill_unknown,
    linear_displacement,
    rows_filler,
    shift_back,
    white_balance,
    white_gains,
)
from chromaperture.color.row_alignment import (
    align_by_rows,
    aligned_bands,
    fill_hidden,
    row_moves,
    shift_along_rows,
    visible_from,
)

HEIGHT, WIDTH = 45, 70
HALVES = np.array([[0.97, 0.0], [0.02, 0.0], [-1.0, 0.0]])
ONE_STILL = np.array([[1.0, 0.0], [0.0, 0.0], [-1.0, 1e-5]])
WHITE = np.array([0.5, 0.7, 0.4])


def scene(seed):
    """A picture of noise, and a near card of another disparity; some displacements end far outside."""
    draw = np.random.default_rng(seed)
    disparity = np.where(np.abs(np.arange(WIDTH) - 30) < 9, -3.0, 2.5) + draw.uniform(-0.2, 0.2, (HEIGHT, WIDTH))
    disparity[0, :3], disparity[1, -3:] = -500, 500
    return draw.random((HEIGHT, WIDTH, 3), np.float32), disparity.astype(np.float32)


@pytest.mark.parametrize("rows_a_band", [1, 13, 200])
@pytest.mark.parametrize("directions", [HALVES, ONE_STILL])
def test_bands_are_the_stages_of_the_whole_picture(monkeypatch, rows_a_band, directions):
    monkeypatch.setattr("chromaperture.color.row_alignment._BAND_ROWS", rows_a_band)
    image, disparity = scene(rows_a_band)
    moved = shift_back(image, linear_displacement(disparity, directions))
    visible = np.stack([visible_from(disparity, u) for u in directions], axis=-1)
    assert (~visible).sum() > 50  # there is something to fill
    order = np.argsort(np.linalg.norm(directions, axis=1), kind="stable")
    whole = fill_hidden(moved, visible, disparity, order)
    along = row_moves(directions)
    np.testing.assert_array_equal(align_by_rows(image, lambda rows: disparity[rows], along), whole)
    np.testing.assert_array_equal(align_channels(image, disparity, directions), whole)
    balanced = align_by_rows(image, lambda rows: disparity[rows], along, white_gains(WHITE))
    np.testing.assert_array_equal(balanced, white_balance(whole, WHITE))
    assert balanced.min() == 0  # cubics of noise go below black


def test_channels_that_move_across_rows_are_not_aligned_by_rows():
    assert row_moves(np.array([[1.0, 0.0], [0.0, 0.002], [-1.0, 0.0]])) is None


@pytest.mark.parametrize("step", [1, 4])
def test_rows_that_are_filled_are_those_of_the_filled_map(step):
    draw = np.random.default_rng(step)
    values = np.where(draw.random((21, 34)) < 0.4, np.nan, draw.random((21, 34))).astype(np.float32)
    rows, whole = rows_filler(values, step=step), fill_unknown(values, step=step)
    assert np.isfinite(whole).all()
    for top in (0, 7, 20):
        np.testing.assert_array_equal(rows(slice(top, top + 9)), whole[top : top + 9])
    known = np.isfinite(values)
    np.testing.assert_array_equal(whole[known], values[known])
    assert np.isin(whole, values[known]).all()


def test_bands_begin_where_they_are_wanted(monkeypatch):
    monkeypatch.setattr("chromaperture.color.row_alignment._BAND_ROWS", 13)
    image, disparity = scene(3)
    taken: dict[int, np.ndarray] = {}

    def keep(band, color):
        taken[band.start] = color

    aligned_bands(image, lambda rows: disparity[rows], row_moves(HALVES), keep, multiple=9)
    assert all(first % 9 == 0 for first in taken)
    whole = align_by_rows(image, lambda rows: disparity[rows], row_moves(HALVES))
    np.testing.assert_array_equal(np.concatenate([taken[first] for first in sorted(taken)]), whole)


# ---- cubics along rows


def test_opencv_agrees_where_its_table_has_the_place():
    draw = np.random.default_rng(0)
    image = draw.random((HEIGHT, WIDTH, 3), np.float32)
    # OpenCV rounds places to 1/32 px; these it has exactly. Some reach far beyond both edges.
    dx = (np.round(draw.normal(0, 6, (HEIGHT, WIDTH)) * 32) / 32).astype(np.float32)
    dx[0, :3], dx[1, -3:] = -500, 500
    found = np.full_like(image, -1)
    for k in range(3):
        shift_along_rows(image, dx, k, found)
    x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    expected = cv2.remap(image, x + dx, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(found, expected, atol=2e-6)  # four products in single precision


def test_between_the_places_of_a_table_it_is_smooth():
    """A straight ramp is shifted by any amount to one cubic's own error, far below a 1/32 px step of the ramp."""
    ramp = np.repeat(np.arange(WIDTH, dtype=np.float32)[None, :, None], 3, axis=2)
    ramp = np.repeat(ramp, HEIGHT, axis=0)
    shifts = np.linspace(0, 1, 257, dtype=np.float32)
    read = []
    for shift in shifts:
        displacement = np.zeros((3, 2, HEIGHT, WIDTH), np.float32)
        displacement[:, 0] = shift
        read.append(shift_back(ramp, displacement)[5, 30, 0] - 30 if shift else 0.0)
    steps = np.diff(read)
    assert steps.max() < 2 / 256  # a table of 1/32 px would stand still and then jump by 8 / 256
    assert steps.min() > 0

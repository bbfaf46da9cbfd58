"""Planes of labels: known planes, spoilt, and asked for back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.matching.execution import execution_named
from chromaperture.matching.planes.fit import (
    DRAW_BITS,
    MOST_PLANES,
    Proposal,
    distinct,
    drawn,
    draws_of,
    plane_proposals,
    tiles_of,
)
from chromaperture.matching.readable.planes import PlaneCosts

SLOW, FAST = execution_named("numpy"), execution_named("numba")
LABELS_PX = np.arange(-3.0, 3.01, 0.1)
COSTS = PlaneCosts(slope=0.3, outside=0.05)


def plane_label(plane: np.ndarray, height: int, width: int) -> np.ndarray:
    return plane[0] * np.arange(width) + plane[1] * np.arange(height)[:, None] + plane[2]


@pytest.mark.parametrize("run", [FAST, SLOW], ids=["numba", "numpy"])
def test_costs_of_planes_are_those_of_a_loop(run) -> None:
    rng = np.random.default_rng(3)
    likelihood = rng.random((4, 5, 7)).astype(np.float32)
    labels = np.arange(7.0)
    planes = np.array([[0, 0, 2.5], [0.5, -0.25, 3.0], [2.0, 1.0, 1.0]])
    found = run.plane_costs(likelihood, planes, labels, PlaneCosts(slope=0.4, outside=0.7))
    for y, x, k in np.ndindex(found.shape):
        a, b, c = planes[k]
        label = a * x + b * y + c
        cost = 0.7 if label > 6 or label < 0 else -np.interp(label, labels, likelihood[y, x])
        assert found[y, x, k] == pytest.approx(cost + 0.2 * (a * a + b * b), abs=1e-5)


# ---- proposals


@pytest.mark.parametrize("run", [FAST, SLOW], ids=["numba", "numpy"])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("sizes", [(96,), (48, 96), (12, 24)])
def test_the_planes_of_two_surfaces_are_proposed(sizes: tuple[int, ...], seed: int, run) -> None:
    rng = np.random.default_rng(seed)
    side = sizes[-1]
    wall, floor = np.array([0.0, 0.0, 12.0]), np.array([1 / side, -19.2 / side, 35.0])
    upper = np.arange(side)[:, None] < 5 * side // 12
    label = np.where(upper, plane_label(wall, side, side), plane_label(floor, side, side))
    noisy = (label + rng.normal(0, 0.5, label.shape)).astype(np.float32)
    outlier = rng.random(label.shape) < 0.2
    noisy[outlier] = rng.uniform(0, 40, outlier.sum())
    found = plane_proposals(noisy, np.full(label.shape, 0.5), sizes, run=run)
    # A tile has 1024 points, or 576, some 400 or 200 of them on a plane that scatter by half a label: their plane is
    # known to .05 or .1 at its corners. Beyond the inliers outliers pull.
    for plane, top, bottom in ((wall, 1, 9), (floor, 11, 23)):
        corners = np.array([[x * side / 24, y * side / 24, 1] for x in (1, 23) for y in (top, bottom)])
        assert np.abs((found - plane) @ corners.T).max(axis=1).min() < 0.3


@pytest.mark.parametrize(("shape", "count"), [((3, 5), 0), ((4, 4), 1)])
def test_nothing_is_proposed_of_fewer_than_sixteen_blocks(shape: tuple[int, int], count: int) -> None:
    found = plane_proposals(np.full(shape, 3.0, np.float32), np.full(shape, 0.1), (12, 24), run=FAST)
    np.testing.assert_allclose(found, np.full((count, 3), (0, 0, 3.0)), atol=1e-9)


def test_of_planes_alike_over_their_square_that_of_the_largest_stays() -> None:
    one = Proposal(np.array([0.0, 0.0, 10.0]), 50, 50, 100)
    near = Proposal(np.array([0.004, 0.0, 10.0]), 50, 50, 40)  # .28 of a label apart where it was found
    far = Proposal(np.array([0.0, 0.0, 11.0]), 50, 50, 40)
    steep = Proposal(np.array([0.05, 0.0, 7.5]), 50, 50, 40)  # alike in the middle, a label apart at the corners
    found = distinct([near, far, steep, one])
    np.testing.assert_array_equal(found, [one.plane, far.plane, steep.plane])
    assert distinct([]).shape == (0, 3)
    assert MOST_PLANES > 190


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 300), st.integers(1, 300), st.sampled_from([(12, 24), (48, 96), (100, 480)]))
def test_tiles_of_every_size_cover_a_picture(height: int, width: int, sizes: tuple[int, ...]) -> None:
    tiles = tiles_of((height, width), sizes)
    for size in sizes:
        seen = np.zeros((height, width), int)
        for tile in tiles:
            y, x = tile.points
            assert y.max() < height
            assert x.max() < width
            assert len(y) <= 32**2  # as many as a random number tells apart: see `drawn`
            if tile.size == size:
                seen[tile.top : tile.top + size, tile.left : tile.left + size] += 1
        # What is left over of less than half a tile belongs to none; but a small picture has one.
        assert (seen[: max(1, height - size // 2), : max(1, width - size // 2)] == 1).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 1024))
def test_draws_are_points_and_the_same_for_a_tile(tile: int, count: int) -> None:
    draws = draws_of(tile)
    np.testing.assert_array_equal(draws, draws_of(tile))
    assert draws.max() < 1 << DRAW_BITS
    points = drawn(draws, count)
    assert points.min() >= 0
    assert points.max() < count
    # 480 draws of every point alike: the mean of a uniform one is known to a fifth of its spread over the root of 480.
    assert abs(points.mean() - (count - 1) / 2) < 5 * count * 0.29 / 480**0.5 + 1e-9

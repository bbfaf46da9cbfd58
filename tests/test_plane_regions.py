"""Regions between depth edges, and how they join: known areas, spoilt, and asked for back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.disparity.execution import execution_named
from chromaperture.disparity.planar import between_labels, block_costs, fits_of_regions
from chromaperture.disparity.plane_fit import Volume
from chromaperture.disparity.plane_regions import (
    MOST_LOG_ODDS,
    border_costs,
    borders_of,
    bounded,
    costs_of_regions,
    joined_regions,
    regions_between_edges,
    shares_of_blocks,
)
from chromaperture.planes_config import PlanesConfig

FAST, READABLE = execution_named("numba"), execution_named("numpy")
LABELS_PX = np.arange(-3.0, 3.01, 0.1)


def edges_of(area: np.ndarray, there: float = 4.0, elsewhere: float = -5.0) -> np.ndarray:
    """Log odds of edges between blocks of different areas."""
    out = np.full((2, *area.shape), elsewhere, np.float32)
    out[0, :-1][area[1:] != area[:-1]] = there
    out[1, :, :-1][area[:, 1:] != area[:, :-1]] = there
    return out


def cards(rng: np.random.Generator, height: int, width: int, count: int) -> np.ndarray:
    """Number of the topmost of some cards on a wall; (height, width)."""
    area = np.zeros((height, width), int)
    for k in range(1, count + 1):
        y, x = rng.integers(0, height - 8), rng.integers(0, width - 8)
        area[y : y + rng.integers(8, 20), x : x + rng.integers(8, 20)] = k
    return area


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), count=st.integers(0, 4), noise=st.sampled_from([0.0, 0.5]))
def test_no_region_crosses_an_edge_that_closes(seed: int, count: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    area = cards(rng, 40, 50, count)
    odds = edges_of(area) + noise * rng.normal(size=(2, 40, 50)).astype(np.float32)
    region = regions_between_edges(odds)
    assert region.shape == area.shape
    assert np.array_equal(np.unique(region), np.arange(region.max() + 1))
    astray = 0
    for k in np.unique(region):
        inside = area == np.bincount(area[region == k]).argmax()
        # A block's strongest link speaks for it, so a border may lie one block aside.
        astray += ((region == k) & ~cv2.dilate(inside.astype(np.uint8), np.ones((3, 3))).astype(bool)).sum()
    assert astray <= 0.03 * area.size  # slivers of two blocks between cards: .017 is the worst of 6000 random pictures


def test_an_even_picture_is_one_region() -> None:
    assert regions_between_edges(np.full((2, 9, 12), -5, np.float32)).max() == 0


def energy(region: np.ndarray, cost: np.ndarray, links: np.ndarray, penalty: float) -> float:
    """What planes and borders cost, region by region."""
    numbers = np.unique(region)
    total = penalty * len(numbers) + sum(cost[region == k].sum(axis=0).min() for k in numbers)
    total += links[0, :-1][region[1:] != region[:-1]].sum()
    return float(total + links[1, :, :-1][region[:, 1:] != region[:, :-1]].sum())


@pytest.mark.parametrize("run", [FAST, READABLE], ids=["numba", "numpy"])
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), penalty=st.sampled_from([0.0, 1.0, 10.0]), scale=st.sampled_from([0.0, 0.3, 3.0]))
def test_joining_lowers_the_energy_until_no_pair_does(run, seed: int, penalty: float, scale: float) -> None:
    rng = np.random.default_rng(seed)
    region = np.arange(30).reshape(5, 6)
    cost, links = rng.normal(size=(5, 6, 4)), scale * rng.random((2, 5, 6))
    found = joined_regions(region, costs_of_regions(region, cost), links, plane_penalty=penalty, run=run)
    least = energy(found.region, cost, links, penalty)
    assert least <= energy(region, cost, links, penalty) + 1e-9
    for k, plane in enumerate(found.plane):
        assert plane == cost[found.region == k].sum(axis=0).argmin()
    for one, other in borders_of(found.region, links)[0]:
        assert energy(np.where(found.region == other, one, found.region), cost, links, penalty) >= least - 1e-9


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**31), size=st.integers(1, 12), penalty=st.sampled_from([0.0, 1.0, 10.0]), ties=st.booleans()
)  # fmt: skip
def test_compiled_joining_is_that_of_numpy(seed: int, size: int, penalty: float, ties: bool) -> None:
    """The same joins in the same order, with whole numbers many pairs gain as much."""
    rng = np.random.default_rng(seed)
    region = np.arange(size * (size + 1)).reshape(size, size + 1)
    total, links = 4 * rng.random((region.size, 9)), 3 * rng.random((2, size, size + 1))
    if ties:
        total, links = total.round(), links.round()
    pairs, border = borders_of(region, links)
    (into, joined), (into_numpy, joined_numpy) = (
        run.join_regions(total, pairs, border, plane_penalty=penalty) for run in (FAST, READABLE)
    )
    np.testing.assert_array_equal(into, into_numpy)
    np.testing.assert_array_equal(joined, joined_numpy)


def test_borders_are_summed() -> None:
    region = np.array([[0, 0, 1], [2, 2, 1]])
    links = np.arange(12, dtype=float).reshape(2, 2, 3)
    pairs, border = borders_of(region, links)
    # 0 meets 2 below twice (links 0 and 1), 1 at the right (7); 2 meets 1 at the right (10).
    assert pairs.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert border.tolist() == [7, 1, 10]


def test_a_sure_edge_costs_nothing_and_a_sure_surface_no_more_than_the_limit() -> None:
    costs = border_costs(np.array([8.0, 0.0, -2.0, -50.0]), 5.0)
    assert costs.tolist() == [0, 0, 10, 5 * MOST_LOG_ODDS]


@pytest.mark.parametrize("seed", range(3))
def test_planes_between_edges_are_found_although_blocks_beside_them_speak_for_the_near_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    area = np.zeros((30, 45), int)
    area[8:22, 12:30] = 1
    truth = np.where(area == 1, -1.0, 1.5)
    seen = truth.copy()
    seen[6:24, 10:32] = -1.0  # windows two blocks beyond the card see the card
    away = (LABELS_PX - seen[..., None]) / 0.6
    sums = (8 * np.maximum(0, 1 - away**2) + rng.normal(0, 0.5, away.shape)).astype(np.float32)
    config = PlanesConfig(learned_border_nats=(5.0,))
    blocks = Volume(sums, LABELS_PX, block_costs(config), FAST)
    planes = np.array([[0, 0, c] for c in (-2.0, -1.0, 0.0, 1.5, 2.5)])
    (fit,) = fits_of_regions(planes, blocks, edges_of(area), (120, 180), config=config)
    # The volume's parabola is sampled at tenths; its place is found to a fraction of one.
    assert np.mean(np.abs(fit.label_px[2::4, 2::4] - truth) < 0.1) > 0.99


@pytest.mark.parametrize("share", [0.0, 0.21, 0.5, 0.83])
def test_level_planes_are_placed_between_labels_and_sloped_ones_stay(share: float) -> None:
    step = LABELS_PX[1] - LABELS_PX[0]
    nearest = LABELS_PX[20 + round(share)]
    choice = np.zeros((30, 45), int)
    choice[:, 30:] = 1
    label = np.where(choice == 0, LABELS_PX[20] + share * step, LABELS_PX[5])
    label[:, 28:30] = LABELS_PX[5]  # windows beside the other plane see that
    sums = 8 * np.exp(-(((LABELS_PX - label[..., None]) / 0.6) ** 2))
    blocks = Volume(sums.astype(np.float32), LABELS_PX, block_costs(PlanesConfig()), FAST)
    planes = np.array([[0, 0, nearest], [0.001, 0, LABELS_PX[5]]])
    found = between_labels(planes, choice, blocks, border=2)
    # A Gaussian is no parabola: 41 places between two labels are found to .01 of a label.
    np.testing.assert_allclose(found[0], [0, 0, LABELS_PX[20] + share * step], atol=0.02 * step)
    np.testing.assert_array_equal(found[1], planes[1])


def test_level_planes_at_an_end_of_the_range_stay() -> None:
    sums = np.zeros((30, 45, len(LABELS_PX)), np.float32)
    sums[..., 0] = 5
    blocks = Volume(sums, LABELS_PX, block_costs(PlanesConfig()), FAST)
    planes = np.array([[0, 0, LABELS_PX[0]]])
    np.testing.assert_array_equal(between_labels(planes, np.zeros((30, 45), int), blocks, border=2), planes)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), most=st.floats(0.1, 100))
def test_bounded_costs_keep_their_order_and_small_losses(seed: int, most: float) -> None:
    cost = np.random.default_rng(seed).normal(0, 20, (4, 5, 6)).astype(np.float32)
    found, least = bounded(cost, most), cost.min(axis=2, keepdims=True)
    # Costs of 20 nats in float32: 1e-5 is five of their last bits.
    np.testing.assert_allclose(found.min(axis=2), least[..., 0], atol=1e-5)
    assert (found - least <= most * (1 + 1e-5) + 1e-5).all()
    order = np.argsort(cost, axis=2)
    assert (np.diff(np.take_along_axis(found, order, axis=2), axis=2) >= -1e-5).all()
    small = bounded(least + most * 1e-3 * np.arange(3, dtype=np.float32), most) - least
    expected = most * np.broadcast_to([0, 0.9995e-3, 1.998e-3], small.shape)
    np.testing.assert_allclose(small, expected, atol=1e-5 + 1e-6 * most)
    assert bounded(cost, 0.0) is cost


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), regions=st.sampled_from([1, 2, 32, 33, 100]), most=st.sampled_from([0.0, 3.0]))
def test_costs_of_regions_are_sums_of_what_blocks_lose(seed: int, regions: int, most: float) -> None:
    rng = np.random.default_rng(seed)
    region = rng.permutation(np.append(np.arange(regions), rng.integers(0, regions, 240 - regions))).reshape(12, 20)
    cost = rng.normal(0, 5, (12, 20, 7)).astype(np.float32)
    found = costs_of_regions(region, cost, most_block_nats=most)
    alone = bounded(cost, most).astype(float)
    # The same float32 terms, added in float64 in the same order.
    np.testing.assert_allclose(found, [alone[region == k].sum(axis=0) for k in range(regions)], rtol=1e-12, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_blocks_count_by_their_shares(seed: int) -> None:
    rng = np.random.default_rng(seed)
    region = rng.permutation(np.append(np.arange(40), rng.integers(0, 40, 200))).reshape(12, 20)
    cost, shares = rng.normal(0, 5, (12, 20, 7)).astype(np.float32), rng.uniform(0, 1, (12, 20)).astype(np.float32)
    found = costs_of_regions(region, cost, most_block_nats=3.0, shares=shares)
    alone = bounded(cost, 3.0) * shares[..., None]
    expected = [alone[region == k].sum(axis=0, dtype=float) for k in range(40)]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-9)  # the same float32 terms, added in float64


def test_blocks_beside_likely_edges_count_less_but_in_thin_regions() -> None:
    """A near card, what is behind it, and a wire one block wide."""
    log_odds = np.full((2, 12, 20), -5.0, np.float32)
    log_odds[1, :, 7] = 3.0  # right of column 7
    log_odds[1, :, 14:16] = 1.0  # on both sides of column 15
    region = np.zeros((12, 20), int)
    region[:, 8:15], region[:, 15], region[:, 16:] = 1, 2, 3
    shares = shares_of_blocks(region, log_odds, 0.3)
    expected = np.ones((12, 20), np.float32)
    expected[:, [7, 8, 14, 16]] = 0.3
    np.testing.assert_array_equal(shares, expected)


def test_a_strip_whose_rim_sees_the_thing_beside_it_keeps_its_own_plane() -> None:
    """Five columns of blank wall beside a book: the first sees the book, and outvoted the others."""
    cost = np.zeros((30, 20, 2), np.float32)
    cost[:, :15] = [3.0, 0.0]  # the book is plane 1
    cost[:, 15] = [3.0, 0.0]
    cost[:, 16:, 1] = 0.6
    log_odds = np.full((2, 30, 20), -6.0, np.float32)
    log_odds[1, :, 14] = 2.0
    region = (np.arange(20) >= 15) * np.ones((30, 1), int)

    def chosen(share: float) -> list[int]:
        total = costs_of_regions(region, cost, shares=shares_of_blocks(region, log_odds, share))
        return total.argmin(axis=1).tolist()

    assert chosen(1.0) == [1, 1]
    assert chosen(0.3) == [1, 0]


def test_few_blocks_of_strong_evidence_do_not_outvote_the_others_of_their_region() -> None:
    """A far wall with a rim of blocks whose evidence for the near thing beside them is ten times as strong."""
    cost = np.zeros((20, 20, 2), np.float32)
    cost[..., 1] = 1.0  # the wall is plane 0
    cost[:, :4] = [10.0, 0.0]
    region = np.zeros((20, 20), int)
    links = np.full((2, 20, 20), 100.0)

    def chosen(cost: np.ndarray) -> int:
        return int(joined_regions(region, costs_of_regions(region, cost), links, plane_penalty=1.0, run=FAST).plane[0])

    assert chosen(cost) == 1
    assert chosen(bounded(cost, 3.0)) == 0

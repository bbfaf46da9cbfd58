"""Regions between depth edges, and how they join: known areas, spoilt, and asked for back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.matching.execution import execution_named
from chromaperture.matching.planes.regions import (
    MOST_LOG_ODDS,
    border_costs,
    borders_of,
    bounded,
    costs_of_regions,
    planes_of_regions,
    regions_between_edges,
    shares_of_blocks,
)
from chromaperture.settings.stages import PlanesConfig

FAST, READABLE = execution_named("numba"), execution_named("numpy")
LABELS = np.arange(61.0)


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
    into, total = run.join_regions(
        costs_of_regions(region, cost), *borders_of(region, links), plane_penalty=penalty
    )  # fmt: skip
    found = into[region]
    least = energy(found, cost, links, penalty)
    assert least <= energy(region, cost, links, penalty) + 1e-9
    for k in np.unique(found):
        np.testing.assert_allclose(total[k], cost[found == k].sum(axis=0), atol=1e-9)
    for one, other in borders_of(found, links)[0]:
        assert energy(np.where(found == other, one, found), cost, links, penalty) >= least - 1e-9


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


def evidence_of(label: np.ndarray, rng: np.random.Generator, strength: np.ndarray | float = 8.0) -> np.ndarray:
    """Sums of the evidence of blocks: parabolas six labels wide, and noise of half a nat."""
    away = (LABELS - label[..., None]) / 6
    peak = np.broadcast_to(strength, label.shape)[..., None]
    return (peak * np.maximum(0, 1 - away**2) + rng.normal(0, 0.5, away.shape)).astype(np.float32)


@pytest.mark.parametrize("run", [FAST, READABLE], ids=["numba", "numpy"])
@pytest.mark.parametrize("seed", range(3))
def test_planes_between_edges_are_found_beside_blocks_that_see_the_near_one(seed: int, run) -> None:
    rng = np.random.default_rng(seed)
    area = np.zeros((30, 45), int)
    area[8:22, 12:30] = 1
    truth = np.where(area == 1, 20.0, 45.0)
    seen = truth.copy()
    seen[6:24, 10:32] = 20.0  # windows two blocks beyond the card see the card
    none = np.empty((0, 3))  # level planes of every label are there anyway
    found = planes_of_regions(evidence_of(seen, rng), none, edges_of(area), config=PlanesConfig(), run=run)
    # Evidence is as noisy at every label: its place is found to a label where blocks are many.
    assert np.mean(np.abs(found.label - truth) <= 1) > 0.99
    assert np.array_equal(np.unique(found.region), np.arange(found.region.max() + 1))


@pytest.mark.parametrize("seed", range(3))
def test_a_weak_area_behind_an_edge_gets_its_own_plane(seed: int) -> None:
    """A strong wall at the left, and at the right a floor whose blocks hardly say anything one by one."""
    rng = np.random.default_rng(seed)
    area = (np.arange(45) >= 20)[None].repeat(30, axis=0).astype(int)
    a, b, c = floor = np.array([0.2, 0.8, 16.4])
    y, x = np.mgrid[:30, :45]
    truth = np.where(area == 1, a * x + b * y + c, 40.0)
    nats = evidence_of(truth, rng, np.where(area == 1, 0.5, 8.0))
    alone = nats.argmax(axis=2)
    assert np.median(np.abs(alone - truth)[area == 1]) > 3  # 4 is found: half of all labels are guessed
    found = planes_of_regions(nats, np.array([floor, [0.0, 0, 30]]), edges_of(area), config=PlanesConfig(), run=FAST)
    np.testing.assert_allclose(found.label[area == 0], 40.0, atol=1.0)
    # Whichever block a border puts on the other side.
    assert np.mean(np.abs(found.label - truth)[area == 1] < 0.01) > 0.97


def test_regions_without_an_edge_between_share_one_plane() -> None:
    """Watersheds cut a picture wherever odds vary; joining takes these borders away again, and their planes."""
    rng = np.random.default_rng(4)
    odds = (-5 + rng.normal(0, 0.5, (2, 30, 45))).astype(np.float32)
    assert regions_between_edges(odds).max() > 20
    truth = np.full((30, 45), 25.0)
    found = planes_of_regions(evidence_of(truth, rng), np.empty((0, 3)), odds, config=PlanesConfig(), run=FAST)
    assert found.region.max() == 0
    np.testing.assert_array_equal(found.label, 25.0)


def test_labels_of_steep_planes_stay_in_range() -> None:
    rng = np.random.default_rng(4)
    steep = 4 * np.arange(45.0) - 58.5
    nats = evidence_of(steep + np.zeros((30, 1)), rng, 20.0)
    odds = np.full((2, 30, 45), -5, np.float32)
    plane = np.array([[4.0, 0.0, -58.5]])
    found = planes_of_regions(nats, plane, odds, config=PlanesConfig(slope_penalty=0.0), run=FAST)
    np.testing.assert_allclose(found.label[0], np.clip(steep, 0, 60))


def levels_of(nats: np.ndarray, log_odds: np.ndarray, **settings_) -> list[float]:
    """Labels of a strip of blocks, by level planes alone, that cost next to nothing."""
    config = PlanesConfig(plane_penalty=1.0, **settings_)
    found = planes_of_regions(nats.astype(np.float32), np.empty((0, 3)), log_odds, config=config, run=FAST)
    return found.label[15].tolist()


@pytest.mark.parametrize(("share", "strip"), [(1.0, 20.0), (0.3, 45.0)])
def test_blocks_beside_a_likely_edge_count_less_for_the_plane_of_their_region(share: float, strip: float) -> None:
    """Five columns beside a book, of which the first sees the book five times as well as the others the wall."""
    nats = np.zeros((30, 20, 61))
    nats[:, :16, 20], nats[:, 16:, 45] = 3.0, 0.6
    log_odds = np.full((2, 30, 20), -6.0, np.float32)
    log_odds[1, :, 14] = 2.0
    found = levels_of(nats, log_odds, edge_block_weight=share, max_block_nats=0.0)
    assert found == [20.0] * 15 + [strip] * 5


@pytest.mark.parametrize(("most", "expected"), [(0.0, 20.0), (3.0, 45.0)])
def test_what_a_block_says_is_bounded(most: float, expected: float) -> None:
    """A fifth of the blocks have ten times the evidence of the others, for something else."""
    nats = np.zeros((30, 20, 61))
    nats[:, :4, 20], nats[:, 4:, 45] = 10.0, 1.0
    log_odds = np.full((2, 30, 20), -6.0, np.float32)
    assert levels_of(nats, log_odds, max_block_nats=most) == [expected] * 20


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
@given(
    seed=st.integers(0, 2**31), regions=st.sampled_from([1, 2, 32, 33, 100]), most=st.sampled_from([0.0, 3.0]),
    shared=st.booleans(),
)  # fmt: skip
def test_costs_of_regions_are_sums_of_what_blocks_lose(seed: int, regions: int, most: float, shared: bool) -> None:
    rng = np.random.default_rng(seed)
    region = rng.permutation(np.append(np.arange(regions), rng.integers(0, regions, 240 - regions))).reshape(12, 20)
    cost = rng.normal(0, 5, (12, 20, 7)).astype(np.float32)
    shares = rng.uniform(0, 1, (12, 20)).astype(np.float32) if shared else None
    found = costs_of_regions(region, cost, most_block_nats=most, shares=shares)
    alone = bounded(cost, most) if shares is None else bounded(cost, most) * shares[..., None]
    expected = [alone[region == k].sum(axis=0, dtype=float) for k in range(regions)]
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

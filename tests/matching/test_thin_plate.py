"""The plate through the evidence of blocks: known surfaces, its energy by loops, and its parts by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from chromaperture.matching.planes.thin_plate import (
    at_labels,
    beside_edges,
    link_weights,
    smoothed_labels,
    tempered,
    thin_plate,
)
from chromaperture.settings.stages import PlateConfig

CONFIG = PlateConfig()
LABELS = np.arange(41.0)


def no_edges(height: int, width: int) -> np.ndarray:
    return np.full((2, height, width), -6.0, np.float32)


def plane(height: int, width: int, a: float, b: float, c: float) -> np.ndarray:
    return a * np.arange(width) + b * np.arange(height)[:, None] + c


def evidence_about(label: np.ndarray, strength: float = 20.0) -> np.ndarray:
    """Nats of blocks that fall off as a parabola: ``strength`` at a distance of one label."""
    return (-strength * (LABELS - label[..., None]) ** 2).astype(np.float32)


# ---- surfaces that are known


@pytest.mark.parametrize("away", [0.0, 1.3, -1.3])
def test_evidence_about_a_plane_gives_that_plane(away: float) -> None:
    truth = plane(24, 30, 0.11, -0.07, 20.3)
    nats = quadratic_evidence(truth, np.full(truth.shape, 0.003), CONFIG, len(LABELS))
    config = replace(CONFIG, slope_penalty=1e-6)  # which levels slopes by as much as its weight says
    found = thin_plate(nats.astype(np.float32), truth + away, no_edges(24, 30), config=config)
    # Parabolas that single precision rounds to 2e-7 of 3 nats have their place to 1e-4.
    np.testing.assert_allclose(found, truth, atol=1e-3)


def test_slopes_are_levelled_by_hardly_anything() -> None:
    """And evidence of a bell, which a parabola through three labels misses a little, in waves of a label."""
    truth = plane(24, 30, 0.11, -0.07, 20.3)
    found = thin_plate(evidence_about(truth), truth, no_edges(24, 30), config=CONFIG)
    assert np.abs(found - truth).max() < 0.02


@pytest.mark.parametrize(("rounds", "share"), [(3, 0.35), (10, 0.25)])
def test_strong_evidence_bends_the_plate_to_a_bowl(rounds: int, share: float) -> None:
    y, x = np.mgrid[-12:13, -15:16]
    truth = 15 + 0.01 * (x**2 + y**2)
    flat = np.full(truth.shape, truth.mean())
    found = thin_plate(evidence_about(truth), flat, no_edges(*truth.shape), config=replace(CONFIG, rounds=rounds))
    # Every second difference is three times what makes a fold. Of the plane's error .25 is left after three rounds,
    # most of it in the corners, and .15 after ten.
    assert np.abs(found - truth).mean() < share * np.abs(flat - truth).mean()


def test_a_plane_goes_on_where_there_is_no_evidence() -> None:
    truth = plane(30, 36, 0.1, 0.05, 15.0)
    nats = evidence_about(truth)
    hole = np.s_[8:22, 10:26]
    nats[hole] = 0
    found = thin_plate(nats, truth + 1.0, no_edges(30, 36), config=replace(CONFIG, slope_penalty=1e-6, rounds=3))
    # Two rounds leave .02 of the label that the start is away. The hole has 1e-4 nats of weight a block there, against
    # bending of 3000.
    np.testing.assert_allclose(found[hole], truth[hole], atol=0.01)


@pytest.mark.parametrize("log_odds", [4.0, -6.0])
def test_a_step_stays_sharp(log_odds: float) -> None:
    """Along a likely depth edge, and without one where the evidence is strong."""
    truth = np.where(np.arange(30) < 15, 12.0, 22.0)[None].repeat(24, axis=0)
    edges = no_edges(24, 30)
    edges[1, :, 14] = log_odds
    found = thin_plate(evidence_about(truth), truth + 0.4, edges, config=CONFIG)
    np.testing.assert_allclose(found, truth, atol=0.05)


def test_what_happens_on_one_side_of_an_edge_does_not_matter_on_the_other() -> None:
    left, right = plane(24, 15, 0.1, 0.0, 12.0), plane(24, 15, 0.0, -0.05, 20.0)
    edges = no_edges(24, 30)
    edges[1, :, 14] = 12.0
    nats = evidence_about(np.concatenate([left, right], axis=1))
    nats[:, :15] = 0  # no evidence: whatever the links let through decides
    start = np.concatenate([left, right], axis=1)
    found = thin_plate(nats, start, edges, config=CONFIG)
    assert np.abs(found[:, :15] - left).max() < 1.0
    np.testing.assert_allclose(found[:, 15:], right, atol=0.03)  # slopes are levelled by .02 in a corner


# ---- the energy


def quadratic_evidence(label: np.ndarray, bend: np.ndarray, config: PlateConfig, count: int) -> np.ndarray:
    """Nats that `tempered` turns into ``most - bend / 2 (k - label)^2``, but for a constant of every block."""
    left = config.max_block_nats - bend[..., None] / 2 * (np.arange(count) - label[..., None]) ** 2
    assert left.min() > 0
    return config.max_block_nats * np.log(left) / config.evidence_share


def loss(difference: float, scale: float) -> float:
    return difference**2 / (1 + difference**2 / scale**2)


def smoothness(u: np.ndarray, links: np.ndarray, config: PlateConfig) -> float:
    """What bends and slopes cost, difference by difference; ``links`` are those below and at the right of blocks."""
    height, width = u.shape
    total = 0.0
    for y in range(height):
        for x in range(width):
            if x + 2 < width:
                weight = links[1, y, x] * links[1, y, x + 1]
                bend = u[y, x] - 2 * u[y, x + 1] + u[y, x + 2]
                total += config.bend_penalty / 2 * weight * loss(bend, config.bend_labels)
            if y + 2 < height:
                weight = links[0, y, x] * links[0, y + 1, x]
                bend = u[y, x] - 2 * u[y + 1, x] + u[y + 2, x]
                total += config.bend_penalty / 2 * weight * loss(bend, config.bend_labels)
            if x + 1 < width and y + 1 < height:
                weight = 2 * min(links[1, y, x], links[1, y + 1, x]) * min(links[0, y, x], links[0, y, x + 1])
                twist = u[y, x] - u[y, x + 1] - u[y + 1, x] + u[y + 1, x + 1]
                total += config.bend_penalty / 2 * weight * loss(twist, config.bend_labels)
            if x + 1 < width:
                total += config.slope_penalty / 2 * links[1, y, x] * loss(u[y, x + 1] - u[y, x], config.slope_labels)
            if y + 1 < height:
                total += config.slope_penalty / 2 * links[0, y, x] * loss(u[y + 1, x] - u[y, x], config.slope_labels)
    return total


@pytest.mark.parametrize("bend_labels", [0.05, 1.0, 50.0])
@pytest.mark.parametrize("seed", range(2))
def test_the_plate_is_where_a_general_purpose_minimiser_ends(seed: int, bend_labels: float) -> None:
    rng = np.random.default_rng(seed)
    shape, count = (5, 6), 9
    config = PlateConfig(
        rounds=100, bend_penalty=0.3, bend_labels=bend_labels, slope_penalty=0.05, smoothed_labels=0.05,
        evidence_share=1.0,
    )  # fmt: skip
    wanted = 4 + plane(*shape, 0.1, -0.1, 0.0) + rng.normal(0, 0.5, shape)
    bend = rng.uniform(0.02, 0.08, shape)
    nats = quadratic_evidence(wanted, bend, config, count)
    odds = rng.normal(-4, 2, (2, *shape)).astype(np.float32)
    odds = np.minimum(odds, -0.1)  # no block beside an edge, whose evidence would count less
    start = np.full(shape, 4.0)
    found = thin_plate(nats.astype(np.float32), start, odds, config=config)

    # The best of a block's labels is worth the same at every block: that scales its evidence.
    left = config.max_block_nats - bend[..., None] / 2 * (np.arange(count) - wanted[..., None]) ** 2
    bend = bend * config.max_block_nats / left.max(axis=2)
    links = 1 / (1 + np.exp(odds + config.edge_log_odds))

    def energy(flat: np.ndarray) -> float:
        u = flat.reshape(shape)
        return float((bend / 2 * (u - wanted) ** 2).sum()) + smoothness(u, links, config)

    options = {"maxiter": 5000, "maxfun": 10**6, "ftol": 1e-15, "gtol": 1e-9}
    # The loss is not convex: the minimiser starts from the plate, and may not find less nearby.
    best = minimize(energy, found.ravel(), method="L-BFGS-B", options=options)
    # Numerical derivatives know the energy to 1e-7; float32 evidence of 3 nats has steps of 2e-7.
    assert energy(found.ravel()) - best.fun < 1e-5
    np.testing.assert_allclose(found.ravel(), best.x, atol=0.02)
    assert energy(found.ravel()) < energy(start.ravel())
    if bend_labels > 10:  # as good as convex: the minimiser ends there from anywhere
        other = minimize(energy, start.ravel(), method="L-BFGS-B", options=options)
        assert energy(found.ravel()) == pytest.approx(other.fun, abs=1e-4)


# ---- any input


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**31), height=st.integers(2, 7), width=st.integers(2, 7), count=st.integers(3, 9),
    strength=st.sampled_from([0.0, 1.0, 1e4]),
)  # fmt: skip
def test_labels_stay_in_range_and_finite(seed: int, height: int, width: int, count: int, strength: float) -> None:
    rng = np.random.default_rng(seed)
    nats = (strength * rng.normal(size=(height, width, count))).astype(np.float32)
    start = rng.uniform(0, count - 1, (height, width))
    odds = rng.normal(0, 8, (2, height, width)).astype(np.float32)
    found = thin_plate(nats, start, odds, config=CONFIG)
    assert found.shape == start.shape
    assert np.isfinite(found).all()
    assert found.min() >= 0
    assert found.max() <= count - 1


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), shift=st.integers(-6, 6))
def test_labels_that_count_from_elsewhere_change_nothing_else(seed: int, shift: int) -> None:
    rng = np.random.default_rng(seed)
    table = np.full((6, 8, 61), -12.0, np.float32)  # of labels -10 to 50
    table[..., 20:40] = rng.normal(0, 3, (6, 8, 20))
    start = rng.uniform(14, 26, (6, 8))
    odds = rng.normal(-3, 2, (2, 6, 8)).astype(np.float32)
    here, there = (
        thin_plate(table[..., 10 - by : 51 - by], start + by, odds, config=CONFIG) for by in (0, shift)
    )  # fmt: skip
    np.testing.assert_allclose(there, here + shift, atol=1e-6)  # equations of weights between 1e-4 and 1e4, in doubles


# ---- its parts


def test_links_are_the_probability_of_no_edge() -> None:
    odds = np.array([-30.0, -2.0, 0.0, 30.0])
    expected = [1, 0.5, 1 / (1 + np.exp(2)), 1e-4]  # the last by the lower bound
    np.testing.assert_allclose(link_weights(odds, 2.0), expected, atol=1e-9)
    np.testing.assert_allclose(link_weights(odds[1:3], 0.0), [1 / (1 + np.exp(-2)), 0.5])


def test_a_likely_edge_touches_the_blocks_at_its_ends() -> None:
    odds = np.full((2, 4, 5), -1.0)
    odds[0, 1, 2] = 0.5  # between rows 1 and 2
    odds[1, 3, 0] = 2.0  # between columns 0 and 1
    odds[0, 3, 4] = odds[1, 0, 4] = 9.0  # links that have one end only
    expected = np.zeros((4, 5), bool)
    expected[[1, 2, 3, 3], [2, 2, 0, 1]] = True
    np.testing.assert_array_equal(beside_edges(odds), expected)


def test_evidence_is_worth_its_share_and_never_more_than_the_bound() -> None:
    nats = np.array([[[0.0, 10, 20], [-100, 4, 5]], [[7, 7, 7], [1e6, 0, 0]]], np.float32)
    odds = np.full((2, 2, 2), -1.0)
    odds[1, 0, 0] = 1.0  # along the first row
    found = tempered(nats, odds, config=PlateConfig(evidence_share=0.2, edge_block_weight=0.5, max_block_nats=4.0))
    expected = [
        [4 * np.exp([-20 * 0.1 / 4, -10 * 0.1 / 4, 0]), 4 * np.exp([-105 * 0.1 / 4, -0.1 / 4, 0])],
        [[4, 4, 4], [4, 0, 0]],
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-30)  # float32


def test_smoothing_along_labels_is_that_of_a_gaussian_and_repeats_beyond_the_ends() -> None:
    nats = np.zeros((2, 3, 15), np.float32)
    nats[0, 1, 7], nats[1, 2, :] = 1.0, 5.0
    found = smoothed_labels(nats, 1.5)
    bell = np.exp(-((np.arange(15) - 7) ** 2) / (2 * 1.5**2))
    bell[np.abs(np.arange(15) - 7) > 6] = 0
    np.testing.assert_allclose(found[0, 1], bell / bell.sum(), atol=1e-6)  # float32
    np.testing.assert_allclose(found[1, 2], 5.0, rtol=1e-6)
    assert not found[0, [0, 2]].any()


def test_slope_and_curvature_are_those_of_the_parabola() -> None:
    k = np.arange(9)
    down, up = -((k - 4.3) ** 2), (k - 4.3) ** 2
    nats = np.stack([down, up, 0 * k])[None].astype(np.float32)
    for label in (4.0, 4.3, 2.75, 0.2, 7.9):
        slope, curvature = at_labels(nats, np.full((1, 3), label))
        np.testing.assert_allclose(slope, [[-2 * (label - 4.3), 2 * (label - 4.3), 0]], atol=1e-5)  # float32 of 20
        np.testing.assert_allclose(curvature, [[2, 0, 0]], atol=1e-5)  # upwards there is no peak to go to

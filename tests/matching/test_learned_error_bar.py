"""The learned error bar: its signs against plain loops, its weights, and how they are found."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.matching import learned_error_bar
from chromaperture.matching.learned_error_bar import SHIFTS, Weights, learned_bar, signs, weights
from chromaperture.matching.planes.block_surface import BlockSurface
from chromaperture.matching.planes.regions import Regions

TRAINING = Path(__file__).parents[2] / "benchmarks" / "error_bar_training.py"
SHAPE = 20, 26  # blocks
LABELS = 40


def blocks(rng, label, *, nats=16.0, planes=None, odds=-5.0):
    """A surface of blocks whose evidence is a parabola about it, with noise."""
    away = (np.arange(LABELS) - label[..., None]) / 8
    evidence = nats * np.maximum(0, 1 - away**2) + rng.normal(0, 1, away.shape)
    log_odds = np.full((2, *label.shape), odds, np.float32)
    regions = Regions(np.zeros(label.shape, int), label if planes is None else planes)
    return BlockSurface(label, evidence.astype(np.float32), log_odds, label, regions)


@pytest.fixture
def world(rng):
    """A slope with a step, the paths' surface that scatters about it, and their error bar."""
    label = 15 + 0.1 * np.arange(SHAPE[1]) + np.zeros((SHAPE[0], 1))
    label[:, 14:] += 6
    surface = blocks(rng, label, planes=label + rng.normal(0, 0.5, SHAPE))
    return surface, label + rng.normal(0, 0.4, SHAPE), rng.uniform(0.2, 2.0, SHAPE)


# ---- signs


@pytest.mark.parametrize("kind", ["blur", "views"])
def test_signs_are_those_that_have_weights(world, kind):
    found = signs(*world)
    assert set(weights()[kind].names) <= set(found)
    assert all(values.shape == SHAPE and values.dtype == np.float32 for values in found.values())


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), kind=st.sampled_from(["constant", "nothing", "random"]))
def test_signs_are_finite(seed, kind):
    rng = np.random.default_rng(seed)
    height, width = rng.integers(2, 12, 2)
    if kind == "random":
        label = rng.uniform(0, LABELS - 1, (height, width))
        nats = (10.0 ** rng.uniform(-3, 4) * rng.normal(size=(height, width, LABELS))).astype(np.float32)
        first, sigma, planes = rng.uniform(0, LABELS - 1, (3, height, width))
        odds = rng.normal(0, 8, (2, height, width))
    else:
        label = planes = np.full((height, width), 7.0)
        nats = np.full((height, width, LABELS), 0.0 if kind == "nothing" else 3.0, np.float32)
        first, sigma = label, np.zeros_like(label)
        odds = np.full((2, height, width), -6.0)
    surface = BlockSurface(label, nats, odds.astype(np.float32), label, Regions(np.zeros(label.shape, int), planes))
    found = signs(surface, first, sigma)
    for name, values in found.items():
        assert np.isfinite(values).all(), name
    for kind_of_evidence in ("blur", "views"):
        bar = learned_bar(found, kind_of_evidence)
        assert np.isfinite(bar).all()
        assert (bar > 0).all()


def test_ranges_are_those_of_plain_windows(world):
    found, label = signs(*world), world[0].label
    for reach in learned_error_bar.REACHES_BLOCKS:
        for y, x in [(0, 0), (10, 13), (19, 3), (12, 25)]:
            part = label[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
            # Labels of 20 in single precision, under a logarithm from .1 on.
            assert found[f"range_{reach}"][y, x] == pytest.approx(np.log(part.max() - part.min() + 0.1), abs=1e-4)


def test_what_paths_and_planes_said_is_told_by_how_far_it_lies(rng):
    label = np.full(SHAPE, 15.0)
    surface = blocks(rng, label, planes=label + 3.0)
    found = signs(surface, label - 2.0, np.full(SHAPE, 0.5))
    np.testing.assert_allclose(found["paths"], np.log(2.1), atol=1e-5)
    np.testing.assert_allclose(found["planes"], np.log(3.1), atol=1e-5)
    np.testing.assert_allclose(found["posterior"], np.log(0.6), atol=1e-5)
    np.testing.assert_allclose(found["frame"], np.log(0.6), atol=1e-5)


def test_depth_edges_are_told_where_they_are(rng):
    surface = blocks(rng, np.full(SHAPE, 15.0), odds=-20.0)
    surface.log_odds[1, :, 5] = 20.0
    edges = signs(surface, surface.label, np.ones(SHAPE))["edges"]
    # The mean in a Gaussian of two blocks: one column of it at the edge, nothing five sigmas away.
    np.testing.assert_allclose(edges[:, 5], 1 / (2 * np.sqrt(2 * np.pi)), rtol=0.01)
    assert edges[:, 16:].max() < 1e-3


def test_the_spread_is_that_of_a_shift_of_a_window_by_its_evidence(rng):
    """The same evidence everywhere: what windows say is what a block says, as often as a window has samples."""
    label = np.full(SHAPE, 20.0)
    nats = np.broadcast_to(-0.02 * (np.arange(LABELS) - 21.0) ** 2, (*SHAPE, LABELS)).astype(np.float32)
    surface = blocks(rng, label)._replace(nats=nats)
    found = signs(surface, label, np.ones(SHAPE))
    samples = 2 * np.pi * (learned_error_bar.SPREAD_BLOCKS * 4) ** 2 / learned_error_bar.PIXELS_ALIKE
    at = np.clip(label[0, 0] + SHIFTS, 0, LABELS - 1)
    likely = np.exp(-0.02 / 16 * samples * (at - 21.0) ** 2) * np.gradient(SHIFTS)
    variance = (likely * SHIFTS**2).sum() / likely.sum()
    np.testing.assert_allclose(found["spread"], np.log(np.sqrt(variance) + 0.1), atol=1e-3)  # float32 exponents
    np.testing.assert_allclose(found["evidence"], np.log(1e-3), atol=1e-4)  # below 0 there is none


# ---- the bar


def made_up(names, rng):
    """Weights of both signs, and a range that most signs leave."""
    values = rng.uniform(0.1, 0.5, len(names)) * np.where(np.arange(len(names)) % 3 == 0, -1, 1)
    return Weights(tuple(names), values, 0.2, np.full(len(names), -1.0), np.full(len(names), 0.5))


@pytest.mark.parametrize("kind", ["blur", "views", "made up"])
def test_the_bar_is_the_weighted_sum_within_what_was_seen(world, kind, rng, monkeypatch):
    monkeypatch.setattr(learned_error_bar, "SMOOTHED_BLOCKS", 1e-3)
    found = signs(*world)
    models = {"made up": made_up(found, rng), **weights()}
    monkeypatch.setattr(learned_error_bar, "weights", lambda: models)
    model = models[kind]
    assert (model.least < model.most).all()
    bar = learned_bar(found, kind)
    for y, x in [(0, 0), (10, 13), (19, 25), (15, 7)]:
        total = model.constant
        for i, name in enumerate(model.names):
            total += model.weights[i] * min(max(float(found[name][y, x]), model.least[i]), model.most[i])
        assert bar[y, x] == pytest.approx(np.exp(total), rel=1e-4)  # single precision


@pytest.fixture(scope="module")
def training():
    spec = importlib.util.spec_from_file_location("error_bar_training", TRAINING)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def scenes_of_known_errors(rng, shares, count=6, pixels=4000):
    """Errors whose distribution is scaled by exp(0.3 + 0.8 a - 0.4 b), whatever c; these shares within 1 and 2."""
    scenes = []
    for _ in range(count):
        found = {name: rng.normal(0, 1, pixels) for name in "abc"}
        # Linear in the logarithm between: both losses ask for the same weights.
        scatter = np.interp(rng.random(pixels), [0, *shares, 1], np.log([0.1, 1, 2, 4]))
        scenes.append({**found, "error": np.exp(0.3 + 0.8 * found["a"] - 0.4 * found["b"] + scatter)})
    return scenes


def test_training_finds_the_weights_that_errors_were_made_with(training, rng):
    parameters, least, most = training.fitted(scenes_of_known_errors(rng, training.SHARES), ["a", "b", "c"])
    # 24,000 errors of a scatter of 1 leave weights to 0.01; the loss is rounded over 0.05, and the outermost hundredth
    # of every sign counts as the next.
    np.testing.assert_allclose(parameters, [0.8, -0.4, 0, 0.3], atol=0.04)
    np.testing.assert_allclose(most, 2.326, atol=0.1)  # of a normal distribution, 99 of 100 are below
    np.testing.assert_allclose(least, -most, atol=0.2)


def test_scenes_of_many_blocks_count_no_more_than_others(training, rng):
    few, many = (scenes_of_known_errors(rng, training.SHARES, count=1, pixels=n)[0] for n in (4000, 40_000))
    many["error"] *= 4
    parameters, *_ = training.fitted([few, many], ["a", "b"])
    # Two scenes whose errors differ by a factor of four: the bar lies between, not at the larger one's.
    assert 0.3 + 0.25 * np.log(4) < parameters[-1] < 0.3 + 0.75 * np.log(4)

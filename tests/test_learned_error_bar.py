"""The learned error bar: its signs against plain loops, its weights, and how they are found."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from chromaperture.disparity import learned_error_bar
from chromaperture.disparity.execution import execution_named
from chromaperture.disparity.learned_error_bar import Weights, learned_sigma, ranges, signs, weights
from chromaperture.disparity.plane_fit import Planes, Volume
from chromaperture.disparity.stages.planes import PlaneCosts
from chromaperture.disparity.winner import Surface

TRAINING = Path(__file__).parents[1] / "benchmarks" / "error_bar_training.py"
STEP_PX = 0.1


def blocks_of(step_px, height=40, width=90, labels=40):
    """Evidence of blocks of 4 px, noise about a parabola."""
    rng = np.random.default_rng(8)
    likelihood = 16 * (1 - ((np.arange(labels) - 15) / 20) ** 2) + rng.normal(0, 2, (height // 4, width // 4, labels))
    volume = likelihood.astype(np.float32)
    return Volume(volume, step_px * np.arange(labels), PlaneCosts(0.1, 1.0), execution_named("numpy"))


@pytest.fixture
def world(rng):
    """Two planes, the right one half rejected; a first surface that scatters about them."""
    height, width = 40, 90
    choice = (np.arange(width) >= 50).astype(int) * np.ones((height, 1), int)
    coefficients = np.array([[0, 0, 1.0], [0, 0.005, -0.5], [0, 0, 9]])  # the third is chosen by no pixel
    planes = Planes(coefficients, choice, blocks_of(STEP_PX))
    first = planes.label_px + rng.normal(0, 0.03, choice.shape).astype(np.float32)
    rejected = (choice == 1) & (np.arange(height)[:, None] >= 20)
    label = np.where(rejected, first, planes.label_px)
    peak = rng.uniform(0.2, 0.8, choice.shape).astype(np.float32)
    surface = Surface(label, rng.uniform(0.02, 0.3, choice.shape).astype(np.float32), peak)
    return surface, first, planes


def test_ranges_are_those_of_plain_windows(rng):
    label = rng.normal(size=(70, 75)).astype(np.float32)
    for reach, found in ranges(label).items():
        for y, x in [(0, 0), (35, 40), (69, 3), (12, 74)]:
            part = label[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
            assert found[y, x] == part.max() - part.min()


def test_a_plane_is_rejected_where_the_surface_before_contradicts_it(world):
    """The second plane in every second row, by two labels; a third of a label is no contradiction."""
    surface, first, planes = world
    contradicts = (planes.choice == 1) & (np.arange(len(first))[:, None] % 2 == 1)
    first = np.where(contradicts, planes.label_px + 2 * STEP_PX, planes.label_px + 0.3 * STEP_PX)
    found = signs(surface, STEP_PX, first_px=first, explained_by=planes)["rejected"]
    np.testing.assert_array_equal(found, np.where(planes.choice == 1, 0.5, 0))


def test_fits_tell_how_far_they_put_a_pixel(world, rng):
    surface, first, planes = world
    fits = rng.normal(1, 0.3, (5, 10, 22))  # of blocks of 4 px; two columns are left over
    found = signs(surface, STEP_PX, first_px=first, explained_by=planes._replace(fits_px=fits))["fits"]
    for y, x in [(0, 0), (3, 4), (39, 87), (20, 89)]:
        away = [abs(fit[y // 4, min(x // 4, 21)] - surface.disparity_px[y, x]) / STEP_PX for fit in fits]
        assert found[y, x] == pytest.approx(np.log(np.mean(away) + 1), abs=1e-4)  # single precision
    one = signs(surface, STEP_PX, first_px=first, explained_by=planes)["fits"]
    np.testing.assert_array_equal(one, 0)  # one fit agrees with itself


def test_signs_are_those_that_have_weights(world):
    surface, first, planes = world
    for kind, explained_by in (("surface", None), ("planes", planes)):
        found = signs(surface, STEP_PX, first_px=first, explained_by=explained_by)
        assert set(found) == set(weights()[kind].names)
        assert all(values.shape == first.shape and values.dtype == np.float32 for values in found.values())


def test_planes_without_their_evidence_are_refused(world):
    surface, first, planes = world
    with pytest.raises(ValueError, match="blocks"):
        signs(surface, STEP_PX, first_px=first, explained_by=planes._replace(blocks=None))


@pytest.mark.parametrize("of_planes", [True, False])
def test_the_bar_is_the_weighted_sum_within_what_was_seen(world, of_planes, monkeypatch):
    monkeypatch.setattr(learned_error_bar, "SMOOTHED_PX", 1e-3)
    surface, first, planes = world
    explained_by = planes if of_planes else None
    model = weights()["planes" if of_planes else "surface"]
    found = signs(surface, STEP_PX, first_px=first, explained_by=explained_by)
    sigma = learned_sigma(surface, STEP_PX, first_px=first, explained_by=explained_by)
    for y, x in [(0, 0), (20, 49), (39, 89), (30, 70)]:
        total = model.constant
        for i, name in enumerate(model.names):
            total += model.weights[i] * min(max(float(found[name][y, x]), model.least[i]), model.most[i])
        assert sigma[y, x] == pytest.approx(STEP_PX * np.exp(total), rel=1e-4)  # single precision


@pytest.mark.parametrize("of_planes", [True, False])
def test_the_bar_counts_in_steps_between_labels(world, of_planes):
    """Twice the step and everything twice as far: the same evidence of another design, and twice the bar."""
    surface, first, planes = world
    double = Surface(2 * surface.disparity_px, 2 * surface.sigma_px, surface.peak)
    wide = Planes(2 * planes.planes, planes.choice, blocks_of(2 * STEP_PX))
    one = learned_sigma(surface, STEP_PX, first_px=first, explained_by=planes if of_planes else None)
    two = learned_sigma(double, 2 * STEP_PX, first_px=2 * first, explained_by=wide if of_planes else None)
    np.testing.assert_allclose(two, 2 * one, rtol=1e-3)  # differences of single precision under a logarithm


@pytest.mark.parametrize("kind", ["planes", "surface"])
def test_stored_weights_widen_the_bar_where_less_is_known(kind):
    model = weights()[kind]
    assert isinstance(model, Weights)
    assert (model.least < model.most).all()
    by_name = dict(zip(model.names, model.weights, strict=True))
    assert by_name["posterior"] > 0
    assert min(by_name.get(name, 1) for name in ("fits", "rejected", "spread")) > 0


def test_what_other_fits_put_elsewhere_has_a_longer_bar(world):
    surface, first, planes = world
    fits = np.stack([planes.label_px[1::4, 1::4][:10, :22]] * 3)
    bars = [
        learned_sigma(surface, STEP_PX, first_px=first, explained_by=planes._replace(fits_px=fits + away))
        for away in (0, 5 * STEP_PX)
    ]
    assert (bars[1][:15, :40] > bars[0][:15, :40]).all()


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
    model = training.fitted(scenes_of_known_errors(rng, training.SHARES), ["a", "b", "c"])
    # 24,000 errors of a scatter of 1 leave weights to 0.01; the loss is rounded over 0.05, the ridge takes 0.01.
    np.testing.assert_allclose(model.weights, [0.8, -0.4, 0], atol=0.04)
    assert model.constant == pytest.approx(0.3, abs=0.04)


def test_other_scenes_set_the_constant_alone(training, rng):
    scenes = scenes_of_known_errors(rng, training.SHARES)
    model = training.fitted(scenes, ["a", "b"])
    others = [{**scene, "error": 0.5 * scene["error"]} for scene in scenes_of_known_errors(rng, training.SHARES)]
    found = training.leveled(model, others)
    np.testing.assert_array_equal(found.weights, model.weights)
    assert found.constant == pytest.approx(0.3 + np.log(0.5), abs=0.05)


def test_bars_of_training_hold_the_shares_that_they_are_made_for(training, rng):
    scenes = scenes_of_known_errors(rng, training.SHARES)
    model = training.fitted(scenes, ["a", "b"])
    other = np.random.default_rng(rng.integers(1e9))
    fresh = scenes_of_known_errors(other, training.SHARES, count=1, pixels=40_000)[0]
    bars = fresh["error"] / training.bars_of(model, fresh)
    for many, share in enumerate(training.SHARES, start=1):
        assert (bars < many).mean() == pytest.approx(share, abs=0.02)  # four standard deviations of the weights

"""Total variation: the operators, the optimum, the schedules of the compiled one, and spoilt maps regularised."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from chromaperture.system.errors import InputError
from chromaperture.system.threads import limited_threads
from chromaperture_paper import variation, variation_kernels
from chromaperture_paper.total_variation import CHECK_EVERY, make_problem, smooth_disparity
from chromaperture_paper.variation import (
    OPERATOR_NORM_SQUARED,
    Problem,
    State,
    divergence,
    edge_weights,
    energy,
    gap_per_px,
    gradient,
    iterate,
    step_sizes,
)


def spoilt_map(rng, shape=(96, 96)):
    """Two slanted planes with a step between them; 10 % outliers, 5 % noise, half the pixels unknown."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    truth = np.where(x > shape[1] // 2, 3.0 + 0.01 * y, 0.01 * x)
    seen = truth + rng.normal(0, 0.05, shape)
    outlier = rng.random(shape) < 0.1
    seen[outlier] = rng.uniform(0, 4, outlier.sum())
    weights = (rng.random(shape) < 0.5).astype(float)
    return truth, seen, weights


def problem(rng, shape=(17, 23), *, data_term="absolute", edged=True, huber=0.05, fidelity=1.2, holes=True):
    seen = rng.normal(0, 1.5, shape)
    weights = rng.uniform(0.2, 1, shape)
    if holes:
        weights[rng.random(shape) < 0.3] = 0
    edges = rng.uniform(0, 1, (2, *shape)) if edged else None
    return make_problem(
        seen, weights, edges, bounds_px=(-2.0, 2.5), fidelity=fidelity, huber=huber, data_term=data_term
    )


def steps(count, primal_step=0.35):
    return step_sizes(count, primal_step=primal_step)


@given(st.integers(2, 12), st.integers(2, 12), st.integers(0, 2**32 - 1))
def test_divergence_is_minus_the_adjoint_of_the_gradient(height, width, seed):
    rng = np.random.default_rng(seed)
    u, p = rng.normal(size=(height, width)), rng.normal(size=(2, height, width))
    # float64 sums of at most 288 products of order 1
    assert np.vdot(gradient(u), p) == pytest.approx(-np.vdot(u, divergence(p)), abs=1e-11)


def test_gradient_has_the_norm_the_steps_rely_on():
    u = np.random.default_rng(1).normal(size=(24, 24))
    for _ in range(300):  # power iteration
        u = -divergence(gradient(u))
        norm, u = np.linalg.norm(u), u / np.linalg.norm(u)
    assert 7.9 < norm <= OPERATOR_NORM_SQUARED


@pytest.mark.parametrize("data_term", ["absolute", "quadratic"])
@pytest.mark.parametrize("edged", [False, True])
def test_gap_closes_and_bounds_the_energy(data_term, edged):
    p = problem(np.random.default_rng(2), data_term=data_term, edged=edged)
    p64 = Problem(p.target.astype(float), p.weight.astype(float), p.edges, p.bounds, p.huber, p.quadratic)
    state = State.start(p64.target)
    gaps = [gap_per_px(p64, state)]
    for _ in range(8):
        iterate(p64, state, steps(500))
        gaps.append(gap_per_px(p64, state))
    assert gaps[0] > 0.05  # 1 and 1.9 are found at the start
    assert min(gaps) > -1e-12  # weak duality, up to rounding
    assert gaps[-1] < 1e-6


@pytest.mark.parametrize("data_term", ["absolute", "quadratic"])
def test_every_step_size_finds_the_same_optimum(data_term):
    p = problem(np.random.default_rng(3), data_term=data_term)
    found = []
    for primal_step in (0.15, 0.35, 0.8):
        state = State.start(p.target)
        variation_kernels.iterate(p, state, steps(6000, primal_step))
        found.append(state.u)
        assert gap_per_px(p, state) < 1e-5  # 1e-7 is found
    # The optimum is unique where h and the data term are; float32 iterations stall at about 1e-4 px.
    assert np.abs(found[0] - found[1]).max() < 5e-3
    assert np.abs(found[2] - found[1]).max() < 5e-3


def test_optimum_agrees_with_a_general_purpose_minimiser():
    p = problem(np.random.default_rng(4), (6, 7), data_term="quadratic", huber=0.3)
    state = State.start(p.target)
    variation_kernels.iterate(p, state, steps(4000))
    start = np.clip(p.target, *p.bounds).ravel().astype(float)
    best = minimize(
        lambda u: energy(p, u.reshape(6, 7)), start, bounds=[p.bounds] * 42, method="L-BFGS-B",
        options={"maxiter": 20000, "maxfun": 10**6, "ftol": 1e-14, "gtol": 1e-9},
    )  # fmt: skip
    # The minimiser differentiates numerically and reaches about 1e-6 of the energy.
    assert energy(p, state.u) == pytest.approx(best.fun, rel=1e-5)


def test_acceleration_is_no_slower_when_every_pixel_has_a_weight():
    p = problem(np.random.default_rng(5), data_term="quadratic", holes=False, fidelity=0.2)
    gaps = []
    for convexity in (0.0, float(p.weight.min())):
        state = State.start(p.target)
        iterate(p, state, step_sizes(200, primal_step=2.0, strong_convexity=convexity))
        gaps.append(gap_per_px(p, state))
    assert gaps[1] < gaps[0]


@pytest.mark.parametrize("data_term", ["absolute", "quadratic"])
@pytest.mark.parametrize("edged", [False, True])
@pytest.mark.parametrize(("bands", "sweep"), [(1, 1), (1, 7), (2, 1), (2, 9), (3, 5), (5, 7), (9, 40)])
def test_every_schedule_of_bands_and_sweeps_gives_the_readable_iterations(data_term, edged, bands, sweep):
    p = problem(np.random.default_rng(6), (37, 29), data_term=data_term, edged=edged)
    reference, fast = State.start(p.target), State.start(p.target)
    iterate(p, reference, steps(43))
    variation_kernels.iterate(p, fast, steps(43), bands=bands, sweep=sweep)
    # Same operations in another order: a few float32 roundings of numbers up to 2.5, for 43 iterations.
    np.testing.assert_allclose(fast.u, reference.u, atol=2e-5)
    np.testing.assert_allclose(fast.extrapolated, reference.extrapolated, atol=5e-5)
    np.testing.assert_allclose(fast.dual, reference.dual, atol=2e-5)


@settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.integers(2, 40), st.integers(2, 40)),
    st.integers(0, 2**32 - 1),
    st.sampled_from(["absolute", "quadratic"]),
    st.booleans(),
    st.sampled_from([1, 2, 3]),
)
def test_iterations_of_the_variation_and_its_gap_agree(shape, seed, data_term, edged, threads):
    p = problem(np.random.default_rng(seed), shape, data_term=data_term, edged=edged, holes=False)
    states = [State.start(p.target) for _ in range(2)]
    with limited_threads(threads):
        for run, state in zip((variation_kernels, variation), states, strict=True):
            run.iterate(p, state, steps(20))
    # Same operations in another order: a few float32 roundings of numbers up to 2.5, for 20 iterations.
    np.testing.assert_allclose(states[0].u, states[1].u, atol=1e-5)
    gaps = [run.gap_per_px(p, states[0]) for run in (variation_kernels, variation)]
    assert gaps[0] == pytest.approx(gaps[1], rel=1e-9, abs=1e-9)  # float64 sums


def test_regularised_maps_agree():
    rng = np.random.default_rng(14)
    disparity_px, weights = rng.normal(0, 1, (31, 33)), rng.random((31, 33)) < 0.5
    fast, slow = (smooth_disparity(disparity_px, weights, iterations=60, execution=name) for name in ("numba", "numpy"))
    np.testing.assert_allclose(fast.disparity_px, slow.disparity_px, atol=3e-5)  # 60 float32 iterations
    assert fast.gap_per_px == pytest.approx(slow.gap_per_px, abs=1e-5)  # of the same rounding


def test_outliers_and_missing_pixels_are_recovered():
    truth, seen, weights = spoilt_map(np.random.default_rng(9))
    known = weights > 0
    before = np.sqrt(np.mean((seen - truth)[known] ** 2))
    out = smooth_disparity(seen, weights, fidelity=0.8, iterations=500)
    after = np.sqrt(np.mean((out.disparity_px - truth) ** 2))
    assert before > 0.5  # 0.63 is found: there is something to recover
    # Noise 0.05 px; the rest is the staircase of a first-order prior and the step's border across the holes.
    assert after < 0.15
    assert out.gap_per_px < 1e-3


def test_unknown_pixels_count_as_nothing():
    _, seen, weights = spoilt_map(np.random.default_rng(10))
    hidden = np.where(weights > 0, seen, np.nan)
    by_nan = smooth_disparity(hidden, fidelity=0.8)
    by_weight = smooth_disparity(np.where(weights > 0, seen, 1e6), weights, fidelity=0.8)
    by_nan_weight = smooth_disparity(seen, np.where(weights > 0, 1, np.nan), fidelity=0.8)
    for other in (by_weight, by_nan_weight):
        np.testing.assert_array_equal(by_nan.disparity_px, other.disparity_px)
    assert np.isfinite(by_nan.disparity_px).all()


@settings(max_examples=20, deadline=None)
@given(st.floats(-10, 10), st.booleans())
def test_constant_map_stays_as_it_is(value, quadratic):
    data_term = "quadratic" if quadratic else "absolute"
    out = smooth_disparity(np.full((9, 11), value, np.float32), data_term=data_term, iterations=40)
    np.testing.assert_array_equal(out.disparity_px, np.float32(value))


def test_result_stays_inside_its_bounds_and_input_is_not_changed():
    _, seen, weights = spoilt_map(np.random.default_rng(11))
    copy = seen.copy()
    out = smooth_disparity(seen, weights, bounds_px=(0.5, 2.0), fidelity=5.0, iterations=50).disparity_px
    assert out.min() >= 0.5  # the bounds
    assert out.max() <= 2.0  # the bounds
    np.testing.assert_array_equal(seen, copy)


def test_edge_weights_keep_a_step_where_the_guide_has_one():
    rng = np.random.default_rng(12)
    guide = np.where(np.arange(60) < 30, 0.2, 0.7) * np.ones((40, 1))
    truth = np.where(guide > 0.5, 1.0, 0.0)
    seen = truth + rng.normal(0, 0.6, truth.shape)
    edges = edge_weights(guide, edge_range=0.05)
    blind = smooth_disparity(seen, data_term="quadratic", fidelity=0.15).disparity_px
    aware = smooth_disparity(seen, edges=edges, data_term="quadratic", fidelity=0.15).disparity_px
    assert np.abs(aware - truth).mean() < 0.5 * np.abs(blind - truth).mean()  # 0.05 is found


def test_tolerance_ends_the_iteration_early():
    _, seen, weights = spoilt_map(np.random.default_rng(13))
    out = smooth_disparity(seen, weights, tolerance=3e-3, iterations=2000)
    assert out.gap_per_px <= 3e-3
    assert out.iterations < 2000
    assert out.iterations % CHECK_EVERY == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"disparity_px": np.full((8, 8), np.nan)}, "nothing to regularise"),
        ({"weights": np.zeros((8, 8))}, "nothing to regularise"),
        ({"weights": np.ones((8, 9))}, "weights must have"),
        ({"edges": np.ones((8, 8))}, "edge weights must have"),
        ({"disparity_px": np.zeros((8, 8, 3))}, "expected a disparity map"),
        ({"bounds_px": (2.0, 1.0)}, "wrong way round"),
        ({"fidelity": 0.0}, "must be positive"),
        ({"iterations": 0}, "iterations >= 1"),
    ],
)
def test_bad_input_is_named(arguments, message):
    arguments = {"disparity_px": np.zeros((8, 8)), **arguments}
    with pytest.raises(InputError, match=message):
        smooth_disparity(arguments.pop("disparity_px"), arguments.pop("weights", None), **arguments)

"""Total variation: the operators, the optimum, the schedules of the compiled one, and spoilt maps regularised."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.system.errors import InputError
from chromaperture.system.threads import limited_threads
from chromaperture_paper import variation_kernels
from chromaperture_paper.variation import (
    OPERATOR_NORM_SQUARED,
    Problem,
    State,
    divergence,
    gradient,
    iterate,
    make_problem,
    smooth_disparity,
)


def energy(problem: Problem, u: np.ndarray) -> float:
    """Energy of a map, summed in float64."""
    u, h = u.astype(np.float64), problem.huber
    norm = np.hypot(*gradient(u))
    prior = np.where(norm <= h, norm**2 / (2 * h), norm - h / 2)
    return float(prior.sum() + (problem.weight * np.abs(u - problem.target)).sum())


def dual_energy(problem: Problem, dual: np.ndarray) -> float:
    """Lower bound of the energy of every map inside the bounds that a dual field proves, summed in float64.

    ``D(p) = -(h / 2) sum |p|^2 - sum G*(div p)``. The conjugate G* of the data term is finite because of the bounds; a
    piecewise linear function is greatest where it is evaluated here.
    """
    p = dual.astype(np.float64)
    q = divergence(p)
    f, w, (lo, hi) = problem.target.astype(np.float64), problem.weight.astype(np.float64), problem.bounds
    conjugate = np.maximum(np.maximum(q * lo - w * (f - lo), q * f), q * hi - w * (hi - f))
    return float(-problem.huber / 2 * (p**2).sum() - conjugate.sum())


def gap_per_px(problem: Problem, state: State) -> float:
    """Primal-dual gap per pixel: how far the energy can be above the least one; >= 0 up to rounding."""
    return (energy(problem, state.u) - dual_energy(problem, state.dual)) / state.u.size


def spoilt_map(rng, shape=(96, 96)):
    """Two slanted planes with a step between them; 10 % outliers, 5 % noise, half the pixels unknown."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    truth = np.where(x > shape[1] // 2, 3.0 + 0.01 * y, 0.01 * x)
    seen = truth + rng.normal(0, 0.05, shape)
    outlier = rng.random(shape) < 0.1
    seen[outlier] = rng.uniform(0, 4, outlier.sum())
    seen[rng.random(shape) < 0.5] = np.nan
    return truth, seen


def problem(rng, shape=(17, 23)):
    seen = rng.normal(0, 1.5, shape)
    seen[rng.random(shape) < 0.3] = np.nan
    return make_problem(seen, bounds_px=(-2.0, 2.5), fidelity=1.2, huber=0.05)


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


def test_gap_closes_and_bounds_the_energy():
    p = problem(np.random.default_rng(2))
    p64 = Problem(p.target.astype(float), p.weight.astype(float), p.bounds, p.huber)
    state = State.start(p64.target)
    gaps = [gap_per_px(p64, state)]
    for _ in range(8):
        iterate(p64, state, 500)
        gaps.append(gap_per_px(p64, state))
    assert gaps[0] > 0.05  # 1 is found at the start
    assert min(gaps) > -1e-12  # weak duality, up to rounding
    assert gaps[-1] < 1e-6


def test_every_step_size_finds_the_same_optimum():
    p = problem(np.random.default_rng(3))
    found = []
    for primal_step in (0.15, 0.35, 0.8):
        state = State.start(p.target)
        variation_kernels.iterate(p, state, 6000, primal_step=primal_step)
        found.append(state.u)
        assert gap_per_px(p, state) < 1e-5  # 1e-7 is found
    # The optimum is unique where h and the data term are; float32 iterations stall at about 1e-4 px.
    assert np.abs(found[0] - found[1]).max() < 5e-3
    assert np.abs(found[2] - found[1]).max() < 5e-3


@pytest.mark.parametrize(("bands", "sweep"), [(1, 1), (1, 7), (2, 1), (2, 9), (3, 5), (5, 7), (9, 40)])
def test_every_schedule_of_bands_and_sweeps_gives_the_readable_iterations(bands, sweep):
    p = problem(np.random.default_rng(6), (37, 29))
    reference, fast = State.start(p.target), State.start(p.target)
    iterate(p, reference, 43)
    variation_kernels.iterate(p, fast, 43, bands=bands, sweep=sweep)
    # Same operations in another order: a few float32 roundings of numbers up to 2.5, for 43 iterations.
    np.testing.assert_allclose(fast.u, reference.u, atol=2e-5)
    np.testing.assert_allclose(fast.extrapolated, reference.extrapolated, atol=5e-5)
    np.testing.assert_allclose(fast.dual, reference.dual, atol=2e-5)


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 40), st.integers(2, 40), st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 3]))
def test_compiled_iterations_of_any_shape_agree(height, width, seed, threads):
    seen = np.random.default_rng(seed).normal(0, 1.5, (height, width))
    p = make_problem(seen, bounds_px=(-2.0, 2.5), fidelity=1.2, huber=0.05)
    states = [State.start(p.target) for _ in range(2)]
    with limited_threads(threads):
        for run, state in zip((variation_kernels.iterate, iterate), states, strict=True):
            run(p, state, 20)
    # Same operations in another order: a few float32 roundings of numbers up to 2.5, for 20 iterations.
    np.testing.assert_allclose(states[0].u, states[1].u, atol=1e-5)


def test_outliers_and_missing_pixels_are_recovered():
    truth, seen = spoilt_map(np.random.default_rng(9))
    before = np.sqrt(np.nanmean((seen - truth) ** 2))
    after = np.sqrt(np.mean((smooth_disparity(seen, fidelity=0.8, iterations=500) - truth) ** 2))
    assert before > 0.5  # 0.63 is found: there is something to recover
    # Noise 0.05 px; the rest is the staircase of a first-order prior and the step's border across the holes.
    assert after < 0.15


@settings(max_examples=20, deadline=None)
@given(st.floats(-10, 10))
def test_constant_map_stays_as_it_is(value):
    out = smooth_disparity(np.full((9, 11), value, np.float32), iterations=40)
    np.testing.assert_array_equal(out, np.float32(value))


def test_result_stays_inside_its_bounds_and_input_is_not_changed():
    _, seen = spoilt_map(np.random.default_rng(11))
    copy = seen.copy()
    out = smooth_disparity(seen, bounds_px=(0.5, 2.0), fidelity=5.0, iterations=50)
    assert out.min() >= 0.5  # the bounds
    assert out.max() <= 2.0  # the bounds
    np.testing.assert_array_equal(seen, copy)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"disparity_px": np.full((8, 8), np.nan)}, "nothing to regularise"),
        ({"disparity_px": np.zeros((8, 8, 3))}, "expected a disparity map"),
        ({"bounds_px": (2.0, 1.0)}, "wrong way round"),
        ({"fidelity": 0.0}, "must be positive"),
    ],
)
def test_bad_input_is_named(arguments, message):
    with pytest.raises(InputError, match=message):
        smooth_disparity(**{"disparity_px": np.zeros((8, 8)), **arguments})

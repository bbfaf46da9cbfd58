"""Fits of planes and the surface that they explain vote on where every block lies."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import correlate1d

from chromaperture.disparity import plane_voting
from chromaperture.disparity.plane_fit import Planes
from chromaperture.disparity.plane_voting import (
    OF_GUIDED,
    Trust,
    neighbour_differences,
    planes_or_surface,
    signs_of_trust,
    voted_planes,
    votes,
)

STEP = 0.15
BLOCK = 4


def two_planes(height: int = 60, width: int = 90, border: int = 44) -> Planes:
    choice = np.zeros((height, width), int)
    choice[:, border:] = 1
    return Planes(np.array([[0.002, 0.0, 0.5], [0.0, -0.003, 2.0]]), choice)


def even(label_px: float, height: int = 60, width: int = 90) -> Planes:
    return Planes(np.array([[0.0, 0.0, label_px]]), np.zeros((height, width), int))


def gaussian(values: np.ndarray, sigma: float) -> np.ndarray:
    """A Gaussian cut off at four sigmas, in double precision: what OpenCV computes for float pictures."""
    at = np.arange(-(round(8 * sigma + 1) // 2), round(8 * sigma + 1) // 2 + 1)
    taps = np.exp(-(at**2) / (2 * sigma**2))
    for axis in (0, 1):
        values = correlate1d(np.asarray(values, float), taps / taps.sum(), axis=axis, mode="mirror")
    return values


def means(values: np.ndarray) -> np.ndarray:
    """Means of squares of four pixels, one by one."""
    height, width = (n // BLOCK for n in values.shape)
    out = np.empty((height, width))
    for y, x in itertools.product(range(height), range(width)):
        out[y, x] = values[BLOCK * y : BLOCK * (y + 1), BLOCK * x : BLOCK * (x + 1)].mean()
    return out


def test_signs_are_those_of_their_definitions() -> None:
    rng = np.random.default_rng(1)
    fits = [two_planes(63, 90), even(1.0, 63, 90)]  # rows are left over, and columns
    surface = fits[0].label_px + rng.normal(0, 0.3, (63, 90))
    sigma = rng.uniform(0.02, 0.4, (63, 90))
    found = signs_of_trust(fits, surface, sigma, STEP, BLOCK)

    differences = np.zeros((63, 90))
    for y, x in itertools.product(range(63), range(90)):
        right = abs(surface[y, x + 1] - surface[y, x]) if x < 89 else 0
        below = abs(surface[y + 1, x] - surface[y, x]) if y < 62 else 0
        differences[y, x] = min((right + below) / STEP, 3)
    np.testing.assert_allclose(found["rough"], np.log(gaussian(means(differences), 4) + 0.02), atol=1e-5)
    np.testing.assert_allclose(
        found["posterior"], np.log(np.sqrt(gaussian(means(sigma**2), 2)) / STEP + 0.02), atol=1e-5
    )
    for k, fit in enumerate(fits):
        apart = np.abs(fit.label_px - surface) > 2 * np.hypot(sigma, STEP)
        np.testing.assert_allclose(found["agreed"][k], 1 - gaussian(means(apart), 2), atol=1e-5)
        whole = apart[:60, :88]
        expected = np.full((15, 22), whole.mean())
        if k == 0:
            expected[:, :11], expected[:, 11:] = whole[:, :44].mean(), whole[:, 44:].mean()
        np.testing.assert_allclose(found["rejected"][k], expected, rtol=1e-6)


def test_votes_are_a_mixture_of_places() -> None:
    """Three fits and the surface by hand: probabilities of a half, places 0, 2, 20 labels, the surface at 20."""
    label, surface = np.array([0.0, 2.0, 20.0]).reshape(3, 1, 1), np.full((1, 1), 20.0)
    of_planes, of_surface = votes(label, surface, np.zeros((3, 1, 1)))
    near = np.exp(-0.5)  # two labels, a standard deviation
    np.testing.assert_allclose(of_planes.ravel(), [(1 + near) / 6, (1 + near) / 6, 1 / 6 + 1 / 2], atol=1e-12)
    np.testing.assert_allclose(of_surface, 1 / 6 + 1 / 2, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(
    arrays(float, st.tuples(st.integers(1, 5), st.just(2), st.just(3)), elements=st.floats(-40, 40)),
    st.integers(0, 1000),
)
def test_votes_do_not_depend_on_the_order_of_fits_or_the_level(label: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    surface, odds = rng.uniform(-40, 40, (2, 3)), rng.normal(0, 2, label.shape)
    order = rng.permutation(len(label))
    of_planes, of_surface = votes(label, surface, odds)
    shuffled, again = votes(label[order] + 7, surface + 7, odds[order])
    np.testing.assert_allclose(shuffled, of_planes[order], atol=1e-9)
    np.testing.assert_allclose(again, of_surface, atol=1e-9)
    assert ((of_planes > 0) & (of_planes <= 1 + 1e-9)).all()


@pytest.mark.parametrize("trust", [OF_GUIDED, None])
def test_two_fits_outvote_a_third(trust: Trust | None) -> None:
    """Two fits have the border at column 44, one at 68; one more takes all for its second plane."""
    true = two_planes()
    sigma = np.full((60, 90), STEP / 2)
    for others in ([two_planes(border=68), two_planes()], [even(2.0), two_planes()]):
        found = voted_planes([*others, true], true.label_px, sigma, STEP, BLOCK, trust=trust)
        label = planes_or_surface(found, true.label_px, STEP)
        # At a middle .4 labels away planes have .98 of the votes, which counts as the same place.
        np.testing.assert_allclose(found.label_px, true.label_px, atol=0.5 * STEP)
        np.testing.assert_array_equal(label, found.label_px)
        assert found.planes.shape[0] <= 4  # none that no block has
        assert found.trusted.all()


def test_noise_gives_way_to_planes_and_smooth_contradiction_does_not() -> None:
    rng = np.random.default_rng(2)
    planes = two_planes(200, 300, 148)
    surface = planes.label_px + rng.normal(0, 3 * STEP, (200, 300))
    surface[:, 148:] = planes.label_px[:, 148:] + 4 * STEP
    surface[:, 288:] = planes.label_px[:, 288:] + 0.9 * STEP
    sigma = np.full((200, 300), STEP / 2)
    sigma[:, :148] = 3 * STEP
    found = voted_planes([planes] * 3, surface, sigma, STEP, BLOCK, trust=OF_GUIDED)
    taken = planes_or_surface(found, surface, STEP)
    # 28 px from the border between both the window of 16 px holds a twentieth of the other side.
    np.testing.assert_array_equal(taken[:, :120], planes.label_px[:, :120])
    np.testing.assert_array_equal(taken[:, 180:288], surface[:, 180:288].astype(np.float32))
    np.testing.assert_array_equal(taken[:, 288:], planes.label_px[:, 288:])  # within a label
    everywhere = voted_planes([planes] * 3, surface, sigma, STEP, BLOCK)
    np.testing.assert_array_equal(planes_or_surface(everywhere, surface, STEP), planes.label_px)


def test_the_surface_says_which_of_two_fits_is_right() -> None:
    """Without a trust it has as many votes as both together."""
    fits, surface = [even(8.0), two_planes()], two_planes().label_px + np.float32(1.2 * STEP)
    found = voted_planes(fits, surface, np.full((60, 90), STEP / 2), STEP, BLOCK)
    np.testing.assert_array_equal(planes_or_surface(found, surface, STEP), two_planes().label_px)


def test_one_fit_of_no_doubt_stays_as_it_is() -> None:
    planes = two_planes()
    found = voted_planes([planes], planes.label_px, np.full((60, 90), 0.1), STEP, BLOCK)
    np.testing.assert_array_equal(found.choice, planes.choice)
    np.testing.assert_array_equal(planes_or_surface(found, planes.label_px, STEP), planes.label_px)


@settings(max_examples=30, deadline=None)
@given(arrays(np.float32, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.floats(-50, 50, width=16)))
def test_neighbour_differences_do_not_depend_on_the_axis_or_the_level(label: np.ndarray) -> None:
    differences = neighbour_differences(label)
    assert differences.shape == label.shape
    assert ((differences >= 0) & (differences <= plane_voting.MOST_DIFFERENCE)).all()
    np.testing.assert_allclose(neighbour_differences(label.T), differences.T, atol=1e-6)
    np.testing.assert_allclose(neighbour_differences(label + 1), differences, atol=1e-4)
    np.testing.assert_array_equal(neighbour_differences(np.full_like(label, 7)), np.zeros_like(label))


@pytest.mark.parametrize("shape", [(8, 41), (33, 9), (11, 8)])
def test_pictures_may_be_narrow(shape: tuple[int, int]) -> None:
    fits = [even(1.0, *shape), even(6.0, *shape)]
    found = voted_planes(fits, np.full(shape, 6.0), np.full(shape, 0.1), STEP, BLOCK)
    assert found.choice.shape == found.trusted.shape == shape
    np.testing.assert_array_equal(planes_or_surface(found, np.full(shape, 6.0), STEP), np.full(shape, 6.0, np.float32))

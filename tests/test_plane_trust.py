"""Whether planes or the surface that they explain are taken, by signs of which is nearer to the truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import correlate1d

from chromaperture.disparity import plane_trust
from chromaperture.disparity.planar import Planes
from chromaperture.disparity.plane_agreement import where_they_agree
from chromaperture.disparity.plane_trust import neighbour_differences, planes_or_surface, signs_of_trust

STEP = 0.15


def two_planes(height: int = 60, width: int = 90) -> Planes:
    choice = np.zeros((height, width), int)
    choice[:, width // 2 :] = 1
    return Planes(np.array([[0.002, 0.0, 0.5], [0.0, -0.003, 2.0]]), choice)


def gaussian(values: np.ndarray, sigma: float) -> np.ndarray:
    """A Gaussian cut off at four sigmas, in double precision: what OpenCV computes for float pictures."""
    at = np.arange(-(round(8 * sigma + 1) // 2), round(8 * sigma + 1) // 2 + 1)
    taps = np.exp(-(at**2) / (2 * sigma**2))
    for axis in (0, 1):
        values = correlate1d(np.asarray(values, float), taps / taps.sum(), axis=axis, mode="mirror")
    return values


def test_signs_are_those_of_their_definitions() -> None:
    rng = np.random.default_rng(1)
    planes = two_planes()
    surface = planes.label_px + rng.normal(0, 0.3, (60, 90))
    sigma = rng.uniform(0.02, 0.4, (60, 90))
    found = signs_of_trust(planes, surface, sigma, STEP)

    steps = np.zeros((60, 90))
    for y in range(60):
        for x in range(90):
            right = abs(surface[y, x + 1] - surface[y, x]) if x < 89 else 0
            below = abs(surface[y + 1, x] - surface[y, x]) if y < 59 else 0
            steps[y, x] = min((right + below) / STEP, 3)
    np.testing.assert_allclose(found["rough"], np.log(gaussian(steps, 16) + 0.02), atol=1e-5)
    posterior = np.log(np.sqrt(gaussian(sigma**2, 8)) / STEP + 0.02)
    np.testing.assert_allclose(found["posterior"], posterior, atol=1e-5)
    apart = np.abs(planes.label_px - surface) > 2 * np.hypot(sigma, STEP)
    np.testing.assert_allclose(found["rejected"][:, :45], apart[:, :45].mean(), rtol=1e-6)
    np.testing.assert_allclose(found["rejected"][:, 45:], apart[:, 45:].mean(), rtol=1e-6)
    agreed = where_they_agree(planes, surface, np.hypot(sigma, STEP)) == planes.label_px
    np.testing.assert_allclose(found["agreed"], gaussian(agreed, 8), atol=1e-5)

    odds = plane_trust.CONSTANT + sum(plane_trust.WEIGHTS[name] * found[name].astype(float) for name in found)
    sure, near = np.abs(odds) > 1e-4, np.abs(planes.label_px - surface) <= STEP
    taken = planes_or_surface(planes, surface, sigma, STEP)
    expected = np.where((odds > 0) | near, planes.label_px, surface.astype(np.float32))
    np.testing.assert_array_equal(taken[sure | near], expected[sure | near])


def test_noise_gives_way_to_planes_and_smooth_contradiction_does_not() -> None:
    rng = np.random.default_rng(2)
    planes = two_planes(200, 300)
    surface = planes.label_px + rng.normal(0, 3 * STEP, (200, 300))
    surface[:, 150:] = planes.label_px[:, 150:] + 4 * STEP
    surface[:, 290:] = planes.label_px[:, 290:] + 0.9 * STEP
    sigma = np.full((200, 300), STEP / 2)
    sigma[:, :150] = 3 * STEP
    taken = planes_or_surface(planes, surface, sigma, STEP)
    # 30 px from the border between both the window of 16 px holds a thirtieth of the other side.
    np.testing.assert_array_equal(taken[:, :120], planes.label_px[:, :120])
    np.testing.assert_array_equal(taken[:, 180:290], surface[:, 180:290].astype(np.float32))
    np.testing.assert_array_equal(taken[:, 290:], planes.label_px[:, 290:])  # within a label


def test_a_surface_that_is_its_planes_stays_what_it_is() -> None:
    planes = two_planes()
    taken = planes_or_surface(planes, planes.label_px, np.full((60, 90), 0.1), STEP)
    np.testing.assert_array_equal(taken, planes.label_px)


@settings(max_examples=30, deadline=None)
@given(arrays(np.float32, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.floats(-50, 50, width=16)))
def test_neighbour_differences_do_not_depend_on_the_axis_or_the_level(label: np.ndarray) -> None:
    steps = neighbour_differences(label)
    assert steps.shape == label.shape
    assert ((steps >= 0) & (steps <= plane_trust.MOST_DIFFERENCE)).all()
    np.testing.assert_allclose(neighbour_differences(label.T), steps.T, atol=1e-6)
    np.testing.assert_allclose(neighbour_differences(label + 1), steps, atol=1e-4)
    np.testing.assert_array_equal(neighbour_differences(np.full_like(label, 7)), np.zeros_like(label))


@pytest.mark.parametrize("shape", [(1, 40), (33, 1), (2, 2)])
def test_pictures_may_be_narrow(shape: tuple[int, int]) -> None:
    planes = Planes(np.array([[0.0, 0, 1]]), np.zeros(shape, int))
    taken = planes_or_surface(planes, np.ones(shape) + 5, np.full(shape, 0.1), STEP)
    assert taken.shape == shape
    assert np.isin(taken, (1, 6)).all()

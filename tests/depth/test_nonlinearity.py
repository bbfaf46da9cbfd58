"""The curve from linear to measured disparity: its inverse, its slope, and curves that are refused."""

from dataclasses import replace

import numpy as np
import pytest

from chromaperture.depth.conversion import DepthModel, depth_to_disparity, disparity_to_depth
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.system.errors import InputError

CURVE = Nonlinearity(-4.5, 2.5, np.array([0.05, 0.08, -0.04, 0.02]))
MODEL = DepthModel(4.3, 8200.0, 50.0, nonlinearity=CURVE)


def test_linear_and_measured_undo_each_other():
    linear = np.linspace(-7, 5, 1001)  # beyond the fitted range on both sides
    np.testing.assert_allclose(CURVE.linear(CURVE.measured(linear)), linear, atol=1e-4)
    assert np.isnan(CURVE.linear(np.array([np.nan]))).all()


def test_slope_is_the_derivative():
    places = np.array([-6.0, -3.0, 0.2, 2.0, 4.0])
    step = 1e-5
    numeric = (CURVE.measured(places + step) - CURVE.measured(places - step)) / (2 * step)
    # Rounding of 1e-16 over the step of 1e-5; 4e-11 is found.
    np.testing.assert_allclose(CURVE.slope(places), numeric, rtol=1e-6)


def test_depth_comes_back_through_the_curve():
    depth = np.linspace(900.0, 6000.0, 200)
    found, _ = disparity_to_depth(depth_to_disparity(depth, MODEL), MODEL)
    np.testing.assert_allclose(found, depth, rtol=2e-4)  # 1e-4 px of the table are 2e-4 at 6 m


def test_error_bar_is_the_finite_difference_of_the_depth():
    disparity = depth_to_disparity(np.array([1100.0, 1800.0, 2600.0, 3800.0]), MODEL)
    step = 0.02
    _, sigma = disparity_to_depth(disparity, MODEL, sigma_px=np.full(4, step))
    ends = [disparity_to_depth(disparity + sign * step, MODEL)[0] for sign in (-1, 1)]
    np.testing.assert_allclose(sigma, (ends[1] - ends[0]) / 2, rtol=0.01)  # curvature of 1/x over 0.02 px


def test_a_curve_that_turns_back_is_refused():
    with pytest.raises(InputError, match="turns back"):
        Nonlinearity(-4.0, 2.0, np.array([0.0, 0.0, 1.5]))
    with pytest.raises(InputError, match="range"):
        Nonlinearity(2.0, 2.0, np.array([0.1]))


@pytest.mark.parametrize("depth_mm", [1100.0, 1900.0, 3500.0])
def test_error_bar_includes_the_error_of_the_curve_and_its_correlations(depth_mm, rng):
    """Scatter over cameras drawn from one covariance, in which the curve and A are correlated."""
    root = rng.normal(size=(7, 7)) * np.array([0.02, 30.0, 1.0, 0.01, 0.01, 0.01, 0.01])[:, None]
    root[0] -= 0.8 * root[3]  # what the curve adds in the middle is taken from A
    covariance = root @ root.T
    uncertain = replace(MODEL, covariance=covariance[:3, :3], curve_covariance=covariance[3:])
    reading = depth_to_disparity(depth_mm, MODEL)
    _, sigma = disparity_to_depth(reading, uncertain, sigma_px=0.0)
    depths = []
    for a, b, delta, *series in rng.multivariate_normal([4.3, 8200.0, 50.0, *CURVE.coefficients], covariance, 4000):
        other = DepthModel(a, b, delta, nonlinearity=replace(CURVE, coefficients=np.array(series)))
        depths.append(float(disparity_to_depth(reading, other)[0]))
    # 4000 draws know a standard deviation to 1.1 %; three times that, and 1 % for what is not linear
    assert sigma == pytest.approx(np.std(depths), rel=0.045)


def test_a_covariance_of_another_curve_is_refused():
    with pytest.raises(InputError, match="4x7"):
        replace(MODEL, curve_covariance=np.zeros((3, 6)))
    with pytest.raises(InputError, match="0x3"):
        DepthModel(4.3, 8200.0, 50.0, curve_covariance=np.zeros((3, 6)))

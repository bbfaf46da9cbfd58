"""The compiled conversion agrees with the NumPy form, which is the oracle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from chromaperture.depth.conversion import DepthModel, depth_and_sigma, disparity_to_depth
from chromaperture.depth.nonlinearity import Nonlinearity

SHAPE = (9, 13)
CURVE = Nonlinearity(-4.0, 2.0, np.array([0.15, -0.05, 0.02]))


def fields(seed: int, *, maps: bool, known: bool, curved: bool, uncertain: bool = False) -> DepthModel:
    """Make a model of numbers or of maps, its errors correlated or 0; ``uncertain``: its curve has errors too."""
    draw = np.random.default_rng(seed)
    shape = SHAPE if maps else ()
    root = draw.normal(size=(*shape, 3, 3)) * np.array([0.01, 20.0, 1.0])[:, None]
    covariance = np.zeros((3, 3)) if known else (root @ np.moveaxis(root, -1, -2)).astype(np.float32 if maps else float)
    a, b = 2.3 + 0.1 * draw.normal(size=shape), 4500.0 + 100 * draw.normal(size=shape)
    with_others, root = draw.normal(size=(3, 3)) * np.array([1e-4, 0.2, 0.01]), 0.02 * draw.normal(size=(3, 3))
    own = np.hstack([with_others, root @ root.T]) if curved and uncertain else None
    return DepthModel(a, b, 47.0, covariance, CURVE if curved else None, own)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@example(
    seed=145, maps=False, known=False, curved=True, uncertain=True, single=False, sigma_is_map=False, odd=[]
)  # parts of the variance cancel
@given(
    seed=st.integers(0, 2**32 - 1),
    maps=st.booleans(),
    known=st.booleans(),
    curved=st.booleans(),
    uncertain=st.booleans(),
    single=st.booleans(),
    sigma_is_map=st.booleans(),
    odd=st.lists(st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 2.3, 1e9, -1e9]), max_size=6),
)
def test_kernel_and_formulas_agree(seed, maps, known, curved, uncertain, single, sigma_is_map, odd):
    model = fields(seed, maps=maps, known=known, curved=curved, uncertain=uncertain)
    draw = np.random.default_rng(seed + 1)
    # From in front of the curve's range to beyond infinity, so that a good part lies beyond the greatest depth too.
    disparity = draw.uniform(-6, 3, SHAPE).astype(np.float32 if single else float)
    disparity.flat[: len(odd)] = odd
    sigma = np.abs(draw.normal(size=SHAPE if sigma_is_map else ())).astype(disparity.dtype)
    if sigma_is_map:
        sigma[0, -1] = np.nan
    with np.errstate(all="ignore"):  # the formulas divide by what is not there
        depth, error = depth_and_sigma(disparity, sigma, model, max_depth_mm=9000.0)
    found, found_error = disparity_to_depth(disparity, model, sigma, max_depth_mm=9000.0)
    assert found.dtype == found_error.dtype == np.float32
    # Both calculate in double precision and round once: one last place of float32 apart, 1.2e-7, at the most; the error
    # bar's terms cancel by up to 1e3 where errors are correlated.
    np.testing.assert_allclose(found, depth, rtol=2e-7)
    if not (uncertain and curved):
        np.testing.assert_allclose(found_error, error, rtol=1e-6, atol=1e-9)  # a few last places of float32
        return
    missed = np.abs(found_error.astype(float) ** 2 - error.astype(float) ** 2)
    allowed = table_error(disparity, depth.astype(float), model) + 1e-5 * error.astype(float) ** 2 + 1e-9
    assert np.array_equal(np.isnan(found_error), np.isnan(error))
    assert np.all((missed <= allowed) | np.isnan(error))


def table_error(disparity: np.ndarray, depth_mm: np.ndarray, model: DepthModel) -> np.ndarray:
    """Bound of what the kernel's table of the curve's error, 512 entries, adds to or takes from a variance; mm^2.

    Linear between entries it misses an eighth of the bend times (2 / 511)^2: squares and products of T_2 to T_4 bend by
    670 at the most, T_4 by 80. Entries are even in what is read, so that they lie farther apart where it rises slowly.
    Variances themselves are no yardstick: their parts cancel.
    """
    assert model.curve_covariance is not None
    largest = np.abs(model.curve_covariance).sum(axis=0)
    own, with_a, with_b, with_delta = largest[3:].sum(), *largest[:3]
    z = depth_mm - model.sensor_to_pupil_mm
    by_b, slope = z / model.scale_px_mm, CURVE.slope(CURVE.linear(disparity))
    by_d = z * by_b
    apart = 2 / 511 * (CURVE.measured(CURVE.high_px) - CURVE.measured(CURVE.low_px)) / 6 / slope  # over a range of 6 px
    cross = by_d * with_a + by_b * with_b + with_delta
    return np.asarray(((by_d / slope) ** 2 * own * 670 + 2 * by_d / slope * cross * 80) * apart**2 / 8)


def test_pixels_of_a_row_need_not_lie_one_after_the_other():
    model = fields(5, maps=False, known=False, curved=True)
    sliced = np.random.default_rng(0).uniform(-3, 1, (SHAPE[0], SHAPE[1] * 2))[:, ::2]
    found, whole = (disparity_to_depth(part, model, part + 9) for part in (sliced, np.ascontiguousarray(sliced)))
    np.testing.assert_array_equal(found, whole)

"""Light in whole units: rounding against NumPy's, and sums that have the same bits in any precision."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.matching import compiled as cpu
from chromaperture.matching.estimate import method_for
from chromaperture.matching.integer_light import (
    LEAST_EXPONENT,
    LIGHT_BITS,
    TAP_PARTS,
    in_whole_units,
    light_unit,
    smooth_whole,
    smoothing_taps,
    whole_taps,
)
from chromaperture.matching.readable.correlation import SAMPLING
from chromaperture.matching.views import halved_views, smooth
from chromaperture.settings.methods import RealTimeConfig
from worlds import wavy_capture


@given(st.floats(1e-9, 100.0))
def test_the_unit_is_a_power_of_two_and_a_fixed_part_of_the_light(mean):
    unit = light_unit(mean)
    assert math.frexp(unit)[0] == 0.5
    assert 2.0**LIGHT_BITS <= np.float32(mean) / unit < 2.0 ** (LIGHT_BITS + 1)


@pytest.mark.parametrize("mean", [0.0, -1.0, 1e-30])
def test_a_black_picture_has_a_unit(mean):
    assert light_unit(mean) == 2.0 ** (LEAST_EXPONENT - LIGHT_BITS)


@pytest.mark.parametrize("less", [0.0, 6.0, -200.0])  # even numbers of units
@pytest.mark.parametrize("unit", [1.0, 2.0**-13])
def test_light_is_rounded_as_numpy_rounds(rng, less, unit):
    values = np.r_[np.arange(-40, 40) / 8, rng.normal(0, 3000, 500)].astype(np.float32)[:, None] * np.float32(unit)
    np.testing.assert_array_equal(
        in_whole_units(values, unit, less=less * unit), np.float32(unit) * (np.round(values / np.float32(unit)) - less)
    )


@given(st.sampled_from(sorted(SAMPLING)), st.floats(0, 1, exclude_max=True))
def test_weights_of_a_filter_are_whole_parts_of_one(sampling, phase):
    exact = SAMPLING[sampling](phase)
    taps = whole_taps(exact)
    assert taps.sum() == 1
    np.testing.assert_array_equal(TAP_PARTS * taps, np.round(TAP_PARTS * taps))
    np.testing.assert_allclose(taps, exact, atol=2.5 / TAP_PARTS)  # the largest takes what the others leave


@pytest.mark.parametrize("sigma_px", [0.0, 0.4, 1.1, 2.0])
def test_whole_smoothing_is_smoothing(rng, sigma_px):
    view, unit = rng.normal(0.3, 0.05, (41, 53)).astype(np.float32), 2.0**-13
    found = np.empty_like(view)
    smooth_whole(view, sigma_px, unit, out=found)
    np.testing.assert_array_equal(found, unit * np.round(found / unit))
    expected = smooth(view, sigma_px)
    # Three roundings, and weights of 1 / 1024 where the light differs by 0.4 at the most.
    apart = np.abs((found - found.mean()) - (expected - expected.mean())).max()
    assert apart < 2 * unit + 0.4 * len(smoothing_taps(sigma_px)) / TAP_PARTS


@pytest.mark.parametrize("design", ["cy_halves", "cmy_circles"])
def test_twice_the_light_has_the_same_scores(design):
    method = method_for(RealTimeConfig().with_range(-4.0, 4.0), aperture=design)
    layers_px = method.config.layers.values_px / 2
    image = 0.4 * wavy_capture(design, saturated=False)
    once, twice = (
        cpu.correlate(
            halved_views(exposure * image, method.space, config=method.config.views)[0],
            layers_px,
            config=method.config.correlation,
        )
        for exposure in (np.float32(1), np.float32(2))
    )
    np.testing.assert_array_equal(once, twice)

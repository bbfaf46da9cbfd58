from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from chromaperture.config import Config, MatcherConfig
from chromaperture.errors import InputError


@example(low=0.45, width=0.5, step=0.25)  # 0.95 - 0.45 is a rounding less than two steps
@given(low=st.floats(-50, 50), width=st.floats(0.5, 60), step=st.sampled_from([0.1, 0.25, 0.3, 0.5, 1.0]))
def test_layers_fill_the_range_evenly(low, width, step):
    assume(width >= 2 * step)
    layers = MatcherConfig(min_disparity_px=low, max_disparity_px=low + width, step_px=step).layers_px
    assert layers[0] == low
    # no layer beyond the end, none missing before it; 1e-5: the end is reached within a rounding of the division
    assert low + width - step < layers[-1] + 1e-5
    assert layers[-1] <= low + width + 1e-5
    np.testing.assert_allclose(np.diff(layers), step, rtol=1e-9)
    assert len(layers) >= 3


@pytest.mark.parametrize("step", [0.1, 0.25, 0.3, 0.5])
def test_an_end_that_is_a_whole_number_of_steps_away_is_a_layer(step):
    config = MatcherConfig(min_disparity_px=-3.0, max_disparity_px=-3.0 + 20 * step, step_px=step)
    assert len(config.layers_px) == 21


@given(low=st.floats(-30, 0), high=st.floats(1.1, 30), quality=st.sampled_from(["paper", "real-time", "accurate"]))
def test_another_range_is_widened_to_whole_layers_which_include_focus(low, high, quality):
    config = preset(quality).with_range(low, high)
    assert config.min_disparity_px <= low
    assert config.max_disparity_px >= high
    assert config.max_disparity_px - high <= config.step_px
    assert low - config.min_disparity_px <= config.step_px
    assert np.abs(config.layers_px).min() < 1e-9
    assert dataclasses.replace(config, min_disparity_px=-8, max_disparity_px=7.5) == preset(quality)


@pytest.mark.parametrize(
    "settings",
    [
        {"step_px": 0.0},
        {"step_px": -0.5},
        {"step_px": float("nan")},
        {"min_disparity_px": float("-inf")},
        {"max_disparity_px": float("nan")},
        {"min_disparity_px": 3.0, "max_disparity_px": 2.0},
        {"min_disparity_px": 0.0, "max_disparity_px": 0.9, "step_px": 0.5},
        {"window_decay": 1.0},
        {"window_decay": 0.0},
        {"window_decay": float("nan")},
        {"bilateral_sigma_px": -1.0},
        {"bilateral_sigma_px": float("nan")},
        {"bilateral_range": 0.0},
        {"bilateral_range": float("nan")},
        {"presmooth_sigma_px": -0.1},
        {"presmooth_sigma_px": float("inf")},
    ],
    ids=str,
)
def test_settings_that_make_no_sense_are_refused(settings):
    with pytest.raises(InputError):
        MatcherConfig(**settings)


def test_presets():
    paper, fast, accurate = map(MatcherConfig.preset, ("paper", "real-time", "accurate"))
    assert fast == Config().matcher
    assert not paper.noise_debiasing
    assert not paper.texture_weighting
    assert accurate.step_px < fast.step_px
    with pytest.raises(InputError, match="choose"):
        preset("best")


def test_settings_cannot_be_changed_behind_the_back():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Config().matcher.step_px = 1.0

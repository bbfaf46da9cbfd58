"""The settings of the methods: layers, ranges, what is refused, and the qualities' defaults."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from chromaperture.settings.methods import QUALITIES, AccurateConfig, Config, PaperConfig, RealTimeConfig, preset
from chromaperture.settings.stages import (
    BilateralConfig,
    CorrelationConfig,
    CorrelationEvidenceConfig,
    CrossFilterConfig,
    FourPathsConfig,
    LayersConfig,
    PlanesConfig,
    PlateConfig,
    SpectralConfig,
    SurfaceConfig,
    ViewsConfig,
)
from chromaperture.system.errors import InputError

NAN, INF = float("nan"), float("inf")


@example(low=0.45, width=0.5, step=0.25)  # 0.95 - 0.45 is a rounding less than two steps
@given(low=st.floats(-50, 50), width=st.floats(0.5, 60), step=st.sampled_from([0.1, 0.25, 0.3, 0.5, 1.0]))
def test_layers_fill_the_range_evenly(low, width, step):
    assume(width >= 2 * step)
    layers = LayersConfig(low, low + width, step).values_px
    assert layers[0] == low
    # no layer beyond the end, none missing before it; 1e-5: the end is reached within a rounding of the division
    assert low + width - step < layers[-1] + 1e-5
    assert layers[-1] <= low + width + 1e-5
    np.testing.assert_allclose(np.diff(layers), step, rtol=1e-9)  # float64 differences of numbers up to 110
    assert len(layers) >= 3


@pytest.mark.parametrize("step", [0.1, 0.25, 0.3, 0.5])
def test_an_end_that_is_a_whole_number_of_steps_away_is_a_layer(step):
    assert len(LayersConfig(-3.0, -3.0 + 20 * step, step).values_px) == 21


@given(low=st.floats(-30, 0), high=st.floats(1.1, 30), quality=st.sampled_from(QUALITIES))
def test_another_range_is_widened_to_whole_layers_which_include_focus(low, high, quality):
    config = preset(quality).with_range(low, high)
    layers = config.layers
    assert layers.min_px <= low
    assert layers.max_px >= high
    assert layers.max_px - high <= layers.step_px
    assert low - layers.min_px <= layers.step_px
    assert np.abs(layers.values_px).min() < 1e-9  # rounding of float64
    back = dataclasses.replace(layers, min_px=-8, max_px=7.5)
    assert dataclasses.replace(config, layers=back) == preset(quality)


@pytest.mark.parametrize(
    ("stage", "settings"),
    [
        (LayersConfig, {"step_px": 0.0}),
        (LayersConfig, {"step_px": -0.5}),
        (LayersConfig, {"step_px": NAN}),
        (LayersConfig, {"min_px": -INF}),
        (LayersConfig, {"max_px": NAN}),
        (LayersConfig, {"min_px": 3.0, "max_px": 2.0}),
        (LayersConfig, {"min_px": 0.0, "max_px": 0.9, "step_px": 0.5}),
        (LayersConfig, {"step_px": 1e-9}),
        (LayersConfig, {"min_px": -1e308, "max_px": 1e308}),
        (ViewsConfig, {"presmooth_sigma_px": -0.1}),
        (ViewsConfig, {"presmooth_sigma_px": INF}),
        (ViewsConfig, {"guide_range": 0.0}),
        (ViewsConfig, {"guide_range": NAN}),
        (CorrelationConfig, {"window_decay": 1.0}),
        (CorrelationConfig, {"window_decay": 0.0}),
        (CorrelationConfig, {"window_decay": NAN}),
        (BilateralConfig, {"sigma_px": -1.0}),
        (BilateralConfig, {"sigma_px": NAN}),
        (CorrelationConfig, {"cell_px": 3}),
        (CorrelationConfig, {"cell_px": 2, "noise_debiasing": True}),
        (FourPathsConfig, {"edge_floor": 2.0}),
        (FourPathsConfig, {"jump_penalty": 0.0}),
        (CorrelationConfig, {"sampling": "linear"}),
        (RealTimeConfig, {"smoothing_edge_range": 0.0}),
        (FourPathsConfig, {"temperature": NAN}),
        (SurfaceConfig, {"paths": 6}),
        (SurfaceConfig, {"slope_penalty": 0.0}),
        (SurfaceConfig, {"edge_range": -1.0}),
        (SurfaceConfig, {"edge_floor": 1.5}),
        (SurfaceConfig, {"temperature": NAN}),
        (SurfaceConfig, {"interpolation_sigma_px": 0.0}),
        (SurfaceConfig, {"learned_error_bar": True}),
        (CrossFilterConfig, {"band_weights": (1.0,)}),
        (CrossFilterConfig, {"bands_px": ((1.4, 0.6), (1.4, 3.2))}),
        (CrossFilterConfig, {"bands_px": (), "band_weights": ()}),
        (CrossFilterConfig, {"damping": 0.0}),
        (CrossFilterConfig, {"noise_margin": NAN}),
        (CrossFilterConfig, {"band_weights": (1.0, NAN)}),
        (CrossFilterConfig, {"fallback_weight": -1.0}),
        (CorrelationEvidenceConfig, {"space": "sensor"}),
        (CorrelationEvidenceConfig, {"correlation": CorrelationConfig(noise_debiasing=True)}),
        (PaperConfig, {"sigma_scale": 0.0}),
        (PaperConfig, {"space": "both"}),
        (RealTimeConfig, {"space": "both"}),
        (RealTimeConfig, {"floor_px": NAN}),
        (RealTimeConfig, {"smoothing_sigma_px": -1.0}),
        (RealTimeConfig, {"correlation": CorrelationConfig(noise_debiasing=True)}),
        (PlanesConfig, {"tiles_px": ()}),
        (PlanesConfig, {"tiles_px": (4,)}),
        (PlanesConfig, {"plane_penalty": -1.0}),
        (PlanesConfig, {"edge_block_weight": 1.5}),
        (PlanesConfig, {"max_block_nats": -1.0}),
        (PlanesConfig, {"known_from_nats": INF}),
        (PlateConfig, {"rounds": 0}),
        (PlateConfig, {"rounds": 1_000_000}),
        (PlateConfig, {"evidence_share": 0.0}),
        (PlateConfig, {"bend_labels": -1.0}),
        (PlateConfig, {"slope_penalty": NAN}),
        (PlateConfig, {"edge_log_odds": INF}),
        (PlateConfig, {"own_evidence_nats": -1.0}),
        (SpectralConfig, {"gain": -1.0}),
        (SpectralConfig, {"cap_nats": 0.0}),
        (SpectralConfig, {"slopes": ()}),
        (SpectralConfig, {"stride_px": 0}),
        (SpectralConfig, {"rounds": 0}),
    ],
    ids=str,
)
def test_settings_that_make_no_sense_are_refused(stage, settings):
    with pytest.raises(InputError):
        stage(**settings)


def test_presets():
    paper, fast, accurate = map(preset, QUALITIES)
    assert (type(paper), type(fast), type(accurate)) == (PaperConfig, RealTimeConfig, AccurateConfig)
    assert fast == Config().matcher
    assert not paper.correlation.noise_debiasing
    assert not paper.bilateral.texture_weighting
    assert accurate.layers.step_px < fast.layers.step_px
    with pytest.raises(InputError, match="choose"):
        preset("best")


def test_a_known_blur_counts_layers_and_slopes_in_blur():
    near, far = AccurateConfig.for_blur(0.2), AccurateConfig.for_blur(0.4)
    assert near.uses_blur
    assert not AccurateConfig().uses_blur
    assert near.label_curves == ("accurate",)
    assert AccurateConfig().label_curves == ("accurate", "real-time")
    assert far.layers.step_px == pytest.approx(2 * near.layers.step_px)  # rounding
    assert near.surface.slope_penalty == pytest.approx(2 * far.surface.slope_penalty)  # rounding
    # Damping falls and the noise margin rises with the square of how close together the views lie.
    assert near.evidence.damping == pytest.approx(0.375 * 0.2**2)
    assert near.evidence.noise_margin == pytest.approx(0.16 / 0.2**2)
    assert far.evidence == CrossFilterConfig()


def test_one_pair_of_views_far_apart_counts_what_is_a_pixels_own():
    own = {
        (reach, one_pair): AccurateConfig.for_blur(reach, one_pair=one_pair).evidence.own_detail
        for reach in (0.09, 0.33)
        for one_pair in (True, False)
    }
    assert own == {(0.09, True): False, (0.09, False): False, (0.33, True): True, (0.33, False): False}


def test_settings_cannot_be_changed_after_they_are_made():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Config().matcher.layers = LayersConfig()

"""Quality real-time: the compiled matcher against the plain one, and planes against their truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chromaperture.disparity.semiglobal import LayerField
from test_kernels import DESIGNS, capture, inputs_of

import planes
from chromaperture.config import CoarseConfig
from chromaperture.disparity import coarse, coarse_kernels
from chromaperture.disparity.estimate import estimate_disparity
from chromaperture.errors import InputError

REAL_TIME = preset("real-time")
SMALL = REAL_TIME.with_range(-4.0, 4.0)
# Likelihoods are kept to 1/5000 nat and messages to 1/700: they move the layer only where two cost the same, and the
# place between the layers by their ratio to a bend of some hundredths of a nat in weak texture.
DISPARITY_TOLERANCE_PX = 0.02
OTHER_WINNERS = 0.01


def assert_agree(inputs, config, field=None):
    fast, slow = (m.match(inputs, config, field=field) for m in (coarse_kernels, coarse))
    assert fast.disparity_px.shape == slow.disparity_px.shape == inputs.fine_guide.shape
    apart = np.abs(fast.disparity_px - slow.disparity_px)
    same = (apart < DISPARITY_TOLERANCE_PX) | (np.isnan(fast.disparity_px) & np.isnan(slow.disparity_px))
    assert np.mean(~same) <= OTHER_WINNERS
    # Squares: near 0 the root of a likelihood's rounding, 2e-4, is large.
    assert np.mean(np.abs(fast.peak**2 - slow.peak**2)[same] > 1e-3) <= OTHER_WINNERS
    assert np.mean(np.abs(fast.spread_px - slow.spread_px)[same] > 0.02) <= OTHER_WINNERS


@pytest.mark.parametrize("design", DESIGNS)
def test_every_design_agrees_with_the_reference(design):
    assert_agree(inputs_of(capture(design), design, SMALL), SMALL)


@pytest.mark.parametrize("shape", [(8, 8), (8, 65), (33, 9), (50, 64), (47, 101)])
def test_every_size_agrees_with_the_reference(shape):
    image = capture("cy_halves", shape=shape, saturated=False)
    image += np.random.default_rng(1).normal(0, 0.02, shape).astype(np.float32)[..., None]
    assert_agree(inputs_of(image, "cy_halves", SMALL), SMALL)


@pytest.mark.parametrize(
    "change", [{"slope_penalty": 3.0, "jump_penalty": 6.0}, {"edge_floor": 1.0}, {"temperature": 0.5}]
)
def test_every_setting_agrees_with_the_reference(change):
    config = replace(SMALL, coarse=CoarseConfig(**change))
    assert_agree(inputs_of(capture("cy_halves"), "cy_halves", config), config)


def test_fields_agree_with_the_reference():
    inputs = inputs_of(capture("cy_halves"), "cy_halves", SMALL)
    y, x = np.mgrid[: inputs.fine_guide.shape[0], : inputs.fine_guide.shape[1]].astype(np.float32)
    assert_agree(inputs, SMALL, LayerField(0.02 * (x - 40) + 0.01 * y, 0.8 + 0.003 * x))


@pytest.mark.parametrize("design", ["cy_halves", "cmy_circles"])
@pytest.mark.parametrize("disparity", [-2.3, -0.6, 0.25, 1.7])
def test_a_plane_is_found_between_the_layers(design, disparity):
    image = planes.capture(planes.texture(np.random.default_rng(4), blur_px=2.0), design, disparity)
    variance = np.full(image.shape, 1e-8, np.float32)
    found = estimate_disparity(image, aperture=design, config=SMALL, noise_variance=variance).value_px
    inner = found[planes.MARGIN_PX : -planes.MARGIN_PX, planes.MARGIN_PX : -planes.MARGIN_PX]
    # Cubic interpolation of the halved views reads up to 0.02 px wrong between their pixels.
    assert abs(np.median(inner) - disparity) < 0.025


def test_a_surface_of_the_field_is_one_plane():
    """Labels of equal depth come back as the disparities that the field says."""
    picture = planes.texture(np.random.default_rng(6), blur_px=2.0)
    image = planes.capture(picture, "cy_halves", 1.2)
    bent = LayerField(np.full(picture.shape, 0.4, np.float32), np.full(picture.shape, 0.8, np.float32))
    plain, bent_back = (
        estimate_disparity(image, aperture="cy_halves", config=SMALL, fields=f).value_px for f in (None, [bent])
    )
    assert np.nanmedian(np.abs(plain - bent_back)) < 0.05  # half of what linear reading between layers may move


def test_saturated_pixels_get_their_neighbours_depth():
    image = planes.capture(planes.texture(np.random.default_rng(5), blur_px=2.0), "cy_halves", 1.0)
    image[30:40, 40:50] = 1.0
    found = estimate_disparity(image, aperture="cy_halves", config=SMALL)
    assert abs(np.nanmedian(found.value_px[32:38, 42:48]) - 1.0) < 0.1


def test_inputs_of_another_quality_are_refused():
    paper = preset("paper")
    with pytest.raises(InputError, match="prepare the views"):
        coarse_kernels.match(inputs_of(capture("cy_halves"), "cy_halves", paper), SMALL)


@pytest.mark.parametrize("change", [{"slope_penalty": 0.0}, {"edge_floor": 2.0}, {"jump_penalty": 100.0}])
def test_impossible_settings_are_refused(change):
    with pytest.raises(InputError):
        CoarseConfig(**change)

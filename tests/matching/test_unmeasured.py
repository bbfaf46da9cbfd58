"""Where nothing was measured: channels without light, clipped lamps."""

import numpy as np
import pytest

from chromaperture.matching.error_bar import MAX_SIGMA_PX, sigma_of_range, widened, without_pixels, without_two_views
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.views import clipped_filled
from chromaperture.settings.methods import preset
from worlds import capture, texture

HOLE = np.s_[24:56, 32:72]  # of pictures of 80 x 96 px; whole squares of 8 px


def test_two_channels_with_light_are_needed_of_those_that_are_matched():
    image = np.full((80, 96, 3), 0.3, np.float32)
    image[HOLE][..., 2] = 0.0
    halves, all_channels = np.eye(3)[[0, 2]], np.eye(3)
    lacking = without_two_views(image, halves)
    assert lacking[HOLE].all()
    assert lacking.sum() == lacking[HOLE].size
    assert not without_two_views(image, all_channels).any()  # red and green are left
    image[HOLE][..., 1] = 0.0
    assert without_two_views(image, all_channels)[HOLE].all()
    image[HOLE] = np.nan  # unknown, which is not dark
    assert not without_two_views(image, halves).any()


@pytest.mark.parametrize(("quality", "empty"), [("real-time", (2,)), ("accurate", (1, 2))])
def test_a_surface_in_one_channel_has_the_error_bar_of_the_range(quality, empty):
    rng = np.random.default_rng(3)
    image = capture(texture(rng, blur_px=2.0), "cy_halves", 1.0)
    for channel in empty:
        image[HOLE][..., channel] = 0.0
    image += rng.normal(0, 8e-4, image.shape).astype(np.float32)  # read noise of 4 in 5000 electrons
    config = preset(quality).with_range(-4.0, 4.0)
    found = estimate_disparity(image, aperture="cy_halves", config=config)
    inside = found.sigma_px[HOLE]
    widest = sigma_of_range(config.layers.values_px)
    known = np.isfinite(inside)
    assert (inside[known] >= 0.99 * widest).all()  # labels between layers reach a little less far
    outside = found.sigma_px[:16]  # a window and more above
    assert np.nanmedian(outside) < 0.2 * widest


def test_error_bars_are_widened_up_to_the_limit_and_stay_unknown():
    sigma = np.array([[0.1, 3.0, np.nan, 0.1]], np.float32)
    unmeasured = np.array([[True, True, True, False]])
    np.testing.assert_allclose(widened(sigma, unmeasured, 2.0), [[2.0, 3.0, np.nan, 0.1]], rtol=1e-6)
    assert widened(sigma, unmeasured, 100.0)[0, 0] == MAX_SIGMA_PX
    assert widened(sigma, np.zeros((1, 4), bool), 2.0) is sigma


def test_clipped_pixels_and_their_neighbours_are_filled_from_around():
    image = np.full((80, 96, 3), (0.2, 0.3, 0.4), np.float32)
    image[30:40, 40:50] = 1.0
    image[33:36, 45] = image[5, 5] = np.nan
    image[60, 20] = 1.0  # by noise
    usable = np.ones((80, 96), np.float32)
    usable[30:40, 40:50] = usable[5, 5] = usable[60, 20] = 0.0
    filled, kept = clipped_filled(image, usable)
    np.testing.assert_array_equal(filled[60, 20], 1.0)
    filled[60, 20] = 0.2, 0.3, 0.4
    np.testing.assert_allclose(filled, np.broadcast_to((0.2, 0.3, 0.4), filled.shape), atol=1e-6)  # float32
    assert (kept == 0).sum() == 16 * 16 + 2  # the area 3 px wider on every side, and two single pixels
    np.testing.assert_array_equal(without_pixels(kept), np.pad(np.ones((8, 8), bool), ((31, 41), (41, 47))))
    everything = np.ones((80, 96), np.float32)
    assert clipped_filled(filled, everything)[0] is filled


def test_a_clipped_lamp_does_not_move_the_wall_beside_it():
    """Its disc ends at the same place in all channels, as a thing in focus would; the wall is 2 px from there."""
    y, x = np.mgrid[:80, :96]
    image = capture(texture(np.random.default_rng(5), blur_px=2.0), "cy_halves", 2.0)
    distance = np.hypot(y - 40, x - 48)
    image[distance < 10] = 1.0
    found = estimate_disparity(image, aperture="cy_halves", config=preset("accurate").with_range(-4.0, 4.0))
    beside = (distance > 14) & (distance < 24)
    assert np.nanmax(np.abs(found.value_px[beside] - 2.0)) < 0.25  # half a layer

"""The channels come back to the view of the pupil's centre."""

import numpy as np
import pytest

from chromaperture.color.alignment import align_channels, channel_directions, fill_unknown, white_balance
from chromaperture.optics.aperture import DESIGNS
from planes import MARGIN_PX, capture, texture


@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares"])
@pytest.mark.parametrize("disparity_px", [-3.3, 2.4])
def test_a_grey_plane_is_grey_again(rng, design, disparity_px):
    picture = texture(rng)
    image = capture(picture, design, disparity_px)
    disparity = np.full(picture.shape, disparity_px, np.float32)
    color = align_channels(image, disparity, channel_directions(DESIGNS[design], {}))
    inner = slice(MARGIN_PX, -MARGIN_PX)
    color = color[inner, inner]
    truth = picture[inner, inner]
    for k in range(3):
        if design == "cy_halves" and k == 1:
            continue  # green sees both halves at once: its blur is not a shift
        scaled = color[..., k] / color[..., k].mean() * truth.mean()
        # cubic interpolation of a texture of 1.5 px blur leaves 2e-3 of its 0.09 contrast
        assert np.sqrt(np.mean((scaled - truth) ** 2)) < 2e-3


def test_leaking_film_moves_a_channel_less():
    ideal = channel_directions(DESIGNS["cy_halves"], {})
    np.testing.assert_allclose(ideal, [[1, 0], [0, 0], [-1, 0]], atol=5e-3)
    leaky = channel_directions(
        DESIGNS["cy_halves"], {"cyan": np.array([0.1, 0.63, 0.65]), "yellow": np.array([0.92, 0.85, 0.1])}
    )
    # Two point masses at +1 and -1: the centroid of red is (T_yellow - T_cyan) / (T_yellow + T_cyan).
    np.testing.assert_allclose(leaky[0, 0], (0.92 - 0.10) / (0.92 + 0.10), atol=5e-3)
    np.testing.assert_allclose(leaky[2, 0], -(0.65 - 0.10) / (0.65 + 0.10), atol=5e-3)


def test_unknown_takes_the_nearest_known():
    values = np.full((5, 5), np.nan)
    values[0, 0], values[4, 4] = 1.0, 2.0
    filled = fill_unknown(values)
    assert filled[1, 0] == 1.0
    assert filled[4, 3] == 2.0
    assert (fill_unknown(np.full((3, 3), np.nan)) == 0).all()


def test_white_paper_comes_out_white():
    white = np.array([0.46, 0.67, 0.34])
    np.testing.assert_allclose(white_balance(np.tile(white, (2, 2, 1)), white), 0.67, rtol=1e-6)

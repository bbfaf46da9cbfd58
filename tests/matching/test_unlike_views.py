"""Views that differ by hue: how much they do, and the error bar that knows of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from chromaperture.matching.paper import CELL_PX, WINDOW_CELLS, cell_moments, mixed_share, unlike_share
from chromaperture.settings.methods import PaperConfig
from worlds import LAYOUT, capture, measured, moved, space_of, texture

PAPER = PaperConfig().with_range(-4.0, 4.0)
SIZES = st.tuples(st.integers(1, 40), st.integers(1, 40), st.integers(2, 3))
STILL = np.zeros((3, 2))  # directions of views that no disparity moves


@given(hnp.arrays(np.float32, SIZES, elements=st.floats(-1, 1, width=32)), st.floats(-60, 60))
def test_it_is_a_share(pictures, disparity_px):
    disparity = np.full(pictures.shape[:2], disparity_px, np.float32)
    disparity[0] = np.nan
    share = unlike_share(pictures, disparity, np.eye(3, 2))
    assert share.shape == pictures.shape[:2]
    assert (share >= 0).all()
    assert (share <= 1).all()


def test_independent_views_have_in_common_what_their_mean_keeps(rng):
    # The mean of K independent views has 1 / K of their variance.
    for count in (2, 3):
        share = unlike_share(rng.normal(size=(400, 400, count)).astype(np.float32), np.zeros((400, 400)), STILL)
        # 784 pixels a window, two hundred windows a frame: the mean is known to a thousandth.
        assert share.mean() == pytest.approx(1 - 1 / count, abs=0.005)


@pytest.mark.parametrize("design", sorted(LAYOUT))
def test_views_are_alike_where_the_disparity_is_right(rng, design):
    """Whole px, so that nothing is interpolated; by one px too little they are not."""
    directions = np.array([(1, 0), (-1, 0), (0, 1)][: len(LAYOUT[design])], float)
    picture = texture(rng, 160, 200)
    # What is at x in the centre view is at x + d u in the view.
    views = np.stack([moved(picture, 3 * x, 3 * y) for x, y in directions], axis=2).astype(np.float32)
    margin = CELL_PX * WINDOW_CELLS // 2 + 2 * CELL_PX  # half a window, the cells between whose centres a pixel lies
    inner = (slice(margin, -margin), slice(margin, -margin))
    right, wrong = (unlike_share(views, np.full(picture.shape, d, np.float32), directions)[inner] for d in (3, 2))
    assert right.max() < 1e-4  # rounding of float32 moments
    # Views 2 px apart of a texture behind a Gaussian of 1.5 px keep exp(-4 / 9) = .64 of their correlation.
    assert wrong.min() > 0.05


def test_it_is_a_window_of_pixels(rng):
    """Against sums written out."""
    pictures, size = rng.normal(size=(60, 64, 3)).astype(np.float32), CELL_PX * WINDOW_CELLS
    window = pictures[16 : 16 + size, 20 : 20 + size].reshape(-1, 3)
    expected = 1 - window.mean(axis=1).var() / window.var(axis=0).mean()
    share = unlike_share(pictures, np.zeros((60, 64)), STILL)
    centre = share[16 + size // 2 - 1 :, 20 + size // 2 - 1 :][:2, :2]  # beside the centre of the middle cell
    # An eighth of a cell off in both directions: 7/8 of it and 1/8 of its neighbour, whose window moves by one cell.
    assert centre.mean() == pytest.approx(expected, abs=0.01)


def test_cells_cover_all_whole_squares(rng):
    plane = rng.normal(size=(2 * CELL_PX + 3, 3 * CELL_PX + 1)).astype(np.float32)
    mean, mean_square = cell_moments(plane)
    assert mean.shape == mean_square.shape == (2, 3)
    square = plane[CELL_PX : 2 * CELL_PX, 2 * CELL_PX : 3 * CELL_PX]
    assert mean[1, 2] == pytest.approx(square.mean(), abs=1e-6)  # float32
    assert mean_square[1, 2] == pytest.approx((square**2).mean(), abs=1e-6)
    mean, mean_square = cell_moments(np.full((1, 2), 3.0, np.float32))
    assert mean == pytest.approx(3.0)
    assert mean_square == pytest.approx(9.0)


def test_one_channel_a_view_is_not_mixed():
    assert mixed_share(np.eye(3)) == 0
    assert mixed_share(space_of("cy_open").rows) == 0  # two views
    assert mixed_share(space_of("cmy_circles").rows) == pytest.approx(1)  # Eq. (1): each view weighs all channels alike
    assert mixed_share(space_of("rgb_squares").rows) == pytest.approx(0, abs=1e-9)


def hue_pattern(rng, design: str, disparity_px: float) -> np.ndarray:
    """A plane whose channels have textures of their own."""
    pictures = [capture(texture(rng, 160, 200, blur_px=3.0), design, disparity_px) for _ in range(3)]
    return np.stack([picture[..., k] for k, picture in enumerate(pictures)], axis=2)


@pytest.mark.parametrize("truth", [-2.0, 1.5])
def test_a_pattern_of_hues_is_read_at_the_focus_and_has_a_wide_error_bar(rng, truth):
    image = hue_pattern(rng, "cmy_circles", truth)
    shares = []
    for hue_share in (0.0, PAPER.hue_share):
        found, sigma = measured(image, "cmy_circles", replace(PAPER, hue_share=hue_share))
        assert abs(np.nanmedian(found)) < 0.2  # .05 px at seven disparities from -3 to 2.5 px
        shares.append(np.mean(np.abs(found - truth) < 2 * sigma))
    assert shares[0] < 0.7  # .42 and .62 of the errors lie within two bars
    assert shares[1] > 0.9  # .94 and .95


@pytest.mark.parametrize("design", sorted(LAYOUT))
def test_a_grey_pattern_keeps_its_error_bar(rng, design):
    image = capture(texture(rng, 160, 200, blur_px=3.0), design, -1.3)
    plain, wide = (measured(image, design, replace(PAPER, hue_share=share))[1] for share in (0.0, PAPER.hue_share))
    assert np.nanmedian(wide) < 1.1 * np.nanmedian(plain)

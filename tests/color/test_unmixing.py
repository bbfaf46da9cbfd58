from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from chromaperture.color.unmixing import mixing_matrix, own_film_unmixing, unmixing_rows, view_directions
from chromaperture.optics.aperture import DESIGNS, channel_transmission
from chromaperture.system.errors import InputError

YELLOW_FILM, CYAN_FILM = (0.92, 0.80, 0.08), (0.08, 0.68, 0.67)  # as real film leaks
levels = st.floats(0.01, 1.0)
colors = st.tuples(levels, levels, levels)


def accepted(filter_colors):
    try:
        return mixing_matrix(np.array(filter_colors))
    except InputError:
        return None


@given(filter_colors=st.lists(colors, min_size=2, max_size=3), brightness=st.floats(1e-3, 1e3))
def test_unmixing_undoes_mixing(filter_colors, brightness):
    mixing = accepted(filter_colors)
    assume(mixing is not None)
    count = len(filter_colors)
    views = np.array([[0.2, 0.7, 0.4], [0.9, 0.1, 0.3]])[:, :count]
    mixed = views @ np.array(filter_colors)
    # condition below 20 on unit columns; brightnesses of filters differ by up to 100
    np.testing.assert_allclose(mixed @ unmixing_rows(mixing, count).T, views, atol=1e-10)
    # The scale is free: the same filters in a dimmer light pass the same gates.
    dimmed = mixing_matrix(brightness * np.array(filter_colors))
    np.testing.assert_allclose(dimmed[:, :count], brightness * mixing[:, :count], rtol=1e-12)  # rounding


def test_two_filters_are_unmixed_by_least_squares_and_x_is_the_residual(rng):
    films = np.array([CYAN_FILM, YELLOW_FILM])
    mixing = mixing_matrix(films)
    pixels = rng.uniform(0, 1, (50, 3))  # not explained by two films
    best, residual, *_ = np.linalg.lstsq(films.T, pixels.T, rcond=None)
    unmixed = pixels @ np.linalg.inv(mixing).T
    np.testing.assert_allclose(unmixed[:, :2], best.T, atol=1e-12)  # rounding
    np.testing.assert_allclose(unmixed[:, 2] ** 2, residual, atol=1e-12)  # rounding of float64


@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares", "cmy_squares", "cmy_circles"])
def test_a_grey_scene_gives_the_views_through_the_filters(rng, design):
    """Where the film covers the pupil without gaps and white light, unmixing gives each film's view alone."""
    aperture = DESIGNS[design]
    views = rng.uniform(0, 1, (6, 9, len(aperture.views)))
    image = np.zeros((6, 9, 3))
    for k, name in enumerate(aperture.views):  # every film adds its colour times its view
        image += views[..., k, None] * np.array(aperture.filter_named(name).transmission)
    found = image @ own_film_unmixing(aperture).T
    np.testing.assert_allclose(found, views, atol=1e-12)  # rounding of float64


def test_noise_of_the_views_is_correlated_as_the_matrix_says(rng):
    deviations = np.array([0.03, 0.02, 0.025])
    rows = unmixing_rows(mixing_matrix(np.array([CYAN_FILM, YELLOW_FILM])), 2)
    noise = rng.normal(0, deviations, (1_000_000, 3)) @ rows.T
    expected = rows @ np.diag(deviations**2) @ rows.T
    # a million draws know a covariance to 0.15 % of the variances
    np.testing.assert_allclose(np.cov(noise.T), expected, atol=0.006 * expected.max())
    ideal = rng.normal(0, 0.02, (1_000_000, 3)) @ own_film_unmixing(DESIGNS["cy_halves"]).T
    assert np.corrcoef(ideal.T)[0, 1] == pytest.approx(-0.5, abs=0.005)  # a million draws: 0.001


@pytest.mark.parametrize(
    ("filter_colors", "message"),
    [
        ([(1.0, 0.9, 0.1), (1.0, 0.8, 0.1)], "deg apart"),
        ([(0.2, 0.2, 0.2), (0.8, 0.8, 0.8)], "deg apart"),
        ([(np.nan, 0.9, 0.1), (0.0, 0.8, 0.9)], "finite"),
        ([(np.inf, 0.9, 0.1), (0.0, 0.8, 0.9)], "finite"),
        ([(0.0, 0.0, 0.0), (0.0, 0.8, 0.9)], "black"),
        ([(1.0, 0.9, 0.1)], "two or three"),
        ([(1.0, 0.9), (0.1, 0.8)], "two or three"),
        # three well separated colours in one plane: the third is a mixture of the others
        ([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.01)], "dependent"),
    ],
)
def test_filters_that_cannot_be_told_apart_are_refused(filter_colors, message):
    with pytest.raises(InputError, match=message):
        mixing_matrix(np.array(filter_colors))


@pytest.mark.parametrize("design", ["magenta_annulus", "open"])
def test_designs_without_parallax_are_refused(design):
    with pytest.raises(InputError, match="no disparity"):
        own_film_unmixing(DESIGNS[design])


# Where the designs' films lie, seen from behind the camera, x right, y down.
SIN60 = np.sqrt(3) / 2
LAYOUT = {
    "cy_halves": [(-1, 0), (1, 0)],
    "cy_open": [(-1, 0), (1, 0)],
    "rgb_squares": [(1, 0), (0, -1), (-1, 0)],
    "cmy_squares": [(1, 0), (0, -1), (-1, 0)],
    "rgb_circles": [(0, -1), (-SIN60, 0.5), (SIN60, 0.5)],
    "cmy_circles": [(0, -1), (-SIN60, 0.5), (SIN60, 0.5)],
}


@pytest.mark.parametrize("design", sorted(LAYOUT))
def test_views_move_towards_their_film(design):
    # 1.5e-3: the directions are rounded to 1e-3, from a pupil sampled at 2e-3
    np.testing.assert_allclose(view_directions(DESIGNS[design]), LAYOUT[design], atol=1.5e-3)


@pytest.mark.parametrize("design", sorted(DESIGNS))
def test_no_channel_gets_more_light_than_the_open_pupil(design):
    assert (channel_transmission(DESIGNS[design]) <= 1).all()
    assert (channel_transmission(DESIGNS[design]) > 0.05).all()  # no channel is black: the least is 0.09

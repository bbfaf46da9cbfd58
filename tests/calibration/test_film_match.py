"""Photographs through the camera's film, through another one, and in coloured light."""

from __future__ import annotations

import numpy as np
import pytest

from chromaperture.capture.files import read_image
from chromaperture.color.film import match_film
from chromaperture.evaluation.health import film_match
from chromaperture.model.camera_file import Calibration
from chromaperture.products.samples import sample_camera, sample_image

HALVES, OPEN = "still_life_cy_halves", "still_life_cy_open"


@pytest.fixture(scope="module")
def photographs():
    return {name: read_image(sample_image(name), black_level=16, white_level=1016) for name in (HALVES, OPEN)}


@pytest.fixture(scope="module")
def films():
    return {name: Calibration.load(sample_camera(name)) for name in (HALVES, OPEN)}


@pytest.mark.parametrize("name", [HALVES, OPEN])
def test_the_right_film_is_accepted(photographs, films, name):
    match = film_match(photographs[name], films[name])
    assert match.doubts == ()
    assert not match.is_wrong
    assert abs(match.cast) < 0.08  # the largest of the scenes that the limits were measured on


def test_the_halves_are_refused_by_the_open_design_and_named(photographs, films):
    match = film_match(photographs[HALVES], films[OPEN])
    assert match.is_wrong
    assert "cy_halves" in match.doubts[0]


def test_the_open_design_is_doubted_by_the_halves(photographs, films):
    """Its displacements are small, as of a scene near the focus: only colours speak against it."""
    match = film_match(photographs[OPEN], films[HALVES])
    assert match.doubts
    assert not match.is_wrong
    assert "cy_open" in match.doubts[0]


@pytest.mark.parametrize("light", [(1.0, 0.75, 0.45), (0.75, 0.9, 1.0)])
def test_lamps_and_shade_are_no_film(photographs, films, light):
    """Tungsten and blue sky differ from daylight in red against blue, by some +-0.8 and -0.3 in the logarithm."""
    assert film_match(photographs[HALVES] * np.float32(light), films[HALVES]).doubts == ()


def test_green_light_is_doubted_but_not_refused(photographs, films):
    match = film_match(photographs[HALVES] * np.float32((0.5, 1.0, 0.5)), films[HALVES])
    assert match.cast == pytest.approx(np.log(2), abs=0.08)  # as in the right film
    assert match.doubts
    assert not match.is_wrong


def test_channels_displaced_in_other_directions_are_another_film(photographs, films):
    """Turned by a quarter, the halves displace the channels upright: no film of the camera does."""
    turned = np.rot90(photographs[HALVES]).copy()
    assert film_match(turned, films[HALVES]).doubts


def test_a_white_sheet_has_no_colours_to_compare(films, rng):
    camera = films[HALVES]
    sheet = camera.film.aperture * 0.9 + rng.normal(0, 0.003, (480, 720, 3))
    match = match_film(sheet.astype(np.float32), camera.aperture, camera.film.aperture, (-14.0, 7.0))
    assert (match.cast, match.explained, match.doubts) == (None, None, ())


@pytest.mark.slow
def test_depth_refuses_another_film_unless_told(run, tmp_path):
    command = ("depth", sample_image(HALVES), "--camera", sample_camera(OPEN), "--out", tmp_path, "-q")
    command += ("--quality=real-time",)
    code, _, said = run(*command)
    assert code == 2
    assert said.count("\n") == 1
    assert "film" in said
    assert "cy_halves" in said
    assert list(tmp_path.iterdir()) == []
    code, _, said = run(*command, "--anyway")
    assert code == 0
    assert said.startswith("warning:")
    assert any(tmp_path.iterdir())

"""Film without a sheet of its own comes back from the light that the whole aperture passes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.color.film import completed_film
from chromaperture.optics.aperture import USUAL_FILM, channel_transmission, design_named, film_named

SEVERAL = ["cy_halves", "cy_open", "rgb_squares", "cmy_circles"]
share = st.floats(0.8, 1.25)


@pytest.mark.parametrize("design", SEVERAL)
def test_one_missing_sheet_is_solved_for(design: str) -> None:
    aperture = design_named(design)
    rng = np.random.default_rng(2)
    film = {name: rng.uniform(0.05, 0.9, 3) for name in aperture.views}
    light = channel_transmission(aperture.with_film(film))
    missing = aperture.views[-1]
    found = completed_film(aperture, {n: t for n, t in film.items() if n != missing}, light=light)
    assert found[missing] == pytest.approx(film[missing], abs=1e-9)  # linear in the film: exact


@pytest.mark.parametrize("design", SEVERAL)
@given(scale=st.tuples(share, share, share))
def test_usual_film_of_another_density_comes_back_without_any_sheet(design: str, scale: tuple) -> None:
    aperture = design_named(design)
    usual = film_named(USUAL_FILM)
    film = {name: np.clip(np.array(usual[name].transmission) * scale, 0, 1) for name in aperture.views}
    light = channel_transmission(aperture.with_film(film))
    found = completed_film(aperture, {}, light=light)
    for name in aperture.views:
        # exact but where a channel was clipped at 1, which the others then share
        assert found[name] == pytest.approx(film[name], abs=0.12 if max(scale) * 0.81 > 1 else 1e-9)


def test_without_white_through_the_aperture_film_is_usual() -> None:
    aperture, usual = design_named("cy_halves"), film_named(USUAL_FILM)
    found = completed_film(aperture, {"cyan": np.array([0.2, 0.6, 0.6])}, light=None)
    assert found["cyan"] == pytest.approx([0.2, 0.6, 0.6])  # copied
    assert found["yellow"] == pytest.approx(usual["yellow"].transmission)  # copied


def test_light_of_another_exposure_does_not_make_film_glow() -> None:
    found = completed_film(design_named("cy_halves"), {}, light=np.full(3, 50.0))
    assert all((film <= 1).all() and (film >= 0).all() for film in found.values())

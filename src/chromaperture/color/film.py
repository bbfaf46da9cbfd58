"""Colours of film of which no white sheet was photographed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from chromaperture.optics.aperture import FIXED, Aperture, channel_transmission, film_named

_MOST_CORRECTION = 2.0  # of usual film in one channel: beyond that the sheets of white differ in exposure


def completed_film(
    aperture: Aperture, measured: Mapping[str, np.ndarray], *, light: np.ndarray | None
) -> dict[str, np.ndarray]:
    """Give the transmission of all film in an aperture, measured or not.

    Film without a sheet is taken as usual film of its colour; where white was photographed through the aperture, its
    channels are scaled until the whole aperture passes that light. With one sheet missing this solves for it.

    Parameters
    ----------
    aperture : Aperture
    measured : mapping of str to (3,) float
        Transmission in R, G, B of the film that has a sheet.
    light : (3,) float or None
        Share of the light of the open pupil that the aperture passes in each channel.

    Returns
    -------
    dict of str to (3,) float64
        For every filter among ``aperture.views``.
    """
    usual = {name: sheet.transmission for name, sheet in (film_named("real") | FIXED).items()}
    film = {
        name: np.asarray(measured.get(name, usual.get(name, aperture.filter_named(name).transmission)), float)
        for name in aperture.views
    }
    guessed = [name for name in aperture.views if name not in measured]
    if light is None or not guessed:
        return film
    known = channel_transmission(aperture.with_film(film | dict.fromkeys(guessed, np.zeros(3))))
    by_guess = channel_transmission(aperture.with_film(film)) - known
    wanted = np.maximum(np.asarray(light, float) - known, 0)
    limits = (1 / _MOST_CORRECTION, _MOST_CORRECTION)
    scale = np.clip(wanted / np.maximum(by_guess, 1e-6), *(limits if len(guessed) > 1 else (0, np.inf)))
    return film | {name: np.clip(scale * film[name], 0, 1) for name in guessed}

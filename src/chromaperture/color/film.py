"""Transmission of film without a photographed white sheet."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from chromaperture.optics.aperture import FIXED, Aperture, channel_transmission, film_named

_MOST_CORRECTION = 2.0  # factor on typical film in one channel; more means that the white sheets differ in exposure


def completed_film(
    aperture: Aperture, measured: Mapping[str, np.ndarray], *, light: np.ndarray | None
) -> dict[str, np.ndarray]:
    """Complete the measured transmission of an aperture's film.

    Film without a sheet is assumed to be typical film of its colour (`FILMS`, "real"). If white was photographed
    through the aperture, its channels are scaled so that the aperture passes that light; with one sheet missing this is
    exact.

    ``measured`` mapping of str to (3,) float: transmission in R, G, B, of film with a sheet; ``light`` (3,) float or
    None: light of each channel through the aperture, over that of the open pupil. Returns dict of str to (3,) float64:
    for every filter among ``aperture.views``.
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

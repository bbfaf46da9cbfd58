"""What a session's white sheets tell: the colours of the film, and the sensor's noise."""

from __future__ import annotations

import dataclasses

import numpy as np

from chromaperture.calibration.session import Session
from chromaperture.camera_file import Film, Sensor
from chromaperture.color.film import completed_film
from chromaperture.color.noise import fit_photon_noise, noise_samples
from chromaperture.optics.aperture import Aperture, channel_transmission

_NOISE_BOARDS = 8


def measure_film(session: Session, aperture: Aperture, notes: list[str]) -> Film:
    """Colours of the filters from the white sheets; usual film where a sheet is missing."""
    clear = session.white("open")
    if clear is None:
        notes.append("no white sheet through the open pupil: colours are relative to full scale")
        clear = np.ones(3)
    sheets = {name: session.sheet(name) for name in aperture.views}
    measured = {name: sheet for name, sheet in sheets.items() if sheet is not None}
    white = session.white(session.design)
    film = completed_film(
        aperture,
        {name: sheet / clear for name, sheet in measured.items()},
        light=None if white is None else white / clear,
    )
    missing = [name for name in aperture.views if name not in measured]
    if missing:
        means = "" if white is None else ", as much of it as the white sheet through the aperture shows"
        notes.append(f"no sheet of {', '.join(missing)} film: taken as usual film{means}; the views may mix a little")
    if white is None:
        notes.append("no white sheet through the aperture: the colour balance is computed from the film")
        white = np.maximum(channel_transmission(aperture.with_film(film)), 1e-3) * clear
    return Film({name: film[name] * clear for name in aperture.views}, clear, white)


def with_noise(session: Session, notes: list[str]) -> Sensor:
    """Give the sensor with its noise: as the session says, else as the white sheets or the boards show it."""
    sensor = session.sensor
    if sensor.full_well_electrons is not None and sensor.read_noise_electrons is not None:
        return sensor
    boards = list(session.boards)
    paths = list(session.sheets.values()) or boards[:: max(1, len(boards) // _NOISE_BOARDS)]
    samples = [noise_samples(session.read(path)) for path in paths]
    found = fit_photon_noise(*(np.concatenate(part) for part in zip(*samples, strict=True)))
    if found is None:
        notes.append("the photographs do not show how noise grows with light: it is estimated in every photograph anew")
        return sensor
    full_well, read_noise = found
    source = "the white sheets" if session.sheets else "the boards, whose finest texture counts as noise"
    notes.append(f"noise told from {source}: full well {full_well:.0f} electrons, read noise {read_noise:.1f}")
    return dataclasses.replace(sensor, full_well_electrons=full_well, read_noise_electrons=read_noise)

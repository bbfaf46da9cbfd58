"""Colours of the film and noise of the sensor, from photographs of white sheets."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chromaperture.calibration.session import SHEETS, Session
from chromaperture.capture.exif import UNMIXED, is_developed, read_noise_profile
from chromaperture.color.film import completed_film
from chromaperture.color.noise import fit_photon_noise, noise_samples, photon_noise_of_sheets
from chromaperture.color.unmixing import own_film_unmixing
from chromaperture.model.camera_parts import CameraSensor, Film
from chromaperture.optics.aperture import channel_transmission, design_named
from chromaperture.optics.dual_pixel_rays import PURE
from chromaperture.system.errors import InputError

_NOISE_BOARDS = 8  # boards that the noise is fitted to where there is no sheet: more were not needed; chosen by hand
_MOST_TRANSMISSION = 1.15  # of a film in a channel: 1, and uneven light; chosen by hand
_DARKEST = 1e-3  # of the white level: least colour of white light through the aperture, which colours are divided by
# Light of a channel through film, over that of the brightest: in camera colours some .05 at least (film that is sold).
# Simulated matrices take red behind cyan film below zero, to -.03 to -.46, where a file ends.
_CUT_OFF = 0.002
# Of the disparity, where film is taken as usual and boards set the scale: rms of `accurate` on coloured surfaces by
# two simulated pairs of gels.
FILM_ERROR = 0.03


@dataclass(frozen=True)
class WhiteSheets:
    """Film and noise."""

    film: Film
    sensor: CameraSensor  # the session's, with its noise where that could be found
    files: tuple[Path, ...]  # sheets that were read
    notes: tuple[str, ...]
    developed: bool | None = None  # whether a colour matrix was applied to the photographs; None where nothing tells


def measure_white_sheets(session: Session) -> WhiteSheets:
    """Measure film and noise; raises InputError for a design without parallax and for sheets that cannot be."""
    own_film_unmixing(design_named(session.design))
    sensor, noise_notes = _sensor_with_noise(session)
    film, film_notes = _film(session)
    stems = {"open", session.design, *(SHEETS.get(name, "") for name in film.filters)}
    known = session.sensor.full_well_electrons is not None and session.sensor.read_noise_electrons is not None
    files = tuple(path for name, path in session.sheets.items() if name in stems or not known)
    developed, matrix_notes = _colour_matrix(session)
    return WhiteSheets(film, sensor, files, (*noise_notes, *film_notes, *matrix_notes), developed)


def _colour_matrix(session: Session) -> tuple[bool | None, list[str]]:
    """Tell whether a colour matrix was applied to the photographs, by their tags or by colours cut off; and notes."""
    developed = next(map(is_developed, session.boards), None)
    what = "the photographs are a camera's JPEG files or name a colour profile: a colour matrix was applied to them"
    if developed is None and session.sensor.black_level == 0:  # else values below black are there, and zero is no end
        plain = dataclasses.replace(session, sensor=dataclasses.replace(session.sensor, response=None))
        sheets = {name: plain.white(SHEETS.get(name, "")) for name in design_named(session.design).views}
        cut = [name for name, sheet in sheets.items() if sheet is not None and sheet.min() < _CUT_OFF * sheet.max()]
        what = f"a channel has no light behind {' and '.join(cut)} film, as where a colour matrix took it below zero"
        developed = True if cut else None
    advice = (
        "parallax comes out too large, by the colour of the object, which the error bar does not know: measure files "
        f"of the same kind only; better take RAW files, or develop them with {UNMIXED}"
    )
    return developed, [f"{what}; {advice}"] if developed else []


def unmeasured_film(session: Session) -> list[str]:
    """List the colours of film that have no white sheet of their own."""
    return [name for name in design_named(session.design).views if SHEETS.get(name) not in session.sheets]


def _film(session: Session) -> tuple[Film, list[str]]:
    """Return the colours of the filters: measured, or those of usual film where a sheet is missing; and notes."""
    if session.sensor.dual_pixel is not None:
        return film_of_halves(), []
    aperture, notes = design_named(session.design), []
    clear = session.white("open")
    if clear is None:
        notes.append("no white sheet through the open pupil: colours are relative to full scale")
        clear = np.ones(3)
    sheets = {name: session.white(SHEETS.get(name, "")) for name in aperture.views}
    measured = {name: sheet / clear for name, sheet in sheets.items() if sheet is not None}
    white = session.white(session.design)
    for name, color in {**measured, session.design: np.zeros(3) if white is None else white / clear}.items():
        if color.max() > _MOST_TRANSMISSION:
            raise InputError(
                f"the white sheet through {name} is {color.max():.2f} times as bright as the one through the open "
                "pupil: were files of white/ mixed up, or not all exposed alike?"
            )
    film = completed_film(aperture, measured, light=None if white is None else white / clear)
    if missing := unmeasured_film(session):
        means = "" if white is None else ", scaled to the light of the white sheet through the aperture"
        notes.append(
            f"no sheet of {', '.join(missing)} film: taken as usual film{means}; the boards set the "
            f"scale, and error bars allow for {FILM_ERROR:.0%} of the disparity of what is coloured"
        )
    if white is None:
        notes.append("no white sheet through the aperture: the colour balance is computed from the film")
        white = np.maximum(channel_transmission(aperture.with_film(film)), _DARKEST) * clear
    return Film({name: film[name] * clear for name in aperture.views}, clear, white), notes


def film_of_halves(film: Mapping[str, Sequence[float]] = PURE) -> Film:
    """Return the colours of a dual-pixel sensor's halves; without crosstalk each sees its side of the pupil."""
    colours = {name: np.array(colour, float) for name, colour in film.items()}
    return Film(colours, np.ones(3), np.sum([*colours.values()], axis=0) / 2)


def _sensor_with_noise(session: Session) -> tuple[CameraSensor, list[str]]:
    """Return the sensor with its noise, and notes.

    It is what the session states, else what the sheets show, else what a DNG file says, else what the boards show.
    """
    sensor = session.sensor
    if sensor.full_well_electrons is not None and sensor.read_noise_electrons is not None:
        return sensor, []
    boards = list(session.boards)
    found, source = None, ""
    if session.sheets:
        found = photon_noise_of_sheets(session.read(path) for path in session.sheets.values())
        source = "measured on the white sheets"
    if found is None:
        found, source = _stated_noise(session, [*session.sheets.values(), *boards[:1]]), "of the DNG's NoiseProfile"
    if found is None and not session.sheets:
        found = _noise_of_boards(session, boards[:: max(1, len(boards) // _NOISE_BOARDS)])
        source = "measured on the boards, whose finest texture counts as noise"
    if found is None:
        return sensor, ["the photographs do not show how noise grows with light: it is estimated in every photograph"]
    full_well, read_noise = found
    note = f"noise {source}: full well {full_well:.0f} electrons, read noise {read_noise:.1f}"
    return dataclasses.replace(sensor, full_well_electrons=full_well, read_noise_electrons=read_noise), [note]


def _noise_of_boards(session: Session, paths: Sequence[Path]) -> tuple[float, float] | None:
    """Full well and read noise, electrons, that the finest detail shows; coarser detail is texture."""
    samples = [noise_samples(session.read(path)) for path in paths]
    return fit_photon_noise(*(np.concatenate(part) for part in zip(*samples, strict=True))) if samples else None


def _stated_noise(session: Session, paths: Sequence[Path]) -> tuple[float, float] | None:
    """Full well and read noise, electrons, of the pixels that are read, as a DNG file has them."""
    profile = next((found for found in map(read_noise_profile, paths) if found is not None), None)
    if profile is None:
        return None
    slope, offset = profile
    full_px, read_px = math.prod(session.photograph_size_px), session.sensor.width_px * session.sensor.height_px
    full_well = 1 / slope  # variance is light over it
    return full_well * full_px / read_px, math.sqrt(offset * full_px / read_px) * full_well

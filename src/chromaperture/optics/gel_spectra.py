"""Spectra of gels, cameras and lights, and what cameras see of film: where no table has it yet.

The gels' are those that their maker publishes, of the optional package ``lighting_filters``; none are shipped.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from chromaperture.optics.gels import LIGHTS, Gel, Seen, gels
from chromaperture.system.errors import InputError, needed
from chromaperture.system.validation import quoted, read_text

WAVELENGTHS_NM = np.arange(400, 701, 10)
_MOST_BYTES = 1_000_000  # of a table: 1 nm steps take 30 KB; chosen by hand
_NARROWEST_NM = (430, 650)  # what a spectrum must cover at least: beyond, cameras see little; chosen by hand
_LEAST_RESPONSE = 1e-3  # of a channel to a light, over that of the brightest; chosen by hand
# CIE standard illuminant D65 at `WAVELENGTHS_NM` (ISO/CIE 11664-2).
_D65 = (82.75, 91.49, 93.43, 86.68, 104.86, 117.01, 117.81, 114.86, 115.92, 108.81, 109.35, 107.80, 104.79, 107.69,
        104.41, 104.05, 100.00, 96.33, 95.79, 88.69, 90.01, 89.60, 87.70, 83.29, 83.70, 80.03, 80.21, 82.28, 78.28,
        69.72, 71.61)  # fmt: skip


def published() -> dict[str, np.ndarray]:
    """Return the transmissions that Lee publishes, by number; of some gels from 405 nm on, below which they stay; (W,).

    Raises
    ------
    MissingDependencyError
        Without the package that has them.
    """
    hint = "spectra of gels need the extra: pip install 'chromaperture[films]'"
    known = needed("lighting_filters", hint).LightingFilters("Lee")
    spectra = {}
    for key, gel in known.items():
        if gel.sd:
            nm, passed = np.array(list(gel.sd), float), np.array(list(gel.sd.values()), float)
            spectra[key[1:]] = np.interp(WAVELENGTHS_NM, nm, passed)
    return spectra


def seen_by(sensitivities: str | Path, light: str, own: Sequence[Gel] = ()) -> Seen:
    """Compute what a camera sees of all gels, and of one's ``own``, from its sensitivities and a light's name or file.

    Raises
    ------
    InputError
        A file is no such table, or a channel hardly sees the light.
    MissingDependencyError
        See `published`.
    """
    sensors = read_spectra(sensitivities, ["red", "green", "blue"])[None, :, WAVELENGTHS_NM - 380]
    power = light_named(light)
    films = {gel: own_spectrum(gel.file) for gel in own}
    spectra = published()
    films |= {gel: spectra[number] for number, gel in gels().items()}
    white, passed = crosstalk(np.stack(list(films.values())), sensors, power)
    return Seen(white, {gel: passed[:, i] for i, gel in enumerate(films)})


def own_spectrum(file: str) -> np.ndarray:
    """Read the transmission of a film from a ``.csv`` file; (W,) float64."""
    values = read_spectra(file, ["transmission"])[0]
    if values.max() > 1:
        raise InputError(f"{quoted(file)}: a film passes {values.max():g} of the light; give shares from 0 to 1")
    return np.asarray(values[WAVELENGTHS_NM - 380])


def light_named(text: str) -> np.ndarray:
    """Return the power of daylight (D65), led (a model) or tungsten (2856 K), or of a ``.csv`` file; (W,) float64."""
    if text.lower().endswith(".csv"):
        return _shared_out(read_spectra(text, ["power"], whole=False))
    if text == "daylight":
        return np.array(_D65)
    if text == "led":
        # A model: the blue LED, 20 nm wide, and its phosphor, 120 nm wide at half height; about 4500 K.
        bands = [np.exp(-4 * np.log(2) * ((WAVELENGTHS_NM - at) / width) ** 2) for at, width in ((450, 20), (570, 120))]
        return np.asarray(bands[0] + bands[1])
    if text == "tungsten":
        metres = WAVELENGTHS_NM * 1e-9
        return np.asarray(metres**-5.0 / np.expm1(1.4388e-2 / (metres * 2856)))  # Planck
    raise InputError(f"unknown light {quoted(text)}: give {', '.join(LIGHTS)}, or a .csv of wavelength_nm,power")


def read_spectra(path: str | Path, names: Sequence[str], *, whole: bool = True) -> np.ndarray:
    """Read a table of wavelength and values at 1 nm from 380 to 780 nm; (len(names), 401) float64.

    Values are interpolated; beyond the table's ends they stay, or are 0 for light (``whole`` false).

    Raises
    ------
    InputError
        It cannot be read, or is no such table.
    """
    path = Path(path)
    form = f"give lines of wavelength_nm,{','.join(names)}"
    rows: list[list[float]] = []
    for number, line in enumerate(read_text(path, most_bytes=_MOST_BYTES).splitlines(), start=1):
        cells = [cell.strip() for cell in re.split(r"[,;\t]", line)]
        if not any(cells) or line.startswith("#"):
            continue
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            if rows:  # before the first numbers stand the heads
                raise InputError(f"{quoted(path)}: line {number} holds no numbers; {form}") from None
            continue
        if len(cells) != 1 + len(names) or not np.isfinite(rows[-1]).all() or min(rows[-1]) < 0:
            raise InputError(f"{quoted(path)}: line {number} needs {1 + len(names)} numbers from 0 up; {form}")
    if len(rows) < 3 or any(a[0] >= b[0] for a, b in pairwise(rows)):
        raise InputError(f"{quoted(path)}: the wavelengths must rise, on three lines or more; {form}")
    nm, *values = np.array(rows).T
    first, last = _NARROWEST_NM
    if whole and not (nm[0] <= first and nm[-1] >= last):
        raise InputError(
            f"{quoted(path)} is of {nm[0]:g} to {nm[-1]:g}: it must cover at least {first} to {last} nm, in nanometres"
        )
    fine = np.arange(380, 781)
    ends = {} if whole else {"left": 0.0, "right": 0.0}
    spectra = np.array([np.interp(fine, nm, column, **ends) for column in values])
    if not (spectra.max(axis=1) > 0).all():
        raise InputError(f"{quoted(path)}: a column is 0 everywhere between 380 and 780 nm; {form}")
    return spectra


def _shared_out(fine: np.ndarray) -> np.ndarray:
    """Share power at 1 nm out between the two nearest samples, so that a line keeps its power and its place."""
    step = np.diff(WAVELENGTHS_NM)[0]
    weights = np.clip(1 - abs(WAVELENGTHS_NM[:, None] - np.arange(380, 781)) / step, 0, None)
    return np.asarray(weights @ fine[0])


def crosstalk(films: np.ndarray, sensors: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute what cameras see of white and of film under a light.

    Parameters
    ----------
    films : array_like
        (G, W); transmissions.
    sensors : array_like
        (K, 3, W); sensitivities.
    light : array_like
        (W,); power.

    Returns
    -------
    white : np.ndarray
        (K, 3) float64; response without film, that of the brightest channel 1.
    passed : np.ndarray
        (K, G, 3) float64; transmission of each film in R, G, B.

    Raises
    ------
    InputError
        A channel hardly sees the light.
    """
    response = np.asarray(sensors) * light
    white = response.sum(axis=2)
    if (white.min(axis=1) <= _LEAST_RESPONSE * white.max(axis=1)).any():
        raise InputError("a channel of the camera hardly sees this light: choose a light that has all colours")
    passed = np.einsum("kcw,gw->kgc", response, films) / white[:, None]
    return white / white.max(axis=1, keepdims=True), passed


def strongest_line(file: str) -> tuple[float, float]:
    """Return where most of the power of a measured light lies within 5 nm, nm, and its share."""
    power = read_spectra(file, ["power"], whole=False)[0]
    within = np.convolve(power, np.ones(11), "same") / power.sum()
    return float(np.flatnonzero(within >= (1 - 1e-9) * within.max()).mean() + 380), float(within.max())

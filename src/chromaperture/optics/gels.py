"""Film one can buy: lighting gels before a camera under a light, and which two tell most about distance.

Two halves of film A and B give channel k, of response s_k to white, the light n_k = s_k (A_k + B_k) / 2 and the share
d_k = (B_k - A_k) / (A_k + B_k) of the half disparity. Of a grey texture of unknown form, under photon noise, the
information about the disparity is I = sum_k n_k (d_k - d)^2, where d is the mean of d_k by n_k: a displacement that all
channels share cannot be told from the texture.

``gels_seen.npz`` has what cameras see of Lee's clear gels, computed by ``benchmarks/film_tables.py`` from spectra that
are not shipped (`gel_spectra`).
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np

from chromaperture.system.errors import InputError
from chromaperture.system.validation import nearest, quoted

LIGHTS = ("daylight", "led", "tungsten")
OF_SPECTRA = "a film's own spectrum is judged by `chromaperture films` with --sensitivities of the camera"


@dataclass(frozen=True)
class Gel:
    """A gel: its number at its maker's and its name; or the file of its spectrum."""

    number: str
    name: str
    file: str = ""

    @property
    def title(self) -> str:
        """Number and name."""
        return f"{self.number} {self.name}".strip()


@dataclass(frozen=True)
class Seen:
    """What K cameras see of white and of gels under a light."""

    white: np.ndarray  # (K, 3) float64; response in R, G, B, that of the brightest channel 1
    passed: dict[Gel, np.ndarray]  # (K, 3) float64; transmission in R, G, B


@dataclass(frozen=True)
class Pair:
    """What two halves of film before a camera do; transmissions and shares as means over the cameras."""

    first: np.ndarray  # (3,) float64; transmission in R, G, B
    second: np.ndarray  # (3,) float64
    exposure: float  # factor on the exposure that makes the brightest channel as bright as without film
    # At the exposure without film, and at the longer one; of one unit for all pairs before the same cameras and light.
    information: tuple[float, float]


@cache
def _table() -> dict[str, np.ndarray]:
    with (resources.files("chromaperture.optics") / "gels_seen.npz").open("rb") as file, np.load(file) as table:
        return dict(table)


@cache
def gels() -> dict[str, Gel]:
    """Return Lee's clear gels by number."""
    numbers, names = (_table()[key].tolist() for key in ("number", "name"))
    return {number: Gel(number, name) for number, name in zip(numbers, names, strict=True)}


def cameras() -> list[str]:
    """List the cameras whose sensitivities were measured."""
    return _table()["camera"].tolist()


def gel_named(text: str) -> Gel:
    """Look up a gel by number (118, Lee 118, L118) or name; or name the ``.csv`` file of its spectrum.

    Raises
    ------
    InputError
        There is no such gel; the message names the nearest.
    """
    if text.lower().endswith(".csv"):
        return Gel(Path(text).stem, "", text)
    known = gels()
    number = re.fullmatch(r"\s*(?:lee|l)?\s*0*(\d{1,4})\s*", text.lower())
    if number:
        if (key := number[1].zfill(3)) in known:
            return known[key]
        near = sorted(known, key=lambda n: abs(int(n) - int(number[1])))[:3]
    else:
        names = {gel.name.lower(): gel.number for gel in known.values()}
        if text.strip().lower() in names:
            return known[names[text.strip().lower()]]
        near = [names[name] for name in difflib.get_close_matches(text.lower()[:80], names, n=3)]
    hint = f"; nearest: {', '.join(known[n].title for n in near)}" if near else ""
    raise InputError(f"no gel {quoted(text)} (Lee's clear gels are known){hint}; {OF_SPECTRA}")


def seen(light: str, camera: str | None = None) -> Seen:
    """Look up what a measured camera, or else all of them, see under daylight, led or tungsten.

    Raises
    ------
    InputError
        There is no such light or camera.
    """
    table, known = _table(), cameras()
    if light not in LIGHTS:
        raise InputError(f"unknown light {quoted(light)}: give {', '.join(LIGHTS)}, or a .csv of wavelength_nm,power")
    whose = slice(None)
    if camera is not None:
        wanted = camera.strip().lower()
        found = [i for i, name in enumerate(known) if wanted in (name.lower(), name.partition(" ")[2].lower())]
        if not found:
            raise InputError(f"no spectral sensitivities of camera {quoted(camera)}{nearest(camera, known)}")
        whose = slice(found[0], found[0] + 1)
    lamp = LIGHTS.index(light)
    passed = table["passed"][:, :, lamp, whose] / 1000  # (G, 3, K)
    white = table["white"][:, lamp, whose] / 1000  # (3, K)
    return Seen(white.T, {gel: passed[i].T for i, gel in enumerate(gels().values())})


def information(first: np.ndarray, second: np.ndarray, white: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute information about the disparity, and the light of the brightest channel.

    Parameters
    ----------
    first, second : np.ndarray
        (..., 3); transmissions of the halves in R, G, B.
    white : np.ndarray
        (..., 3); response without film.

    Returns
    -------
    told : np.ndarray
        (...) float64; in the unit of ``white``.
    brightest : np.ndarray
        (...) float64; light of the brightest channel through both halves.
    """
    light = white * (first + second) / 2
    moved = (second - first) / np.maximum(first + second, 1e-9)
    mean = (light * moved).sum(axis=-1) / np.maximum(light.sum(axis=-1), 1e-9)
    return (light * (moved - mean[..., None]) ** 2).sum(axis=-1), light.max(axis=-1)


def pair_of(first: Gel, second: Gel, what: Seen) -> Pair:
    """Judge a pair of gels, see `Pair`."""
    passed = what.passed[first], what.passed[second]
    told, brightest = information(*passed, what.white)
    a, b = (each.mean(axis=0) for each in passed)
    full = told / np.maximum(brightest, 1e-9)
    return Pair(a, b, float(1 / brightest.mean()), (float(told.mean()), float(full.mean())))


def all_information(what: Seen) -> np.ndarray:
    """Compute `Pair.information` of all pairs of gels, in the order of `gels`; (2, G, G) float64."""
    passed = np.stack([what.passed[gel] for gel in gels().values()], axis=1)  # (K, G, 3)
    told = np.empty((2, passed.shape[1], passed.shape[1]))
    for i in range(passed.shape[1]):
        found, brightest = information(passed[:, i, None], passed, what.white[:, None])
        told[:, i] = found.mean(axis=0), (found / np.maximum(brightest, 1e-9)).mean(axis=0)
    return told


def best_pairs(what: Seen, told: np.ndarray, count: int) -> list[tuple[Gel, Gel]]:
    """Choose the pairs that tell most, each gel once, from one of `all_information`; (G, G)."""

    def redness(gel: Gel) -> float:
        red, _, blue = what.passed[gel].mean(axis=0)
        return float((red - blue) / max(red + blue, 1e-9))

    known, left = list(gels().values()), told.copy()
    pairs = []
    for _ in range(count):
        i, j = divmod(int(left.argmax()), len(known))
        first, second = sorted((known[i], known[j]), key=redness)  # the bluer one first, as cyan stands before yellow
        pairs.append((first, second))
        left[[i, j]] = left[:, [i, j]] = 0
    return pairs

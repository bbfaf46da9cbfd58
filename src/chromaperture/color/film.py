"""Whether a photograph was taken through a camera's film, and film without a photographed white sheet.

*Cast*: the edges of a scene are grey on average (grey-edge hypothesis: van de Weijer, Gevers, Gijsenij 2007), so the
edges of the channels must have the ratios of the camera's white; only green against red and blue counts, as daylight
and lamps differ in red against blue. *Displacement*: red and blue are displaced against green by r (rho_R - rho_G) and
r (rho_B - rho_G), rho the centroids of the film and r the signed blur radius, whatever the light.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.optics.aperture import (
    DESIGNS,
    FIXED,
    USUAL_FILM,
    Aperture,
    centroids,
    channel_transmission,
    film_named,
    made_of,
)

_MOST_CORRECTION = 2.0  # factor on typical film in one channel; more means that the white sheets differ in exposure


def completed_film(
    aperture: Aperture, measured: Mapping[str, np.ndarray], *, light: np.ndarray | None
) -> dict[str, np.ndarray]:
    """Complete measured film by typical film, scaled to the ``light`` (3,) that passes the whole aperture."""
    usual = {name: sheet.transmission for name, sheet in (film_named(USUAL_FILM) | FIXED).items()}
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


_WIDTH_PX = 720  # wider pictures are reduced to it: that of the scenes on which the limits were measured
_EDGE_SIGMA_PX = 3.0  # smoothing before the gradient: wider than most of the displacement of the channels
_FAINT_EDGE = 2e-3  # rms gradient, relative to the mean, below which a picture has no edges (white sheets: 6e-4)
_BAND_SIGMAS_PX = (2.0, 12.0)  # band pass before windows are matched, chosen by hand
_WINDOW_PX, _STEP_PX, _REACH_PX = 96, 48, 8  # windows and the largest displacement searched; halves at 1 m reach 6 px
_FLOOR = 4e-3  # of white level, before the logarithm: about the reading noise
_LEAST_CORRELATION = 0.8  # of a usable window, chosen by hand
_CLOSURE_PX = 0.25  # largest |(B-G) - (R-G) - (B-R)| of a usable window, chosen by hand
_FEWEST_WINDOWS = 20  # usable ones; the scenes of bench50 have 25 or more
_STILL_PX = 0.25  # median displacement below which nothing is displaced; windows of scenes err by some 0.3 px
_MOVED_PX = 0.5  # median displacement from which its direction is judged absolutely
_WIDE = 0.3  # length of a film's displacement, pupil radii, that exceeds these errors: all but the open designs
# Limits, from bench50 by four cameras: right film, 103 scenes, boards, tilts and frames; wrong film, 42 pairs of
# another coded scene with a camera (the table is in docs/colour.md).
_CAST = 0.22  # right film: at most 0.08; the halves against another film: at least 0.38
_ADVANTAGE, _GREAT_ADVANTAGE = 2.0, 4.0  # right: at most 1.44; photographs of three filters: at least 2.58
_EXPLAINED = 0.45  # right: at least 0.66; the open design against three filters: at most 0.36
_SAME_TINT = 0.08  # the largest cast through the right film: whites this near are not told apart
_BEYOND = 0.2  # right: at most 0.06; the halves against the open design, where the scene is deep: 0.36 and 0.47


@dataclass(frozen=True)
class FilmMatch:
    """Evidence for and against a film."""

    # Natural logarithm of the green edges over those of red and blue, relative to the camera's white; None without
    # edges.
    cast: float | None
    moved_px: float = 0.0  # median displacement of red and blue against green; 0 where too few windows were measured
    # Fraction of the squared displacements that this film can cause; None where nothing is displaced.
    explained: float | None = None
    advantage: float = 1.0  # what this film leaves unexplained over what the best known design does
    better: str = ""  # that design
    beyond: float = 0.0  # fraction of the windows displaced further than the working range allows
    wide: bool = False  # whether the film displaces its channels by more than the errors of the windows
    tinted_as: str = ""  # the known designs of usual film whose white is nearest to the cast

    @property
    def doubts(self) -> tuple[str, ...]:
        """Findings that make the film unlikely, in words."""
        found = []
        if self.cast is not None and abs(self.cast) > _CAST:
            tint = "green" if self.cast > 0 else "magenta"
            found.append(f"its edges are {np.expm1(abs(self.cast)):.0%} too {tint}, as by design {self.tinted_as}")
        if self.advantage > _ADVANTAGE:
            found.append(f"its channels are displaced as by design {self.better}")
        elif self.explained is not None and self.wide and self.moved_px > _MOVED_PX and self.explained < _EXPLAINED:
            found.append("its channels are displaced in directions that this film does not cause")
        return tuple(found)

    @property
    def findings(self) -> tuple[str, ...]:
        """The doubts, and displacements beyond the working range."""
        return (*self.doubts, "its channels are displaced too far") if self.beyond > _BEYOND else self.doubts

    @property
    def is_wrong(self) -> bool:
        """Whether no light explains it: the displacement alone, or colours and displacement together."""
        cast = self.cast is not None and abs(self.cast) > _CAST
        return self.advantage > _GREAT_ADVANTAGE or len(self.doubts) > 1 or (cast and self.beyond > _BEYOND)


def match_film(image: np.ndarray, aperture: Aperture, white: np.ndarray, radius_px: tuple[float, float]) -> FilmMatch:
    """Compare a photograph with the film of an aperture, blurred within the radii of the range's two ends."""
    image = np.nan_to_num(np.asarray(image, np.float32), posinf=1.0)
    scale = min(1.0, _WIDTH_PX / image.shape[1])
    if scale < 1:
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    cast = _edge_cast(image, np.asarray(white, float))
    tinted_as = "" if cast is None else _tinted_as(cast + _green(np.asarray(white, float)))
    shift = _displacements(image)
    moved = float(np.median(np.linalg.norm(shift, axis=1))) if len(shift) >= _FEWEST_WINDOWS else 0.0
    if moved < _STILL_PX:
        return FilmMatch(cast, moved, tinted_as=tinted_as)
    own = _displacement(aperture)
    length = float(np.linalg.norm(own))
    explained = _explained(shift, own)
    others = {name: _explained(shift, direction) for name, direction in _known_displacements().items()}
    better = max(others, key=lambda name: others[name])
    advantage = (1 - explained) / max(1 - others[better], 1e-6)
    radius = shift @ own / length**2
    low, high = (scale * r for r in radius_px)
    beyond = float(((radius < low) | (radius > high)).mean())
    return FilmMatch(cast, moved, explained, advantage, better, beyond, length > _WIDE, tinted_as)


def _edge_cast(image: np.ndarray, white: np.ndarray) -> float | None:
    usable = cv2.erode((image.max(axis=2) < SATURATION).astype(np.uint8), np.ones((13, 13), np.uint8)).astype(bool)
    if usable.mean() < 0.05:  # too little is left to judge
        return None
    smooth = cv2.GaussianBlur(image, (0, 0), _EDGE_SIGMA_PX)
    energy = sum((np.diff(smooth, axis=a)[usable[1:] if a == 0 else usable[:, 1:]] ** 2).mean(axis=0) for a in (0, 1))
    mean = image[usable].mean(axis=0)
    if min(mean) <= 0 or np.sqrt(np.min(energy / mean**2)) < _FAINT_EDGE:
        return None
    return _green(np.sqrt(energy)) - _green(white)


def _green(color: np.ndarray) -> float:
    """Return the natural logarithm of green over the geometric mean of red and blue."""
    logs = np.log(color)
    return float(logs[1] - (logs[0] + logs[2]) / 2)


def _tinted_as(green: float) -> str:
    """Return the designs whose white through usual film comes nearest."""
    known = {name: _green(channel_transmission(made_of(DESIGNS[name], USUAL_FILM))) for name in _known_displacements()}
    off = {name: abs(white - green) for name, white in known.items()}
    return " or ".join(name for name in off if off[name] <= min(off.values()) + _SAME_TINT)


def _displacements(image: np.ndarray) -> np.ndarray:
    """Measure windows of red and blue against green; (N, 4) float64, px: x, y of red, then of blue."""
    fine, coarse = _BAND_SIGMAS_PX
    logs = np.log(np.maximum(image, _FLOOR))
    bands = [
        cv2.GaussianBlur(c, (0, 0), fine) - cv2.GaussianBlur(c, (0, 0), coarse)
        for c in np.ascontiguousarray(np.moveaxis(logs, 2, 0))
    ]
    found = []
    height, width = image.shape[:2]
    for y in range(0, height - _WINDOW_PX + 1, _STEP_PX):
        for x in range(0, width - _WINDOW_PX + 1, _STEP_PX):
            red, green, blue = (band[y : y + _WINDOW_PX, x : x + _WINDOW_PX] for band in bands)
            pairs = [_shift(a, b) for a, b in ((red, green), (blue, green), (blue, red))]
            known = [p for p in pairs if p is not None]
            if len(known) == 3 and np.linalg.norm(known[1] - known[0] - known[2]) < _CLOSURE_PX:
                found.append(np.concatenate(known[:2]))
    return np.array(found).reshape(-1, 4)


def _shift(moved: np.ndarray, still: np.ndarray) -> np.ndarray | None:
    """Return the displacement (x, y), px, by normalised correlation; None where it is weak or out of reach."""
    m = _REACH_PX
    scores = cv2.matchTemplate(moved, still[m:-m, m:-m], cv2.TM_CCOEFF_NORMED)
    _, best, _, (i, j) = cv2.minMaxLoc(scores)
    if best < _LEAST_CORRELATION or not (0 < i < 2 * m and 0 < j < 2 * m):
        return None
    return np.array([i, j]) - m + [_vertex(scores[j, i - 1 : i + 2]), _vertex(scores[j - 1 : j + 2, i])]


def _vertex(three: np.ndarray) -> float:
    """Return the offset of the vertex of a parabola through three values."""
    curvature = float(three[0] - 2 * three[1] + three[2])
    return float(three[0] - three[2]) / (2 * curvature) if curvature < 0 else 0.0


def _displacement(aperture: Aperture) -> np.ndarray:
    """Return the displacement of red and blue against green per px of blur radius; (4,) float64."""
    red, green, blue = centroids(aperture)
    return np.concatenate([red - green, blue - green])


@cache
def _known_displacements() -> dict[str, np.ndarray]:
    """Return those of the package's designs with usual film, where a channel is displaced."""
    return {name: _displacement(made_of(design, USUAL_FILM)) for name, design in DESIGNS.items() if design.views}


def _explained(shift: np.ndarray, displacement: np.ndarray) -> float:
    """Return the fraction of squared shifts along a displacement."""
    along = shift @ (displacement / np.linalg.norm(displacement))
    return float((along**2).sum() / (shift**2).sum())

"""The camera's response by its chessboards: whether decoded values are light, and which light they are where not.

A chessboard that is shifted by one square is its own negative: black stands where white was. Blur is linear and alike
at both places, so the light of two points one square apart adds up to the light of black and white, in every channel,
whatever the aperture, the blur and the colour of the light. With f(v) the light of a decoded value v::

    f(v(x)) + f(v(x + square)) = W

holds along the blurred edges, where v runs through all tones, only if f is right; a wrong curve bends it. Any constant
may be added to f: black itself is not determined. The points of all squares of one colour are averaged before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from scipy.optimize import least_squares

from chromaperture.calibration.session import Session
from chromaperture.color.encoding import KNOTS, ResponseCurve, response_table
from chromaperture.color.image import SATURATION
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.color.unmixing import mixing_matrix, unmixing_rows
from chromaperture.optics.aperture import USUAL_FILM, design_named, made_of
from chromaperture.optics.psf import pupil_samples
from chromaperture.system.errors import InputError
from chromaperture.system.robust import MAD_TO_SIGMA

_PHASES = 16  # points across a square; far squares are 10 px wide
_FEWEST_SQUARES = 4  # of each colour, not saturated; chosen by hand
_BOARDS = 8  # that are read, the most blurred ones; chosen by hand
_FEWEST_BOARDS = 2  # one may be lit unevenly; chosen by hand
_DARKEST = 1e-4  # decoded value; below, 16 bits have 6 counts
_CODE_SIGMA = 0.01  # sRGB code by which the points of simulated boards miss their curve: .0012 to .004
# Weights of the prior, in standard deviations a knot for all points together: curves are smooth and near 1.
_SMOOTH, _NEAR_ONE = 0.03, 0.15
_FLAT_SLOPE = 0.02  # of the mean slope, added to it: a curve without slope would explain everything; chosen by hand
# Root mean square of exponent - 1 over the values of the boards: at most .024 of 20 linear sessions, .10 of JPEG files
# that were sharpened or denoised, .26 and .38 of a weak and a strong S-curve, .77 and more of sRGB taken as linear.
_LINEAR = 0.12
_OTHER_CURVE = 0.5  # share of that deviation that the other curve may leave to be taken; chosen by hand
_LARGEST_MISFIT = 0.02  # sRGB code, rms, chosen by hand; boards behind nonlinear noise reduction have .009 to .013
_TONE_LEFT = 0.06  # rms of the exponents' error that is left: of the strong S-curve of docs/decisions.md
_MOST_EXPONENT = 10.0  # limit of the fit, far beyond any camera's; chosen by hand
_EIGHT_BITS = "the photographs have 8 bits a channel: linear files, as RAW, are more accurate"
_ENCODED = {"srgb": "encoded by the sRGB curve", "linear": "linear, though their files usually are not"}
LEAST_RATIO = 1.4  # of two exposures: half a stop; less, and q is known to 0.15 at best; chosen by hand
_BLOCKS = 24  # along the shorter side of a picture, whose means are compared; chosen by hand
_DARKEST_BLOCK = 0.01  # of full scale: below, 8 bits of sRGB have fewer than 25 counts; chosen by hand
_FEWEST, _BINS = 12, 8  # blocks of a bin of levels; bins; chosen by hand
_CONTRASTS = (1.001, 1.5, 2.0, 4.0, 8.0, 23.0)  # of edges; the last is black print, 0.04, on paper of 0.92
_CELLS, _PLACES = 96, 1201  # across the pupil, and along an edge's profile; finer ones change 1e-4


@dataclass(frozen=True)
class FoldedBoard:
    """Mean decoded values at the same place of all squares of one colour, and of the other; (N, 3) float64 each."""

    even: np.ndarray
    odd: np.ndarray


@dataclass(frozen=True)
class FittedResponse:
    """A response and how well it explains the boards."""

    curve: ResponseCurve
    deviation: float  # root mean square of exponent - 1 over the values of the boards
    exponents: tuple[float, float]  # smallest and largest of them, 5th and 95th percentile
    misfit: float  # root mean square error of the boards' values by the curve, sRGB code


def with_response(session: Session, corners: Mapping[Path, np.ndarray]) -> tuple[Session, tuple[str, ...]]:
    """Return a session that decodes its photographs by the response that its boards show, and notes.

    Linear photographs are left as they are. ``corners`` are those of the boards that were found.
    """
    sensor, boards = session.sensor, folded_boards(session, corners)
    notes = [_EIGHT_BITS] if sensor.white_level <= 255 else []
    found = fit_response(boards) if len(boards) >= _FEWEST_BOARDS else None
    if found is None or found.deviation < _LINEAR:
        return session, tuple(notes)
    other_curve: Literal["linear", "srgb"] = "srgb" if sensor.curve == "linear" else "linear"
    otherwise = replace(session, sensor=replace(sensor, curve=other_curve))
    boards = folded_boards(otherwise, corners)  # fewer, where other values count as saturated
    other = fit_response(boards) if len(boards) >= _FEWEST_BOARDS else None
    if other is not None and other.deviation < _OTHER_CURVE * found.deviation:
        found, sensor = other, otherwise.sensor
        notes.append(f"the chessboards show that the photographs are {_ENCODED[other_curve]}; they are decoded so")
    if found.misfit > _LARGEST_MISFIT:
        notes.append("no single tone curve explains the chessboards: switch noise reduction and local tones off")
        return session, tuple(notes)
    if found.deviation >= _LINEAR:
        sensor = replace(sensor, response=found.curve.exponents)
        low, high = found.exponents
        notes.append(
            f"the chessboards show a tone curve, which is undone: light grows with the powers {low:.2f} to {high:.2f} "
            "of decoded values"
        )
    return replace(session, sensor=sensor, tone_error=min(session.tone_error, _TONE_LEFT)), tuple(notes)


def folded_boards(session: Session, corners: Mapping[Path, np.ndarray]) -> list[FoldedBoard]:
    """Fold the most blurred boards that were found."""
    focus = session.focused_at_about_mm
    blurred = sorted(session.boards, key=lambda path: -abs(1 / session.boards[path] - 1 / focus))
    boards: list[FoldedBoard] = []
    for path in blurred:
        if path in corners and len(boards) < _BOARDS:
            board = fold_board(session.read(path), corners[path], session.inner_corners)
            boards += [] if board is None else [board]
    return boards


def fold_board(image: np.ndarray, corners_px: np.ndarray, inner_corners: tuple[int, int]) -> FoldedBoard | None:
    """Average a chessboard, (H, W, 3) float32 as decoded, over its squares of either colour.

    None where too few squares are not saturated. ``corners_px`` are those of `find_corners`.
    """
    columns, rows = inner_corners
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2).astype(np.float32)
    homography, _ = cv2.findHomography(grid, np.asarray(corners_px, np.float32))
    if homography is None:
        return None
    phase = (np.arange(_PHASES) + 0.5) / _PHASES
    x, y = np.meshgrid(*((np.arange(n - 1)[:, None] + phase).ravel() for n in inner_corners))
    places = cv2.perspectiveTransform(np.stack([x, y], -1).reshape(1, -1, 2).astype(np.float32), homography)[0]
    at_x, at_y = (np.ascontiguousarray(places[:, i]).reshape(y.shape) for i in (0, 1))
    seen = cv2.remap(image, at_x, at_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    squares = seen.reshape(rows - 1, _PHASES, columns - 1, _PHASES, 3).transpose(0, 2, 1, 3, 4)
    usable = squares.max(axis=(2, 3, 4)) < SATURATION  # False for NaN
    is_odd = np.add.outer(np.arange(rows - 1), np.arange(columns - 1)) % 2 == 1
    parts = (squares[usable & ~is_odd], squares[usable & is_odd])
    if min(map(len, parts)) < _FEWEST_SQUARES:
        return None
    even, odd = (part.mean(axis=0, dtype=float).reshape(-1, 3) for part in parts)
    return FoldedBoard(even, odd)


def fit_response(boards: Sequence[FoldedBoard]) -> FittedResponse:
    """Fit the response by which the light of points one square apart adds up to the same everywhere on a board.

    The error of a sum is divided by the slopes of the curve, so that it is one of the measured values: a flat curve
    explains nothing better.
    """
    even, odd = (np.stack([getattr(board, name) for board in boards]) for name in ("even", "odd"))
    a, b = (np.asarray(linear_to_srgb(np.maximum(v, _DARKEST)), float) for v in (even, odd))  # (boards, N, 3) codes
    codes = np.linspace(0, 1, len(response_table((1.0,) * KNOTS)[1]))

    def errors(log_exponents: np.ndarray) -> np.ndarray:
        light = response_table(tuple(np.exp(log_exponents)))[1]
        slope = np.gradient(light, codes)
        total = np.interp(a, codes, light) + np.interp(b, codes, light)
        across = np.hypot(np.interp(a, codes, slope), np.interp(b, codes, slope))
        across += _FLAT_SLOPE * across.mean()
        weight = across**-2
        white = (total * weight).sum(axis=1, keepdims=True) / weight.sum(axis=1, keepdims=True)  # of board and channel
        return np.asarray(((total - white) / across).ravel())

    def residuals(log_exponents: np.ndarray) -> np.ndarray:
        prior = np.concatenate([_SMOOTH * np.diff(log_exponents, 2), _NEAR_ONE * log_exponents]) * a.size**0.5
        return np.concatenate([errors(log_exponents) / _CODE_SIGMA, prior])

    most = np.log(_MOST_EXPONENT)
    fit = least_squares(residuals, np.zeros(KNOTS), loss="soft_l1", x_scale=0.1, bounds=(-most, most))
    curve = ResponseCurve(tuple(float(q) for q in np.exp(fit.x)))
    exponents = curve.exponent(np.concatenate([even.ravel(), odd.ravel()]))
    low, high = np.percentile(exponents, (5, 95))
    return FittedResponse(
        curve, float(np.sqrt(np.mean((exponents - 1) ** 2))), (float(low), float(high)),
        float(np.sqrt(np.mean(errors(fit.x) ** 2))),
    )  # fmt: skip


@dataclass(frozen=True)
class ToneCurve:
    """The local exponent q of decoded values by their level."""

    level: np.ndarray  # (N,) float64: geometric mean of the values of both exposures, of full scale
    exponent: np.ndarray  # (N,) float64: log ratio of the values over that of the exposures; 1 where light is linear
    scatter: float  # of single blocks about the exponent of their level: large where the scene or the light changed

    @property
    def error(self) -> float:
        """Root mean square of exponent - 1 over the levels."""
        return float(np.sqrt(np.mean((self.exponent - 1) ** 2)))


def measure_tone(shorter: np.ndarray, longer: np.ndarray, exposure_ratio: float) -> ToneCurve:
    """Measure the exponent of decoded values by one scene, (H, W, 3) linear as decoded, at two exposures.

    Where values are u = L^q of the light L, the ratio of two exposures k apart is k^q at every level; a curve that was
    decoded wrongly in another way has another q at each level, and vignetting shows many levels in one picture.
    Constant ratios are no proof: q needs the exposures, which a camera states to some 5 %, so that q is known to
    0.05 / ln k. Raises InputError for other sizes, exposures that hardly differ, or too little to compare.
    """
    if shorter.shape != longer.shape:
        raise InputError("the two exposures have different sizes; take both with the same settings")
    if not exposure_ratio >= LEAST_RATIO:
        raise InputError(
            f"the exposures differ by a factor of {exposure_ratio:.2f} only; take one at half or a quarter of the other"
        )
    low, high = _blocks(shorter), _blocks(longer)
    usable = (low > _DARKEST_BLOCK) & np.isfinite(high) & (high > 0)
    if usable.sum() < _FEWEST:
        raise InputError("too little of the picture is neither dark nor too bright in both exposures; expose less, or "
                         "light the sheet more")  # fmt: skip
    logs = np.log(high[usable] / low[usable]) / np.log(exposure_ratio)
    level = np.sqrt(high[usable] * low[usable])
    edges = np.geomspace(level.min(), level.max() * (1 + 1e-9), _BINS + 1)
    bins = np.clip(np.searchsorted(edges, level, side="right") - 1, 0, _BINS - 1)
    filled = [i for i in range(_BINS) if (bins == i).sum() >= _FEWEST]
    if not filled:
        filled, bins = [0], np.zeros_like(bins)
    exponent = np.array([np.median(logs[bins == i]) for i in filled])
    middle = np.array([np.exp(np.log(level[bins == i]).mean()) for i in filled])
    residual = logs - np.interp(np.log(level), np.log(middle), exponent)
    return ToneCurve(middle, exponent, float(MAD_TO_SIGMA * np.median(np.abs(residual))))


def _blocks(image: np.ndarray) -> np.ndarray:
    """Return the means of square blocks in each channel, NaN where a pixel is saturated; (N, 3) float64."""
    side = max(min(image.shape[:2]) // _BLOCKS, 1)
    rows, columns = image.shape[0] // side, image.shape[1] // side
    parts = np.asarray(image[: rows * side, : columns * side], float).reshape(rows, side, columns, side, 3)
    means = parts.mean(axis=(1, 3))
    means[parts.max(axis=(1, 3)) >= SATURATION] = np.nan
    return np.asarray(means.reshape(-1, 3))


def disparity_error(design: str, exponent_error: float) -> float:
    """Return the relative error of disparities that calibration with the same wrong exponent leaves.

    A wrong q separates views by the wrong powers. That displaces all edges by the same share of their disparity, which
    calibration takes up. What is left depends on contrast, because the profile of an edge through the pupil bends with
    it: the largest difference to faint edges, over contrasts, directions, and signs of ``exponent_error`` (0 to 1).
    """
    if not 0 <= exponent_error < 1:
        raise InputError(f"the error of the tone curve's exponent must lie between 0 and 1, got {exponent_error:g}")
    return 0.0 if exponent_error == 0 else max(_spread(design, 1 + s * exponent_error) for s in (1, -1))


@lru_cache(maxsize=64)
def _spread(design: str, exponent: float) -> float:
    disparity = np.array([edge_disparity(design, exponent, m, s) for m in _CONTRASTS for s in (1, -1)])
    faint = disparity[:2].mean()
    return float(np.abs(disparity / faint - 1).max())


def edge_disparity(design: str, exponent: float, contrast: float, direction: int) -> float:
    """Return the half disparity of an edge whose light is decoded to the power of an exponent, in pupil radii.

    The edge is seen by each channel through its part of the pupil, the views are separated with what white sheets
    show at the same exponent, and each edge stands at the mean of its slope. ``direction`` is 1 where it is bright
    after the edge, else -1; ``contrast`` that of the bright side to the dark one.
    """
    aperture = made_of(design_named(design), USUAL_FILM)
    points, light = pupil_samples(aperture, _CELLS)
    colors = np.array([aperture.filter_named(name).transmission for name in aperture.views])
    rows = unmixing_rows(mixing_matrix(colors**exponent), len(aperture.views))
    linear = light @ unmixing_rows(mixing_matrix(colors), len(aperture.views)).T
    centres = points.T @ (linear / linear.sum(axis=0))
    axis = centres[:, 0] - centres[:, -1]
    order = np.argsort(points @ axis)
    at, passed = (points @ axis)[order] / np.hypot(*axis), light[order]
    places = np.linspace(-1.1, 1.1, _PLACES)
    white = passed.sum(axis=0)
    summed = np.cumsum(passed, axis=0) / np.maximum(white, 1e-12)
    seen = np.stack([np.interp(places, at, summed[:, k], left=0.0, right=1.0) for k in range(3)], axis=1)
    seen = seen if direction > 0 else 1 - seen
    profile = ((1 + (contrast - 1) * seen) / contrast * white / white.max()) ** exponent @ rows.T
    slope = np.diff(profile, axis=0)
    middle = (places[1:] + places[:-1]) / 2
    stands = (middle[:, None] * slope).sum(axis=0) / slope.sum(axis=0)
    return float(stands[0] - stands[-1]) / 2

"""Fit the blur of a lens to photographs of boards at known distances, whatever their pattern.

With the true blur H_k, two channels are equal after each is filtered with the blur of the other, P and Q
(``matching/evidence/blur.py``). The residual of a tile is ``P / |P| - Q / |Q|`` in its core, in space: a window before
the transform would bias it by the tile's border. The roll-off of the filter is held at the blur of the last step; if it
followed the parameters, more blur would always fit better, because it suppresses noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cache, partial
from typing import NamedTuple

import cv2
import numpy as np
import scipy.fft

from chromaperture.calibration.options import DEFAULT, Progress, reported, silent
from chromaperture.matching.compiled.cross_filter import spectra_of_both
from chromaperture.matching.readable.tiles import without_shading
from chromaperture.optics.lens_blur import BlurModel, LensBlur, Rays, displacements
from chromaperture.system.errors import InputError
from chromaperture.system.threads import parallel_map

NAMES = tuple(f.name for f in fields(BlurModel))
_ALL = tuple(name for name in NAMES if name != "contrast_fall")  # a number of the sensor, kept as the start has it

# Chosen by hand, not tuned, unless a reason is given.
_CORE_PX = 72  # side of a tile's core: tiles must get close to the frame's border, where aberrations are largest
_BLUR_ROOM = (2.2, 12)  # around the core: so many times the blur of infinity, which near boards seldom exceed, and px
_FEW_TILES = 45  # of the first two fits
_LEAST_TILES = 4  # of a board
_FINEST_PX, _COARSEST_PX = 0.8, 6.0  # sigma of the Gaussians that bound the pass band: noise, and what a core holds
_DAMPING = 0.04  # of the roll-off sqrt(S / (S + damping)), S being the mean power transfer: as in docs/equations.md
_LEAST_POWER = np.float32(1e-5)  # added to S, against division by 0
_LEAST_CONTRAST = 1e-3  # standard deviation, white level = 1: less is paper without print
_FLOOR = 0.02  # of a tile's power: residuals below are not fitted further, because the blur varies within a tile
# Of the middle's light that every corner keeps: where rims close there are no rays to trace. A lens that loses four
# f-stops at the corners keeps .06. The whole step is refused: with the rims held the aberrations can run away.
_LEAST_LIGHT = 0.03
_PRIOR = 5e-3  # weight of the priors; strong ones stop the fit halfway from spherical aberration to defocus
_FIRST_DAMPING, _LEAST_DAMPING, _DAMPING_STEP, _TRIES = 1e-3, 1e-6, 8.0, 6  # of Levenberg and Marquardt, no unit
_FIRST = (
    "infinity_px", "scale_px_mm", "axial_red_px", "axial_blue_px", "curvature_px", "spherical_px", "oblique_px",
    "oblique_tangential_px", "astigmatism_px", "coma_px", "lateral_red_px", "lateral_blue_px",
)  # fmt: skip


@dataclass(frozen=True)
class _Tile:
    """One tile of one board: its centre, inverse distance, and the spectra of its channels."""

    x_px: float
    y_px: float
    inverse_mm: float
    spectrum: np.ndarray

    @property
    def size(self) -> int:
        """Its side."""
        return self.spectrum.shape[1]


@dataclass(frozen=True)
class BlurFit:
    """A fitted blur."""

    blur: LensBlur
    # Mean fraction of the power of two cross-filtered channels that disagrees, weighted by pair; includes noise
    disagreement: float
    start_disagreement: float  # the same before the fit


def fit_blur(
    boards: Iterable[tuple[np.ndarray, float]],
    start: LensBlur,
    *,
    board_count: int,
    tile_count: int = DEFAULT.blur_tiles,
    progress: Progress = silent,
) -> BlurFit:
    """Fit all parameters of the blur: the important ones, then all, then all to all tiles.

    ``boards`` yields photographs, (H, W, 3) float32, with 1 / z of their board, z from the entrance pupil in mm, once.
    ``start`` has focus and scale to 20 %; aberrations may be 0. Raises InputError without a board that has texture.
    """
    per_board = max(_LEAST_TILES, math.ceil(tile_count / max(board_count, 1)))
    size, tiles = _tile_size(start), []
    for number, (image, inverse_mm) in enumerate(boards):
        most = max(_LEAST_TILES, round(2 * image.shape[0] * image.shape[1] / _CORE_PX**2))  # each pixel in two tiles
        tiles += _cut(image, inverse_mm, size, min(per_board, most), seed=number)
    if not tiles:
        raise InputError("no board has texture to fit the blur to: photograph a printed pattern that fills the frame")
    few = tiles[:: max(1, len(tiles) // _FEW_TILES)]
    blur = start
    stages = ((few, _FIRST, 8, 2e-3), (few, _ALL, 8, 2e-3), (tiles, _ALL, 5, 1e-3))  # tolerance: change of log cost
    for cut, names, rounds, tolerance in reported(stages, "blur of the lens", progress):
        blur = _gauss_newton(blur, cut, names, rounds=rounds, tolerance=tolerance)
    before, after = (float(np.mean(_cost(b, few, _tapers(b, few)))) for b in (start, blur))
    return BlurFit(blur, after, before)


def _tile_size(blur: LensBlur) -> int:
    """Return the side of a tile: its core with room for the blur around it."""
    factor, more = _BLUR_ROOM
    room = math.ceil(factor * abs(blur.model.infinity_px)) + more
    size = int(scipy.fft.next_fast_len(_CORE_PX + 2 * room, real=True))
    return size + size % 2


def _cut(image: np.ndarray, inverse_mm: float, size: int, count: int, *, seed: int) -> list[_Tile]:
    """Cut tiles from a photograph up to its border, one at random near each cell of a grid."""
    height, width = image.shape[:2]
    margin = (size - _CORE_PX) // 2
    padded = cv2.copyMakeBorder(without_shading(image), margin, margin, margin, margin, cv2.BORDER_REFLECT_101)
    columns = math.ceil(math.sqrt(count * width / height))
    rows = math.ceil(count / columns)
    rng = np.random.default_rng(seed)
    tiles = []
    for row in range(rows):
        for column in range(columns):
            u, v = rng.random(2) * 1.6 - 0.3  # beyond the cell: outer tiles reach the frame's border
            x0 = int((width - _CORE_PX) * np.clip((column + u) / columns, 0, 1))
            y0 = int((height - _CORE_PX) * np.clip((row + v) / rows, 0, 1))
            cut = padded[y0 : y0 + size, x0 : x0 + size].transpose(2, 0, 1)
            if cut.std(axis=(1, 2)).min() > _LEAST_CONTRAST:
                middle = (_CORE_PX - 1) / 2
                tiles.append(_Tile(x0 + middle, y0 + middle, inverse_mm, scipy.fft.rfft2(cut).astype(np.complex64)))
    return tiles


@cache
def _whitening(size: int) -> np.ndarray:
    """Return the filter that makes power that falls with the square of frequency white, within a pass band."""
    w2 = (2 * np.pi * scipy.fft.fftfreq(size))[:, None] ** 2 + (2 * np.pi * scipy.fft.rfftfreq(size)) ** 2
    fine, coarse = (np.exp(-(sigma**2) / 2 * w2) for sigma in (_FINEST_PX, _COARSEST_PX))
    return (np.sqrt(w2) * fine * (1 - coarse)).astype(np.float32)


def _weighted_pairs(blur: LensBlur) -> list[tuple[int, int, float]]:
    """Return the pairs of channels, weighted by the distance of their views; the widest is 1."""
    return [(a, b, blur.separations[a, b]) for a, b in (*blur.pairs, *blur.other_pairs)]


def _squares(transfer: np.ndarray) -> list[np.ndarray]:
    """Return |H|^2 of every channel."""
    return list(np.abs(transfer) ** 2)


def _taper(blur: LensBlur, squares: Sequence[np.ndarray], white: np.ndarray) -> list[np.ndarray]:
    """Return the filters of a tile's pairs that are constant during a step."""
    powers = ((squares[a] + squares[b]) / 2 for a, b, _ in _weighted_pairs(blur))
    return [white * np.sqrt(p / (p + _DAMPING)) for p in powers]


def _tapers(blur: LensBlur, tiles: Sequence[_Tile]) -> list[list[np.ndarray]]:
    """Return `_taper` of every tile."""
    white = _whitening(tiles[0].size)

    def one(tile: _Tile) -> list[np.ndarray]:
        return _taper(blur, _squares(blur.transfer(tile.x_px, tile.y_px, tile.inverse_mm, tile.size)), white)

    return parallel_map(one, tiles)


def _pair_residual(filtered: np.ndarray, transfer: np.ndarray, pair: tuple[int, int, float]) -> np.ndarray:
    """Return the weighted difference of two cross-filtered channels in a tile's core; (core, core) float32.

    ``filtered`` (2, n, n // 2 + 1) complex64: the spectra of both channels, times the pair's `_taper`.
    """
    (a, b, weight), size = pair, filtered.shape[1]
    core = slice((size - _CORE_PX) // 2, (size + _CORE_PX) // 2)
    both = np.empty((1, size, 2 * size), np.float32)
    spectra, transfers = filtered[None].view(np.float32), transfer.view(np.float32)
    spectra_of_both(spectra, transfers, np.array([[a, b]]), _LEAST_POWER, np.float32(1 / size**2), both)
    one, other = cv2.split(cv2.dft(both.reshape(size, size, 2), flags=cv2.DFT_INVERSE)[core, core])
    gain_one, gain_other = (math.sqrt(weight) / (cv2.norm(view) + 1e-12) for view in (one, other))
    return np.asarray(cv2.addWeighted(one, gain_one, other, -gain_other, 0))


def _filtered(tile: _Tile, pairs: Sequence[tuple[int, int, float]], taper: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the spectra of both channels of every pair, times its taper."""
    return [tile.spectrum[[a, b]] * edge for (a, b, _), edge in zip(pairs, taper, strict=True)]


def _residual(blur: LensBlur, tile: _Tile, taper: Sequence[np.ndarray]) -> np.ndarray:
    """Return the differences of all pairs of a tile; (pairs * core * core,) float32."""
    transfer, pairs = blur.transfer(tile.x_px, tile.y_px, tile.inverse_mm, tile.size), _weighted_pairs(blur)
    filtered = _filtered(tile, pairs, taper)
    return np.stack([_pair_residual(one, transfer, pair) for one, pair in zip(filtered, pairs, strict=True)]).ravel()


def _cost(blur: LensBlur, tiles: Sequence[_Tile], tapers: Sequence[list[np.ndarray]]) -> np.ndarray:
    def one(i: int) -> float:
        residual = _residual(blur, tiles[i], tapers[i])
        return float(residual @ residual)

    return np.array(parallel_map(one, range(len(tiles))))


class _Linearised(NamedTuple):
    """A tile's cost, its second and first derivatives by the parameters, and its `_taper`."""

    cost: float
    square: np.ndarray
    slope: np.ndarray
    taper: list[np.ndarray]


def _linearised(blur: LensBlur, moved: Mapping[str, tuple[LensBlur, float]], tile: _Tile) -> _Linearised:
    """Linearise a tile's residual; ``moved`` has for every parameter the blur with it moved, and the step.

    A third of the time of a calibration is spent here. What a parameter leaves as it is is not computed again:
    the rays' places by a rim, their light by anything else, pairs of channels by the colour of the third.
    """
    pairs, position = _weighted_pairs(blur), blur.frame_position(tile.x_px, tile.y_px)
    rays = blur.rays(tile.x_px, tile.y_px)
    transfer = blur.transfer_of(rays, tile.inverse_mm, tile.size)
    taper = _taper(blur, _squares(transfer), _whitening(tile.size))
    filtered = _filtered(tile, pairs, taper)
    residual = np.stack([_pair_residual(one, transfer, pair) for one, pair in zip(filtered, pairs, strict=True)])
    jacobian = np.zeros((len(moved), *residual.shape), np.float32)
    for row, (name, (other, step)) in zip(jacobian, moved.items(), strict=True):
        colors = [0] if "red" in name else [2] if "blue" in name else [0, 1, 2]
        if "rim" in name:
            bent = rays._replace(light=other.ray_weights(position))
            if np.array_equal(bent.light, rays.light):
                continue
        else:
            points = displacements(other.model, other.pupil.points, position, 0.0, colors)
            bent = Rays(points, rays.light[colors])
        there = transfer.copy()
        there[colors] = other.transfer_of(bent, tile.inverse_mm, tile.size)
        for i, pair in enumerate(pairs):
            if pair[0] in colors or pair[1] in colors:
                np.subtract(_pair_residual(filtered[i], there, pair), residual[i], out=row[i])
                row[i] /= np.float32(step)
    flat, rows = residual.ravel(), jacobian.reshape(len(moved), -1)
    return _Linearised(float(flat @ flat), rows @ rows.T, rows @ flat, taper)


def _gauss_newton(
    start: LensBlur, tiles: Sequence[_Tile], names: Sequence[str], *, rounds: int, tolerance: float
) -> LensBlur:
    """Minimise the sum of the logarithms of the tiles' costs, which limits outliers, by Levenberg and Marquardt."""
    free = np.array([NAMES.index(name) for name in names])
    steps, prior = _steps(start.model), _PRIOR / _priors(start.model)[free] ** 2
    origin = np.array(astuple(start.model))
    blur, damping = start, _FIRST_DAMPING
    for _ in range(rounds):
        values = np.array(astuple(blur.model))
        moved = {}
        for name, p in zip(names, free, strict=True):
            ahead = values.copy()
            ahead[p] += steps[p]
            moved[name] = (_with(blur, ahead), steps[p])
        results = parallel_map(partial(_linearised, blur, moved), tiles)
        costs, squares, slopes = (np.array([one[k] for one in results]) for k in range(3))
        tapers = [one.taper for one in results]
        weights = 1 / np.maximum(costs, _FLOOR)
        matrix = np.einsum("i,ijk", weights, squares) + np.diag(prior)
        slope = weights @ slopes + prior * (values - origin)[free]
        unit = np.sqrt(np.diag(matrix))
        before = np.log(np.maximum(costs, _FLOOR)).sum()
        for _ in range(_TRIES):
            move = np.linalg.solve(matrix / np.outer(unit, unit) + damping * np.eye(len(free)), slope / unit) / unit
            tried = values.copy()
            tried[free] -= move
            trial, after = _with(blur, tried), math.inf
            if trial.least_light >= _LEAST_LIGHT:
                after = np.log(np.maximum(_cost(trial, tiles, tapers), _FLOOR)).sum()
            if after < before:
                break
            damping *= _DAMPING_STEP
        if after >= before:
            break
        blur, damping = trial, max(damping / _DAMPING_STEP, _LEAST_DAMPING)
        if before - after < tolerance * len(tiles):
            break
    return blur


def _with(blur: LensBlur, values: np.ndarray) -> LensBlur:
    return LensBlur(BlurModel(*map(float, values)), blur.pupil, blur.width_px, blur.height_px)


def _steps(model: BlurModel) -> np.ndarray:
    """Return the steps of the finite differences: 0.02 to 0.05 px at the pupil's edge, or 0.02 pupil radii of a rim."""
    by_name = {name: 0.05 if name.endswith("px") else 0.02 for name in NAMES}
    by_name |= {name: 0.02 for name in NAMES if name.startswith(("axial", "lateral"))}
    by_name |= {"infinity_px": 0.02, "scale_px_mm": 0.003 * model.scale_px_mm}
    return np.array([by_name[name] for name in NAMES])


def _priors(model: BlurModel) -> np.ndarray:
    """Return the standard deviations of the priors: px for a blur of 10 px at infinity, or pupil radii of a rim.

    Typical differences between lenses, chosen by hand; they scale with the blur. Defocus and scale are all but free.
    """
    size = abs(model.infinity_px) / 10
    by_name = {name: 1.0 * size for name in NAMES}
    by_name |= {name: 2.0 * size for name in ("curvature_px", "curvature4_px", "astigmatism_px")}
    by_name |= {name: 1.5 * size for name in ("spherical_px", "oblique_px", "oblique_tangential_px")}
    by_name |= {name: 0.5 * size for name in NAMES if name.endswith(("red_px", "blue_px"))}  # of one colour only
    by_name |= {name: 1.0 * size for name in NAMES if name.startswith("axial")}
    by_name |= {"infinity_px": 10 * size, "scale_px_mm": 5 * model.scale_px_mm}
    by_name |= {"front_rim_radius": 0.1, "rear_rim_radius": 0.1, "front_rim_shift": 0.15, "rear_rim_shift": 0.15}
    return np.array([by_name[name] for name in NAMES])

"""Fit the blur of a lens to photographs of boards at known distances: Gauss-Newton on what the channels disagree about.

Nothing about the boards' pattern is used. With the blur H_k right, two channels filtered with each other's blur agree
(``disparity/phase.py``), so the residual of a tile is ``P / |P| - Q / |Q|`` in its core, in space: a window before the
transform would leak the tile's border into it and bias the fit. The filter's falling edge is held at the blur of the
last step; were it to follow the parameters, more blur would always fit better, for it hides the noise.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass, fields

import cv2
import numpy as np
import scipy.fft

from chromaperture.config import AccurateConfig
from chromaperture.disparity.estimate import estimate_disparity
from chromaperture.disparity.labels import IDENTITY
from chromaperture.disparity.stages.tiles import without_shading
from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture
from chromaperture.optics.lens_blur import BlurModel, LensBlur

Progress = Callable[[str, int, int], None]
NAMES = tuple(f.name for f in fields(BlurModel))

_CORE_PX = 72  # a tile's core: small enough to reach the frame's border, where the aberrations are largest
_FEW_TILES = 45
_DAMPING = 0.04
_SEARCHED = (6, 15)  # layers to either side of the expected one; more where that left cells unknown
_KNOWN_CELLS = 0.9
_LEAST_CONTRAST = 1e-3  # of full scale: less is paper without print
_FLOOR = 0.02  # share of a tile's power that is never believed: the blur changes within a tile
_PRIOR = 5e-3  # weight of all priors against the boards; they only hold what the boards do not see
_FIRST = (
    "infinity_px", "scale_px_mm", "axial_red_px", "axial_blue_px", "curvature_px", "spherical_px", "oblique_px",
    "oblique_tangential_px", "astigmatism_px", "coma_px", "lateral_red_px", "lateral_blue_px",
)  # fmt: skip


@dataclass(frozen=True)
class _Tile:
    """One tile of one board: its middle, its distance, and the spectra of its channels."""

    x_px: float
    y_px: float
    inverse_mm: float
    spectrum: np.ndarray


@dataclass(frozen=True)
class BlurFit:
    """A fitted blur.

    Attributes
    ----------
    blur : LensBlur
    disagreement : float
        Mean share of the power of two cross-filtered channels that disagrees, pairs by weight; noise included.
    start_disagreement : float
        The same before the fit.
    """

    blur: LensBlur
    disagreement: float
    start_disagreement: float


def fit_blur(
    boards: Iterable[tuple[np.ndarray, float]],
    start: LensBlur,
    *,
    board_count: int,
    tile_count: int = 180,
    progress: Progress = lambda what, done, total: None,
) -> BlurFit:
    """Fit all numbers of the blur.

    Parameters
    ----------
    boards : iterable of ((H, W, 3) float32, float)
        Linear photographs and 1 / z of the board in them, z from the entrance pupil in mm. Read once, one at a time.
    start : LensBlur
        Focus and scale right to a fifth, aberrations none.
    board_count : int
    tile_count : int
        Tiles of all boards together; time grows with it, the error of the fit falls with its root.
    progress : callable, optional

    Returns
    -------
    BlurFit

    Raises
    ------
    InputError
        No board, or none with texture.
    """
    per_board = max(4, math.ceil(tile_count / max(board_count, 1)))
    size, tiles = _tile_size(start), []
    for number, (image, inverse_mm) in enumerate(boards):
        fitting = max(4, round(2 * image.shape[0] * image.shape[1] / _CORE_PX**2))  # more would see the same pixels
        tiles += _cut(image, inverse_mm, size, min(per_board, fitting), seed=number)
    if not tiles:
        raise InputError("no board has texture to fit the blur to: photograph a printed pattern that fills the frame")
    few = tiles[:: max(1, len(tiles) // _FEW_TILES)]
    total = 3
    progress("blur of the lens", 0, total)
    before = float(np.mean(_cost(start, few, _tapers(start, few))))
    blur = _gauss_newton(start, few, _FIRST, rounds=8, tolerance=2e-3)
    progress("blur of the lens", 1, total)
    blur = _gauss_newton(blur, few, NAMES, rounds=8, tolerance=2e-3)
    progress("blur of the lens", 2, total)
    blur = _gauss_newton(blur, tiles, NAMES, rounds=5, tolerance=1e-3)
    progress("blur of the lens", 3, total)
    after = float(np.mean(_cost(blur, few, _tapers(blur, few))))
    return BlurFit(blur, after, before)


def measured_layers(
    image: np.ndarray,
    inverse_mm: float,
    blur: LensBlur,
    *,
    aperture: Aperture,
    cell_px: int,
    unmixing: np.ndarray | None = None,
    noise_variance: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the layer that the matcher, as it is used, sees a flat board in, in cells over the frame.

    Parameters
    ----------
    image : (H, W, 3) float32
    inverse_mm : float, 1/mm
        Of the board; layers near it are searched.
    blur : LensBlur
    aperture : Aperture
    cell_px : int
        Side of a cell.
    unmixing : (K, 3) float, optional
        Rows of M^-1.
    noise_variance : (H, W, 3) float, optional
        Of the image, (white level)^2.

    Returns
    -------
    x_px, y_px : (N,) float
        Middles of the cells.
    layer_px : (N,) float64
        Median of a cell, NaN where less than half of it is known.
    """
    height, width = image.shape[:2]
    at_infinity, scale = blur.reference
    config, expected = AccurateConfig.for_blur(blur.reach), at_infinity - scale * inverse_mm
    rows, columns = (np.linspace(0, n, max(1, n // cell_px) + 1).astype(int) for n in (height, width))
    for searched in _SEARCHED:
        reach = searched * config.layers.step_px
        seen = estimate_disparity(
            image,
            aperture=aperture,
            unmixing=unmixing,
            config=config.with_range(expected - reach, expected + reach),
            noise_variance=noise_variance,
            label_maps=[IDENTITY],
            blur=blur,
        ).value_px
        found = np.array([[_median(cell) for cell in np.split(band, columns[1:-1], axis=1)]
                          for band in np.split(seen, rows[1:-1], axis=0)])  # fmt: skip
        if np.isfinite(found).mean() >= _KNOWN_CELLS:
            break
    y, x = np.meshgrid((rows[:-1] + rows[1:] - 1) / 2, (columns[:-1] + columns[1:] - 1) / 2, indexing="ij")
    return x.ravel(), y.ravel(), found.ravel()


def _median(cell: np.ndarray) -> float:
    """Median of a cell, NaN where less than half of it is known."""
    return float(np.nanmedian(cell)) if np.isfinite(cell).mean() >= 0.5 else math.nan


def _tile_size(blur: LensBlur) -> int:
    """Side of a tile with room for the blur of twice the infinity, which a near board seldom exceeds."""
    size = int(scipy.fft.next_fast_len(_CORE_PX + 2 * (math.ceil(2.2 * abs(blur.model.infinity_px)) + 12), real=True))
    return size + size % 2


def _cut(image: np.ndarray, inverse_mm: float, size: int, count: int, *, seed: int) -> list[_Tile]:
    """Tiles spread over a board's photograph up to its border, at places of their own on every board."""
    height, width = image.shape[:2]
    margin = (size - _CORE_PX) // 2
    padded = cv2.copyMakeBorder(without_shading(image), margin, margin, margin, margin, cv2.BORDER_REFLECT_101)
    columns = math.ceil(math.sqrt(count * width / height))
    rows = math.ceil(count / columns)
    rng = np.random.default_rng(seed)
    tiles = []
    for row in range(rows):
        for column in range(columns):
            u, v = rng.random(2) * 1.6 - 0.3  # beyond the cell: the outer ones end up at the frame's border
            x0 = int((width - _CORE_PX) * np.clip((column + u) / columns, 0, 1))
            y0 = int((height - _CORE_PX) * np.clip((row + v) / rows, 0, 1))
            cut = padded[y0 : y0 + size, x0 : x0 + size].transpose(2, 0, 1)
            if cut.std(axis=(1, 2)).min() > _LEAST_CONTRAST:
                middle = (_CORE_PX - 1) / 2
                tiles.append(_Tile(x0 + middle, y0 + middle, inverse_mm, scipy.fft.rfft2(cut).astype(np.complex64)))
    return tiles


def _whitening(size: int) -> np.ndarray:
    """Raise fine detail to the level of coarse, and leave out what is finer than noise or coarser than the core."""
    w2 = (2 * np.pi * scipy.fft.fftfreq(size))[:, None] ** 2 + (2 * np.pi * scipy.fft.rfftfreq(size)) ** 2
    return (np.sqrt(w2) * np.exp(-0.32 * w2) * (1 - np.exp(-18 * w2))).astype(np.float32)


def _weighted_pairs(blur: LensBlur) -> list[tuple[int, int, float]]:
    """Give the pairs of channels with the distance of their views, the widest one's being 1."""
    return [(a, b, blur.separations[a, b]) for a, b in (*blur.pairs, *blur.other_pairs)]


def _power(transfer: np.ndarray, a: int, b: int) -> np.ndarray:
    return np.asarray((np.abs(transfer[a]) ** 2 + np.abs(transfer[b]) ** 2) / 2)


def _tapers(blur: LensBlur, tiles: Sequence[_Tile]) -> list[list[np.ndarray]]:
    """Give the filters of every tile and pair that stay as they are while the parameters take a step."""
    white = _whitening(tiles[0].spectrum.shape[1])

    def one(tile: _Tile) -> list[np.ndarray]:
        transfer = blur.transfer(tile.x_px, tile.y_px, tile.inverse_mm, tile.spectrum.shape[1])
        powers = (_power(transfer, a, b) for a, b, _ in _weighted_pairs(blur))
        return [white * np.sqrt(p / (p + _DAMPING)) for p in powers]

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(one, tiles))


def _residual(blur: LensBlur, tile: _Tile, taper: Sequence[np.ndarray]) -> np.ndarray:
    """Tell what the cross-filtered channels of a tile disagree about, in its core; (pairs * core * core,) float32."""
    size = tile.spectrum.shape[1]
    margin = (size - _CORE_PX) // 2
    transfer = blur.transfer(tile.x_px, tile.y_px, tile.inverse_mm, size)
    out = []
    for (a, b, weight), edge in zip(_weighted_pairs(blur), taper, strict=True):
        q = edge / np.sqrt(_power(transfer, a, b) + np.float32(1e-5))
        both = scipy.fft.irfft2(np.stack([tile.spectrum[a] * transfer[b] * q, tile.spectrum[b] * transfer[a] * q]))
        both = both[:, margin : margin + _CORE_PX, margin : margin + _CORE_PX]
        both /= np.sqrt((both**2).sum(axis=(1, 2), keepdims=True)) + np.float32(1e-12)
        out.append((both[0] - both[1]) * np.float32(math.sqrt(weight)))
    return np.stack(out).ravel()


def _cost(blur: LensBlur, tiles: Sequence[_Tile], tapers: Sequence[list[np.ndarray]]) -> np.ndarray:
    def one(i: int) -> float:
        residual = _residual(blur, tiles[i], tapers[i])
        return float(residual @ residual)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return np.array(list(pool.map(one, range(len(tiles)))))


def _gauss_newton(
    start: LensBlur, tiles: Sequence[_Tile], names: Sequence[str], *, rounds: int, tolerance: float
) -> LensBlur:
    """Levenberg-Marquardt on the sum of the logarithms of the tiles' costs, which bounds what a bad tile can do."""
    free = np.array([NAMES.index(name) for name in names])
    steps, priors = _steps(start.model), _priors(start.model)
    origin = np.array(astuple(start.model))
    blur, damping = start, 1e-3
    for _ in range(rounds):
        tapers = _tapers(blur, tiles)
        values = np.array(astuple(blur.model))

        def linearised(i: int) -> tuple[float, np.ndarray, np.ndarray]:
            residual = _residual(blur, tiles[i], tapers[i])  # noqa: B023 - used within the round
            jacobian = np.empty((len(free), residual.size), np.float32)
            for row, p in enumerate(free):
                moved = values.copy()  # noqa: B023
                moved[p] += steps[p]
                jacobian[row] = (_residual(_with(blur, moved), tiles[i], tapers[i]) - residual) / steps[p]  # noqa: B023
            return float(residual @ residual), jacobian @ jacobian.T, jacobian @ residual

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            results = list(pool.map(linearised, range(len(tiles))))
        costs, squares, slopes = (np.array(part) for part in zip(*results, strict=True))
        weights = 1 / np.maximum(costs, _FLOOR)
        prior = _PRIOR / priors[free] ** 2
        matrix = np.einsum("i,ijk", weights, squares) + np.diag(prior)
        slope = weights @ slopes + prior * (values - origin)[free]
        unit = np.sqrt(np.diag(matrix))
        before = np.log(np.maximum(costs, _FLOOR)).sum()
        for _ in range(6):
            move = np.linalg.solve(matrix / np.outer(unit, unit) + damping * np.eye(len(free)), slope / unit) / unit
            moved = values.copy()
            moved[free] -= move
            after = np.log(np.maximum(_cost(_with(blur, moved), tiles, tapers), _FLOOR)).sum()
            if after < before:
                break
            damping *= 8
        if after >= before:
            break
        blur, damping = _with(blur, moved), max(damping / 8, 1e-6)
        if before - after < tolerance * len(tiles):
            break
    return blur


def _with(blur: LensBlur, values: np.ndarray) -> LensBlur:
    return LensBlur(BlurModel(*map(float, values)), blur.pupil, blur.width_px, blur.height_px)


def _steps(model: BlurModel) -> np.ndarray:
    """Give the steps of the finite differences: a fiftieth of a px or so on the sensor."""
    by_name = {name: 0.05 if name.endswith("px") else 0.02 for name in NAMES}
    by_name |= {"infinity_px": 0.02, "scale_px_mm": 0.003 * model.scale_px_mm}
    by_name |= {name: 0.02 for name in NAMES if name.startswith(("axial", "lateral"))}
    return np.array([by_name[name] for name in NAMES])


def _priors(model: BlurModel) -> np.ndarray:
    """Scales, standard deviations as it were, within which lenses differ; in px they grow with the blur itself."""
    size = abs(model.infinity_px) / 10
    by_name = {name: 1.0 * size for name in NAMES}
    by_name |= {"infinity_px": 10 * size, "scale_px_mm": 5 * model.scale_px_mm}
    by_name |= {name: 2.0 * size for name in ("curvature_px", "curvature4_px", "astigmatism_px")}
    by_name |= {name: 1.5 * size for name in ("spherical_px", "oblique_px", "oblique_tangential_px")}
    colours = [name for name in NAMES if name.startswith("lateral") or name.endswith(("red_px", "blue_px"))]
    by_name |= {name: 0.5 * size for name in colours}
    by_name |= {name: 1.0 * size for name in NAMES if name.startswith("axial")}
    by_name |= {"front_rim_radius": 0.1, "rear_rim_radius": 0.1, "front_rim_shift": 0.15, "rear_rim_shift": 0.15}
    return np.array([by_name[name] for name in NAMES])

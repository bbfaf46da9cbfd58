"""PSF-aware matching: how well two channels agree once each is blurred as the other was.

Halves of a pupil show mirrored blurs, not shifted copies, so no shift aligns two views of a blurred surface. Where the
blur H_k(z) of each channel is known, filtering each with the other's does align them, at the true depth only::

    P = F^-1[ Y_a H_b / q ],   Q = F^-1[ Y_b H_a / q ],   q^2 = (|H_a|^2 + |H_b|^2) / 2 + eps

and D = P - Q is what maximum likelihood over the unknown sharp picture leaves (``docs/equations.md``). The correlation
of P and Q in a window, in two octaves, is the evidence for a depth. Blur changes over the frame, so this runs on tiles.

Noise lowers the correlation, and more so at depths whose blur leaves fine detail standing: seen against noise, more
blur always agrees better. Frequencies that hold none but noise are therefore left out beforehand, at all depths alike.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft

from chromaperture.config import MatcherConfig, PhaseConfig
from chromaperture.disparity.inputs import MatchInputs
from chromaperture.disparity.optimise import Backend, at_pixels, optimise_volume, solver
from chromaperture.disparity.semiglobal import LayerField
from chromaperture.disparity.subpixel import Winner
from chromaperture.errors import InputError
from chromaperture.optics.blur import FieldBlur

_BACKGROUND_PX = 30.0  # what is smoother than this is shading, and only leaks into a tile from its border
_MAX_CORRELATION2 = 0.999
_SILENT = 0.01  # weight of the other pairs below which a tile need not be asked
_LAG_PX = 8.0  # of the lag window: spectra are told apart to a fiftieth of a cycle a px
_GRID = 24  # places along the width at which half disparities are computed, and interpolated between


def match(
    image: np.ndarray,
    inputs: MatchInputs,
    blur: FieldBlur,
    field: LayerField,
    config: MatcherConfig,
    *,
    noise_variance: np.ndarray | None = None,
    backend: Backend = "numba",
) -> Winner:
    """Match one capture with the camera's blur.

    Parameters
    ----------
    image : (H, W, 3) float32, linear RGB
    inputs : MatchInputs
        Of the same image: guide, mask and layers are used.
    blur : FieldBlur
    field : LayerField
        What equal depth means at every pixel, in the layers of the blur: the camera's quality "accurate".
    config : MatcherConfig
        With ``phase`` and ``optimiser``.
    noise_variance : (H, W, 3) float, optional
        Of the image, (white level)^2; where it is not known, nothing is left out for noise.
    backend : {"numba", "reference"}

    Returns
    -------
    Winner
    """
    assert config.phase is not None
    assert config.optimiser is not None
    layers = inputs.layers_px
    usable = np.where(np.isfinite(image), image, np.float32(0))
    likelihood = phase_likelihood(usable, blur, layers, noise_variance=noise_variance, config=config.phase)
    tile = tile_field(blur, layers)
    both = LayerField(tile.offset_px + tile.scale * field.offset_px, tile.scale * field.scale)
    implementation = solver(backend)
    likelihood = implementation.with_half_layers(likelihood)  # cheaper than to filter and correlate as many
    layers = np.linspace(layers[0], layers[-1], likelihood.shape[2])
    likelihood = implementation.at_labels(likelihood, layers, both) * inputs.mask[..., None]
    winner = optimise_volume(likelihood, inputs.guide, layers, config=config.optimiser, backend=backend)
    return at_pixels(winner, field)


def phase_likelihood(
    image: np.ndarray,
    blur: FieldBlur,
    layers_px: np.ndarray,
    *,
    config: PhaseConfig,
    noise_variance: np.ndarray | None = None,
) -> np.ndarray:
    """Log-likelihood of every layer, from the agreement of cross-filtered channels.

    Parameters
    ----------
    image : (H, W, 3) float32, linear RGB, finite
    blur : FieldBlur
        Of the camera that took it.
    layers_px : (D,) float, px
        Half disparities in the middle of the frame, see ``FieldBlur.reference``: they name distances.
    config : PhaseConfig
    noise_variance : (H, W, 3) float, optional
        Of the image, (white level)^2.

    Returns
    -------
    (H, W, D) float32, nats a pixel. A layer means the distance it has in the middle of the pixel's tile: read the
    volume through `tile_field`.

    Raises
    ------
    InputError
        The image is not of the blur's size.
    """
    height, width = image.shape[:2]
    if (width, height) != (blur.width_px, blur.height_px):
        raise InputError(
            f"the camera's blur was fitted for {blur.width_px} x {blur.height_px} px, the image has {width} x {height}"
        )
    tiles = _Tiles(blur, layers_px)
    spectra = tiles.spectra(np.ascontiguousarray(image, np.float32), noise_variance)
    likelihood = _evidence(blur, blur.pairs, tiles, spectra, layers_px, config)
    if blur.other_pairs and config.fallback_weight > 0:
        silent = np.exp(-likelihood.max(axis=0) / np.float32(config.fallback_nats))
        heard = [spectrum if silent[tiles.core_of(corner)].max() > _SILENT else None
                 for corner, spectrum in zip(tiles.corners, spectra, strict=True)]  # fmt: skip
        other = _evidence(blur, blur.other_pairs, tiles, heard, layers_px, config)
        likelihood += np.float32(config.fallback_weight) * silent * other
    return np.ascontiguousarray(np.moveaxis(likelihood, 0, -1))


def tile_field(blur: FieldBlur, layers_px: np.ndarray) -> LayerField:
    """Tell which layer of a pixel's tile has the half disparity that the pixel itself has in a layer.

    Tiles know the blur of their middle only; within one, field curvature moves the depth of equal blur by a tenth
    of a px. Half disparities are a - b / z at every place, so one distance has ``offset + scale * layer``.
    """
    tiles = _Tiles(blur, layers_px)
    columns = np.linspace(0, blur.width_px - 1, _GRID)
    rows = np.linspace(0, blur.height_px - 1, max(2, round(_GRID * blur.height_px / blur.width_px)))
    coarse = np.array([[blur.half_disparity(x, y) for x in columns] for y in rows])
    x = np.arange(blur.width_px, dtype=np.float32) * np.float32((_GRID - 1) / max(blur.width_px - 1, 1))
    y = np.arange(blur.height_px, dtype=np.float32) * np.float32((len(rows) - 1) / max(blur.height_px - 1, 1))
    at_x, at_y = np.meshgrid(x, y)
    own = [cv2.remap(np.ascontiguousarray(coarse[..., i], np.float32), at_x, at_y, cv2.INTER_LINEAR) for i in (0, 1)]
    tile = np.empty((2, blur.height_px, blur.width_px), np.float32)
    for y0, x0 in tiles.corners:
        tile[:, *tiles.core_of((y0, x0))] = np.reshape(blur.half_disparity(*tiles.centre(y0, x0)), (2, 1, 1))
    # a_t - b_t w_t = a - b w with w = (A0 - layer) / B0 of the pixel; back to a layer with w_t = (A0 - layer_t) / B0.
    at_infinity, reference = blur.reference
    scale = own[1] / tile[1]
    offset = at_infinity * (1 - scale) - reference * (tile[0] - own[0]) / tile[1]
    return LayerField(offset.astype(np.float32), scale.astype(np.float32))


def without_shading(image: np.ndarray) -> np.ndarray:
    """Take off what changes slowly over the picture; (H, W, 3) float32."""
    return np.asarray(image - cv2.GaussianBlur(image, (0, 0), _BACKGROUND_PX))


def band_passes(size: int, bands_px: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Differences of two Gaussians as filters of a tile's spectrum; (bands, size, size // 2 + 1) float32."""
    w2 = (2 * np.pi * scipy.fft.fftfreq(size))[:, None] ** 2 + (2 * np.pi * scipy.fft.rfftfreq(size)) ** 2
    return np.stack([np.exp(-w2 * fine**2 / 2) - np.exp(-w2 * coarse**2 / 2) for fine, coarse in bands_px]).astype(
        np.float32
    )


def signal_share(spectrum: np.ndarray, noise_power: np.ndarray) -> np.ndarray:
    """Share of a picture's power that is no noise, at every frequency: Wiener's filter.

    The power spectrum is Blackman and Tukey's estimate: the autocorrelation of the picture under a lag window, which
    tells textures from noise that a single frequency's power, itself random, could not tell.

    Parameters
    ----------
    spectrum : (C, n, n // 2 + 1) complex
    noise_power : (C,) float
        Of white noise at any frequency: the sum of its variance over the n x n pixels.

    Returns
    -------
    (C, n, n // 2 + 1) float32 in [0, 1]
    """
    size = spectrum.shape[1]
    lag2 = np.minimum(np.arange(size), size - np.arange(size)).astype(np.float32) ** 2
    window = np.exp(-(lag2[:, None] + lag2) / np.float32(2 * _LAG_PX**2))
    power = scipy.fft.rfft2(scipy.fft.irfft2(np.abs(spectrum) ** 2, s=(size, size)) * window).real
    noise = np.asarray(noise_power, np.float32)[:, None, None]
    return np.asarray(np.clip(1 - noise / np.maximum(power, noise + np.float32(1e-30)), 0, 1))


@dataclass(frozen=True)
class _TileSpectrum:
    """Spectra of a tile's channels, (3, size, size // 2 + 1), and the share of them that is no noise, alike or 1."""

    channels: np.ndarray
    share: np.ndarray | None = None

    def pair(self, a: int, b: int) -> tuple[np.ndarray, np.ndarray]:
        """Give two channels, both without the frequencies that are noise in either: they must stay comparable."""
        if self.share is None:
            return self.channels[a], self.channels[b]
        both = np.minimum(self.share[a], self.share[b])
        return self.channels[a] * both, self.channels[b] * both


class _Tiles:
    """Cores that cover the frame, each in the middle of a larger tile that leaves room for the blur."""

    def __init__(self, blur: FieldBlur, layers_px: np.ndarray) -> None:
        room = 2 * float(np.abs(layers_px).max()) / blur.reach + 10  # both blurs, and the bands
        self.core = max(40, round(blur.width_px / 12))
        self.size = int(scipy.fft.next_fast_len(self.core + 2 * math.ceil(room), real=True))
        self.size += self.size % 2
        self.margin = (self.size - self.core) // 2
        self.shape = (blur.height_px, blur.width_px)
        self.corners = [
            (y, x) for y in range(0, self.shape[0], self.core) for x in range(0, self.shape[1], self.core)
        ]

    def core_of(self, corner: tuple[int, int]) -> tuple[slice, slice]:
        """Part of the frame that a tile answers for."""
        return slice(corner[0], corner[0] + self.core), slice(corner[1], corner[1] + self.core)

    def centre(self, y0: int, x0: int) -> tuple[float, float]:
        """Middle (x, y) of the part of a core that lies in the frame."""
        y1, x1 = (min(start + self.core, end) for start, end in zip((y0, x0), self.shape, strict=True))
        return (x0 + x1 - 1) / 2, (y0 + y1 - 1) / 2

    def spectra(self, image: np.ndarray, noise_variance: np.ndarray | None) -> list[_TileSpectrum]:
        """Spectra of the tiles of an image, and how much of them is no noise."""
        detail = self._cuts(without_shading(image))
        if noise_variance is None:
            return [_TileSpectrum(scipy.fft.rfft2(cut)) for cut in detail]
        noise = self._cuts(np.where(np.isfinite(noise_variance), noise_variance, 0).astype(np.float32))
        found = []
        for cut, variance in zip(detail, noise, strict=True):
            spectrum = scipy.fft.rfft2(cut)
            found.append(_TileSpectrum(spectrum, signal_share(spectrum, variance.sum(axis=(1, 2)))))
        return found

    def _cuts(self, image: np.ndarray) -> list[np.ndarray]:
        """Give the tiles of an image, (3, size, size) each, with what surrounds their cores."""
        before, after = self.margin, self.margin + self.core
        padded = cv2.copyMakeBorder(image, before, after, before, after, cv2.BORDER_REFLECT_101)
        return [padded[y : y + self.size, x : x + self.size].transpose(2, 0, 1) for y, x in self.corners]


def _evidence(
    blur: FieldBlur,
    pairs: tuple[tuple[int, int], ...],
    tiles: _Tiles,
    spectra: Sequence[_TileSpectrum | None],
    layers_px: np.ndarray,
    config: PhaseConfig,
) -> np.ndarray:
    """Log-likelihood of every layer from some pairs of channels; tiles without a spectrum stay 0; (D, H, W) float32."""
    bands = band_passes(tiles.size, config.bands_px)
    views = [None if spectrum is None else [spectrum.pair(a, b) for a, b in pairs] for spectrum in spectra]
    at_infinity, scale = blur.reference
    evidence = np.empty((len(layers_px), *tiles.shape), np.float32)

    def fill(layer: int) -> None:
        inverse_mm = (at_infinity - layers_px[layer]) / scale
        evidence[layer] = _layer(blur, pairs, tiles, views, inverse_mm, bands, config)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(fill, range(len(layers_px))))
    return evidence


def _layer(
    blur: FieldBlur,
    pairs: tuple[tuple[int, int], ...],
    tiles: _Tiles,
    views: Sequence[list[tuple[np.ndarray, np.ndarray]] | None],
    inverse_mm: float,
    bands: np.ndarray,
    config: PhaseConfig,
) -> np.ndarray:
    """Evidence for one distance; (H, W) float32."""
    core, margin = tiles.core, tiles.margin
    height, width = tiles.shape
    channels = tuple(sorted({k for pair in pairs for k in pair}))
    products = np.zeros((len(pairs), len(bands), 3, height + core, width + core), np.float32)
    inner = np.s_[:, margin : margin + core, margin : margin + core]
    for (y, x), seen in zip(tiles.corners, views, strict=True):
        if seen is None:
            continue
        transfer = dict(
            zip(channels, blur.transfer(*tiles.centre(y, x), inverse_mm, tiles.size, channels), strict=True)
        )
        for i, ((a, b), (view_a, view_b)) in enumerate(zip(pairs, seen, strict=True)):
            q = np.sqrt((np.abs(transfer[a]) ** 2 + np.abs(transfer[b]) ** 2) / 2 + np.float32(config.damping))
            first = scipy.fft.irfft2(view_a * transfer[b] / q * bands)[inner]
            second = scipy.fft.irfft2(view_b * transfer[a] / q * bands)[inner]
            place = products[i, ..., y : y + core, x : x + core]
            place[:, 0], place[:, 1], place[:, 2] = first * second, first**2, second**2
    evidence = np.zeros((height, width), np.float32)
    for pair in products:
        for band, weight in zip(pair, config.band_weights, strict=True):
            cross, power_a, power_b = (
                cv2.GaussianBlur(p[:height, :width], (0, 0), config.window_sigma_px, borderType=cv2.BORDER_REFLECT_101)
                for p in band
            )
            correlation = np.maximum(cross, 0) / np.sqrt(power_a * power_b + np.float32(1e-12))
            evidence -= np.float32(0.5 * weight / len(pairs)) * np.log1p(
                -np.minimum(correlation**2, np.float32(_MAX_CORRELATION2))
            )
    return evidence

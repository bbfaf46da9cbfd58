"""PSF-aware matching: how well two channels agree once each is blurred as the other was.

Halves of a pupil show mirrored blurs, not shifted copies, so no shift aligns two views of a blurred surface. Where the
blur H_k(z) of each channel is known, filtering each with the other's does align them, at the true depth only::

    P = F^-1[ Y_a H_b / q ],   Q = F^-1[ Y_b H_a / q ],   q^2 = (|H_a|^2 + |H_b|^2) / 2 + eps

and D = P - Q is what maximum likelihood over the unknown sharp picture leaves (``docs/equations.md``). The correlation
of P and Q in a window, in two octaves, is the evidence for a depth. Blur changes over the frame: H is taken at nodes
on a grid (``tiles.py``), and P and Q are mixed between them.

Noise lowers the correlation, and more so at depths whose blur leaves fine detail standing: seen against noise, more
blur always agrees better. Frequencies that hold none but noise are therefore left out beforehand, at all depths alike.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import cv2
import numpy as np
import scipy.fft

from chromaperture.config import MatcherConfig, PhaseConfig
from chromaperture.disparity.optimise import Backend, at_pixels, optimise_volume, solver, with_halves
from chromaperture.disparity.semiglobal import LayerField
from chromaperture.disparity.tiles import Nodes, TileSpectrum
from chromaperture.disparity.views import MatchInputs
from chromaperture.disparity.winner import Winner
from chromaperture.errors import InputError
from chromaperture.optics.lens_blur import LensBlur, Rays

_MAX_CORRELATION2 = 0.999
_SILENT = 0.01  # weight of the other pairs below which a tile need not be asked


def match(
    image: np.ndarray,
    inputs: MatchInputs,
    blur: LensBlur,
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
    blur : LensBlur
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
    implementation = solver(backend)
    labels = with_halves(layers)  # cheaper than to filter and correlate as many
    likelihood = implementation.at_labels(likelihood, layers, labels, field, factors=sum(config.phase.band_weights))
    likelihood *= inputs.mask[..., None]
    winner = optimise_volume(likelihood, inputs.guide, labels, config=config.optimiser, backend=backend)
    return at_pixels(winner, field)


def phase_likelihood(
    image: np.ndarray,
    blur: LensBlur,
    layers_px: np.ndarray,
    *,
    config: PhaseConfig,
    noise_variance: np.ndarray | None = None,
) -> np.ndarray:
    """Log-likelihood of every layer, from the agreement of cross-filtered channels.

    Parameters
    ----------
    image : (H, W, 3) float32, linear RGB, finite
    blur : LensBlur
        Of the camera that took it.
    layers_px : (D,) float, px
        Half disparities in the middle of the frame, see ``LensBlur.reference``: they name distances.
    config : PhaseConfig
    noise_variance : (H, W, 3) float, optional
        Of the image, (white level)^2.

    Returns
    -------
    (H, W, D) float32, nats a pixel. A layer means one distance all over the frame.

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
    margin = 2 * float(np.abs(layers_px).max()) / blur.reach + 10  # both blurs, and the bands
    nodes = Nodes(height, width, margin_px=margin)
    spectra = nodes.spectra(np.ascontiguousarray(image, np.float32), noise_variance, noise_margin=config.noise_margin)
    likelihood = _evidence(blur, blur.pairs, nodes, spectra, layers_px, config)
    if blur.other_pairs and config.fallback_weight > 0:
        silent = np.exp(-likelihood.max(axis=2) / np.float32(config.fallback_nats))
        asked = nodes.canvas()
        nodes.in_frame(asked)[:] = silent
        heard = [spectrum if asked[nodes.on_canvas(place)].max() > _SILENT else None
                 for place, spectrum in zip(nodes.places, spectra, strict=True)]  # fmt: skip
        other = _evidence(blur, blur.other_pairs, nodes, heard, layers_px, config)
        other *= np.float32(config.fallback_weight) * silent[..., None]
        likelihood += other
    return likelihood


def _evidence(
    blur: LensBlur,
    pairs: tuple[tuple[int, int], ...],
    nodes: Nodes,
    spectra: Sequence[TileSpectrum | None],
    layers_px: np.ndarray,
    config: PhaseConfig,
) -> np.ndarray:
    """Log-likelihood of every layer from some pairs of channels, 0 where no tile has a spectrum; (H, W, D) float32."""
    channels = tuple(sorted({k for pair in pairs for k in pair}))
    low_pass = _gaussian(nodes.size, _finest(config))  # the same at all depths, hence done once
    tiles = [
        _Tile(
            place, weight, blur.rays(*place, channels), [[v * low_pass for v in spectrum.pair(*pair)] for pair in pairs]
        )
        for place, weight, spectrum in zip(nodes.places, nodes.weights, spectra, strict=True)
        if spectrum is not None
    ]
    at_infinity, scale = blur.reference
    evidence = np.empty((*nodes.shape, len(layers_px)), np.float32)

    def fill(layer: int) -> None:
        inverse_mm = (at_infinity - layers_px[layer]) / scale
        views = _cross_filtered(blur, pairs, channels, nodes, tiles, inverse_mm, config.damping)
        evidence[..., layer] = np.mean([_agreement(p, q, config) for p, q in views], axis=0)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(fill, range(len(layers_px))))
    return evidence


class _Tile(NamedTuple):
    """What of a tile does not depend on the depth tried: its rays, and the spectra of both channels of every pair."""

    place: tuple[float, float]
    weight: np.ndarray
    rays: Rays
    pairs: list[list[np.ndarray]]


def _cross_filtered(
    blur: LensBlur,
    pairs: tuple[tuple[int, int], ...],
    channels: tuple[int, ...],
    nodes: Nodes,
    tiles: Sequence[_Tile],
    inverse_mm: float,
    damping: float,
) -> np.ndarray:
    """P and Q of every pair of channels, at one distance; (pairs, 2, H, W) float32."""
    from chromaperture.disparity.phase_kernels import cross_filter  # compiling starts here, not at import

    canvas = nodes.canvas(len(pairs), 2)
    spectra = np.empty((2, nodes.size, nodes.size // 2 + 1), np.complex64)
    inner = nodes.in_tile()
    for tile in tiles:
        transfer = dict(zip(channels, blur.transfer_of(tile.rays, inverse_mm, nodes.size), strict=True))
        for i, ((a, b), (view_a, view_b)) in enumerate(zip(pairs, tile.pairs, strict=True)):
            cross_filter(view_a, view_b, transfer[a], transfer[b], np.float32(damping), spectra)
            canvas[i, :, *nodes.on_canvas(tile.place)] += scipy.fft.irfft2(spectra)[:, inner, inner] * tile.weight
    return nodes.in_frame(canvas)


def _agreement(first: np.ndarray, second: np.ndarray, config: PhaseConfig) -> np.ndarray:
    """Nats that the correlation of P and Q earns in a window around every pixel, all bands; (H, W) float32."""
    evidence = np.zeros(first.shape, np.float32)
    bands = zip(_bands(first, config), _bands(second, config), config.band_weights, strict=True)
    for p, q, weight in bands:
        cross, power_p, power_q = (_smooth(product, config.window_sigma_px) for product in (p * q, p * p, q * q))
        correlation2 = np.maximum(cross, 0) ** 2 / (power_p * power_q + np.float32(1e-12))
        evidence -= np.float32(0.5 * weight) * cv2.log(1 - np.minimum(correlation2, np.float32(_MAX_CORRELATION2)))
    return evidence


def _bands(picture: np.ndarray, config: PhaseConfig) -> list[np.ndarray]:
    """Differences of Gaussians of a picture that has passed the finest of them; (H, W) float32 each."""
    finest = _finest(config)
    sigmas = {sigma for band in config.bands_px for sigma in band}
    smooth = {s: _smooth(picture, math.sqrt(s**2 - finest**2)) if s > finest else picture for s in sigmas}
    return [smooth[fine] - smooth[coarse] for fine, coarse in config.bands_px]


def _finest(config: PhaseConfig) -> float:
    return min(fine for fine, _ in config.bands_px)


def _smooth(picture: np.ndarray, sigma_px: float) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT_101))


def _gaussian(size: int, sigma_px: float) -> np.ndarray:
    """Give a Gaussian as the filter of a tile's spectrum; (size, size // 2 + 1) float32."""
    w2 = (2 * np.pi * scipy.fft.fftfreq(size))[:, None] ** 2 + (2 * np.pi * scipy.fft.rfftfreq(size)) ** 2
    return np.exp(-w2 * sigma_px**2 / 2).astype(np.float32)

"""Filtering channels with each other's blur, in plain NumPy: the oracle of ``compiled/cross_filter.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.fft

from chromaperture.optics.lens_blur import Rays, point_transforms


class Tile(NamedTuple):
    """The parts of a tile that are the same at all depths; C channels, P pairs of them."""

    rays: Rays  # of the channels
    spectra: np.ndarray  # (P, 2, n, n // 2 + 1) complex64: of both channels of every pair
    inner: slice  # part of the tile, along both axes, that is no margin
    weight: np.ndarray  # (h, w, 2) float32: of that part, alike for P and Q
    place: tuple[slice, slice]  # where it lies on the canvas


def cross_filter(
    tiles: Sequence[Tile],
    channels: np.ndarray,
    defocus_px: np.ndarray,
    canvas: np.ndarray,
    *,
    size_px: int,
    damping: float,
) -> None:
    """Add P and Q of tiles at one distance to a canvas, see ``evidence/blur.py``.

    Parameters
    ----------
    tiles : sequence of Tile
    channels : (P, 2) int
        Of every pair, numbers of the tiles' channels.
    defocus_px : (N, 2) float, px
        How far the distance moves the rays of the pupil's points.
    canvas : (P, H, W, 2) float32
        Is added to.
    size_px : int
        Side of a tile, of n samples.
    damping : float
        eps.
    """
    for tile in tiles:
        samples = tile.spectra.shape[2]
        transfers = point_transforms(tile.rays.at_infinity_px - defocus_px, tile.rays.light, size_px, samples)
        for part, spectra, (a, b) in zip(canvas, tile.spectra, channels, strict=True):
            views = cross_filtered(spectra, (transfers[a], transfers[b]), damping)
            part[tile.place] += tile.weight * views[tile.inner, tile.inner]


def cross_filtered(spectra: np.ndarray, transfers: tuple[np.ndarray, np.ndarray], damping: float) -> np.ndarray:
    """Return P and Q of two channels, (n, n, 2): spectra and transfer functions are half planes, (n, n // 2 + 1)."""
    (a, b), (h_a, h_b) = spectra, transfers
    power = (np.abs(h_a) ** 2 + np.abs(h_b) ** 2) / 2
    gain = 1 / np.sqrt(power + np.float32(damping))
    shape = (len(a), len(a))
    return np.stack([scipy.fft.irfft2(view * gain, s=shape) for view in (a * h_b, b * h_a)], axis=-1)

"""A photograph cut into the tiles in which its blur is taken for constant, without the frequencies that are noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft

_BACKGROUND_PX = 30.0  # what is smoother than this is shading, and only leaks into a tile from its border
_LAG_PX = 8.0  # of the lag window: spectra are told apart to a fiftieth of a cycle a px
_SPACINGS = 9  # of the nodes, along the width
_LEAST_SPACING_PX = 40.0


def without_shading(image: np.ndarray) -> np.ndarray:
    """Take off what changes slowly over the picture; (H, W, 3) float32."""
    return np.asarray(image - cv2.GaussianBlur(image, (0, 0), _BACKGROUND_PX))


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
class TileSpectrum:
    """Spectra of a tile's channels, (3, size, size // 2 + 1), and the share of them that is no noise, alike or 1."""

    channels: np.ndarray
    share: np.ndarray | None = None

    def pair(self, a: int, b: int) -> tuple[np.ndarray, np.ndarray]:
        """Give two channels, both without the frequencies that are noise in either: they must stay comparable."""
        if self.share is None:
            return self.channels[a], self.channels[b]
        both = np.minimum(self.share[a], self.share[b])
        return self.channels[a] * both, self.channels[b] * both


class Nodes:
    """Places (x, y) where the blur is evaluated, up to the frame's border, and a tile around each.

    A tile answers for what surrounds its node as far as the next, fading out on the way: the filter of a pixel is the
    bilinear mix of those of the four nodes around it, so that blur varies as smoothly as in the lens. Beyond that the
    tile has a margin, for what filters bring in from its border.

    Parameters
    ----------
    height_px, width_px : int
        Of the frame.
    margin_px : float
        What filters reach.
    """

    def __init__(self, height_px: int, width_px: int, *, margin_px: float) -> None:
        self.shape = (height_px, width_px)
        spacing = max(_LEAST_SPACING_PX, width_px / _SPACINGS)
        rows, columns = (np.unique(np.linspace(0, n - 1, max(1, round(n / spacing)) + 1)) for n in self.shape)
        steps = [max(1.0, float(axis[-1]) / max(1, len(axis) - 1)) for axis in (rows, columns)]
        self.half = math.ceil(max(steps)) + 1
        self.size = int(scipy.fft.next_fast_len(2 * (self.half + math.ceil(margin_px)), real=True))
        self.size += self.size % 2
        self.places = [(float(x), float(y)) for y in rows for x in columns]
        offsets = np.arange(-self.half, self.half)
        row_weights, column_weights = (
            [np.clip(1 - np.abs(int(node) + offsets - node) / step, 0, 1) for node in axis]
            for axis, step in zip((rows, columns), steps, strict=True)
        )
        self.weights = [np.outer(y, x).astype(np.float32) for y in row_weights for x in column_weights]

    def canvas(self, *shape: int) -> np.ndarray:
        """Give room for the frame and what its tiles have beyond it; (..., H + 2 half, W + 2 half) float32 zeros."""
        return np.zeros((*shape, *(n + 2 * self.half for n in self.shape)), np.float32)

    def on_canvas(self, place: tuple[float, float]) -> tuple[slice, slice]:
        """Part of a canvas that the tile of a node answers for."""
        x, y = map(int, place)
        return slice(y, y + 2 * self.half), slice(x, x + 2 * self.half)

    def in_tile(self) -> slice:
        """Part of a tile, along both axes, that it answers for."""
        return slice(self.size // 2 - self.half, self.size // 2 + self.half)

    def in_frame(self, canvas: np.ndarray) -> np.ndarray:
        """Part of a canvas that is the frame; (..., H, W)."""
        height, width = self.shape
        return canvas[..., self.half : self.half + height, self.half : self.half + width]

    def spectra(
        self, image: np.ndarray, noise_variance: np.ndarray | None, *, noise_margin: float = 1.0
    ) -> list[TileSpectrum]:
        """Spectra of the tiles of an image (H, W, 3), and how much of them is no noise.

        Parameters
        ----------
        image : (H, W, 3) float32
        noise_variance : (H, W, 3) float or None
        noise_margin : float
            Noise counts as this many times its power.
        """
        detail = self._cuts(without_shading(image))
        if noise_variance is None:
            return [TileSpectrum(scipy.fft.rfft2(cut)) for cut in detail]
        noise = self._cuts(np.where(np.isfinite(noise_variance), noise_variance, 0).astype(np.float32))
        found = []
        for cut, variance in zip(detail, noise, strict=True):
            spectrum = scipy.fft.rfft2(cut)
            found.append(TileSpectrum(spectrum, signal_share(spectrum, noise_margin * variance.sum(axis=(1, 2)))))
        return found

    def _cuts(self, image: np.ndarray) -> list[np.ndarray]:
        """Give the tiles of an image, (3, size, size) each."""
        pad, size = self.size // 2, self.size
        padded = cv2.copyMakeBorder(image, pad, pad, pad, pad, cv2.BORDER_REFLECT_101)
        return [padded[int(y) : int(y) + size, int(x) : int(x) + size].transpose(2, 0, 1) for x, y in self.places]

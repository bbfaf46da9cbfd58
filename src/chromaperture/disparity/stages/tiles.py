"""A photograph cut into tiles in which its blur is assumed constant, without the frequencies that are noise.

Without a compiled twin: it is FFTs of SciPy and filters of OpenCV.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft

_BACKGROUND_PX = 30.0  # smoother parts are shading: no period fits into a tile, only its border effects; chosen by hand
_LAG_PX = 8.0  # of the lag window: it resolves spectra to 1 / (2 pi 8) = a fiftieth of a cycle a px
# Of the nodes, along the width: a surface of focus that is curved by 2.5 px of blur errs by 0.02 px between them
# (docs/equations.md, "Layers and fields").
_SPACINGS = 9
_LEAST_SPACING_PX = 40.0  # of the nodes; closer ones would only filter the same pixels more often


def without_shading(image: np.ndarray) -> np.ndarray:
    """Subtract the parts that vary slowly over the picture; (H, W, 3) float32."""
    return np.asarray(image - cv2.GaussianBlur(image, (0, 0), _BACKGROUND_PX))


def high_pass(frequency: np.ndarray) -> np.ndarray:
    """Gain of `without_shading` at frequencies in cycles a px."""
    return np.asarray(-np.expm1(-((2 * np.pi * frequency * _BACKGROUND_PX) ** 2) / 2))


def signal_fraction(spectrum: np.ndarray, noise_power: np.ndarray) -> np.ndarray:
    """Return the fraction of a picture's power that is no noise, at every frequency: Wiener's filter.

    The power spectrum is Blackman and Tukey's estimate: the autocorrelation of the picture under a lag window. The
    power of a single frequency is itself random and would not separate texture from noise.

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
    """Spectra of a tile's channels, (3, size, size // 2 + 1), and the fraction that is no noise, alike or (3, 1, 1)."""

    channels: np.ndarray
    signal: np.ndarray

    def pair(self, a: int, b: int) -> tuple[np.ndarray, np.ndarray]:
        """Return two channels, both without the frequencies that are noise in either: they must stay comparable."""
        both = np.minimum(self.signal[a], self.signal[b])
        return self.channels[a] * both, self.channels[b] * both


class Nodes:
    """Places (x, y) where the blur is evaluated, up to the frame's border, and a tile around each.

    A tile covers the surroundings of its node as far as the next node, with weights that fall linearly to 0: the filter
    of a pixel is the bilinear interpolation of those of the four nodes around it, so that blur varies smoothly. Beyond
    that the tile has a margin of the filters' reach.

    Parameters
    ----------
    height_px, width_px : int
        Of the frame.
    margin_px : float
        Reach of the filters.
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
        """Return zeros for the frame and the parts of its tiles beyond it; (..., H + 2 half, W + 2 half) float32."""
        return np.zeros((*shape, *(n + 2 * self.half for n in self.shape)), np.float32)

    def on_canvas(self, place: tuple[float, float]) -> tuple[slice, slice]:
        """Part of a canvas that the tile of a node covers."""
        x, y = map(int, place)
        return slice(y, y + 2 * self.half), slice(x, x + 2 * self.half)

    def in_tile(self) -> slice:
        """Part of a tile, along both axes, that is not margin."""
        return slice(self.size // 2 - self.half, self.size // 2 + self.half)

    def in_frame(self, canvas: np.ndarray) -> np.ndarray:
        """Part of a canvas that is the frame; (..., H, W)."""
        height, width = self.shape
        return canvas[..., self.half : self.half + height, self.half : self.half + width]

    def spectra(
        self, image: np.ndarray, noise_variance: np.ndarray | None, *, noise_margin: float = 1.0
    ) -> list[TileSpectrum]:
        """Compute the spectra of the tiles of an image, and how much of them is no noise.

        Parameters
        ----------
        image : (H, W, 3) float32
        noise_variance : (H, W, 3) float or None
        noise_margin : float
            Noise counts as this many times its power.
        """
        detail = self._cuts(without_shading(image))
        if noise_variance is None:
            return [TileSpectrum(scipy.fft.rfft2(cut), np.ones((3, 1, 1), np.float32)) for cut in detail]
        noise = self._cuts(np.where(np.isfinite(noise_variance), noise_variance, 0).astype(np.float32))
        found = []
        for cut, variance in zip(detail, noise, strict=True):
            spectrum = scipy.fft.rfft2(cut)
            found.append(TileSpectrum(spectrum, signal_fraction(spectrum, noise_margin * variance.sum(axis=(1, 2)))))
        return found

    def _cuts(self, image: np.ndarray) -> list[np.ndarray]:
        """Return the tiles of an image, (3, size, size) each."""
        pad, size = self.size // 2, self.size
        padded = cv2.copyMakeBorder(image, pad, pad, pad, pad, cv2.BORDER_REFLECT_101)
        return [padded[int(y) : int(y) + size, int(x) : int(x) + size].transpose(2, 0, 1) for x, y in self.places]

"""A photograph cut into tiles in which its blur is assumed constant, without the frequencies that are noise.

Tiles are sampled every `SAMPLING_PX`: finer detail than a quarter of a cycle a px is left out. It tells little of
depth, because blur and noise hide it first, and it costs most of the time (docs/decisions.md, *Time of `accurate`*).

Without a compiled twin: it is FFTs of SciPy and filters of OpenCV.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import scipy.fft

from chromaperture.optics.lens_blur import low_frequencies
from chromaperture.system.threads import parallel_map

BACKGROUND_PX = 30.0  # smoother parts are shading: no period fits into a tile, only its border effects; chosen by hand
SAMPLING_PX = 2.0  # distance of two samples of a tile
LAG_PX = 8.0  # of the lag window: it resolves spectra to 1 / (2 pi 8) = a fiftieth of a cycle a px
# Of the nodes, along the width: a surface of focus that is curved by 2.5 px of blur errs by 0.02 px between them
# (docs/equations.md, "Layers and fields").
_SPACINGS = 9
_LEAST_SPACING_PX = 40.0  # of the nodes; closer ones would only filter the same pixels more often


def without_shading(image: np.ndarray) -> np.ndarray:
    """Subtract the parts that vary slowly over the picture; (H, W, 3) float32."""
    out = np.empty(image.shape, np.float32)

    def subtract(k: int) -> None:
        channel = np.ascontiguousarray(image[..., k], np.float32)
        np.subtract(channel, cv2.GaussianBlur(channel, (0, 0), BACKGROUND_PX), out=out[..., k])

    parallel_map(subtract, range(image.shape[2]))
    return out


def high_pass(frequency: np.ndarray) -> np.ndarray:
    """Gain of `without_shading` at frequencies in cycles a px."""
    return np.asarray(-np.expm1(-((2 * np.pi * frequency * BACKGROUND_PX) ** 2) / 2))


def signal_fraction(spectrum: np.ndarray, noise_power: np.ndarray, *, sampling_px: float = 1.0) -> np.ndarray:
    """Return the fraction of a picture's power that is no noise, at every frequency: Wiener's filter.

    The power spectrum is Blackman and Tukey's estimate: the autocorrelation of the picture under a lag window. The
    power of a single frequency is itself random and would not separate texture from noise.

    ``spectrum`` (C, n, n // 2 + 1) complex; ``noise_power`` (C,) float: of white noise at any frequency: the sum of its
    variance over the pixels; ``sampling_px`` float, px: distance of two samples. Returns (C, n, n // 2 + 1) float32 in
    [0, 1].
    """
    size = spectrum.shape[1]
    lag2 = np.minimum(np.arange(size), size - np.arange(size)).astype(np.float32) ** 2
    window = np.exp(-(lag2[:, None] + lag2) / np.float32(2 * (LAG_PX / sampling_px) ** 2))
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


class NodeAxis(NamedTuple):
    """Nodes along one axis: where the part of each tile that is no margin begins, and the weights of its samples."""

    starts: np.ndarray  # (N,) int
    weights: np.ndarray  # (N, 2 half) float64


class Nodes:
    """Places (x, y) where the blur is evaluated, up to the frame's border, and a tile around each.

    A tile covers the surroundings of its node as far as the next node, with weights that fall linearly to 0: the filter
    of a pixel is the bilinear interpolation of those of the four nodes around it, so that blur varies smoothly. Beyond
    that the tile has a margin of the filters' reach. Sample (i, j) of the frame is at the pixel `SAMPLING_PX` (i, j).

    ``height_px``, ``width_px``: of the frame; ``margin_px``: reach of the filters.

    ``shape`` (int, int): samples of the frame, along y and x; ``half``, ``size``: half the side of a tile without its
    margin, and its whole side; samples; ``places`` list of (float, float): (x, y) of every node, px; ``weights`` list
    of (2 half, 2 half, 2) float32: for P and Q alike; ``down``, ``across``: of which the weights are products.
    """

    def __init__(self, height_px: int, width_px: int, *, margin_px: float) -> None:
        frame = (height_px, width_px)
        self.shape = tuple(int((n - 1) / SAMPLING_PX) + 1 for n in frame)
        spacing = max(_LEAST_SPACING_PX, width_px / _SPACINGS)
        rows, columns = (np.unique(np.linspace(0, n - 1, max(1, round(n / spacing)) + 1)) for n in frame)
        steps = [max(1.0, float(axis[-1]) / max(1, len(axis) - 1)) / SAMPLING_PX for axis in (rows, columns)]
        self.half = math.ceil(max(steps)) + 2  # a tile's middle is up to two samples off its node
        self.size = 4 * scipy.fft.next_fast_len(math.ceil((self.half + int(margin_px / SAMPLING_PX)) / 2), real=True)
        self.places = [(float(x), float(y)) for y in rows for x in columns]
        offsets = np.arange(-self.half, self.half)
        self.down, self.across = (
            NodeAxis(
                np.array([_middle(node) - self.half for node in axis]),
                np.stack(
                    [np.clip(1 - np.abs(_middle(node) + offsets - node / SAMPLING_PX) / step, 0, 1) for node in axis]
                ),
            )
            for axis, step in zip((rows, columns), steps, strict=True)
        )
        self.weights = [
            np.repeat(np.outer(y, x)[..., None], 2, axis=-1).astype(np.float32)
            for y in self.down.weights
            for x in self.across.weights
        ]

    @property
    def size_px(self) -> int:
        """Side of a tile."""
        return round(self.size * SAMPLING_PX)

    def canvas(self, pairs: int) -> np.ndarray:
        """Return zeros for the frame and the parts of its tiles beyond it; (pairs, H + 2 half, W + 2 half, 2)."""
        return np.zeros((pairs, *(n + 2 * self.half for n in self.shape), 2), np.float32)

    def on_canvas(self, place: tuple[float, float]) -> tuple[slice, slice]:
        """Part of a canvas that the tile of a node covers."""
        x, y = map(_middle, place)
        return slice(y, y + 2 * self.half), slice(x, x + 2 * self.half)

    def in_tile(self) -> slice:
        """Part of a tile, along both axes, that is not margin."""
        return slice(self.size // 2 - self.half, self.size // 2 + self.half)

    def in_frame(self, canvas: np.ndarray) -> np.ndarray:
        """Part of a canvas that is the frame; (pairs, H, W, 2)."""
        height, width = self.shape
        return canvas[:, self.half : self.half + height, self.half : self.half + width]

    def spectra(
        self, image: np.ndarray, noise_variance: np.ndarray | None, *, noise_margin: float = 1.0
    ) -> list[TileSpectrum]:
        """Compute the spectra of the tiles of an image, and how much of them is no noise.

        ``image`` (H, W, 3) float32; ``noise_variance`` (H, W, 3) float or None; ``noise_margin``: noise counts as this
        many times its power.
        """
        detail = self.cuts(without_shading(image))
        scale = np.float32(SAMPLING_PX**2)  # a sample keeps the value of its pixel
        powers = None if noise_variance is None else self.noise_powers(noise_variance, noise_margin=noise_margin)

        def of_tile(i: int) -> TileSpectrum:
            columns = scipy.fft.rfft(detail[i])[..., : (self.size + 1) // 2]  # those that are kept
            spectrum = low_frequencies(scipy.fft.fft(columns, axis=1), self.size) / scale
            if powers is None:
                return TileSpectrum(spectrum, np.ones((3, 1, 1), np.float32))
            return TileSpectrum(spectrum, signal_fraction(spectrum, powers[i], sampling_px=SAMPLING_PX))

        return parallel_map(of_tile, range(len(detail)))

    def noise_powers(self, noise_variance: np.ndarray, *, noise_margin: float = 1.0) -> np.ndarray:
        """Power of the noise in the spectrum of every tile, at any frequency; (tiles, 3)."""
        finite = np.where(np.isfinite(noise_variance), noise_variance, 0).astype(np.float32)
        size, pad = self.size_px, self.size_px // 2
        whole = cv2.integral(cv2.copyMakeBorder(finite, pad, pad, pad, pad, cv2.BORDER_REFLECT_101))
        x, y = np.array(self.corners_px).T + pad
        sums = whole[y + size, x + size] - whole[y, x + size] - whole[y + size, x] + whole[y, x]
        # White noise has the same power at the frequencies that are kept; the spectra were scaled.
        return np.asarray(noise_margin * sums / SAMPLING_PX**4)

    @property
    def corners_px(self) -> list[tuple[int, int]]:
        """First pixel (x, y) of every tile; beyond the frame the picture is mirrored."""
        pad = self.size_px // 2
        return [(round(_middle(x) * SAMPLING_PX) - pad, round(_middle(y) * SAMPLING_PX) - pad) for x, y in self.places]

    def cuts(self, image: np.ndarray) -> list[np.ndarray]:
        """Return the tiles of an image, (3, n, n) px each."""
        size, pad = self.size_px, self.size_px // 2
        padded = cv2.copyMakeBorder(image, pad, pad, pad, pad, cv2.BORDER_REFLECT_101)
        return [
            padded[y + pad : y + pad + size, x + pad : x + pad + size].transpose(2, 0, 1) for x, y in self.corners_px
        ]


def _middle(place_px: float) -> int:
    """Sample in the middle of a node's tile: an even one, which lies on a pixel."""
    return 2 * int(place_px / (2 * SAMPLING_PX))

"""What the blur of every layer passes on of a texture's power, as a tapered window sees it.

A window multiplies the picture, so every frequency of its spectrum holds power of the frequencies around it::

    G_jk(f) = sum_f' |T(f - f')|^2  H_j(f') H_k(f')*  f'^(-2 slope)

T is the taper's spectrum. Without it a steep texture's power leaks into frequencies that the blur has emptied, and the
likelihood takes it for less blur. Real pictures leak more than Gaussian textures: edges, slants and borders of objects.
The taper's autocorrelation is therefore cut off, at `_LAG_TAPERS`, which adds side lobes of about 1e-3 of the low
frequencies' power as a floor; with the exact taper, even areas and edges mislead more (docs/decisions.md).
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import sliding_window_view

from chromaperture.matching.execution import Execution
from chromaperture.matching.readable.tiles import high_pass
from chromaperture.optics.lens_blur import LensBlur
from chromaperture.settings.stages import SpectralConfig
from chromaperture.system.threads import parallel_map

# Cycles a px; below lies shading, above, of an open design, noise: .35 was no better (docs/decisions.md).
BAND = (0.04, 0.25)
_LEAKAGE_REACH = 0.08  # cycles a px; four sigmas of |T|^2 of the least taper
_SOFTEST = 0.01  # cycles a px, at which the texture's spectrum levels off: shading is subtracted
_LEAST_TILE_PX = 64  # side of the tile of a point-spread function
_LAG_TAPERS = 31 / 8  # sigmas of the taper at which its autocorrelation is cut off, falling from 0.02 of its peak
_SIDE_TAPERS = 3.0  # half the side of a window, in sigmas of its taper
_NODES_AT_ONCE = 16  # 30 MB
_COLUMNS_AT_ONCE = 256  # of products with waves: small enough to stay in one thread
_SPACINGS = 11  # of the nodes, along the width; a blur of 20 px varies by a tenth of a px between them


class Windows:
    """Tapered windows of a picture, and the frequencies at which they are compared.

    A window is twice as long as the period of its lowest frequency: the taper correlates neighbouring frequencies, and
    half as many tell nearly all.
    """

    def __init__(self, config: SpectralConfig) -> None:
        self.taper_px = config.taper_px
        self.period = 2 * math.ceil(_SIDE_TAPERS * config.taper_px / 2)
        self.side = 2 * self.period
        place = np.arange(self.side) - (self.side - 1) / 2
        along = np.exp(-(place**2) / (2 * config.taper_px**2))
        self.along = along / np.sqrt((along**2).sum())
        fy, fx = scipy.fft.fftfreq(self.period)[:, None], scipy.fft.rfftfreq(self.period)[None]
        radius = np.hypot(fy, fx)
        chosen = (radius >= BAND[0]) & (radius <= BAND[1]) & ~((fx == 0) & (fy < 0))
        self.rows, self.columns = np.nonzero(chosen)
        self.fy, self.fx = scipy.fft.fftfreq(self.period)[self.rows], scipy.fft.rfftfreq(self.period)[self.columns]
        # Frequencies of one window are correlated: so many of them count as one.
        self.redundancy = (self.period / (np.sqrt(2 * np.pi) * config.taper_px)) ** 2
        self.area_px2 = 2 * np.pi * config.taper_px**2  # that a window is worth

    def spectra(self, image: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Compute the spectra of windows around pixels, of unit gain for white noise; (len(rows) * ..., 3, F).

        Products with the few waves of the band, along y and then along x, take a fraction of transforms' time.
        """
        half, waves = self.side // 2, self.waves
        padded = np.pad(image.transpose(2, 0, 1), ((0, 0), (half, half), (half, half)), mode="symmetric")
        taper = self.taper
        out = np.empty((len(rows), len(columns), 3, len(self.rows)), np.complex64)

        def fill(row: int) -> None:
            band = padded[:, rows[row] : rows[row] + self.side]
            along_y = np.empty((3, len(waves), band.shape[2]), np.float32)
            for first in range(0, band.shape[2], _COLUMNS_AT_ONCE):
                part = np.s_[:, :, first : first + _COLUMNS_AT_ONCE]
                np.matmul(waves, band[part], out=along_y[part])
            cuts = sliding_window_view(along_y.reshape(-1, band.shape[2]), self.side, axis=1)[:, columns]
            products = (cuts.transpose(1, 0, 2) @ waves.T).reshape(len(columns), 3, len(waves), len(waves))
            out[row] = self._of_products(products) - products[..., 0, :1] * taper  # less the mean under the taper

        parallel_map(fill, range(len(rows)))
        return out.reshape(-1, 3, len(self.rows))

    @cached_property
    def waves(self) -> np.ndarray:
        """Cosines, then sines, of 0, 1, 2, ... waves a period under the taper; (2 * (K + 1), side) float32."""
        angle = 2 * np.pi / self.period * np.outer(np.arange(self.columns.max() + 1), np.arange(self.side))
        return (self.along * np.concatenate([np.cos(angle), np.sin(angle)])).astype(np.float32)

    @cached_property
    def taper(self) -> np.ndarray:
        """Spectrum of an even picture whose mean under the taper is 1; (F,) complex64."""
        sums = self.waves.sum(axis=1, dtype=float)
        return self._of_products(np.outer(sums, sums) / sums[0] ** 2)

    @cached_property
    def wave_numbers(self) -> tuple[np.ndarray, np.ndarray]:
        """Waves a period of every frequency, along y and x; (F,) int each."""
        return np.rint(self.fy * self.period).astype(np.intp), self.columns

    def _of_products(self, products: np.ndarray) -> np.ndarray:
        """Spectra from products with the waves along y and x, (..., W, W); (..., F) complex64."""
        few = len(self.waves) // 2
        down, x = self.wave_numbers
        y, sign = np.abs(down), np.where(down < 0, -1, 1)
        real = products[..., y, x] - sign * products[..., few + y, few + x]
        imaginary = sign * products[..., few + y, x] + products[..., y, few + x]
        return np.asarray(real - 1j * imaginary, np.complex64)


class SpectralModel:
    """G of every node, slope and layer, for one camera.

    ``layers_px`` (D,) float, px; ``run``: transforms point-spread functions.
    """

    def __init__(
        self, blur: LensBlur, layers_px: np.ndarray, windows: Windows, slopes: tuple[float, ...], run: Execution
    ) -> None:
        self.blur, self.layers_px, self.windows, self.slopes, self.run = blur, layers_px, windows, slopes, run
        widest = 2 * float(np.abs(layers_px).max()) / blur.reach
        lags = 2 * round(_LAG_TAPERS * windows.taper_px) + 2
        least = max(_LEAST_TILE_PX, lags, math.ceil(widest) + windows.period)
        self.size = int(scipy.fft.next_fast_len(least, real=True))
        self.size += self.size % 2
        spacing = max(1.0, blur.width_px / _SPACINGS)
        self.counts = [max(1, round(n / spacing)) + 1 for n in (blur.height_px, blur.width_px)]

    def nodes(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return the nearest node of every window; (len(rows) * len(columns),) int."""
        of_row, of_column = (
            np.rint(place / max(1, n - 1) * (count - 1)).astype(np.intp)
            for place, n, count in zip(
                (rows, columns), (self.blur.height_px, self.blur.width_px), self.counts, strict=True
            )
        )
        return np.asarray((of_row[:, None] * self.counts[1] + of_column).ravel())

    def powers(self) -> np.ndarray:
        """Compute G; (slopes, nodes, D, 9, F) float32, in the order of `readable.spectral_likelihood`."""
        rows, columns = (
            np.linspace(0, n - 1, count)
            for n, count in zip((self.blur.height_px, self.blur.width_px), self.counts, strict=True)
        )
        places = [(x, y) for y in rows for x in columns]
        count, frequencies = len(self.layers_px), len(self.windows.fy)
        out = np.empty((len(self.slopes), len(places), count, 9, frequencies), np.float32)
        even, odd = self._leakage
        for first in range(0, len(places), _NODES_AT_ONCE):
            together = places[first : first + _NODES_AT_ONCE]
            # Products of matrices have threads of their own, and stay out of ours.
            for node, products in enumerate(parallel_map(lambda place: self._products(*place), together), start=first):
                for parts, leakage in (([0, 1, 2, 3, 5, 7], even), ([4, 6, 8], odd)):
                    seen = products[:, parts].reshape(-1, products.shape[2]) @ leakage
                    seen = seen.reshape(count, len(parts), len(self.slopes), frequencies)
                    out[:, node, :, parts] = seen.transpose(1, 2, 0, 3)
        return out

    def _products(self, x: float, y: float) -> np.ndarray:
        """H_j H_k* of every layer at a node, before any leakage; (D, 9, F') float32."""
        at_infinity, scale = self.blur.reference
        rays = self.blur.rays(x, y)
        rows, columns = self._sources
        out = np.empty((len(self.layers_px), 9, len(rows)), np.float32)
        for layer, products in zip(self.layers_px, out, strict=True):
            inverse_mm = (at_infinity - layer) / scale
            transfer = self.blur.transfer_of(rays, inverse_mm, self.size, transform=self.run.point_transforms)
            transfer = transfer[:, rows, columns]
            products[:3] = np.abs(transfer) ** 2
            for n, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
                cross = transfer[i] * transfer[j].conj()
                products[3 + 2 * n], products[4 + 2 * n] = cross.real, cross.imag
        return out

    @cached_property
    def _sources(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies f' of the half plane from which power leaks into the band."""
        fy, fx = scipy.fft.fftfreq(self.size)[:, None], scipy.fft.rfftfreq(self.size)[None]
        rows, columns = np.nonzero(np.hypot(fy, fx) < BAND[1] + _LEAKAGE_REACH)
        return rows, columns

    @cached_property
    def _leakage(self) -> tuple[np.ndarray, np.ndarray]:
        """Leakage times the texture's power, for even and odd parts of spectra; (F', slopes * F) float32 each."""
        rows, columns = self._sources
        fy, fx = scipy.fft.fftfreq(self.size), scipy.fft.rfftfreq(self.size)
        lags = round(_LAG_TAPERS * self.windows.taper_px)
        lag = np.arange(-lags, lags + 1)
        shared = np.correlate(self.windows.along, self.windows.along, "full")[lag + self.windows.side - 1]

        def along(f: np.ndarray, source: np.ndarray) -> np.ndarray:
            gap = 2 * np.pi * (f - source[:, None])
            return np.asarray(np.cos(gap[..., None] * lag) @ shared / self.size)

        direct = along(self.windows.fy, fy)[rows] * along(self.windows.fx, fx)[columns]
        mirrored = along(self.windows.fy, -fy)[rows] * along(self.windows.fx, -fx)[columns]
        mirrored[(columns == 0) | (columns == self.size // 2)] = 0  # the half plane holds these with their mirror
        radius = np.hypot(fy[rows], fx[columns])
        power = (radius[:, None] ** 2 + _SOFTEST**2) ** -np.array(self.slopes) * high_pass(radius)[:, None] ** 2
        inside = (radius > BAND[0]) & (radius < BAND[1])
        power /= power[inside].mean(axis=0)
        even, odd = (
            (np.maximum(direct, 0) + sign * np.maximum(mirrored, 0))[:, None] * power[..., None] for sign in (1, -1)
        )
        return tuple(part.reshape(len(rows), -1).astype(np.float32) for part in (even, odd))

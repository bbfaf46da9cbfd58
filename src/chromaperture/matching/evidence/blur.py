"""Evidence for every layer from channels that are filtered with each other's blur.

Halves of a pupil show mirrored blurs, not shifted copies, so no shift aligns two views of a blurred surface. Where the
blur H_k(z) of each channel is known, filtering each with the other's does align them, at the true depth only::

    P = F^-1[ Y_a H_b / q ],   Q = F^-1[ Y_b H_a / q ],   q^2 = (|H_a|^2 + |H_b|^2) / 2 + eps

and D = P - Q is the residual of maximum likelihood over the unknown sharp picture (``docs/equations.md``). The
correlation of P and Q in a window, in two octaves, is the evidence for a depth. Blur changes over the frame: H is
computed at nodes on a grid (``readable/tiles.py``), and P and Q are interpolated between them.

A wide blur also spreads detail over surroundings that have none: `readable.band_correlation` takes that off where the
settings ask for it.

Noise lowers the correlation, and more so at depths whose blur leaves fine detail: with noise, more blur always agrees
better. Frequencies that hold only noise are therefore left out beforehand, at all depths alike.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft

from chromaperture.matching.execution import Execution
from chromaperture.matching.labels import LabelMap
from chromaperture.matching.readable.cross_filter import Tile
from chromaperture.matching.readable.paths import lagrange_weights
from chromaperture.matching.readable.tiles import SAMPLING_PX, Nodes
from chromaperture.matching.result import NoiseModel
from chromaperture.optics.lens_blur import LensBlur
from chromaperture.settings.stages import CrossFilterConfig
from chromaperture.system.errors import InputError
from chromaperture.system.threads import each_band, parallel_map

# 3.5 nats a band at most: a perfect agreement must not outweigh the whole neighbourhood
MAX_CORRELATION2_OF_BANDS = 0.999
CONTRARY = 0.3  # product of two pairs' correlations; .1 and any finds the same: docs/decisions.md
SPACING_PX = round(2 * SAMPLING_PX)  # of the evidence: windows of sigma 4 px leave nothing finer
# Blur, px at the pupil's edge, up to which every layer is computed: half of them would move walls of sharp texture by
# 0.013 px of half disparity (2.2 px of blur), of less sharp texture by 0.003 px (3.4 px).
SHARP_PX = 4.0
IN_FOCUS_PX = 0.0  # half disparity at which views are hardly blurred: they show whose detail it is
_ROWS = 4  # whose correlations are explained at once: 5 MB at 720 columns stay in the cache; chosen by hand
# Beyond the reach of both blurs, for the tails of damped filters. 10 px make tiles of 180 samples in place of 160
# (720 px wide), and change no surface.
TAILS_PX = 8


@dataclass(frozen=True)
class BlurEvidence:
    """Log-likelihood of every label from the camera's own blur."""

    config: CrossFilterConfig
    blur: LensBlur
    # What equal depth means at every pixel, in the layers of the blur: the camera's quality "accurate".
    label_map: LabelMap
    noise: NoiseModel
    run: Execution

    def at(
        self,
        image: np.ndarray,
        layers_px: np.ndarray,
        labels_px: np.ndarray,
        *,
        noise_variance: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return nats a pixel; (H, W, N).

        Where blur is wide, correlations are computed at every second layer, those of secondary pairs everywhere at
        every fourth and at the last, and interpolated: see `with_midpoints`. Their views lie about half as far apart as
        the widest; twice as many layers where blur is narrow change no surface.
        """
        layers_px = odd_layers(layers_px)
        evens, between = layers_px[::2], layers_px[1::2]
        sharp = self.is_sharp(between)
        primary, few, count = len(self.blur.pairs), len(evens[::2]), len(evens)
        # Else the last layer is one of every fourth; now it is the first of those that follow them.
        at_last = count % 2 == 0
        layers_of = {pair: few + at_last for pair in self.all_pairs[primary:]}
        in_turn = np.concatenate([evens[::2], evens[1::2][::-1], between[sharp]])
        computed = self._correlations(image, in_turn, layers_of, noise_variance)
        likelihood = np.empty((*computed.shape[2:4], len(layers_px)), np.float32)

        def explain(rows: slice) -> None:
            part = np.ascontiguousarray(computed[:, :, rows])
            every_second = np.empty((*part.shape[:-1], count), np.float32)
            every_second[..., ::2] = part[..., :few]
            every_second[:primary, ..., 1::2] = part[:primary, ..., few:count][..., ::-1]
            every_second[primary:, ..., : 2 * few - 1] = with_midpoints(part[primary:, ..., :few])
            if at_last:
                every_second[primary:, ..., -1] = part[primary:, ..., few]
            correlation = with_midpoints(every_second)
            correlation[:primary, ..., 1::2][..., sharp] = part[:primary, ..., count:]
            likelihood[rows] = self._explained(correlation)

        each_band(explain, len(likelihood), rows_a_band=_ROWS)
        return self.run.read_at_labels(
            likelihood, layers_px, labels_px, self.label_map,
            factors=sum(self.config.band_weights), shape=image.shape[:2], spacing_px=SPACING_PX,
        )  # fmt: skip

    def likelihood(self, image: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
        """Compute the log-likelihood of every layer; where the noise is not known nothing is left out for it.

        ``image`` (H, W, 3) float32, linear RGB; ``layers_px`` (D,) float, px: half disparities in the middle of the
        frame, see ``LensBlur.reference``: each means a distance. Returns (ceil(H / 3), ceil(W / 3), D) float32, nats a
        pixel: at every third pixel, from the first on. A layer means one distance all over the frame. Raises
        InputError: the image is not of the blur's size.
        """
        return self._explained(self._correlations(image, layers_px))

    @property
    def all_pairs(self) -> tuple[tuple[int, int], ...]:
        """Primary and, where they count, secondary pairs of channels."""
        return self.blur.pairs + (self.blur.other_pairs if self.config.fallback_weight > 0 else ())

    def _explained(self, correlation: np.ndarray) -> np.ndarray:
        """Nats that the correlations of all pairs and bands earn, (pairs, bands, H, W, D); (H, W, D) float32."""
        evidence = _nats(correlation, self.config.band_weights)
        primary = len(self.blur.pairs)
        likelihood = evidence[:primary].mean(axis=0)
        if len(evidence) > primary:
            weight = np.exp(-likelihood.max(axis=2, keepdims=True) / np.float32(self.config.fallback_nats))
            likelihood += np.float32(self.config.fallback_weight) * weight * evidence[primary:].mean(axis=0)
        return np.asarray(likelihood)

    def known_variance(self, image: np.ndarray, noise_variance: np.ndarray | None = None) -> np.ndarray | None:
        """Return the variance of an image's noise, (H, W, 3), as given or computed; None where it is not known."""
        return self.noise.variance_of(image, noise_variance) if self.noise.is_known else None

    def _correlations(
        self,
        image: np.ndarray,
        layers_px: np.ndarray,
        layers_of: Mapping[tuple[int, int], int] | None = None,
        noise_variance: np.ndarray | None = None,
    ) -> np.ndarray:
        """Correlation of P and Q of every pair of channels, in every band; (pairs, bands, H / 3, W / 3, D) float32.

        ``layers_of`` has pairs for which only so many of the first layers are computed; others hold nothing.
        """
        blur = self.blur
        noise_variance = self.known_variance(image, noise_variance)
        image = np.where(np.isfinite(image), image, np.float32(0))
        self.check_size(image)
        height, width = image.shape[:2]
        nodes = self.nodes(layers_px)
        spectra = nodes.spectra(
            np.ascontiguousarray(image, np.float32), noise_variance, noise_margin=self.config.noise_margin
        )
        low_pass = _gaussian(
            nodes.size, finest_px(self.config) / SAMPLING_PX
        )  # the same at all depths, hence done once

        def of_tile(i: int) -> Tile:
            filtered = [part * low_pass for pair in self.all_pairs for part in spectra[i].pair(*pair)]
            pairs = np.stack(filtered).reshape(-1, 2, *low_pass.shape)
            x, y = nodes.places[i]
            return Tile(blur.rays(x, y), pairs, nodes.in_tile(), nodes.weights[i], nodes.on_canvas((x, y)))

        tiles = parallel_map(of_tile, range(len(spectra)))
        at_infinity, scale = blur.reference
        shape = (len(self.all_pairs), len(self.config.bands_px), -(-height // SPACING_PX), -(-width // SPACING_PX))
        correlation, most = np.empty((len(layers_px), *shape), np.float32), layers_of or {}
        every = tuple(range(len(self.all_pairs)))

        pairs_of = [
            tuple(i for i, pair in enumerate(self.all_pairs) if layer < most.get(pair, len(layers_px)))
            for layer in range(len(layers_px))
        ]
        used = {pairs: self._used(tiles, pairs) for pairs in {*pairs_of, every}}

        def views(layer_px: float, pairs: tuple[int, ...]) -> np.ndarray:
            """P and Q of the frame; (pairs, H, W, 2)."""
            canvas = nodes.canvas(len(pairs))
            defocus = blur.defocus_px((at_infinity - layer_px) / scale)
            self.run.cross_filter(*used[pairs], defocus, canvas, size_px=nodes.size_px, damping=self.config.damping)
            return nodes.in_frame(canvas)

        takes_off = self.config.allowed_growth > 0
        seen = parallel_map(self._powers, views(IN_FOCUS_PX, every)) if takes_off else [[None] * shape[1]] * shape[0]

        def fill(layer: int) -> None:
            pairs = pairs_of[layer]
            for i, both in zip(pairs, views(layers_px[layer], pairs), strict=True):
                self._correlate(both, seen[i], correlation[layer, i])

        parallel_map(fill, range(len(layers_px)))
        return np.moveaxis(correlation, 0, -1)

    def is_sharp(self, layers_px: np.ndarray) -> np.ndarray:
        """Return whether the blur of layers is so narrow that they are all computed; (D,) bool."""
        return np.asarray(np.abs(layers_px) < SHARP_PX * self.blur.reach)

    def nodes(self, layers_px: np.ndarray) -> Nodes:
        """Return the tiles of the frame, whose margin holds both blurs of the widest layer."""
        margin = 2 * float(np.abs(layers_px).max()) / self.blur.reach + TAILS_PX
        return Nodes(self.blur.height_px, self.blur.width_px, margin_px=margin)

    def check_size(self, image: np.ndarray) -> None:
        """Raise InputError where the image is not of the blur's size."""
        (height, width), blur = image.shape[:2], self.blur
        if (width, height) != (blur.width_px, blur.height_px):
            raise InputError(
                f"the camera's blur was fitted for {blur.width_px} x {blur.height_px} px, the image has "
                f"{width} x {height}"
            )

    def _used(self, tiles: list[Tile], pairs: tuple[int, ...]) -> tuple[list[Tile], np.ndarray]:
        """Return tiles with only the channels of some pairs, numbers of `all_pairs`; and their places in these."""
        used, channels = np.unique([self.all_pairs[i] for i in pairs], return_inverse=True)
        if len(pairs) < len(self.all_pairs) or len(used) < len(tiles[0].rays.light):
            tiles = [tile._replace(rays=tile.rays.of(used), spectra=tile.spectra[list(pairs)]) for tile in tiles]
        return tiles, channels.reshape(-1, 2)

    def _correlate(self, both: np.ndarray, seen: Sequence[np.ndarray | None], out: np.ndarray) -> None:
        """Correlate P and Q, (H, W, 2), in windows around every second sample, for every band; (bands, h, w)."""
        (height, width), growth = out.shape[1:], self.config.allowed_growth
        for band, views, own in zip(out, _bands(both, self.config), seen, strict=True):
            correlation = self.run.band_correlation(*views, sigma=self._window, seen=own, allowed_growth=growth)
            band[:] = correlation[:height, :width]

    def _powers(self, both: np.ndarray) -> list[np.ndarray]:
        """Powers of P and Q, (H, W, 2), in the windows of every band."""
        return [self.run.band_powers(*views, sigma=self._window) for views in _bands(both, self.config)]

    @property
    def _window(self) -> float:
        return self.config.window_sigma_px / SAMPLING_PX  # samples


def odd_layers(layers_px: np.ndarray) -> np.ndarray:
    """Return layers, one more if their number is even: every second one is computed, and the last; float64, px."""
    return np.asarray(layers_px[0] + (layers_px[1] - layers_px[0]) * np.arange(len(layers_px) // 2 * 2 + 1))


def with_midpoints(volume: np.ndarray) -> np.ndarray:
    """Interpolate a volume (..., D) halfway between its layers, by a polynomial through six of them; (..., 2 D - 1).

    Correlations are smoother than their squares, which count: those would have to be computed twice as densely.
    """
    count = volume.shape[-1]
    out = np.empty((*volume.shape[:-1], 2 * count - 1), volume.dtype)
    out[..., ::2] = volume
    wide = np.pad(volume, [(0, 0)] * (volume.ndim - 1) + [(2, 2)], mode="reflect", reflect_type="odd")
    weights = (np.float32(weight) for weight in lagrange_weights(np.array(0.5)))
    out[..., 1::2] = sum(weight * wide[..., k : k + count - 1] for k, weight in enumerate(weights))
    return out


def _nats(correlation: np.ndarray, weights: Sequence[float]) -> np.ndarray:
    """Log-likelihood of correlations (pairs, bands, ...) against uncorrelated pictures; (pairs, ...) float32."""
    bands = np.moveaxis(explained_variance(correlation), 1, 0)
    return np.asarray(sum(np.float32(-0.5 * w) * np.log1p(-band) for w, band in zip(weights, bands, strict=True)))


def explained_variance(correlation: np.ndarray) -> np.ndarray:
    """Return the share of variance that pairs of channels explain of each other, bounded; as (pairs, bands, ...).

    Where orange meets blue, one channel rises as another falls: their correlation is negative, and as good a sign.
    The signs of a surface that changes between two colours agree: of three pairs none or two are negative. A negative
    correlation counts as far as the product of the other two is negative, in full from `CONTRARY` on.
    """
    found = np.maximum(correlation, 0) ** 2
    for i in range(len(correlation) if len(correlation) == 3 else 0):
        one, other = (correlation[k] for k in range(3) if k != i)
        contrary = np.clip(one * other / np.float32(-CONTRARY), 0, 1)
        found[i] += contrary * np.minimum(correlation[i], 0) ** 2
    return np.asarray(np.minimum(found, np.float32(MAX_CORRELATION2_OF_BANDS)))


def _bands(picture: np.ndarray, config: CrossFilterConfig) -> list[tuple[np.ndarray, np.ndarray]]:
    """Both Gaussians of every band, of pictures that have passed the finest of them; (H, W, 2) float32 each."""
    finest = finest_px(config)
    sigmas = {sigma for band in config.bands_px for sigma in band}
    smooth = {s: _smooth(picture, math.sqrt(s**2 - finest**2)) if s > finest else picture for s in sigmas}
    return [(smooth[fine], smooth[coarse]) for fine, coarse in config.bands_px]


def finest_px(config: CrossFilterConfig) -> float:
    """Return the sigma of the finest Gaussian of all bands, which is applied once to all depths alike."""
    return min(fine for fine, _ in config.bands_px)


def _smooth(picture: np.ndarray, sigma_px: float) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px / SAMPLING_PX, borderType=cv2.BORDER_REFLECT_101))


def _gaussian(size: int, sigma: float) -> np.ndarray:
    """Return a Gaussian as the filter of a tile's spectrum, sigma in samples; (size, size // 2 + 1) float32."""
    w2 = (2 * np.pi * scipy.fft.fftfreq(size))[:, None] ** 2 + (2 * np.pi * scipy.fft.rfftfreq(size)) ** 2
    return np.exp(-w2 * sigma**2 / 2).astype(np.float32)

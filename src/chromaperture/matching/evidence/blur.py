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
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import scipy.fft

from chromaperture.matching.blocks import block_middles
from chromaperture.matching.execution import Execution
from chromaperture.matching.labels import LabelMap
from chromaperture.matching.readable.cross_filter import Tile
from chromaperture.matching.readable.pair_evidence import Fallback
from chromaperture.matching.readable.tiles import SAMPLING_PX, Nodes
from chromaperture.matching.result import NoiseModel
from chromaperture.optics.lens_blur import LensBlur
from chromaperture.settings.stages import CrossFilterConfig
from chromaperture.system.errors import InputError
from chromaperture.system.threads import parallel_map

SPACING_PX = round(2 * SAMPLING_PX)  # of the evidence: windows of sigma 4 px leave nothing finer
# Blur, px at the pupil's edge, up to which every layer is computed: half of them would move walls of sharp texture by
# 0.013 px of half disparity (2.2 px of blur), of less sharp texture by 0.003 px (3.4 px).
SHARP_PX = 4.0
IN_FOCUS_PX = 0.0  # half disparity at which views are hardly blurred: they show whose detail it is
# Beyond the reach of both blurs, for the tails of damped filters. 10 px make tiles of 180 samples in place of 160
# (720 px wide), and change no surface.
TAILS_PX = 8


class LayerPlan(NamedTuple):
    """Which layers are computed, of an odd number D."""

    layers_px: np.ndarray  # (D,) float64
    computed_px: np.ndarray  # (L,) float64: those of all pairs first
    places: np.ndarray  # (2, D) int: see `readable.pair_evidence`
    of_all_pairs: int


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
        """Return nats a pixel in blocks; (H // 4, W // 4, N).

        Where blur is wide, correlations are computed at every second layer, those of secondary pairs everywhere at
        every fourth and at the last, and interpolated: see `readable/pair_evidence.py`. Their views lie about half as
        far apart as the widest; twice as many layers where blur is narrow change no surface.
        """
        plan = self.plan(layers_px)
        computed = self._correlations(image, plan.computed_px, plan.of_all_pairs, noise_variance)
        likelihood, layers_px = self._explained(computed, plan.places), plan.layers_px
        sampled = (np.arange(0, n, SPACING_PX) for n in image.shape[:2])
        rows, columns = (block_middles(n) / SPACING_PX for n in image.shape[:2])
        return self.run.read_at_labels(
            likelihood, layers_px, labels_px, self.label_map.at(*sampled),
            factors=sum(self.config.band_weights), places=(rows, columns),
        )  # fmt: skip

    def likelihood(self, image: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
        """Compute the log-likelihood of every layer; where the noise is not known nothing is left out for it.

        ``image`` (H, W, 3) float32, linear RGB; ``layers_px`` (D,) float, px: half disparities in the middle of the
        frame, see ``LensBlur.reference``: each means a distance. Returns (ceil(H / 4), ceil(W / 4), D) float32, nats a
        pixel: at every fourth pixel, from the first on. A layer means one distance all over the frame. Raises
        InputError: the image is not of the blur's size.
        """
        every = np.arange(len(layers_px))
        return self._explained(self._correlations(image, layers_px, len(every)), np.stack([every, every]))

    def plan(self, layers_px: np.ndarray) -> LayerPlan:
        """Return which layers are computed."""
        numbers = np.arange(len(layers_px) // 2 * 2 + 1)
        layers_px = layers_px[0] + (layers_px[1] - layers_px[0]) * numbers  # every second one is computed, and the last
        sharp = (numbers % 2 == 1) & (np.abs(layers_px) < SHARP_PX * self.blur.reach)
        of_all = (numbers % 4 == 0) | (numbers == numbers[-1])
        computed = np.concatenate([numbers[of_all], numbers[~of_all & ((numbers % 2 == 0) | sharp)]])
        places = np.full((2, len(layers_px)), -1)
        places[0, computed] = np.arange(len(computed))
        places[1, of_all] = np.arange(of_all.sum())
        return LayerPlan(layers_px, layers_px[computed], places, int(of_all.sum()))

    @property
    def all_pairs(self) -> tuple[tuple[int, int], ...]:
        """Primary and, where they count, secondary pairs of channels."""
        return self.blur.pairs + (self.blur.other_pairs if self.config.fallback_weight > 0 else ())

    def _explained(self, correlation: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Nats that the correlations of layers, (L, pairs, bands, H, W), earn at all layers; (H, W, D) float32."""
        config = self.config
        return self.run.pair_evidence(
            correlation, places, primary=len(self.blur.pairs), band_weights=config.band_weights,
            fallback=Fallback(config.fallback_weight, config.fallback_nats),
        )  # fmt: skip

    def known_variance(self, image: np.ndarray, noise_variance: np.ndarray | None = None) -> np.ndarray | None:
        """Return the variance of an image's noise, (H, W, 3), as given or computed; None where it is not known."""
        return self.noise.variance_of(image, noise_variance) if self.noise.is_known else None

    def _correlations(
        self, image: np.ndarray, layers_px: np.ndarray, of_all_pairs: int, noise_variance: np.ndarray | None = None
    ) -> np.ndarray:
        """Correlation of P and Q of every pair of channels, in every band; (L, pairs, bands, H / 4, W / 4) float32.

        Those of secondary pairs are computed for the first ``of_all_pairs`` layers; others hold nothing.
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
        correlation = np.empty((len(layers_px), *shape), np.float32)
        every, primary = tuple(range(len(self.all_pairs))), tuple(range(len(self.blur.pairs)))
        used = {pairs: self._used(tiles, pairs) for pairs in {every, primary}}

        def views(layer_px: float, pairs: tuple[int, ...]) -> np.ndarray:
            """P and Q of the frame; (pairs, H, W, 2)."""
            canvas = nodes.canvas(len(pairs))
            defocus = blur.defocus_px((at_infinity - layer_px) / scale)
            self.run.cross_filter(*used[pairs], defocus, canvas, size_px=nodes.size_px, damping=self.config.damping)
            return nodes.in_frame(canvas)

        takes_off = self.config.allowed_growth > 0
        seen = parallel_map(self._powers, views(IN_FOCUS_PX, every)) if takes_off else [[None] * shape[1]] * shape[0]

        def fill(layer: int) -> None:
            pairs = every if layer < of_all_pairs else primary
            for i, both in zip(pairs, views(layers_px[layer], pairs), strict=True):
                self._correlate(both, seen[i], correlation[layer, i])

        parallel_map(fill, range(len(layers_px)))
        return correlation

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

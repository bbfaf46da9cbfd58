"""Evidence of all three channels together: a Gaussian texture behind the camera's own blur.

Pairs of channels that are filtered with each other's blur (`blur`) use what blur does to one channel against
another, and throw away what it does to the spectrum of each, and the third channel. The likelihood of a window's
spectra y, given a layer's blur, uses all of it::

    L(z) = -sum_f [ log det C(f, z) + y^H C^-1 y ],   C = S o G + N

with the colours' covariance S estimated in the window for every layer (``readable/spectral_likelihood.py``), and the
slope of the texture's power spectrum drawn from a distribution that is learned over the picture: a known slope tells
how large blur is, a wrong one misleads.

References
----------
P. Trouve, F. Champagnat, G. Le Besnerais et al.: Passive depth estimation using chromatic aberration and a depth from
defocus approach. Applied Optics 52, 2013. doi:10.1364/AO.52.007152 (likelihood of the channels of one image)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np
from scipy.special import logsumexp

from chromaperture.matching.blocks import block_means, block_middles
from chromaperture.matching.evidence.blur import BlurEvidence
from chromaperture.matching.evidence.half_pixels import (
    HalvesModel,
    half_pixel_likelihood,
    noise_of_frequencies,
    of_equal_light,
    sum_and_difference,
)
from chromaperture.matching.evidence.spectral_model import SpectralModel, Windows
from chromaperture.matching.labels import LabelMap
from chromaperture.matching.readable.paths import between_samples, lagrange_weights
from chromaperture.matching.readable.tiles import without_shading
from chromaperture.matching.result import NoiseModel
from chromaperture.settings.stages import CrossFilterConfig, SpectralConfig
from chromaperture.system.threads import parallel_map

EVERY_LAYER = 2  # layers are 0.3 px of blur apart, for small windows; these see half of them
LEAST_LAYERS = 4  # that the interpolation needs
LEARNING_ROUNDS = 10
LEAST_SHARE = 1e-9  # of a slope, before its logarithm


@dataclass(frozen=True)
class SpectralEvidence:
    """Pairs of channels, and all channels together."""

    config: SpectralConfig
    pairs: BlurEvidence  # its blur, noise, labels and execution hold for both
    _powers: dict[bytes, np.ndarray] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def noise(self) -> NoiseModel:
        """Noise of the photographs."""
        return self.pairs.noise

    def at(
        self,
        image: np.ndarray,
        layers_px: np.ndarray,
        labels_px: np.ndarray,
        *,
        noise_variance: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return nats a pixel in blocks; (H // 4, W // 4, N) float32.

        Without known noise those of the pairs alone: faint detail would be noise.
        """
        variance = self.pairs.known_variance(image, noise_variance)

        def of_pairs() -> np.ndarray:
            likelihood = self.pairs.at(image, layers_px, labels_px, noise_variance=variance)
            own = self.own_detail(image, variance)
            return likelihood if own is None else np.multiply(likelihood, own[..., None], out=likelihood)

        def of_windows() -> np.ndarray:
            at_windows = self.of_windows(image, layers_px, labels_px, variance)
            for axis in (0, 1):
                at_blocks = block_middles(image.shape[axis]) / self.config.stride_px
                at_windows = between_samples(at_windows, at_blocks, axis=axis)
            return at_windows

        # Side by side: what either does on one core the other fills up. The calling thread takes the first, which takes
        # longer; other threads help it when they have done the second.
        both = [of_pairs, of_windows]
        likelihood, *more = parallel_map(lambda work: work(), both[: 1 + self.is_used(layers_px)])
        for at_blocks in more:
            likelihood += at_blocks
        return likelihood

    def own_detail(self, image: np.ndarray, noise_variance: np.ndarray | None = None) -> np.ndarray | None:
        """Return how much of the pairs' evidence is a block's own; (h, w) float32, None where all of it counts."""
        pairs = self.pairs
        if not pairs.config.own_detail:
            return None
        variance = pairs.known_variance(image, noise_variance)
        finite = np.where(np.isfinite(image), image, np.float32(0))
        channels = tuple(sorted({k for pair in pairs.blur.pairs for k in pair}))
        return block_means(own_detail(finite, variance, channels, pairs.config))

    def is_used(self, layers_px: np.ndarray) -> bool:
        """Whether all channels together count beside their pairs."""
        enough = len(layers_px[::EVERY_LAYER]) >= LEAST_LAYERS
        return self.config.gain != 0 and self.pairs.noise.is_known and enough

    def of_windows(
        self, image: np.ndarray, layers_px: np.ndarray, labels_px: np.ndarray, noise_variance: np.ndarray | None = None
    ) -> np.ndarray:
        """Return what labels earn in windows around every ``stride_px``-th pixel; (h, w, N) float32, nats a pixel."""
        few_px = layers_px[::EVERY_LAYER]
        rows, columns = (np.arange(0, n, self.config.stride_px) for n in image.shape[:2])
        at_windows = self.at_windows(image, few_px, rows, columns, noise_variance)
        at_windows = _at_labels(at_windows, few_px, labels_px, self.pairs.label_map, rows, columns)
        return _tempered(at_windows, self.config)

    def at_windows(
        self,
        image: np.ndarray,
        layers_px: np.ndarray,
        rows: np.ndarray,
        columns: np.ndarray,
        noise_variance: np.ndarray | None = None,
    ) -> np.ndarray:
        """Compute the log-likelihood of every layer in windows around pixels; (len(rows), len(columns), D), nats a px.

        ``image`` (H, W, 3) float32, linear RGB; ``layers_px`` (D,) float, px; ``rows``, ``columns``: of the windows'
        middles; ``noise_variance`` (H, W, 3) float: of the image; computed where it is not given.
        """
        config, run = self.config, self.pairs.run
        model = self.model(layers_px)
        windows = model.windows
        noise = self.noise_of_windows(self.noise.variance_of(image, noise_variance), rows, columns)
        image = np.where(np.isfinite(image), image, np.float32(0))
        if config.dual_pixel:
            image = of_equal_light(image)
        spectra = windows.spectra(without_shading(image), rows, columns)
        node = model.nodes(rows, columns)
        error = config.channel_error
        if config.dual_pixel:
            likelihood = partial(
                half_pixel_likelihood, sum_and_difference(spectra), node=node, noise=noise[:, 1], channel_error=error,
                of_frequencies=noise_of_frequencies(np.hypot(windows.fy, windows.fx)),
            )  # fmt: skip
        else:
            likelihood = partial(
                run.spectral_likelihood, spectra, node=node, noise=noise, channel_error=error, rounds=config.rounds
            )
        by_slope = np.stack([likelihood(powers=powers) for powers in self.powers_of(model)])
        return (over_slopes(by_slope / windows.redundancy) / windows.area_px2).reshape(len(rows), len(columns), -1)

    def model(self, layers_px: np.ndarray) -> SpectralModel:
        """Return what the blur of layers passes on."""
        kind = HalvesModel if self.config.dual_pixel else SpectralModel
        return kind(self.pairs.blur, layers_px, Windows(self.config), self.config.slopes, self.pairs.run)

    def noise_of_windows(self, noise_variance: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return the power of noise, (H, W, 3), in windows around pixels; (len(rows) * len(columns), 3) float32."""
        variance = np.nan_to_num(np.asarray(noise_variance, np.float32), posinf=0, neginf=0)
        # The mean over the square of a window's taper.
        sigma = self.config.taper_px / math.sqrt(2)
        mean = cv2.GaussianBlur(variance, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
        return np.asarray(mean[np.ix_(rows, columns)].reshape(-1, 3))

    def powers_of(self, model: SpectralModel) -> np.ndarray:
        """Compute the powers of a model, or take those of the last photograph by the same layers."""
        key = model.layers_px.tobytes()
        if key not in self._powers:
            self._powers.clear()
            self._powers[key] = model.powers()
        return self._powers[key]


def over_slopes(by_slope: np.ndarray) -> np.ndarray:
    """Average likelihoods over slopes, by how often each is found in the picture.

    The distribution of the slopes is that of highest likelihood over all windows, by expectation and maximisation.

    ``by_slope`` (B, M, D) float: log-likelihoods, nats. Returns (M, D) float.
    """
    best = by_slope.max(axis=(0, 2), keepdims=True)
    of_slope = logsumexp(by_slope - best, axis=2)  # whatever the layer
    share = np.full(len(by_slope), 1 / len(by_slope))
    for _ in range(LEARNING_ROUNDS):
        logs = np.log(share + LEAST_SHARE)[:, None] + of_slope
        share = np.exp(logs - logsumexp(logs, axis=0)).mean(axis=1)
    return np.asarray(logsumexp(by_slope - best + np.log(share + LEAST_SHARE)[:, None, None], axis=0) + best[0])


def _at_labels(
    volume: np.ndarray,
    layers_px: np.ndarray,
    labels_px: np.ndarray,
    label_map: LabelMap,
    rows: np.ndarray,
    columns: np.ndarray,
) -> np.ndarray:
    """Interpolate windows' log-likelihoods at labels, by a polynomial through six layers; the ends hold beyond them."""
    maps = label_map.at(rows, columns)
    disparity = maps.offset_px[..., None] + maps.scale[..., None] * labels_px
    place = np.clip((disparity - layers_px[0]) / (layers_px[1] - layers_px[0]), 0, len(layers_px) - 1)
    place = np.broadcast_to(place, (*volume.shape[:2], len(labels_px)))
    # Two more layers at either end.
    wide = np.pad(volume, ((0, 0), (0, 0), (2, 2)), mode="reflect", reflect_type="odd")
    out = np.empty(place.shape)

    def interpolate(row: int) -> None:
        below = np.clip(place[row].astype(np.intp), 0, len(layers_px) - 2)
        taps = (np.take_along_axis(wide[row], below + k, axis=1) for k in range(6))
        out[row] = sum(w * tap for w, tap in zip(lagrange_weights(place[row] - below), taps, strict=True))

    parallel_map(interpolate, range(len(out)))
    return out


def _tempered(log_likelihood: np.ndarray, config: SpectralConfig) -> np.ndarray:
    """Limit what the best label earns over the worst to ``cap_nats``; near the best nothing changes."""
    below_best = log_likelihood - log_likelihood.max(axis=2, keepdims=True)
    earned = config.cap_nats * np.exp(config.gain / config.cap_nats * below_best)
    return np.asarray(earned - earned.min(axis=2, keepdims=True), np.float32)


OWN_SIGMA_PX = 1.5  # of the narrow window: 2.7 times narrower than that of the correlation; chosen by hand
_LEAST_POWER = np.float32(1e-14)  # against division by 0


def own_detail(
    image: np.ndarray, noise_variance: np.ndarray | None, channels: tuple[int, ...], config: CrossFilterConfig
) -> np.ndarray:
    """Return the share of its window's evidence that is a pixel's own; (H, W) float32 in [0, 1].

    ``image`` (H, W, 3) float32, linear RGB, finite; ``noise_variance`` (H, W, 3) float: without it nothing is taken off
    for noise; ``channels``: that are correlated.
    """
    fine = min(low for low, _ in config.bands_px)
    coarse = max(high for _, high in config.bands_px)
    power = np.zeros(image.shape[:2], np.float32)
    for k in channels:
        channel = np.ascontiguousarray(image[..., k], np.float32)
        detail = _smooth(channel, fine) - _smooth(channel, coarse)
        power += detail * detail / np.float32(len(channels))
    window = _smooth(power, config.window_sigma_px) + _LEAST_POWER
    own = np.minimum(1, _smooth(power, OWN_SIGMA_PX) / window)
    if noise_variance is None:
        return np.asarray(own, np.float32)
    mean = np.nan_to_num(np.asarray(noise_variance, np.float32)[..., list(channels)].mean(axis=2), posinf=0, neginf=0)
    noise = _smooth(mean, config.window_sigma_px) * np.float32(_power_of_noise(fine, coarse))
    signal = np.maximum(0, 1 - noise / window)
    return np.asarray(own * signal**2, np.float32)


def _power_of_noise(fine_px: float, coarse_px: float) -> float:
    """Share of the power of white noise that the difference of two Gaussians passes."""
    return (fine_px**-2 + coarse_px**-2 - 4 / (fine_px**2 + coarse_px**2)) / (4 * math.pi)


def _smooth(picture: np.ndarray, sigma_px: float) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT_101))
